"""Laboratory tests: one type of test a file, listed in `calibrate.labtests.composite`.

A new type is one file beside these, with a final class of `calibrate.labtests.base`, and one line
in `TYPES`.
"""
