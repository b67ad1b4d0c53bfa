"""`calibrate export`: calibrated parameters in the words of LIGGGHTS, EDEM, YADE, or JSON."""

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Adds `export` to the program."""
    app.command("export")(export_command)


def export_command(
    source: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder of a fit, or a lab file (its start).")
    ],
    to: Annotated[
        str, typer.Option("--to", help="Program or format: liggghts, ... (docs/export.md).")
    ],
    diameter: Annotated[
        str | None,
        typer.Option("--diameter", help='Of your particles: "4 mm"; default: as calibrated.'),
    ] = None,
    changes: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Change a parameter.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="File to write; default: in results/export.")
    ] = None,
    json: Annotated[Path | None, typer.Option("--json", help="Write them as JSON too.")] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Also of a fit that missed its data.")
    ] = False,
) -> None:
    """Write a soil's parameters for another program, with uncertainty and scale-up note."""
    from calibrate.commands.options import answer, parse_changes
    from calibrate.verbs.export import export

    answer(
        json, "", export, source, to=to, diameter=diameter, values=parse_changes(changes), out=out,
        force=force,
    )  # fmt: skip
