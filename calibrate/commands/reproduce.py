"""`calibrate reproduce`: the paper's figures beside what its own tables give."""

from pathlib import Path

import typer

from calibrate.commands.options import Json, Out


def register(app: typer.Typer) -> None:
    """Adds `reproduce` to the program."""
    app.command("reproduce")(reproduce_command)


def reproduce_command(out: Out = Path("results/reproduce"), json: Json = None) -> None:
    """Put the paper's published figures beside what its own printed tables give."""
    from rich.console import Console

    from calibrate.core.files import check_writable, make_folder
    from calibrate.designs.reproduction import paper
    from calibrate.reports import reproduction as report

    check_writable(json)
    make_folder(out)
    result = paper.reproduce()
    report.write(result, out, json)
    report.show(result, Console())
    print(f"page and JSON in {out}")
