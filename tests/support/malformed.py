"""Malformed files through the program: is there ever a traceback?

Files that had accidents (`tests.support.accidents`) are given to a command in this process, without
simulating: refused is exit status 2 and one line on standard error, still usable is status 0,
anything else is strange.
"""

import contextlib
import io
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from calibrate import cli, figures
from calibrate.io.lab import bundled_lab
from calibrate.simulation import Campaign
from tests import DATA
from tests.support.accidents import spoiled_bytes, spoiled_curve, spoiled_lab

EXPORTS = DATA / "machine_exports"
CURVES = """
[[curves]]
test = "confined"
file = "confined.csv"
displacement = { column = "travel", unit = "mm" }
force = { column = "load", unit = "kN" }

[[curves]]
test = "unconfined"
file = "unconfined.csv"
displacement = { column = "travel", unit = "mm" }
force = { column = "load", unit = "kN" }
"""


class Accepted(BaseException):
    """The file was read and simulations would begin."""


Case = tuple[str, bytes]  # name and content of the file that had the accident


def lab_text() -> bytes:
    return (bundled_lab().read_text(encoding="utf-8") + CURVES).encode()


def curve_text(largest: float, unloads: bool) -> bytes:
    """A plausible curve up to `largest` (kN), and back where it unloads."""
    load = np.linspace(0, largest, 60)
    rows = [(8 * (f / largest) ** 0.7, f) for f in load]
    rows += [(7 + f / largest, f) for f in load[::-1]] if unloads else []
    return "\n".join(["travel,load", *(f"{x:.5g},{f:.5g}" for x, f in rows)]).encode()


GOOD = {
    "lab.toml": lab_text(),
    "confined.csv": curve_text(0.41, unloads=True),
    "unconfined.csv": curve_text(0.2, unloads=False),
}


def labs(rng: np.random.Generator) -> Iterator[Case]:
    while True:
        yield "lab.toml", spoiled_lab(GOOD["lab.toml"], rng)


def curves(rng: np.random.Generator) -> Iterator[Case]:
    while True:
        name = ("confined.csv", "unconfined.csv")[rng.integers(2)]
        yield name, spoiled_curve(GOOD[name], rng)


def exports(rng: np.random.Generator) -> Iterator[Case]:
    goods = [
        EXPORTS / name for name in ("decimal_comma.csv", "tab_units.txt", "two_specimens.xlsx")
    ]
    while True:
        path = goods[rng.integers(len(goods))]
        yield "case" + path.suffix, spoiled_bytes(path.read_bytes(), rng)


KINDS: dict[str, tuple[Callable, list[str]]] = {
    "lab": (labs, ["fit", "lab.toml"]),
    "curve": (curves, ["fit", "lab.toml"]),
    "export": (exports, ["convert"]),
}


def command_for(kind: str, name: str) -> list[str]:
    words = KINDS[kind][1]
    return [*words, *([name] if kind == "export" else []), "--out", "out"]


def laid_out(folder: Path, case: Case) -> None:
    """The good files, with the case's in place of one of them."""
    for name, content in {**GOOD, case[0]: case[1]}.items():
        (folder / name).write_bytes(content)


def called(folder: Path, command: list[str]) -> tuple[int, str]:
    """Exit status (0 if simulations would begin) and standard error of a command."""
    errors = io.StringIO()
    before, sys.argv = sys.argv, ["calibrate", *command]
    quiet = (contextlib.redirect_stderr(errors), contextlib.redirect_stdout(io.StringIO()))
    try:
        with contextlib.chdir(folder), quiet[0], quiet[1]:
            cli.main()
        return 0, errors.getvalue()
    except Accepted:
        return 0, errors.getvalue()
    except SystemExit as end:
        return int(end.code or 0), errors.getvalue()
    except BaseException as error:  # what the program must never let out
        return 1, f"Traceback: {type(error).__name__}: {error}"
    finally:
        sys.argv = before


def verdict(status: int, error: str) -> str:
    """ "refused", "read", or what was wrong."""
    if "Traceback" in error or status not in (0, 2):
        return f"status {status}: {error.strip()[-300:]}"
    if status == 2 and (error.count("\n") != 1 or not error.startswith("error: ")):
        return f"not one line: {error[-300:]!r}"
    return "refused" if status == 2 else "read"


@contextlib.contextmanager
def nothing_simulated() -> Iterator[None]:
    """Simulations raise `Accepted` and previews are not drawn."""

    def accepted(*_, **__):
        raise Accepted

    changed = [(Campaign, "runs", accepted), (Campaign, "each", accepted)]
    changed += [
        (figures, "FIGURES", {**figures.FIGURES, "convert": {}}),
        (cli, "_configure", lambda: None),
    ]
    before = [(owner, name, getattr(owner, name)) for owner, name, _ in changed]
    for owner, name, value in changed:
        setattr(owner, name, value)
    try:
        yield
    finally:
        for owner, name, value in before:
            setattr(owner, name, value)


def fuzzed(kind: str, refused: int, seed: int, strange: Path) -> tuple[Counter, list[Case]]:
    """Counts of verdicts until so many were refused, and the first cases; files that were neither
    read nor refused are kept in `strange`."""
    cases = KINDS[kind][0](np.random.default_rng(seed))
    counts: Counter[str] = Counter()
    first = []
    with nothing_simulated(), tempfile.TemporaryDirectory() as home:
        while counts["refused"] < refused and counts.total() < 20 * refused:
            case = next(cases)
            laid_out(Path(home), case)
            word = verdict(*called(Path(home), command_for(kind, case[0])))
            counts[word if word in ("refused", "read") else "strange"] += 1
            if word not in ("refused", "read"):
                kept(strange / f"{kind}-{counts['strange']}", case, word)
            first.append(case) if word == "refused" and len(first) < 50 else None
    return counts, first


def kept(place: Path, case: Case, word: str) -> None:
    """Keeps a strange case for whoever mends it."""
    place.parent.mkdir(parents=True, exist_ok=True)
    Path(f"{place}-{case[0]}").write_bytes(case[1])
    Path(f"{place}.txt").write_text(word, encoding="utf-8")
    print(f"{place.name}: {word}", file=sys.stderr)
