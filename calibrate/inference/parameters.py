"""The parameters that a fit may free: bounds, priors and the space a solver moves in; strengths of
effects, which a posterior may free with them.

    y = logit((t(p) - t(low)) / (t(high) - t(low))),   t = ln

A solver works on unbounded y; the parameter never leaves (low, high).  Priors are
normal in ln p around the starting value.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.stats import truncnorm

from calibrate.core.errors import COMMAND_LINE, InputError, suggestion
from calibrate.io.choices import expanded, plain
from calibrate.io.conventions import check_free
from calibrate.io.lab import Lab
from calibrate.io.labfile import PARAMETER_UNITS, entry_of
from calibrate.io.soil import base_soil, with_values
from jdem.core.parameter import Search as Range
from jdem.materials.catalogue import WHOLE, parameters_of
from jdem.materials.conventions import DEFAULT
from jdem.materials.soil import SoilParameters
from jdem.sensitivity.ensemble import Ensemble

FACTORS = (
    "restitution",
    "static_friction",
    "rolling_friction",
    "surface_energy",
    "plasticity_ratio",
    "tensile_exponent",
    "tangential_multiplier",
)

ON_WALLS = ("wall_friction", "platen_friction")  # fitted only where a user names them


def ranges(law: str) -> dict[str, Range]:
    """Where a fit looks for the parameters of a law (a name that a lab keeps), by name."""
    return {n: entry.search for n, entry in parameters_of(law).items() if entry.search is not None}


def candidates(law: str) -> tuple[str, ...]:
    """The parameters of a law that a fit chooses from."""
    if law in WHOLE:
        return tuple(name for name in ranges(law) if name not in ON_WALLS)
    return (*FACTORS, "shear_modulus")


def ranges_of(lab: Lab) -> dict[str, Range]:
    """Where a fit looks for the parameters of a lab's law, those that differ with moisture once for
    each moisture of its specimens."""
    return expanded(ranges(lab.particles.conventions), lab.differing())


def candidates_of(lab: Lab) -> tuple[str, ...]:
    """The parameters that a fit of a lab chooses from."""
    return tuple(expanded(dict.fromkeys(candidates(lab.particles.conventions)), lab.differing()))


def not_held(lab: Lab) -> tuple[str, ...]:
    """Those of them that the lab file does not hold."""
    held = {name for name, choice in lab.parameters.items() if choice.free is False}
    return tuple(name for name in candidates_of(lab) if name not in held)


def stated_free(lab: Lab) -> tuple[str, ...] | None:
    """The parameters that a lab file frees; None where it leaves the choice to a fit."""
    stated = [name for name, choice in lab.parameters.items() if choice.free]
    present = [own for values in lab.differing().values() for own in values]
    return tuple(name for name in stated if name == plain(name) or name in present) or None


# Bounds enclose the paper's Plackett-Burman levels (Table 2); priors are as wide as they.
RANGES = ranges(DEFAULT)


def checked_free(names: Sequence[str], lab: Lab) -> tuple[str, ...]:
    """Names of parameters that are to be fitted, refused where one cannot be, or where the lab's
    law does not have it, or its conventions hold it; of one that differs with moisture, those of
    its values."""
    law = lab.particles.conventions
    known = ranges_of(lab)
    names = [own for name in names for own in lab.differing().get(name, [name])]
    for name in names:
        if name not in known:
            if name in PARAMETER_UNITS:
                entry_of(name, COMMAND_LINE, "--free", law)
            repair = suggestion(name, known) or f"give some of {', '.join(known)}"
            raise InputError(COMMAND_LINE, "--free", f"'{name}' cannot be fitted", repair)
    if not names or len(set(names)) < len(names):
        problem = "no name, or one name twice"
        raise InputError(COMMAND_LINE, "--free", problem, "name each parameter once")
    check_free(lab.particles.conventions, names, COMMAND_LINE, "--free ")
    return tuple(names)


@dataclass(frozen=True)
class Space:
    """Free parameters by name, each with its bounds, and the values of all others.

    Arrays follow the order of `names`; `base` holds every parameter of the soil.
    """

    names: tuple[str, ...]
    ranges: tuple[Range, ...]
    base: SoilParameters

    def start(self) -> np.ndarray:
        """The base soil's values of the free parameters."""
        values = self.base.values()
        return np.array([float(values[name]) for name in self.names])

    def soil(self, values) -> SoilParameters:
        """The base soil with the free parameters at `values`; differentiable."""
        return with_values(self.base, dict(zip(self.names, jnp.asarray(values), strict=True)))

    def to_unbounded(self, values: np.ndarray) -> np.ndarray:
        """y of the values, which must lie within the bounds."""
        share = np.clip(self.share(values), _EDGE, 1 - _EDGE)
        return np.log(share / (1 - share))

    def from_unbounded(self, y) -> np.ndarray:
        """Values of y."""
        return within(np.asarray(y), self.log_bounds())

    def log_slope(self, y) -> np.ndarray:
        """d ln p / d y, to turn slopes per ln p into slopes per y."""
        low, high = self.log_bounds()
        share = 1 / (1 + np.exp(-np.asarray(y)))
        return (high - low) * share * (1 - share)

    def inside(self, log_values: np.ndarray) -> np.ndarray:
        """ln p moved to the nearest point within the bounds; shape (..., p)."""
        return np.clip(log_values, *self.log_bounds())

    def bounds(self) -> np.ndarray:
        """Lowest and highest values (p, 2)."""
        return np.array([(entry.low, entry.high) for entry in self.ranges]).reshape(-1, 2)

    def prior_sd(self) -> np.ndarray:
        """Standard deviations of ln p."""
        return np.array([entry.prior_sd for entry in self.ranges])

    def at_bound(self, values: np.ndarray) -> list[str]:
        """Names of parameters within one per cent of a bound, in ln p."""
        shares = zip(self.names, self.share(values), strict=True)
        return [name for name, share in shares if share < 0.01 or share > 0.99]

    def share(self, values: np.ndarray) -> np.ndarray:
        """Where values (p,) lie between their bounds in ln p: 0 at the lower, 1 at the upper."""
        low, high = self.log_bounds()
        return (np.log(values) - low) / (high - low)

    def log_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """ln of the lowest and of the highest values, each (p,)."""
        low = np.log([entry.low for entry in self.ranges])
        return low, np.log([entry.high for entry in self.ranges])


def within(y, log_bounds):
    """Values (p,) of unbounded y (p,), of numpy or JAX, between the bounds' logarithms."""
    numbers, (low, high) = y.__array_namespace__(), log_bounds
    return numbers.exp(low + (high - low) / (1 + numbers.exp(-y)))


class Acting(NamedTuple):
    """An effect that may act on the tests: the strength that is typical of it, in its unit, and how
    many typical strengths runs reach down and up to."""

    name: str
    typical: float
    unit: str
    low: float
    high: float


class Strengths(eqx.Module):
    """Strengths (e,) of effects, in typical ones, between low and high."""

    names: tuple[str, ...] = eqx.field(static=True)
    low: Array
    high: Array

    @staticmethod
    def of(acting: Sequence[Acting]) -> "Strengths":
        ends = np.array([(each.low, each.high) for each in acting]).reshape(-1, 2)
        return Strengths(tuple(each.name for each in acting), *map(jnp.asarray, ends.T))

    def values(self, y: Array) -> Array:
        """At unbounded y (e,)."""
        return self.low + (self.high - self.low) * jax.nn.sigmoid(y)

    @property
    def prior(self):
        """Of each (e,): normal, of deviation 1."""
        return truncnorm(np.asarray(self.low), np.asarray(self.high))

    def drawn(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Of the prior (count, e)."""
        shape = (count, len(self.names))
        return self.prior.rvs(shape, random) if self.names else np.zeros(shape)

    def prior_sd(self) -> np.ndarray:
        """Of the prior (e,)."""
        return np.asarray(self.prior.std()) if self.names else np.zeros(0)

    def start(self) -> tuple[np.ndarray, np.ndarray]:
        """The prior's middle, y (e,), and its variance (e,) there."""
        if not self.names:
            return np.zeros(0), np.zeros(0)
        span = np.asarray(self.high - self.low)
        share = (self.prior.median() - np.asarray(self.low)) / span
        slope = span * share * (1 - share)
        return np.log(share / (1 - share)), self.prior.var() / slope**2


DIGITS = 12


def to_digits(values: np.ndarray, digits: int = DIGITS) -> np.ndarray:
    """Values rounded so that a point taken to ln p or y and back is the same, simulated once."""
    return np.vectorize(lambda value: float(f"{value:.{digits}g}"), otypes=[float])(values)


PROBE = 0.2  # usual step in ln p; about 20 %


def probing_steps(space: Space) -> tuple[float, ...]:
    """Steps in ln p (p,): PROBE, or as far as the nearer bound of a parameter is away."""
    (low, high), start = space.log_bounds(), np.log(space.start())
    return tuple(np.minimum(PROBE, np.minimum(high - start, start - low)).tolist())


# What matters most to depth and force, spread over three groups when dealt out in turn: with the
# modulus go parameters that hardly change the depth, with the plasticity ratio, and with
# rolling friction, such that do not act through the same term (docs/derivatives.md).
DEALT = (
    "shear_modulus",
    "yield_strength",
    "plasticity_ratio",
    "rolling_friction",
    "surface_energy",
    "gamma",
    "cohesion",
    "tensile_strength",
    "shear_strength",
    "normal_stiffness",
    "shear_stiffness",
    "tangential_multiplier",
    "restitution",
    "tensile_exponent",
    "static_friction",
    "wall_friction",
    "platen_friction",
)
MOST_GROUPS = 3
# Parameters of which the audit confirmed no slope while others moved with them.
ALONE = ("restitution", "tensile_exponent", "static_friction", "wall_friction", "platen_friction")


def probing_groups(names: Sequence[str]) -> tuple[tuple[int, ...], ...]:
    """Indices of the parameters that are probed together: two or three in a group where that
    is enough for MOST_GROUPS, in the order of DEALT."""
    return _dealt(names, range(len(names)))


def fitting_groups(names: Sequence[str]) -> tuple[tuple[int, ...], ...]:
    """The same for a fit: those of ALONE are moved one at a time, as the audit's reference is."""
    single = [i for i, name in enumerate(names) if plain(name) in ALONE]
    together = [i for i in range(len(names)) if i not in single]
    return (*_dealt(names, together), *((i,) for i in single))


def _dealt(names: Sequence[str], chosen: Sequence[int]) -> tuple[tuple[int, ...], ...]:
    """The chosen indices in groups, dealt out in the order of DEALT."""
    count = min(MOST_GROUPS, max(min(len(chosen), 2), -(-len(chosen) // 2)))
    order = sorted(chosen, key=lambda i: DEALT.index(plain(names[i])))
    return tuple(tuple(order[first::count]) for first in range(count))


def ensemble(space: Space, pairs: int = 1) -> Ensemble:
    """Slopes in all parameters at a cost of six runs a packing; screening relies on it."""
    return Ensemble(probing_steps(space), probing_groups(space.names), pairs)


def fitting_ensemble(space: Space) -> Ensemble:
    """What fits use and the audit passes: the ensemble, with two runs more a packing for each
    parameter whose slopes the audit could not confirm within a group."""
    return Ensemble(probing_steps(space), fitting_groups(space.names))


_EDGE = 1e-6  # keeps a start on a bound off infinity


def space(lab: Lab, names: tuple[str, ...], base: SoilParameters | None = None) -> Space:
    """Free parameters with the lab file's bounds and priors where it states them."""
    base = base_soil(lab) if base is None else base
    every, values = tuple(range_of(lab, name) for name in names), base.values()
    for name, bounds in zip(names, every, strict=True):
        _check_inside(lab, name, float(values[name]), bounds)
    return Space(names, every, base)


def _check_inside(lab: Lab, name: str, value: float, bounds: Range) -> None:
    """Refuses a start on or beyond the bounds of a free parameter."""
    if not bounds.low < value < bounds.high:
        raise InputError(
            lab.file,
            f"parameters.{name}",
            f"{value:g} is not between the bounds {bounds.low:g} and {bounds.high:g} of a fit",
            "change the value, or give its low and high",
        )


def range_of(lab: Lab, name: str) -> Range:
    """Bounds and prior of a parameter, those of the lab file where it states them."""
    default, choice = ranges(lab.particles.conventions)[plain(name)], lab.parameters.get(name)
    if choice is None:
        return default
    stated = (choice.low, choice.high, choice.prior_sd)
    usual = (default.low, default.high, default.prior_sd)
    return Range(*[u if s is None else s for s, u in zip(stated, usual, strict=True)])
