"""How long a user waits for the first result: `calibrate simulate --preset quick`, wall time.

    python benchmarks/startup.py               about 3 minutes on two idle cores

Each round takes the command through three states of a home folder of its own:

    nothing kept         as after installing
    programs kept        compiled programs are in the user's cache, results go to a new folder
    packings kept too    another soil in the same folder

Writes a section of benchmarks/results/README.md.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import reporting

COMMAND = ("simulate", "--preset", "quick")
OTHER_SOIL = ("--set", "static_friction=0.55")
ASKED = {"nothing kept": 30.0, "programs kept": 10.0}  # s
STATES = ("nothing kept", "programs kept", "packings kept too")


def one_round() -> dict[str, float]:
    """Seconds by state."""
    home = Path(tempfile.mkdtemp(prefix="startup"))
    try:
        first, second = home / "first", home / "second"
        return {
            "nothing kept": seconds(home, first),
            "programs kept": seconds(home, second),
            "packings kept too": seconds(home, second, *OTHER_SOIL),
        }
    finally:
        shutil.rmtree(home)


def seconds(home: Path, out: Path, *options: str) -> float:
    """Wall time of the command with this home folder."""
    calibrate = Path(sys.executable).with_name("calibrate")
    environment = {"PATH": os.environ["PATH"], "HOME": str(home)}
    begun = time.perf_counter()
    subprocess.run(
        [calibrate, *COMMAND, "--out", out, *options],
        env=environment, check=True, capture_output=True,
    )  # fmt: skip
    return time.perf_counter() - begun


def markdown(content: dict) -> str:
    rows = [
        [state, f"{np.median(found):.1f}", f"{min(found):.1f} to {max(found):.1f}",
         f"{ASKED[state]:.0f}" if state in ASKED else "-"]
        for state, found in content["seconds"].items()
    ]  # fmt: skip
    lines = [
        "## Start-up",
        "",
        f"`calibrate {' '.join(COMMAND)}` from start to exit, s; median and range of "
        f"{content['rounds']} rounds.",
        "",
        reporting.table(["state", "median (s)", "range (s)", "asked for (s)"], rows),
    ]
    return "\n".join(lines) + reporting.footer(content)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=3)
    rounds = parser.parse_args().rounds
    found: dict[str, list[float]] = {state: [] for state in STATES}
    for _ in range(rounds):
        for state, spent in one_round().items():
            found[state].append(spent)
            print(f"{state}: {spent:.1f} s", flush=True)
    content = {**reporting.provenance(), "rounds": rounds, "seconds": found}
    reporting.write("startup", content, markdown(content))


if __name__ == "__main__":
    main()
