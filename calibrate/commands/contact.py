"""`calibrate contact`: the force-overlap loop of two equal spheres."""

from pathlib import Path
from typing import Annotated

import typer

from calibrate.commands.options import Changes, Json, Out, answer, parse_changes


def register(app: typer.Typer) -> None:
    """Adds `contact` to the program."""
    app.command("contact")(contact_command)


def contact_command(
    path_um: Annotated[
        str, typer.Option("--path-um", help="Turning points of the overlap, micrometres.")
    ],
    changes: Changes = None,
    radius_mm: Annotated[float, typer.Option("--radius-mm", help="Radius of both spheres.")] = 2.5,
    young_mpa: Annotated[float, typer.Option("--young-mpa", help="Young's modulus.")] = 5.0,
    poisson: Annotated[float, typer.Option("--poisson", help="Poisson's ratio.")] = 0.3,
    smooth: Annotated[
        bool, typer.Option("--smooth/--sharp", help="Default roundings, or the law as printed.")
    ] = False,
    out: Out = Path("results/contact"),
    json: Json = None,
) -> None:
    """Drive two equal spheres through overlaps, quasi-statically: force-overlap loop."""
    from calibrate.verbs.contact import contact

    answer(
        json, "contact.json and contact.png", contact, path_um.split(","),
        values=parse_changes(changes), radius_mm=radius_mm, young_mpa=young_mpa, poisson=poisson,
        smooth=smooth, out=out,
    )  # fmt: skip
