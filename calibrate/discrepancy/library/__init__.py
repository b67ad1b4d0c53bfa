"""A library of runs, made once and shared by all diagnoses of soils of one kind.

`design` says which soils, settings and effects are simulated on which packings, `simulate`
runs them (resumable) and keeps every feature of every curve, `emulator` fits the processes of
`calibrate.response` to them, `description` hands values and slopes to `discrepancy.comparison` at
any point.  docs/diagnosis.md.
"""
