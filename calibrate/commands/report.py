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
            help="Folder that fit, doe, audit or diagnose wrote, or its JSON file.",
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
    from calibrate.commands.options import answer
    from calibrate.verbs.report import report

    answer(json, "", report, place, out=out)
