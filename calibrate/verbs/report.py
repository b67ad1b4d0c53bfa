"""Write report.html: one file with figures, tables, settings and versions, to hand on."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.console import RenderableType

from calibrate.core.files import make_folder, write_text
from calibrate.reports import kinds
from calibrate.verbs import options
from calibrate.verbs.base import AbstractResult, line, verb

PAGE = "report.html"


@dataclass(frozen=True, eq=False, repr=False)
class ReportResult(AbstractResult):
    """The report of a result.

    Attributes:
        path: the page that was written.
        sentence: what was found, in one sentence.
        folder: where the page is.
        content: kind of the result, the sentence, the page's path.
    """

    path: Path
    sentence: str
    folder: Path
    content: dict

    def words(self) -> Iterator[RenderableType]:
        yield line(self.sentence)
        yield line(f"report in {self.path}")


@verb
def report(
    source: Annotated[
        AbstractResult | str | Path,
        typer.Argument(
            metavar="DIR", help="Folder that fit, doe, audit or diagnose wrote, or its JSON file."
        ),
        options.Typed(Path),
    ],
    *,
    out: Annotated[
        str | Path | None,
        typer.Option("--out", help="Folder for report.html; default: DIR itself."),
        options.Typed(Path | None),
    ] = None,
) -> ReportResult:
    """Writes report.html of a result: one file with figures, tables and settings, to hand on.

    Args:
        source: what `fit`, `doe`, `audit` or `diagnose` returned, their folder or its JSON file.
        out: folder for the page; None: that of the result.

    Returns:
        The page's path and what was found in one sentence.

    Raises:
        InputError: there is no result to report on, or it is damaged.

    Example:
        >>> calibrate.report("results/fit").path
    """
    place = Path(source) if isinstance(source, str | Path) else source.folder
    kind, file = kinds.find(place)
    folder = file.parent if out is None else Path(out)
    make_folder(folder)
    page = kinds.page_of(kind, file)
    path = folder / PAGE
    write_text(path, page.html)
    content = {"kind": kind.name, "summary": page.sentence, "report": str(path)}
    return ReportResult(path, page.sentence, folder, content)
