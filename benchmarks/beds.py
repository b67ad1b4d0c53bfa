"""The settled beds that ship with the package: those of bundled soils that a first command needs.

    python benchmarks/beds.py                    three minutes, beside two other jobs

Which beds: `support.shipped_beds`.  They are kept by the hash of all that they depend on, the
engine's source too: after a change of `jdem` none of them is found, beds settle as any other's do,
and tests/test_beds.py asks for this command.
"""

import shutil
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from support.shipped_beds import SOILS, seeds

from calibrate.core.progress import for_terminal
from calibrate.core.runtime import configure
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.simulation.resolution import PRESETS
from calibrate.simulation.specimens import campaign
from calibrate.simulation.store import SHIPPED


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
