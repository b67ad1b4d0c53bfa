"""Which settled beds ship with the package: those that a first command on a bundled soil needs.

All that `simulate` and `fit` take with seed 0 at the preset quick, and those that `simulate` takes
at standard; `benchmarks/beds.py` makes them.
"""

from calibrate.simulation.resolution import PRESETS
from calibrate.simulation.specimens import Seeds

SOILS = ("wheat_after_rice", "trumao")


def seeds(preset: str) -> tuple[int, ...]:
    """Seeds of the beds that ship at a preset."""
    every = Seeds.of(0, PRESETS[preset].packings)
    return every.scatter if preset == "quick" else every.fitted
