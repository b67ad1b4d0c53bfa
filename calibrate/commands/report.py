"""`calibrate report`: one self-contained HTML file of a result."""

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Adds `report` to the program."""
    app.command("report")(report_command)


def report_command(
    place: Annotated[
        Path,
        typer.Argument(
            metavar="DIR",
            help="Folder that fit, doe, audit, diagnose or withheld wrote, or its JSON file.",
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for report.html; default: DIR itself.")
    ] = None,
    json: Annotated[
        Path | None, typer.Option("--json", help="Write kind and summary here.")
    ] = None,
) -> None:
    """Write report.html: one file with figures, tables, settings and versions, to hand on."""
    from calibrate.core.files import check_writable, make_folder, write_json, write_text
    from calibrate.reports import kinds

    check_writable(json)
    kind, file = kinds.find(place)
    folder = file.parent if out is None else out
    make_folder(folder)
    page = kinds.page_of(kind, file)
    write_text(folder / PAGE, page.html)
    if json is not None:
        summary = {"kind": kind.name, "summary": page.sentence, "report": str(folder / PAGE)}
        write_json(json, summary)
    print(page.sentence)
    print(f"report of {file} in {folder / PAGE}")


PAGE = "report.html"
