"""Cases whose effect is withheld: made, sealed, diagnosed, opened, scored.

`plan` draws them, `outside` holds effects outside the library of effects, `laboratory` simulates
and records specimens, `seal` keeps the labels shut, `trial` diagnoses, `scores` and `baselines`
judge.  A diagnosis sees a case's folder and nothing else.  Of cases that were opened, `training`
learns how the diagnosis states probabilities.
"""
