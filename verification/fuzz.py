"""Malformed files through the program: is there ever a traceback?

    lab       `calibrate fit LAB` on a lab file that had an accident
    curve     the same on a good lab file one of whose curves had an accident
    export    `calibrate convert FILE` on a testing machine's export that had an accident

Each is repeated with fresh accidents until `--refused` of them have been refused: exit status
2 and one line on standard error.  Accidents that leave a usable file (exit status 0) are counted
beside them; anything else, a traceback above all, is kept in results/benchmarks/fuzz and fails
(`tests.support.malformed`).
The program runs in this process without simulating; `--processes` cases of each kind run again
as real processes.

    python -m verification.fuzz                   about 5 minutes on one core

Writes a section of verification/results/reliability.md.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from tests.support.malformed import KINDS, Case, command_for, fuzzed, laid_out, verdict
from verification import reporting

STRANGE = reporting.CACHE / "fuzz"  # files that were neither read nor refused


def as_process(kind: str, case: Case) -> str:
    """The verdict on a real process."""
    with tempfile.TemporaryDirectory() as home:
        laid_out(Path(home), case)
        command = [sys.executable, "-m", "calibrate", *command_for(kind, case[0])]
        done = subprocess.run(command, cwd=home, capture_output=True, text=True)
    return verdict(done.returncode, done.stderr)


def main() -> None:
    options = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    options.add_argument("--refused", type=int, default=300, help="of each kind")
    options.add_argument("--processes", type=int, default=3, help="of each kind")
    options.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    options.add_argument("--seed", type=int, default=1)
    chosen = options.parse_args()
    reporting.configure()
    shutil.rmtree(STRANGE, ignore_errors=True)
    origin, rows = reporting.provenance(), reporting.earlier("fuzz", "kinds")
    for number, kind in enumerate(KINDS):
        if kind not in chosen.kinds:
            continue
        counts, first = fuzzed(kind, chosen.refused, chosen.seed + number, STRANGE)
        real = Counter(as_process(kind, case) for case in first[: chosen.processes])
        rows[kind] = {
            "made": counts.total(),
            "refused": counts["refused"],
            "still_usable": counts["read"],
            "strange": counts["strange"],
            "processes": sum(real.values()),
            "processes_refused": real["refused"],
            "command": origin["command"],
        }
        print(kind, rows[kind], file=sys.stderr)
    header = ["file", "made", "refused (status 2, one line)", "still usable (status 0)"]
    header += ["traceback or other status", "real processes", "of these refused", "made by"]
    lines = [[kind, *(str(number) for number in row.values())] for kind, row in rows.items()]
    text = "# Malformed files\n\n" + reporting.table(header, lines) + reporting.footer(origin)
    reporting.write_content("fuzz", {**origin, "kinds": rows})
    reporting.write_section("reliability", text)
    raise SystemExit(any(row["strange"] for row in rows.values()))


if __name__ == "__main__":
    main()
