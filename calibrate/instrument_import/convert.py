"""An export of a testing machine, read whole: `read_export` gives its clean specimens."""

import re
from dataclasses import dataclass, replace
from pathlib import Path

from calibrate.core.errors import BadValue, InputError, one_line
from calibrate.instrument_import.cells import Sheet
from calibrate.instrument_import.loadsteps import step_specimen
from calibrate.instrument_import.measured import Units
from calibrate.instrument_import.recordings import Choices, Recording, recordings_in
from calibrate.instrument_import.sizes import Size
from calibrate.instrument_import.specimen_rows import unique_labels
from calibrate.instrument_import.specimens import Specimen, specimen_from, tool_specimen
from calibrate.instrument_import.strengths import Strengths, strengths_in
from calibrate.instrument_import.textfile import text_sheet
from calibrate.instrument_import.vocabulary import SOFTENS, STIFFENS, plain, tool_test_in
from calibrate.instrument_import.workbook import is_workbook, workbook_sheets
from calibrate.labtests.composite import TYPES

LARGEST = 100_000_000  # bytes of an export
_FOREIGN = {  # how files begin that are neither text nor .xlsx
    b"\xd0\xcf\x11\xe0": ("an old Excel or Word file", "save it as .xlsx or .csv"),
    b"%PDF": ("a PDF", "export the recorded points as .csv, .txt or .xlsx"),
    b"\x1f\x8b": ("compressed", "unpack it first"),
    b"\x89PNG": ("a picture", "export the recorded points as .csv, .txt or .xlsx"),
}


@dataclass(frozen=True, eq=False)
class Export:
    """A file as it was understood: how it was read, its specimens in file order, and one
    sentence for each specimen that could not be used.  `strengths` is given instead of
    specimens where the file holds strengths only."""

    file: str
    layout: str
    specimens: tuple[Specimen, ...]
    skipped: tuple[str, ...]
    strengths: Strengths | None = None

    @property
    def is_plain(self) -> bool:
        """Whether all is force and displacement of compression at a speed."""
        curves = (not s.points and not s.raw.is_converted for s in self.specimens)
        types = {s.test for s in self.specimens} <= {SOFTENS, STIFFENS}
        return self.strengths is None and all(curves) and types


def read_export(
    path: Path,
    test: str | None = None,
    units: Units | None = None,
    size: Size | None = None,
    points: bool | None = None,
) -> Export:
    """Reads the export at `path`; the rest is what the user says against or beside it.

    `size` is needed for stress, strain and void ratio where the file does not state it;
    `points` says whether rows are load steps.  Raises `InputError` with one useful sentence
    for any file that cannot be used.
    """
    choices = Choices(test, units or Units(), size or Size(), points)
    try:
        data = _bytes(Path(path))
        sheets = _sheets(data, Path(path).stem)
        try:
            recordings = recordings_in(sheets, choices)
        except BadValue as bad:
            strengths = strengths_in(sheets, choices) if choices.record is None else None
            if strengths is None:
                raise _naming(bad, sheets, test) from None
            return Export(str(path), sheets[0].layout, (), (), strengths)
        specimens, refused = _specimens(recordings, test)
        if not specimens:
            raise _naming(refused[0], sheets, test)
    except BadValue as bad:
        raise InputError(str(path), "", one_line(bad.problem), bad.repair) from None
    skipped = tuple(one_line(f"left out: {bad.problem}; {bad.repair}") for bad in refused)
    return Export(str(path), sheets[0].layout, tuple(specimens), skipped)


def joined(exports: list[Export]) -> Export:
    """Several exports of one soil as one; specimens of the same name get a number."""
    first = exports[0]
    if len(exports) == 1:
        return first
    for one in exports:
        if one.strengths is not None:
            problem = "it holds strengths and no curve, which cannot be joined with other files"
            raise InputError(one.file, "", problem, "convert it alone")
    specimens = [s for one in exports for s in one.specimens]
    names = unique_labels([s.label for s in specimens])
    return replace(
        first,
        layout="; ".join(f"{Path(one.file).name}: {one.layout}" for one in exports),
        specimens=tuple(replace(s, label=n) for s, n in zip(specimens, names, strict=True)),
        skipped=tuple(f"{Path(one.file).name}: {t}" for one in exports for t in one.skipped),
    )


def _naming(bad: BadValue, sheets: list[Sheet], given: str | None) -> BadValue:
    """The refusal of a file without a `given` test, with the one with a tool that it plainly is."""
    lines = [line for page in sheets for line in page.texts if any(_has_letters(c) for c in line)]
    words = [*(page.name for page in sheets), *(cell for line in lines for cell in line)]
    test = None if given is not None else tool_test_in(words)
    if test is None or f"--test {test}" in bad.repair:
        return bad
    named = f"if it is a {TYPES[test].title} test, give --test {test}"
    return BadValue(bad.problem, f"{bad.repair}; {named}")


def _has_letters(cell: str) -> bool:
    return any(c.isalpha() for c in cell)


def _specimens(
    recordings: list[Recording], test: str | None
) -> tuple[list[Specimen], list[BadValue]]:
    """The clean specimens, and why others are none."""
    specimens: list[Specimen] = []
    refused: list[BadValue] = []
    for recording, label in zip(
        recordings, unique_labels([r.label for r in recordings]), strict=True
    ):
        clean = step_specimen if recording.points else specimen_from
        clean = tool_specimen if recording.tool is not None else clean
        try:
            specimens.append(clean(recording, test, label))
        except BadValue as bad:
            refused.append(bad)
    return specimens, refused


def _bytes(path: Path) -> bytes:
    """The content of a regular file of sensible size."""
    try:
        if path.is_dir():
            raise BadValue("this is a folder", "give the path of a file inside it")
        if not path.is_file():
            raise BadValue("no such file", "check the path for a typing error")
        if path.stat().st_size > LARGEST:
            raise BadValue("it is larger than 100 MB", "export fewer points or specimens")
        return path.read_bytes()
    except OSError as error:
        raise BadValue(f"it cannot be read ({error.strerror})", "check its permissions") from None


def _sheets(data: bytes, name: str) -> list[Sheet]:
    """The sheets of a text file or workbook, told apart by how the file begins."""
    if not data.strip():
        raise BadValue("it is empty", "export the record again")
    for beginning, (what, repair) in _FOREIGN.items():
        if data.startswith(beginning):
            raise BadValue(f"this is {what}", repair)
    if is_workbook(data):
        sheets = workbook_sheets(data)
        if not sheets:
            raise BadValue("no worksheet holds anything", "export the record again")
        return sheets
    return [text_sheet(data, name)]


def file_stem(text: str) -> str:
    """`text` as part of a file's name: letters, digits, - and _ only, never a path."""
    safe = re.sub(r"[^a-z0-9_-]+", "_", plain(text)).strip("_-")
    return safe[:40] or "specimen"
