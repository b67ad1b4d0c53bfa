"""Kill -9 at random moments: is anything lost, repeated or different in the end?

Each verb runs once without interruption.  In another folder it is killed after a random amount
of processor time and given again, until it ends; then once more in a fresh folder, until
`--kills` kills are done.  After every kill:

    kept        every finished simulation is still there and readable
    unrepeated  no finished simulation was written anew (same file, same time)

and whenever a command got through, its result.json must equal that of the first run, but for
counts of simulations and times.  A verb is one line of `VERBS`.

By default simulations are formulas (tests/formulas.py) of 20 ms, so that kills fall into every
part of a command and not only into the simulation; --dem simulates 48 spheres.

    python benchmarks/kills.py                       some 5 minutes on one core
    python benchmarks/kills.py --dem --verbs fit     some 10 minutes on one core

Writes benchmarks/results/kills.json and .md (kills_dem with --dem).
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
from pathlib import Path

import psutil
import reporting

from calibrate import cli, output, presets
from calibrate.campaign.places import AbstractPlace
from calibrate.campaign.store import Store
from calibrate.measurements import bundled_lab
from calibrate.presets import Preset
from calibrate.report import study
from jdem.packing import Packing
from jdem.particles import Spheres
from jdem.vector import Vector

VERBS = {
    "fit": ["fit", "--free", "shear_modulus,surface_energy"],
    "doe": ["doe"],
}
RESULTS = ("result.json", "audit.json", "diagnosis.json")  # what a verb ends with
DIFFERS = ("simulations", "runtime_s", "particle_steps_per_s", "command")
TINY = Preset("quick", 48, 0.1, 0.2, 2)
FOLDER = reporting.CACHE / "kills"
LOADED = (study,)  # imported before forking, as all of the above


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
            presets.PRESETS["quick"] = TINY
            if not dem:
                output.HERE = FormulaPlace()
            lab = [str(low_lab(folder.parent / "low.toml"))] if dem else []
            sys.argv = ["calibrate", *VERBS[verb], *lab, "--out", str(folder)]
            cli.main()
            sys.stdout.flush()
        os._exit(0)
    except SystemExit as end:
        os._exit(int(end.code or 0))
    except BaseException:
        sys.excepthook(*sys.exc_info())
        os._exit(70)


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
    """Finished simulations, each with what would change if its file were written again."""
    return {
        path.stem: (path.stat().st_ino, path.stat().st_mtime_ns)
        for path in (folder / "runs").glob("*.nc")
    }


def inspected(folder: Path, before: dict, tally: Tally) -> dict:
    """Counts what a kill has lost or a start repeated; what is finished now."""
    after, store = written(folder), Store(folder)
    tally.lost += sum(key not in after or store.run(key) is None for key in before)
    tally.lost += sum(store.run(key) is None for key in after if key not in before)
    tally.repeated += sum(key in after and after[key] != before[key] for key in before)
    return after


def result_of(folder: Path) -> dict:
    name = next(name for name in RESULTS if (folder / name).exists())
    return without(json.loads((folder / name).read_text(encoding="utf-8")))


def without(value):
    """The result but for what may differ between starts."""
    if isinstance(value, dict):
        return {key: without(item) for key, item in value.items() if key not in DIFFERS}
    return [without(item) for item in value] if isinstance(value, list) else value


def tried(verb: str, kills: int, seed: int, dem: bool) -> dict:
    """All kills of one verb."""
    home = FOLDER / verb
    shutil.rmtree(home, ignore_errors=True)
    home.mkdir(parents=True)
    begun, child = os.times(), started(verb, home / "whole", dem)
    if os.waitpid(child, 0)[1]:
        raise SystemExit(f"{verb} fails without being killed: see {home}/whole.log")
    ended = os.times()
    whole = sum(ended[2:4]) - sum(begun[2:4])
    expected, reference = result_of(home / "whole"), written(home / "whole")
    luck, tally = random.Random(seed), Tally()
    while tally.kills < kills:
        folder = home / f"killed-{tally.finished}"
        done: dict = {}
        while True:
            budget = luck.uniform(0.0, whole) if tally.kills < kills else float("inf")
            was_killed = killed(started(verb, folder, dem), budget)
            done = inspected(folder, done, tally)
            tally.kills += was_killed
            print(f"{verb}: {tally}, {len(done)} simulations on disk", file=sys.stderr)
            if not was_killed:
                same = result_of(folder) == expected and set(done) == set(reference)
                tally.finished, tally.different = tally.finished + 1, tally.different + (not same)
                break
    return {"processor_s": whole, "simulations": len(reference), **vars(tally)}


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("--kills", type=int, default=20, help="of each verb")
    options.add_argument("--verbs", nargs="+", choices=list(VERBS), default=list(VERBS))
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--dem", action="store_true", help="simulate 48 spheres")
    chosen = options.parse_args()
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
    name = "kills_dem" if chosen.dem else "kills"
    rows = {}
    for verb in chosen.verbs:
        rows[verb] = tried(verb, chosen.kills, chosen.seed, chosen.dem)
    origin = reporting.provenance()
    header = ["verb", "processor time (s)", "simulations", "kills", "commands that got through"]
    header += ["simulations lost", "repeated", "results that differ"]
    lines = [
        [verb, f"{row['processor_s']:.0f}", *(str(row[key]) for key in list(row)[1:])]
        for verb, row in rows.items()
    ]
    text = "# Kills at random moments\n\n" + reporting.table(header, lines)
    reporting.write(name, {**origin, "verbs": rows}, text + reporting.footer(origin))
    bad = ("lost", "repeated", "different")
    raise SystemExit(any(row[key] for row in rows.values() for key in bad))


if __name__ == "__main__":
    main()
