"""Why a calibrated simulation still differs from the soil: one question per file.

`features` and `repeats` turn curves into numbers, `linear` holds what simulations said about
them, `noise` says how far specimens scatter.  Then: `where` the gap lies, `which` effect it
is (`score`, `evidence`, `classes`, `opinion`, `sets`), `how_far` it shrinks, and the
`next_test` that would settle the rest; `verdict` writes it down.  Only numpy and scipy; no
simulation runs in here.  docs/diagnosis.md has the equations.
"""
