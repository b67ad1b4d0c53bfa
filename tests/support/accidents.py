"""Malformed lab files, curves and machine exports, made from good ones by accidents.

Each function takes the good file's bytes and a random generator and returns other bytes.  What
happens to files in a laboratory: transfers break off, editors change encodings, columns move,
people write words where numbers belong.
"""

import re

import numpy as np

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
