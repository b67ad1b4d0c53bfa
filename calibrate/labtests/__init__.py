"""Laboratory tests: one type of test per file, `TYPES` lists them.

A new type is one file beside this one, with a final class of `calibrate.labtests.base`, and one
line in `calibrate.labtests.composite`.
"""
