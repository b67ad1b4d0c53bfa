"""Where exported parameters come from: the folder of a fit, or a lab file's starting values."""

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from calibrate.core.errors import COMMAND_LINE, BadValue, InputError, shown
from calibrate.inference.draws import read_draws
from calibrate.inference.misfit import Miss, misses
from calibrate.io.choices import AT, at, of_one_soil, percent, plain
from calibrate.io.lab import Lab, load_lab
from calibrate.io.labfile import PARAMETER_UNITS, check_parameter, entry_of, read_text
from calibrate.io.soil import base_soil
from calibrate.simulation.resolution import PRESETS, specimen
from calibrate.simulation.specimens import soil_json
from jdem.materials.catalogue import EVERY, WHOLE, parameters_of
from jdem.materials.contact_laws import BED_LAWS, SHRINKING
from jdem.materials.conventions import DEFAULT
from jdem.packing import specimen as packing

RESULT = "result.json"  # what `calibrate fit` writes into its folder

UNITS = {name: entry.unit for name, entry in EVERY.items()}
SURFACE_ENERGIES = ("surface_energy", "gamma")  # stated at the reference diameter


@dataclass(frozen=True)
class Found:
    """What is exported: parameters by name in SI, 95 % intervals of those that were fitted.

    `diameter` (m) is that of the particles that the export is for; `fitted_diameter` (m) the
    mean of the spheres of the calibration, None if not known; `origin` says in words where
    the numbers come from; `conventions` whose contact law they are for, or which other law, as a
    lab keeps it; `warnings` what the fit warned of, of which `missed` are the numbers that it did
    not meet.
    """

    soil: str
    origin: str
    values: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    diameter: float
    fitted_diameter: float | None
    conventions: str = DEFAULT
    warnings: tuple[str, ...] = ()
    missed: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> float:
        return self.values[name]

    @property
    def law(self) -> str:
        """The contact law's name in a lab file."""
        return self.conventions if self.conventions in WHOLE else DEFAULT

    @property
    def sized(self) -> str | None:
        """The surface energy that its law has, by name; None where it has none."""
        return next((name for name in SURFACE_ENERGIES if name in self.values), None)

    @property
    def scale(self) -> float:
        """Surface energy at `diameter` over the parameter."""
        return self.diameter / self["reference_diameter"]

    def at_size(self, name: str) -> float:
        """A parameter between particles of `diameter` over what is stated."""
        if name in SHRINKING and name in self.values:
            return 1 / self.scale
        return self.scale if name == self.sized else 1.0

    @property
    def surface_energy(self) -> float:
        """Surface energy between particles of `diameter`, J/m^2."""
        return self[self.sized or "surface_energy"] * self.scale

    def check_law(self, known: Iterable[str], program: str) -> None:
        """`InputError` where an export to a program does not know the soil's law."""
        if self.law not in known:
            problem = f"the law '{self.law}' is not exported to {program}"
            repair = f"export it as csv or json, or calibrate with {' or '.join(known)}"
            raise InputError(self.origin, "law", problem, repair)

    @property
    def young(self) -> float:
        """Young's modulus 2 G (1 + nu), Pa."""
        return 2 * self["shear_modulus"] * (1 + self["poisson_ratio"])

    @property
    def stiffness_ratio(self) -> float:
        """k2/k1 = 1/(1 - plasticity ratio)."""
        return 1 / (1 - self["plasticity_ratio"])


def find(
    path: Path, changes: dict[str, float], diameter: float | None, moisture: float | None = None
) -> Found:
    """The parameters of a fit's folder, its result.json, or a lab file.

    `changes` replace values (and their intervals); without `diameter` (m) the particles are
    as large as the calibration's spheres.  Where parameters differ with moisture, those at this
    one.  Raises `InputError`.
    """
    path = Path(path)
    if path.suffix == ".toml":
        found = _of_lab(path, moisture)
    else:
        found = _of_result(path / RESULT if path.is_dir() else path, moisture)
    if moisture is not None:
        found = replace(found, origin=f"{found.origin}, at a moisture of {percent(moisture)}")
    return _sized(found, path, changes, diameter)


def find_draws(
    folder: Path, count: int, changes: dict[str, float], diameter: float | None
) -> list[Found]:
    """So many soils of a posterior's folder, spread along what its tests leave most open; the rest
    as in `find`."""
    known = read_draws(folder)
    spheres = known.tree.attrs.get("spheres")
    size = _packing_diameter(folder, None if spheres is None else int(spheres))
    found = []
    for number, soil in enumerate(known.spread(count), 1):
        origin = f"{folder}, soil {number} of {count} that the tests allow"
        every = soil_json(soil)
        values = {name: every[name] for name in UNITS if name in every}
        about = str(known.tree.attrs["soil"]), origin, values, {}, math.nan, size
        one = Found(*about, str(known.tree.attrs["conventions"]))
        found.append(_sized(one, folder, changes, diameter))
    return found


def _sized(found: Found, path: Path, changes: dict[str, float], diameter: float | None) -> Found:
    """With changes in place of values, for particles of this diameter (m)."""
    for name in changes:
        entry_of(name, COMMAND_LINE, f"--set {name}", found.conventions)
    if changes:
        kept = {n: i for n, i in found.intervals.items() if n not in changes}
        origin = f"{found.origin}; set by hand: {', '.join(changes)}"
        values = {**found.values, **changes}
        found = replace(found, values=values, intervals=kept, origin=origin)
    wanted = diameter if diameter is not None else found.fitted_diameter
    if wanted is None:
        problem = "the size of the calibration's spheres is not known"
        raise InputError(str(path), "", problem, 'give --diameter "5 mm", that of your particles')
    return replace(found, diameter=wanted)


def _of_lab(path: Path, moisture: float | None) -> Found:
    """The starting values of a lab file, for spheres of the quick preset."""
    lab = load_lab(path)
    values = of_one_soil(soil_json(base_soil(lab)), moisture, str(path))
    origin = f"starting values of {path.name}, not calibrated"
    conventions = lab.particles.conventions
    return Found(lab.name, origin, values, {}, math.nan, _mean_diameter(lab), conventions)


def _mean_diameter(lab: Lab) -> float:
    return 2 * specimen(lab, PRESETS["quick"]).mean_radius()


def _of_result(path: Path, moisture: float | None) -> Found:
    """The fitted parameters of a result.json."""
    result = _json(path)
    parameters = of_one_soil(_table(result, "parameters", path), moisture, str(path))
    law = _law(result, path)
    values = {n: _value(n, parameters.get(n), path, law) for n in parameters_of(law)}
    every = _table(_table(result, "identifiability", path), "interval_95", path)
    known = {n: x for n, x in every.items() if AT not in n or n == at(plain(n), moisture or 0.0)}
    found = {plain(name): interval for name, interval in known.items()}
    intervals = {name: _interval(name, found[name], path) for name in UNITS if name in found}
    soil = str(result.get("soil", "soil"))
    origin = f"{path}, preset {result.get('preset', 'unknown')}"
    diameter = _packing_diameter(path.parent, result.get("spheres"))
    missed = tuple(str(miss) for miss in _misses(result))
    warned = (*_sentences(result.get("warnings"), path), *missed)
    return Found(
        soil, origin, values, intervals, math.nan, diameter, law,
        tuple(dict.fromkeys(warned)), missed,
    )  # fmt: skip


def _law(result: dict, path: Path) -> str:
    """The law of a result, or EEPA's conventions."""
    field = "law" if "law" in result else "conventions"
    name = result.get(field, DEFAULT)
    if not isinstance(name, str) or name not in BED_LAWS:
        raise InputError(str(path), field, f"{shown(name)} is unknown", "run the fit again")
    return name


def _misses(result: dict) -> list[Miss]:
    """What the fit did not meet, by its own numbers, however old the file is."""
    features, targets = result.get("features"), result.get("targets")
    rows = features if isinstance(features, dict) else {}
    known = set(targets) if isinstance(targets, dict) else set()
    return misses(
        {
            name: {"target": True if name in known else None, **row}
            for name, row in rows.items()
            if isinstance(row, dict)
        }
    )


def _sentences(warnings: Any, path: Path) -> list[str]:
    """What the fit warned of; nothing in results of earlier versions."""
    listed = [] if warnings is None else warnings
    if not isinstance(listed, list) or not all(isinstance(each, str) for each in listed):
        raise InputError(str(path), "warnings", "it is no list of sentences", "run the fit again")
    return listed


def _packing_diameter(folder: Path, spheres: int | None) -> float | None:
    """Mean diameter (m) of the spheres of the fit's packings, None if there are none; those of
    other numbers of spheres, with which a fit explores, do not count."""
    diameters = []
    for file in sorted((folder / "packings").glob("*.npz")):
        try:
            bed = packing.load(file)
        except (OSError, ValueError):
            continue
        if spheres in (None, bed.spheres.count):
            diameters.append(float(bed.mean_diameter()))
    return sum(diameters) / len(diameters) if diameters else None


def _json(path: Path) -> dict:
    """The object in a JSON file."""
    try:
        content = json.loads(read_text(path))
    except BadValue as bad:
        repair = "give the folder that `calibrate fit` wrote, or a lab file"
        raise InputError(str(path), "", bad.problem, repair) from None
    except (ValueError, RecursionError) as error:
        raise InputError(str(path), "", f"not valid JSON: {error}", "run the fit again") from None
    if not isinstance(content, dict):
        raise InputError(str(path), "", "it is no JSON object", "give a fit's result.json")
    return content


def _table(content: dict, name: str, path: Path) -> dict:
    table = content.get(name)
    if not isinstance(table, dict):
        problem = "this is not the result of a fit"
        raise InputError(str(path), name, problem, "give the folder that `calibrate fit` wrote")
    return table


def _value(name: str, value: Any, path: Path, law: str) -> float:
    """One parameter, refused where its law does not accept it."""
    if value is None:
        raise InputError(str(path), f"parameters.{name}", "missing", "run the fit again")
    if name in PARAMETER_UNITS:
        return check_parameter(name, value, str(path), f"parameters.{name}", law)
    accepted = EVERY[name].accepted
    if isinstance(value, bool) or not isinstance(value, int | float) or not accepted(value):
        problem = f"{shown(value)} is out of range"
        raise InputError(str(path), f"parameters.{name}", problem, "run the fit again")
    return float(value)


def _interval(name: str, ends: Any, path: Path) -> tuple[float, float]:
    listed = ends if isinstance(ends, list) else []
    numbers = [end for end in listed if isinstance(end, int | float)]
    if len(numbers) != 2 or not all(math.isfinite(end) for end in numbers):
        problem = f"{shown(ends)} is no interval"
        raise InputError(str(path), f"interval_95.{name}", problem, "run the fit again")
    return float(numbers[0]), float(numbers[1])


def in_order(names: Iterable[str]) -> list[str]:
    """Names of parameters in the order of `UNITS`."""
    wanted = set(names)
    return [name for name in UNITS if name in wanted]
