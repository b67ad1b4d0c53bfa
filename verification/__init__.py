"""What the sentences with measured numbers in README and pages rest on, made again on request.

Scripts run as `python -m verification.NAME` from a checkout and write verification/results.  Rows
(`verification.rows`) tie sentences to numbers there; `python -m verification` makes them.
"""
