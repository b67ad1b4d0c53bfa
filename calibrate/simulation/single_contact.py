"""`calibrate contact`: forces of one contact along a path, by any contact law that has a name."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from calibrate.core.errors import COMMAND_LINE, BadValue, InputError, shown, suggestion
from calibrate.core.units import number_or_quantity
from calibrate.io import conventions
from calibrate.io.labfile import check_parameter
from calibrate.io.soil import with_values
from jdem.apparatus.pair import (
    Along,
    Encounter,
    Path,
    SpherePair,
    drive_overlap,
    drive_path,
    overlap_path,
)
from jdem.core.smooth import Smoothing
from jdem.laws.base import AbstractContactLaw
from jdem.materials.contact_laws import CONTACT_LAWS, NamedLaw, Stated
from jdem.materials.conventions import CONVENTIONS
from jdem.materials.soil import SoilParameters, particle_law

POINTS_PER_LEG = 500
STEPS = 20_000  # of a path in all, at least

Values = Mapping[str, float | str]  # parameters as a user gives them


@dataclass(frozen=True)
class Spheres:
    """Radius (m) of the sphere that stays and of the moved one (None: the same), Young's modulus
    (Pa) and Poisson's ratio of both; with `wall` a plane stays in place of the first."""

    radius: float
    young: float
    poisson: float
    second: float | None = None
    wall: bool = False

    @property
    def moved(self) -> float:
        """Radius of the moved sphere, m."""
        return self.radius if self.second is None else self.second

    @property
    def plain(self) -> bool:
        """Two equal spheres."""
        return self.second is None and not self.wall

    @property
    def touching(self) -> float:
        """Height of the moved sphere's centre over the other one, or the plane, as they touch."""
        return self.moved if self.wall else self.radius + self.moved


@dataclass(frozen=True)
class Law:
    """A law and what it was given: sliding friction and all numbers by name (SI), options by name.

    Attributes:
        make: the law, with these roundings.
    """

    name: str
    numbers: dict[str, float]
    chosen: dict[str, str]

    def of(self, pair: Spheres, smooth: bool) -> tuple[AbstractContactLaw, float]:
        """The law between these bodies, and their coefficient of sliding friction."""
        smoothing = Smoothing() if smooth else Smoothing.sharp()
        if self.name in CONVENTIONS:
            soil = _soil(pair, self.numbers, self.name)
            law = particle_law(soil, jnp.asarray(2 * pair.radius), smoothing)
            return law, float(soil.static_friction)
        numbers = {name: jnp.asarray(value) for name, value in self.numbers.items()}
        stated = Stated(
            jnp.asarray(pair.young), jnp.asarray(pair.poisson), numbers, self.chosen, smoothing
        )
        return CONTACT_LAWS[self.name].law(stated), self.numbers["static_friction"]


def law_of(name: str, values: Values | None) -> Law:
    """The law of this name with these parameters, checked; an `InputError` says what is wrong."""
    given = dict(values or {})
    if name in CONVENTIONS:
        numbers = {
            k: check_parameter(k, v, COMMAND_LINE, f"--set {k}", name) for k, v in given.items()
        }
        conventions.check_values(name, numbers, COMMAND_LINE, "--set ")
        return Law(name, {**conventions.held_by(name, COMMAND_LINE, "--law"), **numbers}, {})
    if name not in CONTACT_LAWS:
        repair = suggestion(name, [*CONVENTIONS, *CONTACT_LAWS])
        raise InputError(COMMAND_LINE, "--law", f"no law is called {shown(name)}", repair)
    law = CONTACT_LAWS[name]
    chosen = {k: _choice(law, k, given.pop(k)) for k in law.options if k in given}
    numbers = {k: _number(name, law, k, value) for k, value in given.items()}
    if missing := law.missing(numbers):
        problem = f"the law '{name}' needs {' and '.join(missing)}"
        repair = "add " + " ".join(f"--set {each}=..." for each in missing)
        raise InputError(COMMAND_LINE, "--set", problem, repair)
    return Law(name, {**law.defaults, **numbers}, chosen)


def _choice(law: NamedLaw, option: str, value: float | str) -> str:
    """What was chosen for an option, checked."""
    known = law.options[option]
    if value not in known:
        problem = f"{shown(value)} is none of its values"
        repair = suggestion(str(value), known)
        raise InputError(COMMAND_LINE, f"--set {option}", problem, repair)
    return str(value)


def _number(name: str, law: NamedLaw, parameter: str, value: float | str) -> float:
    """The value of a law's parameter in SI units, checked."""
    known, field = {entry.name: entry for entry in law.parameters}, f"--set {parameter}"
    if parameter not in known:
        problem = f"the law '{name}' has no parameter {shown(parameter)}"
        repair = suggestion(parameter, [*known, *law.options])
        raise InputError(COMMAND_LINE, field, problem, repair)
    entry = known[parameter]
    try:
        number = number_or_quantity(value, entry.unit)
    except BadValue as bad:
        raise InputError(COMMAND_LINE, field, bad.problem, entry.repair) from None
    if not entry.accepted(number):
        problem = f"{parameter} {value} is out of range"
        raise InputError(COMMAND_LINE, field, problem, entry.repair)
    return number


def _soil(pair: Spheres, values: Mapping[str, float], convention: str) -> SoilParameters:
    """A soil of these spheres' modulus, whose surface energy acts unscaled on them."""
    own = {
        "shear_modulus": pair.young / (2 * (1 + pair.poisson)),
        "poisson_ratio": pair.poisson,
        "reference_diameter": 2 * pair.radius,
    }
    soil = SoilParameters(conventions=CONVENTIONS[convention])
    return with_values(soil, {**own, **values})


def drive(pair: Spheres, law: Law, turning_points_m: list[float], smooth: bool) -> dict:
    """Overlaps (m) and normal forces (N) along turning points of the overlap."""
    overlaps = overlap_path(turning_points_m, POINTS_PER_LEG)
    if pair.plain:
        contact_law, _ = law.of(pair, smooth)
        spheres = SpherePair(jnp.asarray(pair.radius))
        force = eqx.filter_jit(drive_overlap)(contact_law, spheres, overlaps)
    else:
        rows = np.zeros((len(overlaps), 5))
        rows[:, 0] = -np.asarray(overlaps)
        force = _driven(pair, law, rows, smooth).normal_force
    return {
        "overlap_m": np.asarray(overlaps).tolist(),
        "normal_force_n": np.asarray(force).tolist(),
    }


def drive_along(pair: Spheres, law: Law, rows: np.ndarray, smooth: bool) -> dict:
    """All forces along a path of rows (points, 5): z and x of the second sphere's centre over its
    first touch (m), and its rotation about x, y and z (rad).

    The tangential force is its part in the plane of the path, positive towards +x.
    """
    found = _driven(pair, law, rows, smooth)
    traction = np.asarray(found.traction)
    sine, cosine = _slope(pair, rows)
    arrays = {
        "z_m": rows[:, 0],
        "x_m": rows[:, 1],
        "rotation_rad": rows[:, 2:],
        "overlap_m": found.overlap,
        "normal_force_n": found.normal_force,
        "tangential_force_n": cosine * traction[:, 0] - sine * traction[:, 2],
        "force_n": found.force,
        "torque_nm": found.torque,
        "moment_nm": found.moment,
    }
    plain = {name: np.asarray(values).tolist() for name, values in arrays.items()}
    return {"law": law.name, "parameters": law.numbers, "options": law.chosen, **plain}


def _slope(pair: Spheres, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sine and cosine of the normal's angle from z towards x."""
    x = np.zeros(len(rows)) if pair.wall else rows[:, 1]
    height = rows[:, 0] + pair.touching
    distance = np.hypot(x, height)
    return x / distance, height / distance


def _driven(pair: Spheres, law: Law, rows: np.ndarray, smooth: bool) -> Along:
    contact_law, friction = law.of(pair, smooth)
    places = np.zeros((len(rows), 3))
    places[:, 0], places[:, 2] = rows[:, 1], rows[:, 0] + pair.touching
    path = Path(jnp.asarray(places), jnp.asarray(rows[:, 2:]), jnp.zeros_like(places))
    bodies = Encounter(pair.moved, pair.radius, friction, wall=pair.wall)
    steps = math.ceil(STEPS / len(rows))
    return eqx.filter_jit(drive_path)(contact_law, bodies, path, steps)
