"""Kill -9 at random moments: is anything lost, repeated or different in the end?

Each command runs once without interruption.  In another folder it is killed after a random
amount of processor time and given again, until it ends; then once more in a fresh folder, until
`--kills` kills are done.  After every kill:

    kept        every finished simulation, case and verdict is still there and readable
    unrepeated  none of them was written anew (same file, same time)

and whenever a command got through, its result must equal that of the first run, but for
counts of simulations and times (`support.pieces`).

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
import os
import random
import shutil
import signal
import sys
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import psutil
import reporting

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from support.pieces import VERBS, Tally, Whole, inspected, result_of, written

from calibrate import cli
from calibrate.discrepancy import diagnosis as diagnosed
from calibrate.discrepancy.library import simulate
from calibrate.io.lab import bundled_lab
from calibrate.reports import study
from calibrate.reports import withheld as withheld_report
from calibrate.simulation import Campaign, session
from calibrate.simulation import resolution as presets
from calibrate.simulation.executors import AbstractPlace
from calibrate.simulation.resolution import Preset
from calibrate.validation import plan, run, trial
from jdem.bodies.spheres import Spheres
from jdem.core.vector import Vector
from jdem.packing.specimen import Packing

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
