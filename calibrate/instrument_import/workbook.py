"""Excel workbooks (.xlsx): every worksheet becomes a sheet of cells, through openpyxl.

A workbook is a zip archive of XML.  What it would unpack to is bounded before it is opened,
formulas are never computed (their stored values are read), macros are never touched.
(pandas.read_excel reads through openpyxl too, in the same way; bounds and texts would remain.)
"""

import datetime
import io
import zipfile
from collections.abc import Iterator

from calibrate.core.errors import BadValue
from calibrate.instrument_import.cells import Sheet, sheet

MOST_UNPACKED = 300_000_000  # bytes
MOST_ROWS, MOST_COLUMNS = 1_000_000, 200


def is_workbook(data: bytes) -> bool:
    """Whether the bytes are a zip archive, as .xlsx files are."""
    return data.startswith(b"PK\x03\x04")


def workbook_sheets(data: bytes) -> list[Sheet]:
    """The worksheets that hold anything; `BadValue` for a damaged or monstrous workbook."""
    _check_size(data)
    try:
        return list(_sheets(data))
    except BadValue:
        raise
    except Exception as error:  # a damaged workbook makes openpyxl raise nearly anything
        problem = f"the workbook is damaged ({type(error).__name__})"
        raise BadValue(problem, "open it, save it again as .xlsx, or export as .csv") from None


def _sheets(data: bytes) -> Iterator[Sheet]:
    from openpyxl import load_workbook  # 0.2 s, and few exports are workbooks

    book = load_workbook(io.BytesIO(data), read_only=True, data_only=True, keep_links=False)
    for page in book.worksheets:
        page.reset_dimensions()  # what the file says of its size may be wrong
        rows = [
            [_text(value) for value in row[:MOST_COLUMNS]]
            for row in page.iter_rows(max_row=MOST_ROWS, values_only=True)
        ]
        if any(any(row) for row in rows):
            yield sheet(page.title, rows, ".", "Excel workbook")


def _check_size(data: bytes) -> None:
    """Refuses an archive that is no workbook or that would unpack to far too much."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
    except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError) as error:
        problem = f"the workbook is damaged ({error})"
        raise BadValue(problem, "open it, save it again as .xlsx, or export as .csv") from None
    if not any(entry.filename == "xl/workbook.xml" for entry in entries):
        problem = "this archive is no .xlsx workbook"
        raise BadValue(problem, "give the export itself: .csv, .txt or .xlsx")
    if sum(entry.file_size for entry in entries) > MOST_UNPACKED:
        raise BadValue("the workbook would unpack to more than 300 MB", "export fewer points")


def _text(value: object) -> str:
    """A cell as text; numbers with a decimal point, times of day as clock times."""
    if value is None or isinstance(value, bool):
        return ""
    if isinstance(value, datetime.timedelta):
        return repr(value.total_seconds())
    if isinstance(value, datetime.datetime | datetime.date | datetime.time):
        return value.isoformat().replace("T", " ")
    return repr(value) if isinstance(value, int | float) else _with_point(str(value))


def _with_point(cell: str) -> str:
    """A text; a number stored as text with a decimal comma gets a point."""
    whole, comma, rest = cell.partition(",")
    looks_numeric = comma and whole.strip(" -+").isdigit() and rest.strip().isdigit()
    return f"{whole.strip()}.{rest.strip()}" if looks_numeric else cell
