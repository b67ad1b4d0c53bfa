"""What a command has finished on disk, and what a kill did to it: lost, repeated, different.

`verification/kills.py` kills commands at random moments and looks by these; a command is one line
of `VERBS`.
"""

import json
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import xarray as xr

from calibrate import cli
from calibrate.discrepancy.library import simulate
from calibrate.io.lab import bundled_lab
from calibrate.simulation import NETCDF, Campaign, session
from calibrate.simulation import resolution as presets
from calibrate.simulation.executors import AbstractPlace
from calibrate.simulation.resolution import Preset
from calibrate.simulation.store import Store
from jdem.bodies.spheres import Spheres
from jdem.core.vector import Vector
from jdem.packing.specimen import Packing
from studies.sealed import __main__ as sealed
from studies.sealed import plan, run, trial
from tests import DATA

TINY = Preset("quick", 48, 0.1, 0.2, 2)
STUDY = "withheld"  # no verb: `python -m studies.sealed`, which resumes and writes as verbs do
SEED = 1  # of its cases
CASES = {"none": 1, "above 6": 1}  # 309 in earnest
FEWER = {"DRAWS": 60, "TRAINING": 60}  # 300, 1200 in earnest


@dataclass(frozen=True)
class Verb:
    """A command without --out, what --out names in its folder, its result there."""

    command: tuple[str, ...]
    result: str
    out: str = "."
    takes_lab: bool = True
    before: tuple[str, ...] = ()  # a command that makes ./made, which this one reads
    on_spheres: bool = False  # whether it simulates spheres even where others take formulas

    def arguments(self, folder: Path, dem: bool = False) -> list[str]:
        """The command, with --out; what begins with ./ lies beside the folder that it works in."""
        given = [str(folder.parent / a[2:]) if a[:2] == "./" else a for a in self.command]
        if self.takes_lab and (dem or self.on_spheres):
            given.append(str(low_lab(folder.parent / "low.toml")))
        return [*given, "--out", str(folder / self.out)]


VERBS = {
    "fit": Verb(("fit", "--free", "shear_modulus,surface_energy"), "result.json"),
    "doe": Verb(("doe",), "result.json"),
    "library": Verb(
        ("library", "--packings", "16", "--shaped", "0", "--refined", "0", "--spheres", "120"),
        "library.nc",
        out="library.nc",
    ),
    STUDY: Verb((STUDY,), "withheld.json", takes_lab=False),
}
_LAB = str(DATA / "silt_loam" / "lab.toml")
PAIRED = {  # verbs that write, too, and lose nothing that another kill would not
    "simulate": Verb(("simulate",), "result.json"),
    "audit": Verb(("audit", "--packings", "2", "--spheres", "48", "--strategy", "ensemble"),
                  "audit.json"),
    "view": Verb(("view", "--frames", "4"), "view.json", on_spheres=True),
    "contact": Verb(("contact", "--path-um", "20,2,32,-28"), "contact.json", takes_lab=False),
    "convert": Verb(("convert", str(DATA / "machine_exports" / "two_specimens.xlsx")),
                    "convert.json", takes_lab=False),
    "export": Verb(("export", str(DATA / "fit_result"), "--to", "json", "--diameter", "5 mm"),
                   "soil.json",
                   out="soil.json", takes_lab=False),
    "report": Verb(("report", "./made"), "report.html", takes_lab=False,
                   before=("fit", "--free", "shear_modulus")),
    "diagnose": Verb(("diagnose", _LAB), "result.json", takes_lab=False),
    "next": Verb(("next", _LAB), "next.json", takes_lab=False),
}  # fmt: skip
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


def left_over(folder: Path) -> list[Path]:
    """What is no whole file: left by a writer that was stopped or did not clean up."""
    return [path for path in folder.rglob("*") if ".part" in path.name]


def result_of(path: Path) -> dict:
    """What a command found, from its JSON, HTML or NetCDF file; its own folder is not named."""
    if path.suffix in (".html", ".json"):
        text = path.read_text(encoding="utf-8")
        text = text.replace(str(path.parent), "HERE")
        return {"page": text} if path.suffix == ".html" else without(json.loads(text))
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


class FormulaPlace(AbstractPlace):
    """Runs and packings of formulas; a packing remembers its seed as its height."""

    def slots(self, workers):
        return workers

    def warm_up(self, lab, packing, soil, say):
        pass

    def simulate(self, lab, specimen, packing, soil):
        from tests.support.formulas import specimen as formula

        time.sleep(0.02)
        return formula(soil, round(float(packing.height)) - 1)

    def prepare(self, specimen, seed, soil):
        import jax.numpy as jnp

        places = np.random.default_rng(seed).uniform(size=(specimen.count, 3))
        ones = jnp.ones(specimen.count)
        position = Vector.from_rows(jnp.asarray(places))
        return Packing(position, Spheres(ones, ones), 1.0 + seed, 1.0)


def prepare_process(dem: bool) -> None:
    """Small specimens, few cases and draws, a known seed, and formulas unless `dem`."""
    presets.PRESETS["quick"] = TINY
    for name, count in FEWER.items():
        setattr(trial, name, count)
    plan.COUNTS = CASES
    run.secrets = SimpleNamespace(randbits=lambda bits: SEED)
    if not dem:
        session.HERE = FormulaPlace()
        simulate.Campaign = partial(Campaign, place=FormulaPlace())


def low_lab(path: Path) -> Path:
    """The bundled soil in a mould that 48 spheres fill, pressed with 50 N."""
    text = bundled_lab().read_text(encoding="utf-8")
    for old, new in (('"100 mm"', '"50 mm"'), ('"200 N"', '"25 N"'), ('"400 N"', '"50 N"')):
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return path


def begin(arguments: list[str], dem: bool = False) -> None:
    """The command line in this process, on small specimens."""
    spheres = {name for name, verb in PAIRED.items() if verb.on_spheres}
    prepare_process(dem or arguments[0] in spheres)
    study, sys.argv = arguments[0] == STUDY, ["calibrate", *arguments]
    if study:
        sys.argv = arguments
        cli.run(sealed.app, sealed.NAME, arguments[1:])
    else:
        cli.main()
