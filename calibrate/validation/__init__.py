"""Cases whose effect is withheld: made, sealed, diagnosed, opened, scored.

`plan` draws them, `outside` holds effects that the library does not have, `laboratory` simulates
and records specimens, `seal` keeps the labels shut, `trial` diagnoses, `scores` and `rivals`
judge.  A diagnosis sees a case's folder and nothing else.
"""
