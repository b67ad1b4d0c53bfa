"""Why a calibrated simulation still differs from the soil: one question per file.

`calibrate.labtests.diagnosis` turns curves into numbers, `repeats` joins those of specimens,
`linear` holds what simulations said about them, `noise` how far specimens scatter.  Then:
`localise` the gap, `compare` its explanations (`projection`, `evidence`, `classes`,
`probability_calibration`, `sets`), estimate the `reduction` of the gap, and the `next_test` that
would settle the rest; `verdict` writes it down.  Only numpy and scipy; no simulation runs in here.
docs/diagnosis.md has the equations.
"""
