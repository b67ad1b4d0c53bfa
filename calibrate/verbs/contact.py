"""Drive two equal spheres through overlaps, quasi-statically: force-overlap loop."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import RenderableType

from calibrate.core.errors import COMMAND_LINE, InputError, shown
from calibrate.core.files import make_folder, write_json
from calibrate.simulation import single_contact
from calibrate.verbs import options
from calibrate.verbs.base import AbstractDrawnResult, line, parameter_values, verb


@dataclass(frozen=True, eq=False, repr=False)
class ContactResult(AbstractDrawnResult):
    """The force-overlap loop of one contact.

    Attributes:
        folder: where contact.json and contact.png are.
    """

    verb = "contact"
    files = ("contact.json",)
    folder: Path
    content: dict

    @property
    def overlap_m(self) -> np.ndarray:
        """Overlap of the spheres along the path, m."""
        return np.array(self.content["overlap_m"])

    @property
    def normal_force_n(self) -> np.ndarray:
        """Normal force at each overlap, N; attraction is negative."""
        return np.array(self.content["normal_force_n"])

    def words(self) -> Iterator[RenderableType]:
        force = self.normal_force_n
        yield line(f"largest force {force.max():.4g} N, largest tension {-force.min():.4g} N")

    @property
    def drawn(self) -> tuple[np.ndarray, np.ndarray]:
        """Overlaps (m) and normal forces (N)."""
        return self.overlap_m, self.normal_force_n


@verb
def contact(
    path_um: Annotated[
        Sequence[float | str],
        typer.Option("--path-um", help="Turning points of the overlap, micrometres."),
        options.Typed(str, lambda text: text.split(",")),
    ],
    *,
    values: options.Changes = None,
    radius_mm: Annotated[float, typer.Option("--radius-mm", help="Radius of both spheres.")] = 2.5,
    young_mpa: Annotated[float, typer.Option("--young-mpa", help="Young's modulus.")] = 5.0,
    poisson: Annotated[float, typer.Option("--poisson", help="Poisson's ratio.")] = 0.3,
    smooth: Annotated[
        bool, typer.Option("--smooth/--sharp", help="Default roundings, or the law as printed.")
    ] = False,
    out: options.Out = "results/contact",
) -> ContactResult:
    """Drives two equal spheres through overlaps, quasi-statically.

    Args:
        path_um: turning points of the overlap, micrometres; below zero the spheres are apart.
        values: the soil's parameters by name, in SI units or with a unit; surface energy acts
            unscaled on these spheres.
        radius_mm: radius of both spheres, mm.
        young_mpa: Young's modulus of both, MPa.
        poisson: Poisson's ratio of both.
        smooth: with the roundings that simulations have; False: the law as printed.
        out: folder for results.

    Returns:
        Overlaps and normal forces, and contact.json and contact.png in `out`.

    Raises:
        InputError: an argument is wrong.

    Example:
        >>> loop = calibrate.contact([20, 2, 32, -28], values={"surface_energy": 20.0})
        >>> loop.normal_force_n.max()
    """
    points = _metres(path_um)
    pair = single_contact.Spheres(*_checked(radius_mm, young_mpa, poisson))
    _check_path(points, pair.radius)
    folder = Path(out)
    make_folder(folder)
    found = single_contact.drive(pair, parameter_values(values), points, smooth)
    result = ContactResult(folder, found)
    write_json(folder / "contact.json", found)
    result.save_figures()
    return result


def _metres(path_um: Sequence[float | str]) -> list[float]:
    """Turning points in m, refused where one is no number."""
    try:
        points = [1e-6 * float(point) for point in path_um]
    except (TypeError, ValueError):
        points = []
    if not points or not all(map(math.isfinite, points)):
        said = ",".join(map(str, path_um))
        problem = f"{shown(said)} is no list of numbers"
        raise InputError(COMMAND_LINE, "--path-um", problem, "write 20,2,32,-28")
    return points


def _check_path(points: list[float], radius: float) -> None:
    """Refuses overlaps (m) of spheres that would have gone through each other."""
    deepest = max(points)
    if deepest >= radius:
        problem = f"an overlap of {1e6 * deepest:.6g} um is not below the radius"
        repair = f"give overlaps below {1e6 * radius:.6g} um, or larger spheres by --radius-mm"
        raise InputError(COMMAND_LINE, "--path-um", problem, repair)


def _checked(radius_mm: float, young_mpa: float, poisson: float) -> tuple[float, float, float]:
    """Radius (m), modulus (Pa) and Poisson's ratio, checked."""
    for field, value in (("--radius-mm", radius_mm), ("--young-mpa", young_mpa)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(COMMAND_LINE, field, f"{value:g} is not positive", "give e.g. 2.5")
    if not -1 < poisson < 0.5:
        raise InputError(COMMAND_LINE, "--poisson", f"{poisson:g} is out of range", "give e.g. 0.3")
    return radius_mm * 1e-3, young_mpa * 1e6, poisson
