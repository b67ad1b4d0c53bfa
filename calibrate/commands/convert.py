"""`calibrate convert`: the export of a testing machine becomes curves and a lab file."""

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Adds `convert` to the program."""
    app.command("convert")(convert_command)


def convert_command(
    exports: Annotated[
        list[Path],
        typer.Argument(metavar="EXPORT...", help=".csv, .txt or .xlsx files of one soil."),
    ],
    test: Annotated[
        str | None,
        typer.Option("--test", help="Its type (calibrate.labtests); default: found out."),
    ] = None,
    diameter: Annotated[
        str | None, typer.Option("--diameter", help="Of the specimen, for stresses: 50 mm.")
    ] = None,
    height: Annotated[
        str | None, typer.Option("--height", help="Of the specimen, for strains: 100 mm.")
    ] = None,
    void_ratio: Annotated[
        str | None,
        typer.Option("--void-ratio", help="Initial one (e0), or one a specimen: 1.2,1.3; first."),
    ] = None,
    settlement: Annotated[
        str | None,
        typer.Option("--settlement", help="Whole one of a degree of consolidation: 0.2 mm, 1 %."),
    ] = None,
    points: Annotated[
        bool | None, typer.Option("--points/--curve", help="Rows are load steps, or a curve.")
    ] = None,
    force_unit: Annotated[
        str | None, typer.Option("--force-unit", help="Unit of force, against the file: kN.")
    ] = None,
    displacement_unit: Annotated[
        str | None, typer.Option("--displacement-unit", help="Unit of travel, against the file.")
    ] = None,
    stress_unit: Annotated[
        str | None, typer.Option("--stress-unit", help="Unit of stress, against the file: MPa.")
    ] = None,
    strain_unit: Annotated[
        str | None, typer.Option("--strain-unit", help="Unit of strain, against the file: % or -.")
    ] = None,
    time_unit: Annotated[
        str | None, typer.Option("--time-unit", help="Unit of time, against the file: min.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path(
        "results/convert"
    ),
    json: Annotated[Path | None, typer.Option("--json", help="Write what was found here.")] = None,
) -> None:
    """Turn exports of testing machines into clean curves and a lab file for `calibrate fit`."""
    from calibrate.commands.options import answer
    from calibrate.verbs.convert import convert

    answer(
        json, "", convert, *exports, test=test, diameter=diameter, height=height,
        void_ratio=void_ratio, settlement=settlement, points=points, force_unit=force_unit,
        displacement_unit=displacement_unit, stress_unit=stress_unit, strain_unit=strain_unit,
        time_unit=time_unit, out=out,
    )  # fmt: skip
