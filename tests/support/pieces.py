"""What a command has finished on disk, and what a kill did to it: lost, repeated, different.

`benchmarks/kills.py` kills commands at random moments and looks by these; a command is one line of
`VERBS`.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import xarray as xr

from calibrate.simulation import NETCDF
from calibrate.simulation.store import Store


@dataclass(frozen=True)
class Verb:
    """A command without --out, what --out names in its folder, its result there."""

    command: tuple[str, ...]
    result: str
    out: str = "."
    takes_lab: bool = True


VERBS = {
    "fit": Verb(("fit", "--free", "shear_modulus,surface_energy"), "result.json"),
    "doe": Verb(("doe",), "result.json"),
    "bank": Verb(("bank", "--packings", "8", "--spheres", "60"), "bank.nc", out="bank.nc"),
    "withheld": Verb(("withheld",), "withheld.json", takes_lab=False),
}
PIECES = ("runs/*.nc", "sealed/*.attempt", "verdicts/*.json")  # simulations, cases, verdicts
DIFFERS = ("simulations", "runtime_s", "particle_steps_per_s", "command")


@dataclass
class Tally:
    """What was seen over all kills of one verb."""

    kills: int = 0
    finished: int = 0
    lost: int = 0
    repeated: int = 0
    different: int = 0


def written(folder: Path) -> dict[str, tuple[int, int]]:
    """Finished pieces by path, each with what would change if its file were written again."""
    return {
        str(path.relative_to(folder)): (path.stat().st_ino, path.stat().st_mtime_ns)
        for piece in PIECES
        for path in folder.rglob(piece)
    }


def readable(path: Path) -> bool:
    """Whether a finished piece is whole."""
    if path.suffix == ".nc":
        return Store(path.parents[1]).run(path.stem) is not None
    try:
        json.loads(path.read_text(encoding="utf-8"))  # an attempt is a number
    except (OSError, ValueError):
        return False
    return True


def inspected(folder: Path, before: dict, tally: Tally) -> dict:
    """Counts what a kill has lost or a start repeated; what is finished now."""
    after = written(folder)
    tally.lost += len(before.keys() - after.keys())
    tally.lost += sum(not readable(folder / path) for path in after)
    tally.repeated += sum(path in after and after[path] != before[path] for path in before)
    return after


def result_of(path: Path) -> dict:
    """What a command found, from its JSON or NetCDF file."""
    if path.suffix == ".json":
        return without(json.loads(path.read_text(encoding="utf-8")))
    with xr.open_dataset(path, engine=NETCDF) as data:
        return without(data.load().to_dict())


def without(value):
    """The result but for what may differ between starts."""
    if isinstance(value, dict):
        return {key: without(item) for key, item in value.items() if key not in DIFFERS}
    return [without(item) for item in value] if isinstance(value, list) else value


@dataclass(frozen=True)
class Whole:
    """The undisturbed run: processor time (s), result, finished pieces."""

    processor_s: float
    result: dict
    pieces: frozenset[str]

    def equals(self, verb: str, folder: Path) -> bool:
        """Whether a command that was killed ended with the same result and pieces."""
        return self.pieces == written(folder).keys() and self.result == result_of(
            folder / VERBS[verb].result
        )
