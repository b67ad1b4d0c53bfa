"""Calibrated parameters in the words of other programs: LIGGGHTS, EDEM, YADE, JSON.

`source` reads them from a fit or a lab file, `notes` says what every export says beside the
numbers, each program has one file, and `composite` lists them.
"""
