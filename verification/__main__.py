"""Makes the numbers of pages again, the cheapest first, and says which rows hold.

    python -m verification                      all that is not made with the present physics
    python -m verification --most 5             of it what takes at most five processor minutes
    python -m verification --only prior audit   these, whatever made them
    python -m verification --status             runs nothing

What is up to date is left out, and each script keeps its runs, so a second call goes on where the
first was stopped.  Writes verification/results/status.md, after each script.  Exit status 1 if a
script failed or a row that is up to date does not hold.
"""

import argparse
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from calibrate.core.files import write_text
from jdem.physics import PHYSICS
from verification.quick import faults
from verification.reporting import ROOT, Row, Script, table
from verification.rows import README, ROWS
from verification.scripts import SCRIPTS

HEADER = ("row", "page", "state", "made with physics", "on", "what the page says", "holds if",
          "script")  # fmt: skip


def ran(command: str) -> int:
    """Exit status of a command; what it prints is shown."""
    return subprocess.run([sys.executable, *shlex.split(command)[1:]], cwd=ROOT).returncode


def made(
    scripts: Mapping[str, Script], chosen: Sequence[str], most: float, anew: bool,
    root: Path = ROOT, run: Callable[[str], int] = ran,
) -> dict[str, str]:  # fmt: skip
    """Runs scripts that are not up to date (with `anew` all that are chosen), the cheapest first;
    what became of each."""
    due, became = [], {}
    for name in sorted(chosen, key=lambda name: scripts[name].minutes):
        script = scripts[name]
        missing = [program for program in script.needs if not shutil.which(program)]
        if script.is_current(root) and not anew:
            became[name] = "up to date"
        elif missing:
            became[name] = f"needs {', '.join(missing)}"
        elif script.minutes > most:
            became[name] = f"left: takes {script.minutes:g} processor minutes"
        else:
            due.append(name)
    for name, what in became.items():
        print(f"{name}: {what}", flush=True)
    for number, name in enumerate(due, start=1):
        script, begun = scripts[name], time.monotonic()
        about = f"about {script.minutes:g} processor minutes"
        print(f"{number} of {len(due)}: {name}, {about}", flush=True)
        failed = [command for command in script.commands if run(command)]
        became[name] = f"failed: {failed[0]}" if failed else "made"
        write_status(root)
        print(f"{name}: {became[name]}, {time.monotonic() - begun:.0f} s", flush=True)
    return became


def state(row: Row, scripts: Mapping[str, Script], root: Path = ROOT) -> tuple[str, bool]:
    """What can be said of a row, and whether that is bad.  A row that is not up to date is bad only
    if its page says another number."""
    wrong, current = faults(row, root), scripts[row.script].is_current(root)
    if scripts[row.script].origin(root) is None:
        return "no numbers yet", False
    if current:
        return (f"DOES NOT HOLD: {'; '.join(wrong)}" if wrong else "holds"), bool(wrong)
    before = f"did not hold: {'; '.join(wrong)}" if wrong else "held before"
    return f"not made with physics {PHYSICS} yet; {before}", bool(wrong)


def status(rows: Sequence[Row], scripts: Mapping[str, Script], root: Path = ROOT) -> str:
    """The page that says on what each row stands."""
    lines = [_line(row, scripts, root) for row in rows]
    costs = [
        [name, f"{script.minutes:g}", "up to date" if script.is_current(root) else "to be made",
         "; ".join(f"`{command}`" for command in script.commands)]
        for name, script in sorted(scripts.items(), key=lambda item: item[1].minutes)
    ]  # fmt: skip
    return (
        "# What the numbers of pages rest on\n\n"
        f"Each row is a sentence with measured numbers. The present version of the physics is "
        f"{PHYSICS}. `make verification` makes rows again that were made with an earlier one, and "
        "`make verification-quick` measures smaller forms of some in ten minutes. "
        "`python -m verification --status` writes this page.\n\n"
        f"## Rows\n\n{table(HEADER, lines)}\n"
        "## Scripts\n\nThe cheapest first. Minutes are those of one processor, about, from "
        "nothing.\n\n" + table(("script", "minutes", "state", "commands"), costs)
    )  # fmt: skip


def _line(row: Row, scripts: Mapping[str, Script], root: Path) -> list[str]:
    script = scripts[row.script]
    origin = script.origin(root)
    try:
        said = row.sentence(row.numbers(root))
    except (LookupError, ValueError):
        said = "-"
    physics = "any" if not script.physics else origin.physics.split(",")[0] if origin else "-"
    note = f" ({row.note})" if row.note else ""
    return [
        row.name, row.page, state(row, scripts, root)[0], physics + note,
        (origin.date if origin else "") or "-", said.replace("|", "").strip(), row.rule,
        row.script,
    ]  # fmt: skip


def standing(rows: Sequence[Row], scripts: Mapping[str, Script], root: Path = ROOT) -> str:
    """The README's sentence about which of its rows stand on the present physics."""
    names: dict[bool, list[str]] = {True: [], False: []}
    for row in (row for row in rows if row.page == README):
        note = f" ({row.note})" if row.note else ""
        names[scripts[row.script].is_current(root)].append(row.name + note)
    present, earlier = (listed(names[current]) for current in (True, False))
    physics = "stand on the present version of the physics"
    if not earlier:
        return f"All of these {physics}"
    return f"Of these, {present or 'none'} {physics}; {earlier} do not yet"


def listed(names: Sequence[str]) -> str:
    """In words: with commas, and an "and" before the last one."""
    *most, last = names or [""]
    return f"{', '.join(most)} and {last}" if most else last


def write_status(root: Path = ROOT) -> None:
    """verification/results/status.md, from the pages that are there."""
    write_text(root / "verification" / "results" / "status.md", status(ROWS, SCRIPTS, root))


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--only", nargs="+", choices=list(SCRIPTS), help="default: all")
    parser.add_argument("--most", type=float, default=float("inf"), metavar="MINUTES")
    parser.add_argument("--status", action="store_true", help="write the page alone")
    chosen = parser.parse_args()
    became = {}
    if not chosen.status:
        names = chosen.only or list(SCRIPTS)
        became = made(SCRIPTS, names, chosen.most, anew=bool(chosen.only))
    write_status()
    bad = []
    for row in ROWS:
        what, is_bad = state(row, SCRIPTS)
        print(f"{row.name}: {what}")
        bad += [row.name] if is_bad else []
    failed = [name for name, what in became.items() if what.startswith("failed")]
    raise SystemExit(bool(bad or failed))


if __name__ == "__main__":
    main()
