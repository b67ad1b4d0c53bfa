"""Kill -9 at random moments: is anything lost, repeated or different in the end?

Each command runs once without interruption.  In another folder it is killed after a random
amount of processor time and given again, until it ends; then once more in a fresh folder, until
`--kills` kills are done.  After every kill:

    kept        every finished simulation, case and verdict is still there and readable
    unrepeated  none of them was written anew (same file, same time)

and whenever a command got through, its result must equal that of the first run, but for
counts of simulations and times.  A command is one line of `VERBS`.

By default simulations are formulas (tests/formulas.py) of 20 ms, so that kills fall into every
part of a command and not only into the simulation; --dem simulates spheres, 48 in fit and doe.
The bank is the smallest there is, `withheld` has two cases that the bundled bank diagnoses after
few draws; its seed, otherwise secret, is given, so that results can be compared.

    python benchmarks/kills.py
    python benchmarks/kills.py --dem --verbs fit

Writes benchmarks/results/kills.json and .md (kills_dem with --dem); what was killed lies in
results/benchmarks/kills, with a log of each folder.
"""

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import psutil
import reporting
import xarray as xr

from calibrate import cli
from calibrate.discrepancy import diagnosis as diagnosed
from calibrate.discrepancy.library import simulate
from calibrate.io.lab import bundled_lab
from calibrate.reports import study
from calibrate.reports import withheld as withheld_report
from calibrate.simulation import NETCDF, Campaign, session
from calibrate.simulation import resolution as presets
from calibrate.simulation.executors import AbstractPlace
from calibrate.simulation.resolution import Preset
from calibrate.simulation.store import Store
from calibrate.validation import plan, run, trial
from jdem.bodies.spheres import Spheres
from jdem.core.vector import Vector
from jdem.packing.settling import Packing


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
TINY = Preset("quick", 48, 0.1, 0.2, 2)
SEED = 1  # of the withheld cases
CASES = {"none": 1, "above 6": 1}  # 309 in earnest
FEWER = {"DRAWS": 60, "TRAINING": 60}  # 300, 1200 in earnest
FOLDER = reporting.CACHE / "kills"
LOADED = (diagnosed, study, withheld_report)  # imported before forking, as all of the above


class FormulaPlace(AbstractPlace):
    """Runs and packings of formulas; a packing remembers its seed as its height."""

    def slots(self, workers):
        return workers

    def warm_up(self, lab, packing, soil, say):
        pass

    def simulate(self, lab, specimen, packing, soil):
        from formulas import specimen as formula

        time.sleep(0.02)
        return formula(soil, round(float(packing.height)) - 1)

    def prepare(self, specimen, seed, soil):
        import jax.numpy as jnp

        ones = jnp.ones(specimen.count)
        return Packing(Vector(ones, ones, ones), Spheres(ones, ones), 1.0 + seed, 1.0)


def started(verb: str, folder: Path, dem: bool) -> int:
    """The verb in a process of its own (forked before JAX is up, so that it begins at once)."""
    child = os.fork()
    if child:
        return child
    try:
        with (folder.parent / f"{folder.name}.log").open("a") as log:
            os.dup2(log.fileno(), 1)
            os.dup2(log.fileno(), 2)
            prepare_process(dem)
            chosen = VERBS[verb]
            lab = [str(low_lab(folder.parent / "low.toml"))] if dem and chosen.takes_lab else []
            sys.argv = ["calibrate", *chosen.command, *lab, "--out", str(folder / chosen.out)]
            cli.main()
            sys.stdout.flush()
        os._exit(0)
    except SystemExit as end:
        os._exit(int(end.code or 0))
    except BaseException:
        sys.excepthook(*sys.exc_info())
        os._exit(70)


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


def processor_time(child: int) -> float:
    """Seconds of processor time that a child has used; infinite once it has ended."""
    try:
        process = psutil.Process(child)
        ended = process.status() == psutil.STATUS_ZOMBIE
        return float("inf") if ended else sum(process.cpu_times()[:2])
    except psutil.NoSuchProcess:
        return float("inf")


def killed(child: int, budget: float) -> bool:
    """Kills the child once it has used its budget; False if it ended before."""
    while processor_time(child) < budget:
        time.sleep(0.005)
    with contextlib.suppress(ProcessLookupError):
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        return True
    if os.WEXITSTATUS(status):
        raise SystemExit(f"the command failed by itself with status {os.WEXITSTATUS(status)}")
    return False


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


def undisturbed(verb: str, folder: Path, dem: bool) -> Whole:
    """Runs the verb without a kill."""
    begun, child = os.times(), started(verb, folder, dem)
    if os.waitpid(child, 0)[1]:
        raise SystemExit(f"{verb} fails without being killed: see {folder}.log")
    ended = os.times()
    processor_s = sum(ended[2:4]) - sum(begun[2:4])
    return Whole(processor_s, result_of(folder / VERBS[verb].result), frozenset(written(folder)))


def tried(verb: str, kills: int, seed: int, dem: bool) -> dict:
    """All kills of one verb."""
    home = FOLDER / verb
    shutil.rmtree(home, ignore_errors=True)
    home.mkdir(parents=True)
    whole = undisturbed(verb, home / "whole", dem)
    luck, tally = random.Random(seed), Tally()
    while tally.kills < kills:
        folder = home / f"killed-{tally.finished}"
        done, was_killed = {}, True
        while was_killed:
            budget = luck.uniform(0.0, whole.processor_s) if tally.kills < kills else float("inf")
            was_killed = killed(started(verb, folder, dem), budget)
            done = inspected(folder, done, tally)
            tally.kills += was_killed
            print(f"{verb}: {tally}, {len(done)} pieces on disk", file=sys.stderr)
        tally.finished += 1
        tally.different += not whole.equals(verb, folder)
        print(f"{verb}: got through, {tally}", file=sys.stderr)
    return {"processor_s": whole.processor_s, "pieces": len(whole.pieces), **vars(tally)}


def write(name: str, origin: dict, rows: dict[str, dict]) -> None:
    """What is known so far, commands of earlier calls included."""
    header = ["command", "processor time (s)", "pieces", "kills", "runs that got through"]
    header += ["pieces lost", "repeated", "results that differ", "made by"]
    lines = [
        [verb, f"{row['processor_s']:.0f}", *(str(row[key]) for key in list(row)[1:])]
        for verb, row in rows.items()
    ]
    text = "# Kills at random moments\n\nPieces: finished simulations, cases and verdicts.\n\n"
    text += reporting.table(header, lines)
    reporting.write(name, {**origin, "verbs": rows}, text + reporting.footer(origin))


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("--kills", type=int, default=20, help="of each verb")
    options.add_argument("--verbs", nargs="+", choices=list(VERBS), default=list(VERBS))
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--dem", action="store_true", help="simulate 48 spheres")
    chosen = options.parse_args()
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
    name = "kills_dem" if chosen.dem else "kills"
    origin, rows = reporting.provenance(), reporting.earlier(name, "verbs")
    for verb in chosen.verbs:
        found = tried(verb, chosen.kills, chosen.seed, chosen.dem)
        rows[verb] = {**found, "made_by": origin["command"]}
        write(name, origin, rows)
    bad = ("lost", "repeated", "different")
    raise SystemExit(any(row[key] for row in rows.values() for key in bad))


if __name__ == "__main__":
    main()
