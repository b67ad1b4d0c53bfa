"""Drive two bodies along a path, quasi-statically: forces of one contact, by any law."""

import csv
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import RenderableType

from calibrate.core.errors import COMMAND_LINE, InputError, shown
from calibrate.core.files import make_folder, write_json, write_text
from calibrate.io.curves import read_columns
from calibrate.simulation import single_contact
from calibrate.verbs import options
from calibrate.verbs.base import AbstractDrawnResult, line, verb

ROTATION = ("wx", "wy", "wz")
VECTORS = {
    "f": ("force_n", "n"),
    "t": ("torque_nm", "nm"),
    "m": ("moment_nm", "nm"),
}  # of contact.csv


@dataclass(frozen=True, eq=False, repr=False)
class ContactResult(AbstractDrawnResult):
    """The forces of one contact along its path.

    Attributes:
        folder: where contact.json and contact.png are, and contact.csv of a path.
        content: everything, with the keys of contact.json.
        tables: contact.csv, where a path was followed.
    """

    verb = "contact"
    files = ("contact.json",)
    folder: Path
    content: dict
    tables: tuple[str, ...] = ()

    @property
    def overlap_m(self) -> np.ndarray:
        """Overlap of the bodies along the path, m."""
        return np.array(self.content["overlap_m"])

    @property
    def normal_force_n(self) -> np.ndarray:
        """Normal force at each overlap, N; attraction is negative."""
        return np.array(self.content["normal_force_n"])

    @property
    def tangential_force_n(self) -> np.ndarray:
        """Tangential force on the moved sphere in the plane of the path, N, positive towards +x;
        empty where overlaps alone were given."""
        return np.array(self.content.get("tangential_force_n", []))

    def words(self) -> Iterator[RenderableType]:
        force, along = self.normal_force_n, np.abs(self.tangential_force_n)
        said = f"largest force {force.max():.4g} N, largest tension {0.0 - force.min():.4g} N"
        if len(along):
            torque = np.linalg.norm(self.content["torque_nm"], axis=1).max()
            said += f", largest tangential force {along.max():.4g} N, torque {torque:.4g} N m"
        yield line(said)

    @property
    def drawn(self) -> tuple:
        """Overlaps (m) and normal forces (N); of a path also shifts and tangential forces."""
        if not len(self.tangential_force_n):
            return self.overlap_m, self.normal_force_n
        sliding = (np.array(self.content["x_m"]), self.tangential_force_n)
        return self.overlap_m, self.normal_force_n, sliding

    def written(self) -> tuple[str, ...]:
        json, *pictures = super().written()
        return (json, *self.tables, *pictures)


@verb
def contact(
    path_um: Annotated[
        Sequence[float | str] | None,
        typer.Option("--path-um", help="Turning points of the overlap, micrometres."),
        options.Typed(str | None, lambda text: text.split(",")),
    ] = None,
    *,
    path: Annotated[
        str | Path | None,
        typer.Option(
            "--path", metavar="FILE.csv", help="Columns z_um, x_um; wx, wy, wz (rad) if it turns."
        ),
        options.Typed(Path | None),
    ] = None,
    law: Annotated[
        str,
        typer.Option(
            "--law",
            help="eepa, liggghts, liggghts_history, hertz_mindlin, hertz_cohesion, "
            "hysteretic_cohesion, jkr or parallel_bond.",
        ),
    ] = "eepa",
    values: options.Changes = None,
    radius_mm: Annotated[float, typer.Option("--radius-mm", help="Radius of both spheres.")] = 2.5,
    second_radius_mm: Annotated[
        float | None, typer.Option("--second-radius-mm", help="Of the moved one, if it differs.")
    ] = None,
    wall: Annotated[
        bool, typer.Option("--wall", help="A plane of the same material stands still, no sphere.")
    ] = False,
    young_mpa: Annotated[float, typer.Option("--young-mpa", help="Young's modulus.")] = 5.0,
    poisson: Annotated[float, typer.Option("--poisson", help="Poisson's ratio.")] = 0.3,
    smooth: Annotated[
        bool, typer.Option("--smooth/--sharp", help="Default roundings, or the law as printed.")
    ] = False,
    out: options.Out = "results/contact",
) -> ContactResult:
    """Drives two bodies along a path, quasi-statically: no dashpot acts.

    Args:
        path_um: turning points of the overlap, micrometres; below zero the spheres are apart.
        path: CSV file with a column z_um, height of the second sphere's centre over its first
            touch, and x_um, its shift; wx, wy and wz, if there, are the angles (rad) by which it
            has turned.  It goes straight from row to row.  Either this or `path_um`.
        law: name of the contact law; `eepa`, `liggghts` and `liggghts_history` take a soil's
            parameters.
        values: the law's parameters by name, in SI units or with a unit, and its options; surface
            energy of a soil acts unscaled on these spheres.
        radius_mm: radius of both spheres, mm.
        second_radius_mm: radius of the moved sphere, mm; None: the same.
        wall: the sphere is moved against a plane that stands still.
        young_mpa: Young's modulus of both, MPa.
        poisson: Poisson's ratio of both.
        smooth: with the roundings that simulations have; False: the law as printed.
        out: folder for results.

    Returns:
        Overlaps and forces, and contact.json and contact.png in `out`.  Of a path also forces and
        torques on the moved sphere, and contact.csv; a torque that the law leaves to the time step
        (rolling resistance of `eepa`) is not in it.

    Raises:
        InputError: an argument is wrong.

    Example:
        >>> loop = calibrate.contact([20, 2, 32, -28], values={"surface_energy": 20.0})
        >>> loop.normal_force_n.max()
    """
    if (path_um is None) == (path is None):
        problem = "no path is given" if path is None else "--path is given as well"
        repair = "give either --path-um 20,2,32,-28 or --path FILE.csv"
        raise InputError(COMMAND_LINE, "--path-um", problem, repair)
    pair = _pair(radius_mm, second_radius_mm, young_mpa, poisson, wall)
    named = single_contact.law_of(law, values)
    points = _metres(path_um) if path_um is not None else []
    rows = _rows(Path(path)) if path is not None else np.zeros((1, 5))
    deepest = max(points) if path is None else _deepest(rows, pair)
    _check_depth(deepest, pair, "--path-um" if path is None else "--path")
    folder = Path(out)
    make_folder(folder)
    if path is None:
        result = ContactResult(folder, single_contact.drive(pair, named, points, smooth))
    else:
        found = single_contact.drive_along(pair, named, rows, smooth)
        result = ContactResult(folder, found, ("contact.csv",))
        write_text(folder / "contact.csv", _table(found))
    write_json(folder / "contact.json", result.content)
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


def _rows(file: Path) -> np.ndarray:
    """Rows of a path: z and x (m) and three rotations (rad), shape (points, 5)."""
    table = read_columns(file)
    places = [1e-6 * table.column(name) for name in ("z_um", "x_um")]
    turns = [table.column(name) if name in table.header else 0 * places[0] for name in ROTATION]
    return np.stack([*places, *turns], axis=1)


def _deepest(rows: np.ndarray, pair: single_contact.Spheres) -> float:
    """Largest overlap along a path, m."""
    height = pair.touching + rows[:, 0]
    distance = height if pair.wall else np.hypot(rows[:, 1], height)
    return float((pair.touching - distance).max())


def _check_depth(deepest: float, pair: single_contact.Spheres, option: str) -> None:
    """Refuses an overlap (m) of spheres that would have gone through each other."""
    smaller = pair.moved if pair.wall else min(pair.radius, pair.moved)
    if deepest >= smaller:
        problem = f"an overlap of {1e6 * deepest:.6g} um is not below the radius"
        repair = f"give overlaps below {1e6 * smaller:.6g} um, or larger spheres by --radius-mm"
        raise InputError(COMMAND_LINE, option, problem, repair)


def _pair(
    radius_mm: float, second_mm: float | None, young_mpa: float, poisson: float, wall: bool
) -> single_contact.Spheres:
    """The two bodies, checked."""
    second = radius_mm if second_mm is None else second_mm
    sizes = (("--radius-mm", radius_mm), ("--second-radius-mm", second), ("--young-mpa", young_mpa))
    for field, value in sizes:
        if not (math.isfinite(value) and value > 0):
            raise InputError(COMMAND_LINE, field, f"{value:g} is not positive", "give e.g. 2.5")
    if not -1 < poisson < 0.5:
        raise InputError(COMMAND_LINE, "--poisson", f"{poisson:g} is out of range", "give e.g. 0.3")
    moved = None if second_mm is None else second_mm * 1e-3
    return single_contact.Spheres(radius_mm * 1e-3, young_mpa * 1e6, poisson, moved, wall)


def _table(found: dict) -> str:
    """What was found along a path, as CSV."""
    columns = {"z_um": 1e6 * np.array(found["z_m"]), "x_um": 1e6 * np.array(found["x_m"])}
    turned = np.array(found["rotation_rad"])
    columns |= {name: turned[:, k] for k, name in enumerate(ROTATION)}
    columns["overlap_um"] = 1e6 * np.array(found["overlap_m"])
    columns |= {name: np.array(found[name]) for name in ("normal_force_n", "tangential_force_n")}
    for letter, (name, unit) in VECTORS.items():
        values = np.array(found[name])
        columns |= {f"{letter}{axis}_{unit}": values[:, k] for k, axis in enumerate("xyz")}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    rows = np.stack(list(columns.values()), axis=1) + 0.0  # no zero with a sign
    writer.writerows([f"{value:.9g}" for value in row] for row in rows)
    return text.getvalue()
