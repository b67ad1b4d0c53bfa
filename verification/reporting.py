"""What scripts of this folder share: where results and their pages are kept, and what a row is.

Pages (verification/results) are committed and hold every number that a row needs; JSON beside them
serves scripts that go on, and notebooks.  A row is a sentence of README or of a page with gaps, the
cells of result pages that fill them, and a rule that says which numbers let it stand.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path

from jdem.physics import PHYSICS
from studies import reporting
from studies.reporting import (
    CACHE,
    IMAGES,
    configure,
    footer,
    keep_content,
    keep_page,
    kept_entry,
    no_options,
    physics_of,
    table,
)

__all__ = [
    "CACHE",
    "IMAGES",
    "Cell",
    "Numbers",
    "Origin",
    "Row",
    "Script",
    "configure",
    "earlier",
    "file_of",
    "footer",
    "kept",
    "no_options",
    "origin_of",
    "physics_of",
    "provenance",
    "table",
    "write",
    "write_content",
    "write_page",
    "write_section",
]
ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).parent / "results"  # what is committed
OF_NOTEBOOKS = ROOT / "notebooks" / "data"
SHOWN = ("audit", "calibration", "tangents")  # what notebooks draw, in a folder beside them
COMMITTED = (
    "hidden_soils",
    "other_tests",
    "resolution",
    "sound_soils",
)  # what later calls go on from


def provenance() -> dict:
    """Command, day, machine and versions."""
    return {**reporting.provenance(), "date": date.today().isoformat()}


def file_of(name: str) -> Path:
    """Where a result's JSON is kept."""
    if name in SHOWN:
        return OF_NOTEBOOKS / f"{name}.json"
    return (RESULTS if name in COMMITTED else CACHE) / f"{name}.json"


def kept(name: str, folder: Path = CACHE) -> Path:
    """Folder of what a script keeps that is not known by its physics elsewhere."""
    return folder / f"{name}-physics-{PHYSICS}"


def write(name: str, content: dict, markdown: str) -> None:
    """The result's JSON and verification/results/<name>.md; says where they are."""
    write_content(name, content)
    write_page(name, markdown)


def write_content(name: str, content: dict) -> None:
    """The result's JSON alone."""
    keep_content(file_of(name), content)


def write_page(name: str, markdown: str) -> None:
    """verification/results/<name>.md alone, where it says all that was measured."""
    keep_page(RESULTS / f"{name}.md", markdown)


def write_section(name: str, markdown: str) -> None:
    """The section of a page that begins with the heading of `markdown`; the others stay."""
    path = RESULTS / f"{name}.md"
    known = path.read_text(encoding="utf-8") if path.exists() else ""
    parts = [part.strip() + "\n" for part in re.split(r"(?m)^(?=# )", known) if part.strip()]
    heading = markdown.partition("\n")[0]
    found = [part.partition("\n")[0] == heading for part in parts]
    parts = [markdown if same else part for same, part in zip(found, parts, strict=True)]
    keep_page(path, "\n".join(parts if any(found) else [*parts, markdown]))


def earlier(name: str, key: str) -> dict:
    """Entry `key` of results written before with the same physics, or an empty dict."""
    return kept_entry(file_of(name), key)


# ---------------------------------------------------------------- what pages say

Numbers = dict[str, float]
NUMBER = r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?"
MADE = re.compile(
    r"(?m)^(?:Made|To be made again)(?: on (\d{4}-\d\d-\d\d))? by `([^`]*)`.*physics (.+)\.$"
)


@dataclass(frozen=True)
class Origin:
    """What made a section of a page: command, version of the physics, day (empty if not stated)."""

    command: str
    physics: str
    date: str = ""


def only(found: list[float]) -> float:
    """The number of the one row that was meant."""
    (value,) = found
    return value


@dataclass(frozen=True)
class Cell:
    """Where a number stands: a page of results, a column of one of its tables, and rows.

    Rows are those whose cells equal or match `where`; `how` makes one number of theirs.  `part`
    counts numbers within a cell from 0: the standard error in "3.336 ± 0.0098" is part 1.  With
    `over` the number is a percentage of that in another column.  Where no table holds the number,
    `line` is a regular expression whose groups are the numbers.
    """

    page: str
    column: str = ""
    where: Mapping[str, str | re.Pattern] = field(default_factory=dict)
    part: int = 0
    how: Callable[[list[float]], float] = only
    folder: str = "verification"
    line: str = ""
    over: str = ""

    def path(self, root: Path) -> Path:
        return root / self.folder / "results" / f"{self.page}.md"

    def read(self, root: Path) -> float:
        """The number; LookupError where the page or the place is missing."""
        path = self.path(root)
        if not path.exists():
            raise LookupError(f"{path.name} is missing")
        text = path.read_text(encoding="utf-8")
        found = self._in_lines(text) if self.line else self._in_tables(text)
        if not found:
            raise LookupError(f"{path.name} has no {self.column or self.line} of {self.where}")
        return self.how(found)

    def _in_lines(self, text: str) -> list[float]:
        groups = [found.groups()[self.part] for found in re.finditer(self.line, text)]
        return [float(number) for number in groups]

    def _in_tables(self, text: str) -> list[float]:
        rows = [row for row in _rows(text) if self.column in row]
        rows = [row for row in rows if all(_is(row.get(k), v) for k, v in self.where.items())]
        numbers = [re.findall(NUMBER, row[self.column]) for row in rows]
        wholes = [float(row[self.over]) / 100 if self.over else 1.0 for row in rows]
        return [
            float(found[self.part]) / whole
            for found, whole in zip(numbers, wholes, strict=True)
            if len(found) > self.part
        ]


def _is(cell: str | None, wanted: str | re.Pattern) -> bool:
    if isinstance(wanted, str):
        return cell == wanted
    return cell is not None and wanted.match(cell) is not None


def _rows(text: str) -> list[dict[str, str]]:
    """All rows of all tables of a page, by the headers of their columns, with the heading that a
    table stands under and the line before it (`under`, `after`)."""
    rows, header, under, after = [], [], "", ""
    for line in text.splitlines():
        if not line.startswith("|"):
            header = []
            under = line.lstrip("# ") if line.startswith("#") else under
            after = line or after
            continue
        cells = [cell.strip() for cell in line.strip()[1:-1].split("|")]
        if not header:
            header = cells
        elif not set(line) <= set("|- "):
            rows.append({"under": under, "after": after, **dict(zip(header, cells, strict=True))})
    return rows


def origin_of(path: Path, heading: str = "") -> Origin | None:
    """What made a page, or its section under `# heading`; None where that is not there."""
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    section = text[text.index(f"# {heading}\n") :] if f"# {heading}\n" in text else ""
    found = MADE.search(section if heading else text)
    return Origin(found[2], found[3], found[1] or "") if found else None


# ---------------------------------------------------------------- rows


@dataclass(frozen=True)
class Script:
    """Commands that write a page of results (its section under `# heading`).

    `physics` is False where no simulation of soil takes part; `needs` are programs.
    """

    commands: tuple[str, ...]
    minutes: float
    page: str
    heading: str = ""
    folder: str = "verification"
    physics: bool = True
    needs: tuple[str, ...] = ()

    def origin(self, root: Path = ROOT) -> Origin | None:
        """What made the page that is there."""
        return origin_of(Cell(self.page, folder=self.folder).path(root), self.heading)

    def is_current(self, root: Path = ROOT) -> bool:
        """Whether the page was made with the present version of the physics."""
        origin = self.origin(root)
        return origin is not None and (not self.physics or origin.physics == str(PHYSICS))


@dataclass(frozen=True)
class Row:
    """Parts of a sentence, with gaps {name} that `cells` fill, and the rule of its numbers."""

    name: str
    page: str
    says: tuple[str, ...]
    script: str
    cells: Mapping[str, Cell]
    rule: str
    holds: Callable[[Numbers], bool]
    note: str = ""

    def numbers(self, root: Path = ROOT) -> Numbers:
        """What the result pages hold; LookupError where one has no such number."""
        return {name: cell.read(root) for name, cell in self.cells.items()}

    def sentence(self, numbers: Numbers) -> str:
        """The sentence with these numbers."""
        return " [...] ".join(part.format(**numbers) for part in self.says)

    def contradicted(self, numbers: Numbers, root: Path = ROOT) -> list[str]:
        """Parts of the sentence, with these numbers, that its page does not have."""
        text = " ".join((root / self.page).read_text(encoding="utf-8").split())
        return [said for part in self.says if (said := part.format(**numbers)) not in text]
