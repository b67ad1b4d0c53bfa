"""Cases whose effect is withheld: made, sealed, diagnosed, opened, scored.

`plan` draws them, `outside` holds effects outside the library of effects, `laboratory` simulates
and records specimens, `seal` keeps the labels shut, `trial` diagnoses, `scores` and `rivals`
judge.  A diagnosis sees a case's folder and nothing else.
"""
