"""The settled beds that ship with the package: those of bundled soils that a first command needs.

    python benchmarks/beds.py                    three minutes, beside two other jobs

Which beds: all that `simulate` and `fit` take with seed 0 at the preset quick, and those that
`simulate` takes at standard.  They are kept by the hash of all that they depend on, the engine's
source too: after a change of `jdem` none of them is found, beds settle as any other's do, and
tests/test_beds.py asks for this command.
"""

import shutil

from calibrate.core.progress import for_terminal
from calibrate.core.runtime import configure
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.simulation.resolution import PRESETS
from calibrate.simulation.specimens import Seeds, campaign
from calibrate.simulation.store import SHIPPED

SOILS = ("wheat_after_rice", "trumao")


def seeds(preset: str) -> tuple[int, ...]:
    """Seeds of the beds that ship at a preset."""
    every = Seeds.of(0, PRESETS[preset].packings)
    return every.scatter if preset == "quick" else every.fitted


def main() -> None:
    configure()
    shutil.rmtree(SHIPPED.folder, ignore_errors=True)
    for soil in SOILS:
        for preset in ("quick", "standard"):
            lab = load_lab(bundled_lab(soil))
            work = campaign(lab, PRESETS[preset], SHIPPED.folder, for_terminal())
            work.packings(seeds(preset))
    shutil.rmtree(SHIPPED.folder / "claims", ignore_errors=True)


if __name__ == "__main__":
    main()
