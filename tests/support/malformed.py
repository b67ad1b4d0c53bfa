"""Malformed files through the program: is there ever a traceback?

Good files have accidents such as happen in a laboratory: transfers break off, editors change
encodings, columns move, people write words where numbers belong.  They are given to a command in
this process, without simulating: refused is exit status 2 and one line on standard error, still
usable is status 0, anything else is strange.
"""

import contextlib
import io
import re
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


VALUES = (
    '""', '"often"', '"-3 mm"', '"3 parsecs"', '"mm"', '"1e400 N"', '"nan N"', '"inf mm"', "nan",
    "-inf", "1e999", "0", "-1", "true", "[]", "{}", '[["5 mm"]]', "1979-05-27", '"5"', '"5 N mm"',
    '"../../../etc/passwd"', '"/dev/zero"', '"a\\u0000b"', '"9' + "9" * 400 + ' N"', '"１２ mm"',
    '"5 mm; rm -rf"', '"__import__(\'os\')"', '"5 ** 99999999 mm"', "'''", '"' + "x" * 2000 + '"',
)  # fmt: skip
CELLS = (
    b"", b"nan", b"inf", b"-", b"five", b"1,5", b"1e400", b"#DIV/0!", b"=1+1", b"0x1F", b"1_000",
    b'"', b"\x00", b"\xff\xfe", b"\xe2\x88\x92", b"9" * 400, b"--1", b"1.2.3", b"N/A", b"\r",
)  # fmt: skip


def spoiled_bytes(good: bytes, rng: np.random.Generator) -> bytes:
    """One to three accidents that any file may have."""
    data = bytearray(good)
    for _ in range(rng.integers(1, 4)):
        place, length = int(rng.integers(0, len(data) + 1)), int(rng.integers(1, 40))
        accident = rng.integers(0, 7)
        if accident == 0:
            del data[place:]
        elif accident == 1:
            del data[place : place + length]
        elif accident == 2:
            data[place : place + length] = rng.bytes(length)
        elif accident == 3:
            data[place:place] = CELLS[rng.integers(len(CELLS))]
        elif accident == 4:
            lines = bytes(data).split(b"\n")
            rng.shuffle(lines)
            data = bytearray(b"\n".join(lines))
        elif accident == 5:
            data = bytearray(bytes(data).decode("utf-8", "replace").encode("utf-16"))
        else:
            data = data * 2
    return bytes(data)


def spoiled_lab(good: bytes, rng: np.random.Generator) -> bytes:
    """A lab file with a wrong value, a wrong name, something missing or something too much."""
    lines = good.decode("utf-8").splitlines()
    entries = [k for k, line in enumerate(lines) if re.match(r"\w+ *=", line)]
    tables = [k for k, line in enumerate(lines) if line.startswith("[")]
    for _ in range(rng.integers(1, 3)):
        place, table = int(rng.choice(entries)), int(rng.choice(tables))
        name = lines[place].split("=")[0].strip()
        accident = rng.integers(0, 8)
        if accident <= 2:
            lines[place] = f"{name} = {VALUES[rng.integers(len(VALUES))]}"
        elif accident == 3:
            lines[place] = lines[place].replace(name, name + "s", 1)
        elif accident == 4:
            lines[place] = f"{name}.deeper = 1"
        elif accident == 5:
            lines[place] = "" if rng.random() < 0.5 else lines[place] + "\n" + lines[place]
        elif accident == 6:
            lines[table] = lines[table].replace("[", "[x", 1)
        else:
            return spoiled_bytes("\n".join(lines).encode(), rng)
    return "\n".join(lines).encode()


def spoiled_curve(good: bytes, rng: np.random.Generator) -> bytes:
    """A curve file with bad cells, other columns, too few rows, or any file's accidents."""
    rows = [line.split(b",") for line in good.strip().split(b"\n")]
    for _ in range(rng.integers(1, 3)):
        row, column = int(rng.integers(0, len(rows))), int(rng.integers(0, len(rows[0])))
        accident = rng.integers(0, 6)
        if accident <= 1:
            rows[row][column % len(rows[row])] = CELLS[rng.integers(len(CELLS))]
        elif accident == 2:
            rows = [line[:column] for line in rows]
        elif accident == 3:
            rows = rows[: int(rng.integers(1, 6))]
        elif accident == 4:
            rows = [rows[0], *([b"-" + cell for cell in line] for line in rows[1:])]
        else:
            return spoiled_bytes(b"\n".join(b",".join(line) for line in rows), rng)
        rows = [line or [b""] for line in rows]
    return b"\n".join(b",".join(line) for line in rows)
