"""Contact laws by name, for one contact between two bodies of one material.

    hertz_mindlin        elastic spheres; `memory` names what the tangential spring keeps
    hertz_cohesion       the same with linear cohesion
    hysteretic_cohesion  hysteretic spring of Walton and Braun with linear cohesion
    jkr                  elastic spheres that stick; gamma is each body's surface energy
    parallel_bond        a bond of Potyondy and Cundall beside Hertz-Mindlin, or alone

All have a rolling spring beside them whose limit is 0 unless given.  Beds can have all of them
(BED_LAWS), with the parameters of a soil (`jdem.materials.soil`), beside the conventions of EEPA.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import jax.numpy as jnp

from jdem.core.parameter import Accepted, Parameter
from jdem.core.quantity import Real
from jdem.core.smooth import Smoothing
from jdem.laws import bond, friction, hysteretic, jkr
from jdem.laws.base import AbstractContactLaw, AbstractNormalLaw
from jdem.laws.composite import ContactLaw
from jdem.laws.hertz_mindlin import Hertz, Kept, LinearCohesion, MindlinSpring
from jdem.laws.liggghts import RollingSpring
from jdem.materials.conventions import CONVENTIONS, Parts
from jdem.mechanics import dashpot
from jdem.mechanics.elasticity import (
    DEEP,
    AbstractStiffness,
    HertzStiffness,
    LinearStiffness,
    contact_modulus,
    contact_shear_modulus,
)


class Stated(NamedTuple):
    """What a user states: Young's modulus (Pa) and Poisson's ratio of both bodies, parameters by
    name (SI), options by name, widths of roundings."""

    young: Real
    poisson: Real
    values: Mapping[str, Real]
    chosen: Mapping[str, str]
    smoothing: Smoothing

    def hertz(self) -> HertzStiffness:
        """Contact moduli of two equal bodies."""
        shear = self.young / (2 * (1 + self.poisson))
        modulus = contact_modulus(shear, self.poisson)
        return HertzStiffness(modulus, contact_shear_modulus(shear, self.poisson))


@dataclass(frozen=True)
class NamedLaw:
    """A law that has a name.

    Attributes:
        build: makes it of all that is stated.
        parameters: what it takes.
        defaults: of parameters that may be left out, SI.
        options: for each option that is no number, what may be chosen; the first is the default.
    """

    build: Callable[[Stated], AbstractContactLaw]
    parameters: tuple[Parameter, ...]
    defaults: Mapping[str, float] = field(default_factory=dict)
    options: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def missing(self, values: Mapping[str, Real]) -> list[str]:
        """Names of parameters that have no default and are not in `values`."""
        names = [entry.name for entry in self.parameters]
        return [name for name in names if name not in {**self.defaults, **values}]

    def law(self, stated: Stated) -> AbstractContactLaw:
        """The law; what is not stated has its default."""
        values = {**self.defaults, **stated.values}
        chosen = {name: known[0] for name, known in self.options.items()} | dict(stated.chosen)
        return self.build(stated._replace(values=values, chosen=chosen))


def hertz_mindlin(stated: Stated) -> ContactLaw:
    """LIGGGHTS `hertz tangential history rolling_friction epsd2`, unless chosen otherwise."""
    hertz = stated.hertz()
    return _with_springs(Hertz(hertz, stated.values["restitution"]), hertz, stated)


def hertz_cohesion(stated: Stated) -> ContactLaw:
    """LIGGGHTS `cohesion sjkr`; the load "total" is its `tangential_reduce on`."""
    hertz = stated.hertz()
    elastic = Hertz(hertz, stated.values["restitution"])
    felt = stated.chosen["friction_load"] == "total"
    cohesive = LinearCohesion(elastic, stated.values["cohesion"], felt)
    return _with_springs(cohesive, hertz, stated)


def hysteretic_cohesion(stated: Stated) -> ContactLaw:
    """EDEM "Hysteretic Spring" and "Linear Cohesion"; sliding has the stiffness n K1."""
    values = stated.values
    normal = hysteretic.HystereticSpring(
        yield_strength=values["yield_strength"],
        restitution=values["restitution"],
        cohesion=values["cohesion"],
        damping_factor=values["damping_factor"],
        onset=stated.smoothing.onset,
    )
    loading = LinearStiffness(values["yield_strength"], 5.0)  # K1
    undamped = stated._replace(values={**values, "restitution": 1.0})
    law = _with_springs(normal, loading, undamped)
    return replace(law, tangential_multiplier=values["tangential_multiplier"])


def sticking(stated: Stated) -> ContactLaw:
    """LAMMPS `jkr` with `tangential mindlin`, but up to the tear-off itself."""
    stiffness = jkr.JKRStiffness(stated.hertz(), 2 * stated.values["gamma"])
    load = jkr.Load(stated.chosen["friction_load"])
    return _with_springs(jkr.JKR(stiffness, stated.values["restitution"], load), stiffness, stated)


def parallel_bond(stated: Stated) -> bond.ParallelBond:
    """EDEM "Bonding V2", PFC: a bond beside Hertz-Mindlin; the base "none": the bond alone."""
    alone = stated.chosen["base"] == "none"
    base = hertz_mindlin(stated._replace(young=0.0 * stated.young) if alone else stated)
    return bond.ParallelBond(base, **{e.name: stated.values[e.name] for e in bond.PARAMETERS})


def _with_springs(
    normal: AbstractNormalLaw, shear: AbstractStiffness, stated: Stated
) -> ContactLaw:
    """A normal law with Mindlin's spring and a rolling spring beside it."""
    values, smoothing = stated.values, stated.smoothing
    kept = Kept(stated.chosen.get("memory", Kept.STRETCH.value))
    return ContactLaw(
        normal=normal,
        shear=shear,
        tangential=MindlinSpring(kept, values["restitution"], smoothing),
        rolling=RollingSpring(shear, values["rolling_friction"], smoothing),
        deepest=DEEP,
    )


_UP_TO_ONE = Accepted(0.0, 1.0, least_open=True)
_TABLES = (friction, dashpot, hysteretic, jkr)
_KNOWN = {entry.name: entry for table in _TABLES for entry in table.PARAMETERS}
_ELASTIC = replace(_KNOWN["restitution"], accepted=_UP_TO_ONE, repair="give above 0, at most 1")
_SLIDING = (_KNOWN["static_friction"], _KNOWN["rolling_friction"])
_FREE = {"restitution": 1.0, "rolling_friction": 0.0}  # no dashpot, no resistance to rolling
_BONDED = {"radius_ratio": 1.0, "internal_friction": 0.0, "moment_share": 1.0}
_MEMORY = {"memory": tuple(kept.value for kept in Kept)}

CONTACT_LAWS: dict[str, NamedLaw] = {
    "hertz_mindlin": NamedLaw(hertz_mindlin, (*_SLIDING, _ELASTIC), _FREE, _MEMORY),
    "hertz_cohesion": NamedLaw(
        hertz_cohesion,
        (_KNOWN["cohesion"], *_SLIDING, _ELASTIC),
        _FREE,
        {**_MEMORY, "friction_load": ("elastic", "total")},
    ),
    "hysteretic_cohesion": NamedLaw(
        hysteretic_cohesion,
        (
            *hysteretic.PARAMETERS,
            *_SLIDING,
            replace(_ELASTIC, label="coefficient of restitution, sqrt(K1/K2)"),
            _KNOWN["tangential_multiplier"],
        ),
        {"rolling_friction": 0.0, "damping_factor": 0.0, "tangential_multiplier": 1.0},
    ),
    "jkr": NamedLaw(
        sticking,
        (*jkr.PARAMETERS, *_SLIDING, _ELASTIC),
        _FREE,
        {**_MEMORY, "friction_load": tuple(load.value for load in jkr.Load)},
    ),
    "parallel_bond": NamedLaw(
        parallel_bond,
        (*bond.PARAMETERS, *_SLIDING, _ELASTIC),
        {**_FREE, **_BONDED},
        {**_MEMORY, "base": ("hertz_mindlin", "none")},
    ),
}


# ---------------------------------------------------------------- laws of beds


def hertz_mindlin_bed(parts: Parts) -> AbstractContactLaw:
    """Hertz-Mindlin of a soil."""
    return _of_soil("hertz_mindlin", parts)


def hertz_cohesion_bed(parts: Parts) -> AbstractContactLaw:
    """Hertz-Mindlin of a soil, with linear cohesion."""
    return _of_soil("hertz_cohesion", parts)


def hysteretic_cohesion_bed(parts: Parts) -> AbstractContactLaw:
    """The hysteretic spring of a soil, with linear cohesion."""
    return _of_soil("hysteretic_cohesion", parts)


def jkr_bed(parts: Parts) -> AbstractContactLaw:
    """JKR of a soil."""
    return _of_soil("jkr", parts)


def parallel_bond_bed(parts: Parts) -> AbstractContactLaw:
    """Hertz-Mindlin of a soil and bonds, once and where a laboratory lets them form."""
    law = _of_soil("parallel_bond", parts)
    return replace(law, forming=0.0, within=BONDED_WITHIN, longest=BONDED_UP_TO)


ATTRACTING = ("cohesion", "gamma")  # what `wall_adhesion` multiplies at walls
BONDING = ("tensile_strength", "shear_strength", "normal_stiffness", "shear_stiffness")
SIZED = ("gamma",)  # what is stated at the reference diameter, and grows with the spheres
SHRINKING = ("normal_stiffness", "shear_stiffness")  # the same, over the spheres' diameter
BONDED_WITHIN = 0.02  # of R*, a hundredth of a radius; gap up to which bonds form in beds
BONDED_UP_TO = 0.4  # of R*; gap up to which they hold, as contact radii of 1.1 radii do in EDEM
NO_ADHESION = 1e-12  # of the soil's, where JKR and the reach of bonds need some


def _of_soil(name: str, parts: Parts) -> AbstractContactLaw:
    """A law by name from what a soil states: G and Poisson's ratio, and the law's parameters.

    Strength of a packing goes with gamma/d (Rumpf 1962), so gamma grows with the spheres as EEPA's
    surface energy does; then a bed of spheres of any size is the same but for its scale.  A bond's
    stiffness per area is a modulus over a length, so it goes with 1/d, and strengths stay.
    """
    law, values = CONTACT_LAWS[name], parts.values
    own = {entry.name: values[entry.name] for entry in law.parameters if entry.name in values}
    share = jnp.maximum(parts.adhesion, NO_ADHESION)
    own |= {each: share * own[each] for each in (*ATTRACTING, *BONDING) if each in own}
    own |= {each: parts.size * own[each] for each in SIZED if each in own}
    own |= {each: own[each] / parts.size for each in SHRINKING if each in own}
    young = 2 * values["shear_modulus"] * (1 + values["poisson_ratio"])
    return law.law(Stated(young, values["poisson_ratio"], own, {}, parts.smoothing))


BED_LAWS: dict[str, Callable[[Parts], AbstractContactLaw]] = {
    **CONVENTIONS,
    "hertz_mindlin": hertz_mindlin_bed,
    "hertz_cohesion": hertz_cohesion_bed,
    "hysteretic_cohesion": hysteretic_cohesion_bed,
    "jkr": jkr_bed,
    "parallel_bond": parallel_bond_bed,
}
