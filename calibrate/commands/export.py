"""`calibrate export`: calibrated parameters in the words of LIGGGHTS, EDEM, YADE, or JSON."""

from pathlib import Path
from typing import Annotated

import typer

from calibrate.core.errors import COMMAND_LINE, BadValue, InputError

FILES = {
    "liggghts": "soil.liggghts",
    "edem": "soil_edem.csv",
    "yade": "soil_yade.py",
    "json": "soil.json",
}


def register(app: typer.Typer) -> None:
    """Adds `export` to the program."""
    app.command("export")(export_command)


def export_command(
    source: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder of a fit, or a lab file (its start).")
    ],
    to: Annotated[str, typer.Option("--to", help="liggghts, edem, yade or json.")],
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
    from calibrate.commands.options import parse_changes
    from calibrate.core.files import check_writable, make_folder, write_json, write_text
    from calibrate.export import asjson, edem, liggghts, notes, yade
    from calibrate.export.source import find

    writers = {
        "liggghts": liggghts.text,
        "edem": edem.text,
        "yade": yade.text,
        "json": asjson.text,
    }
    if to not in writers:
        raise InputError(COMMAND_LINE, "--to", f"no program '{to}'", f"give {', '.join(writers)}")
    check_writable(json)
    found = find(source, parse_changes(changes or []), _length(diameter))
    if found.missed and not force:
        repair = "fit again, or give --force to export it all the same, with this warning"
        rest = len(found.missed) - 1
        problem = found.missed[0] + (f", and {rest} more" if rest else "")
        raise InputError(str(source), "", problem, repair)
    text = writers[to](found)
    target = Path("results/export") / FILES[to] if out is None else out
    if target.is_dir():
        problem = f"{target} is a folder"
        raise InputError(COMMAND_LINE, "--out", problem, "give the name of a file")
    make_folder(target.parent)
    write_text(target, text)
    if json is not None:
        write_json(json, asjson.content(found))
    for line in [*notes.heading(found), *notes.scale_up(found)]:
        print(line)
    print(f"written to {target}")


def _length(diameter: str | None) -> float | None:
    from calibrate.core.units import LENGTH, positive_quantity

    if diameter is None:
        return None
    try:
        return positive_quantity(diameter, LENGTH)
    except BadValue as bad:
        raise bad.at(COMMAND_LINE, "--diameter") from None
