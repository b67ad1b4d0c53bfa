"""Text exports: which encoding, which delimiter, which decimal sign.

Every pair of delimiter and decimal sign is tried on a sample of lines; the one that turns
most cells of tables into numbers, and fewest into anything else, is taken.  csv.Sniffer, which
knows no decimal commas, finds another delimiter in one file of nine of the tests' generator;
pandas.read_csv has to be told where a table begins, which is what is sought here.
"""

import codecs
import csv
import re
from dataclasses import dataclass

from calibrate.core.errors import BadValue
from calibrate.instrument_import.cells import Sheet, is_grouped, number, sheet
from calibrate.instrument_import.unittext import unit_of
from calibrate.instrument_import.vocabulary import Quantity, kind_of

MOST_LINES = 1_000_000
_SAMPLE = 150  # lines looked at for the layout, from each of two places
_DELIMITERS = {
    "\t": "tab",
    ";": "semicolon",
    ",": "comma",
    "|": "bar",
    "  ": "two or more blanks",
    " ": "blanks",
}
_COMMENT = re.compile(r"\s*(?:#+|//+|%+(?= )|!+|\*+(?=\s))\s*(\S.*)")
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


@dataclass(frozen=True)
class Layout:
    """How a line becomes cells: the delimiter and the decimal sign."""

    delimiter: str
    decimal: str

    def cells(self, line: str) -> list[str]:
        """The cells of one line; an unbalanced quote spoils this line and no other."""
        if self.delimiter == "  ":
            return re.split(r"\s{2,}|\t", line.strip())
        if self.delimiter == " ":
            return _with_their_units(line.split())
        try:
            return next(csv.reader([line], delimiter=self.delimiter), [])
        except csv.Error:
            return line.split(self.delimiter)

    def words(self) -> str:
        sign = "comma" if self.decimal == "," else "point"
        return f"delimiter {_DELIMITERS[self.delimiter]}, decimal {sign}"


def text_sheet(data: bytes, name: str) -> Sheet:
    """The one sheet of a text file; `BadValue` where it is no text or holds no table."""
    text, encoding = decode(data)
    lines = _uncommented(text.splitlines())
    if len(lines) > MOST_LINES:
        raise BadValue(f"it has {len(lines)} lines", f"export at most {MOST_LINES} of them")
    layout = find_layout(lines)
    rows = [layout.cells(line) for line in lines]
    return sheet(name, rows, layout.decimal, f"encoding {encoding}, {layout.words()}")


def _uncommented(lines: list[str]) -> list[str]:
    """The lines, those of words without the sign of a comment before them: "# t u F" names
    columns.  "% s mm" are units, unless another line shows that % begins comments."""
    found = [_COMMENT.fullmatch(line) for line in lines]
    rests = [m[1] if m and _is_of_words(m[1]) else "" for m in found]
    per_cent = [line.lstrip().startswith("%") for line in lines]
    units = [all(unit_of(word) for word in rest.split()) for rest in rests]
    comments = any(rest and p and not u for rest, p, u in zip(rests, per_cent, units, strict=True))
    return [
        rest if rest and (not p or comments) else line
        for line, rest, p in zip(lines, rests, per_cent, strict=True)
    ]


def _is_of_words(text: str) -> bool:
    """Whether a line names something; numbers that are commented out stay so."""
    first = text.split(None, 1)[0].rstrip(",;")
    return any(c.isalpha() for c in text) and number(first, ".") != number(first, ".")


def decode(data: bytes) -> tuple[str, str]:
    """The text of a file and its encoding; `BadValue` for what is no text."""
    encoding = _encoding(data)
    text = data.decode(encoding, errors="replace")
    sample = text[:4000]
    strange = sum((ord(c) < 32 and c not in "\t\n\r\f\v") or c == "�" for c in sample)
    if strange > len(sample) / 50:
        raise BadValue(
            "this is neither text nor an .xlsx workbook",
            "export the recorded points as .csv, .txt or .xlsx",
        )
    return text.replace("\0", ""), encoding


def _encoding(data: bytes) -> str:
    """A byte order mark, UTF-16 by its zeros, UTF-8, GB 18030 if that gives Chinese words for force
    or travel, else Windows-1252.

    charset-normalizer misreads one file of eight of the tests' generator, since a few headings
    over many numbers say little: "mm²" becomes "mmｲ", GB 18030 Korean.
    """
    for mark, encoding in _MARKS:
        if data.startswith(mark):
            return encoding
    start = data[:400]
    if start.count(0) > len(start) // 4:
        return "utf-16-le" if start[::2].count(0) < start[1::2].count(0) else "utf-16-be"
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        chinese = data.decode("gb18030", errors="replace")
        is_chinese = any(word in chinese for word in ("力", "荷", "位移", "时间"))
        return "gb18030" if chinese.count("�") < 3 and is_chinese else "cp1252"
    return "utf-8"


def find_layout(lines: list[str]) -> Layout:
    """The layout that makes most of the sample numeric; `BadValue` if none finds a table."""
    filled = [line for line in lines if line.strip()]
    middle = len(filled) // 2
    sample = filled[:_SAMPLE] + filled[max(middle, _SAMPLE) : max(middle, _SAMPLE) + _SAMPLE]
    quoted = any('"' in line for line in sample)
    layouts = [
        Layout(delimiter, decimal)
        for delimiter in _DELIMITERS
        for decimal in (".", ",")
        if not (delimiter == decimal == "," and not quoted)
    ]
    scores = [_score(layout, sample) for layout in layouts]
    if max(scores) < 2:  # rows may hold as many words as numbers: "25;0,95;M1;natural"
        scores = [_score(layout, sample, few=True) for layout in layouts]
    if max(scores) < 2:
        raise BadValue(
            "it holds no table of recorded points, only text or results",
            "export the recorded points (time, force, extension) as .csv, .txt or .xlsx",
        )
    layout = layouts[scores.index(max(scores))]
    _check_comma(layout, sample)
    return layout


def _score(layout: Layout, sample: list[str], few: bool = False) -> float:
    """Numeric cells less others over all lines that look like rows of a table; few: of as many
    words as numbers."""
    total, per_other, per_grouped = 0.0, *((0.5, 0.0) if few else (1.5, 0.3))
    for line in sample:
        cells = [cell for cell in layout.cells(line) if cell.strip()]
        values = [number(cell, layout.decimal) for cell in cells]
        numeric = sum(value == value for value in values)
        if (len(cells) if few else numeric) >= 2 and 2 * numeric >= len(cells):
            grouped = sum(is_grouped(cell, layout.decimal) for cell in cells)
            total += numeric - per_other * (len(cells) - numeric) - per_grouped * grouped
    return total


def _check_comma(layout: Layout, sample: list[str]) -> None:
    """Refuses a file whose comma is delimiter and decimal sign at once."""
    if layout.delimiter != ",":
        return
    rows = [[cell for cell in layout.cells(line) if cell.strip()] for line in sample]
    loads = (Quantity.FORCE, Quantity.STRESS)
    named = [len(row) for row in rows if any(kind_of(cell)[0] in loads for cell in row)]
    data = [row for row in rows if len(row) > 1 and all(c.strip("-+ ").isdigit() for c in row)]
    if named and len(data) > 5 and sum(len(row) > max(named) for row in data) > len(data) / 2:
        raise BadValue(
            "its comma separates columns and decimals alike, so the columns cannot be told apart",
            "export it again with semicolons or tabs between columns, or with a decimal point",
        )


def _with_their_units(words: list[str]) -> list[str]:
    """Words of a line where "(N)" belongs to the "Force" before it."""
    cells: list[str] = []
    for word in words:
        if cells and word[0] in "([" and word[-1] in ")]":
            cells[-1] += " " + word
        else:
            cells.append(word)
    return cells
