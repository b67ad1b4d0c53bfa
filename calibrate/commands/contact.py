"""`calibrate contact`: the force-overlap loop of two equal spheres."""

import math
from pathlib import Path
from typing import Annotated

import typer

from calibrate.commands.options import Changes, Json, Out, parse_changes
from calibrate.core.errors import COMMAND_LINE, InputError


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
    from calibrate.core.files import check_writable
    from calibrate.reports.results import write_contact
    from calibrate.simulation import single_contact

    check_writable(json)
    points = parse_path(path_um)
    values = parse_changes(changes or [])
    pair = single_contact.Spheres(*parse_pair(radius_mm, young_mpa, poisson))
    check_overlap(points, pair.radius)
    result = single_contact.drive(pair, values, points, smooth)
    write_contact(result, out, json)


def parse_path(path_um: str) -> list[float]:
    """`--path-um` turning points in m."""
    try:
        points = [1e-6 * float(point) for point in path_um.split(",")]
    except ValueError:
        points = [float("nan")]
    if not all(map(math.isfinite, points)):
        raise InputError(
            COMMAND_LINE, "--path-um", f"'{path_um}' is no list of numbers", "write 20,2,32,-28"
        )
    return points


def check_overlap(points: list[float], radius: float) -> None:
    """Refuses overlaps (m) of spheres that would have gone through each other."""
    deepest = max(points)
    if deepest >= radius:
        problem = f"an overlap of {1e6 * deepest:.6g} um is not below the radius"
        repair = f"give overlaps below {1e6 * radius:.6g} um, or larger spheres by --radius-mm"
        raise InputError(COMMAND_LINE, "--path-um", problem, repair)


def parse_pair(radius_mm: float, young_mpa: float, poisson: float) -> tuple[float, float, float]:
    """Radius (m), modulus (Pa) and Poisson's ratio, checked."""
    for field, value in (("--radius-mm", radius_mm), ("--young-mpa", young_mpa)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(COMMAND_LINE, field, f"{value:g} is not positive", "give e.g. 2.5")
    if not -1 < poisson < 0.5:
        raise InputError(COMMAND_LINE, "--poisson", f"{poisson:g} is out of range", "give e.g. 0.3")
    return radius_mm * 1e-3, young_mpa * 1e6, poisson
