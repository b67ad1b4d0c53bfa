"""Kill -9 at random moments: is anything lost, repeated or different in the end?

Each command runs once without interruption.  In another folder it is killed after a random
amount of processor time and given again, until it ends; then once more in a fresh folder, until
`--kills` kills are done.  After every kill:

    kept        every finished simulation, case and verdict is still there and readable
    unrepeated  none of them was written anew (same file, same time)

and whenever a command got through, its result must equal that of the first run, but for
counts of simulations and times (`tests.support.pieces`).

A round of pairs gives every command that writes twice at once, in one folder: both end with 0,
with the same result, and nothing is left over.

By default simulations are formulas (tests/support/formulas.py) of 20 ms, so that kills fall into
every part of a command and not only into the simulation; --dem simulates spheres, 48 in fit and
doe.
The library is the smallest there is.  The study of sealed cases (`withheld`) has two, which the
bundled library diagnoses after few draws; its seed, otherwise secret, is given, so that results
compare.

    python -m verification.kills
    python -m verification.kills --dem --verbs fit
    python -m verification.kills --kills 0 --pairs 6

Writes two sections of verification/results/reliability.md; what was killed lies in
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
import traceback
from pathlib import Path

import psutil

from calibrate.discrepancy import diagnosis as diagnosed
from calibrate.reports import study
from studies.sealed import report as withheld_report
from tests.support.pieces import (
    PAIRED,
    VERBS,
    Tally,
    Whole,
    begin,
    inspected,
    left_over,
    result_of,
    written,
)
from verification import reporting

FOLDER = reporting.CACHE / "kills"
LOADED = (diagnosed, study, withheld_report)  # imported before forking, as all of the above


def started(verb: str, folder: Path, dem: bool, number: int = 0) -> int:
    """The verb in a process of its own, of several the one of this number."""
    chosen = (VERBS | PAIRED)[verb]
    return launched(
        chosen.arguments(folder, dem), folder.parent / f"{folder.name}{number or ''}.log", dem
    )


def launched(arguments: list[str], said: Path, dem: bool) -> int:
    """A command in a process of its own (forked before JAX is up, so that it begins at once)."""
    child = os.fork()
    if child:
        return child
    try:
        with said.open("a") as log:
            os.dup2(log.fileno(), 1)
            os.dup2(log.fileno(), 2)
            begin(arguments, dem)
            sys.stdout.flush()
        os._exit(0)
    except SystemExit as end:
        os._exit(int(end.code or 0))
    except BaseException:
        traceback.print_exc()
        os._exit(70)


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


def paired(verb: str, pairs: int, seed: int, dem: bool) -> dict:
    """Pairs of the same command in one folder, the second a random while after the first, every
    other pair in a folder where all runs are there already: how many ended badly or differ."""
    home, chosen = FOLDER / f"{verb} pairs", (VERBS | PAIRED)[verb]
    shutil.rmtree(home, ignore_errors=True)
    home.mkdir(parents=True)
    if chosen.before:
        os.waitpid(
            launched([*chosen.before, "--out", str(home / "made")], home / "made.log", dem), 0
        )
    luck, expected, spent = random.Random(seed), None, 0.0
    found = {"pairs": 0, "failed": 0, "left": 0, "differ": 0}
    for number in range(pairs):
        folder = home / f"pair-{number // 2}"
        folder.mkdir(exist_ok=True)
        begun = time.monotonic()
        first = started(verb, folder, dem, 1)
        time.sleep(luck.uniform(0.0, 0.3 * spent) if number % 2 == 0 else 0.0)
        ends = [os.waitpid(child, 0)[1] for child in (first, started(verb, folder, dem, 2))]
        spent = time.monotonic() - begun
        result = result_of(folder / chosen.result) if not any(ends) else None
        expected = result if expected is None else expected
        found["pairs"] += 1
        found["failed"] += sum(map(bool, ends))
        found["left"] += len(left_over(folder))
        found["differ"] += result != expected
        print(f"{verb}, in pairs: {found}", file=sys.stderr)
    return found


def _with(name: str) -> str:
    """What a heading says of the runs."""
    return ", with spheres" if name.endswith("_dem") else ""


def write_kills(name: str, origin: dict, rows: dict[str, dict]) -> None:
    """What is known so far, commands of earlier calls included."""
    header = ["command", "processor time (s)", "pieces", "kills", "runs that got through"]
    header += ["pieces lost", "repeated", "results that differ", "made by"]
    lines = [
        [verb, f"{row['processor_s']:.0f}", *(str(row[key]) for key in list(row)[1:])]
        for verb, row in rows.items()
    ]
    text = f"# Kills at random moments{_with(name)}\n\n"
    text += "Pieces: finished simulations, cases and verdicts.\n\n"
    text += reporting.table(header, lines)
    reporting.write_content(name, {**origin, "verbs": rows})
    reporting.write_section("reliability", text + reporting.footer(origin))


def write_pairs(name: str, origin: dict, rows: dict[str, dict]) -> None:
    """The same of pairs."""
    header = ["command", "pairs", "processes that failed", "files left over"]
    header += ["results that differ", "made by"]
    lines = [[verb, *(str(cell) for cell in row.values())] for verb, row in rows.items()]
    text = (
        f"# Two processes in one folder{_with(name)}\n\nEvery other pair finds all runs there.\n\n"
    )
    text += reporting.table(header, lines)
    reporting.write_content(name, {**origin, "verbs": rows})
    reporting.write_section("reliability", text + reporting.footer(origin))


def main() -> None:
    options = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    options.add_argument("--kills", type=int, default=20, help="of each verb")
    options.add_argument("--pairs", type=int, default=6, help="of each verb")
    every = list(VERBS | PAIRED)
    options.add_argument("--verbs", nargs="+", choices=every, default=every)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--dem", action="store_true", help="simulate 48 spheres")
    chosen = options.parse_args()
    tail = "_dem" if chosen.dem else ""
    origin = reporting.provenance()
    killed_rows = reporting.earlier(f"kills{tail}", "verbs")
    pair_rows = reporting.earlier(f"pairs{tail}", "verbs")
    for verb in chosen.verbs:
        if chosen.kills and verb in VERBS:
            found = tried(verb, chosen.kills, chosen.seed, chosen.dem)
            killed_rows[verb] = {**found, "made_by": origin["command"]}
            write_kills(f"kills{tail}", origin, killed_rows)
        if chosen.pairs:
            found = paired(verb, chosen.pairs, chosen.seed, chosen.dem)
            pair_rows[verb] = {**found, "made_by": origin["command"]}
            write_pairs(f"pairs{tail}", origin, pair_rows)
    bad = ("lost", "repeated", "different", "failed", "left", "differ")
    every_row = [*killed_rows.values(), *pair_rows.values()]
    raise SystemExit(any(row.get(key) for row in every_row for key in bad))


if __name__ == "__main__":
    main()
