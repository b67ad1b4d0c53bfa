"""Versions of the physics: what results, cached runs and beds are known by.

Laws, effects, boundaries, laboratory tests and the time step are one physics.  A change that
alters their numbers raises PHYSICS, and runs are simulated anew.  A change of round-off alone is
none, as processors differ by as much.  A test compares a few small runs with numbers that are kept
(tests/data/physics.json) and fails where a version should have been raised.

Beds take minutes and most changes do not touch them, so how beds settle and grow has a version of
its own.  Who raises PREPARATION raises PHYSICS as well, so that PHYSICS alone says which numbers a
result has.  Derivatives change no run and no bed; theirs is the third.
"""

PHYSICS = 1  # of runs
PREPARATION = 1  # of beds
DERIVATIVES = 1  # of slopes that JAX takes
