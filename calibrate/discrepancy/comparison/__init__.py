"""Why a calibrated simulation still differs from the soil: one question per file.

`features` and `repeats` turn curves into numbers, `linear` holds what simulations said about
them, `noise` says how far specimens scatter.  Then: `localise` the gap, `compare` its explanations
(`score`, `evidence`, `classes`, `probability_calibration`, `sets`), estimate the `reduction` of the
gap, and the `next_test` that would settle the rest; `verdict` writes it down.  Only numpy and
scipy; no simulation runs in here.  docs/diagnosis.md has the equations.
"""
