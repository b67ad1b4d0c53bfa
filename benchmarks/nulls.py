"""Lab files of cases that are known to hide nothing, to estimate a model discrepancy from.

    calibrate discrepancy $(python benchmarks/nulls.py FOLDER...) --out DISCREPANCY.json

Each folder holds `cases/` and, unless all of them hide nothing, sealed labels with their hashes;
name only sets whose seal has been opened for scoring.
"""

import argparse
from pathlib import Path

from calibrate.discrepancy.comparison.probability_calibration import NONE
from calibrate.validation.seal import HASHES, open_seal


def lab_files(folder: Path) -> list[Path]:
    """The lab files of a folder's cases with nothing hidden, by name."""
    every = sorted((folder / "cases").glob("*/lab.toml"))
    if not every:
        raise SystemExit(f"{folder}: there are no cases here")
    if not (folder / HASHES).exists():
        return every
    labels = open_seal(folder)
    return [path for path in every if labels[path.parent.name]["kind"] == NONE]


def main() -> None:
    parser = argparse.ArgumentParser(description="Lab files of cases that hide nothing.")
    parser.add_argument("folders", nargs="+", type=Path)
    print(*(path for folder in parser.parse_args().folders for path in lab_files(folder)))


if __name__ == "__main__":
    main()
