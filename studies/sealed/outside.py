"""Effects outside the library of effects, for cases that should be called unknown.

They are written against the same contract as `jdem.effects`, but `EFFECTS` does not list them,
so no library of runs and no diagnosis knows their signatures.
"""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from jdem.core.quantity import Real, quantity
from jdem.effects.base import About, AbstractEffect
from jdem.laws.base import AbstractContactLaw, Memory
from jdem.mechanics.contact import Contact, ContactForce, NormalForce

ONSET = 0.2  # overlap over R* at which aggregates begin to break, at strength 1
LOST = 0.75  # largest share of its force that a contact loses
PORES = 0.2  # of the volume, filled with air
ATMOSPHERE = 101325.0  # Pa


def _about(
    quantity_: str, typical: tuple[float, float], one_sided: bool, text: str, kind: str
) -> About:
    return About(quantity_, "1", typical, one_sided, text, text, (), "outside the library", kind)


class AggregateCrushing(AbstractEffect):
    """Contacts weaken for good once squeezed beyond ONSET/strength; 0 to 3, dimensionless.

    D = LOST (1 - exp(-<s d_max/(ONSET R*) - 1>)): all elastic and frictional forces times 1 - D.
    """

    strength: Real = quantity(0.0)
    about: ClassVar[About] = _about(
        "weakness s", (0.5, 2.0), True, "softer at large forces", "soil"
    )

    def law(self, law, stage):
        return Crushable(law, self.strength)


class Crushable(AbstractContactLaw):
    """A law whose contacts are damaged by their own largest overlap."""

    inner: AbstractContactLaw
    weakness: Real = quantity()

    def force(self, contact: Contact, history: Memory):
        force, history = self.inner.force(contact, history)
        beyond = self.weakness * _largest_overlap(history) / (ONSET * contact.radius) - 1.0
        left = 1.0 - LOST * -jnp.expm1(-jnp.maximum(beyond, 0.0))
        normal = NormalForce(
            force.normal.hysteretic * left,
            force.normal.viscous,
            force.normal.frictional_load * left,
        )
        weaker = ContactForce(
            normal, force.tangential * left, force.tangential_viscous, force.rolling_limit * left
        )
        return weaker, history

    def longest_step(self, mass, radius):
        return self.inner.longest_step(mass, radius)

    def memory(self, shape, dtype):
        return self.inner.memory(shape, dtype)


def _largest_overlap(history: Memory):
    """What the plastic law within remembers (m), whatever wraps it."""
    leaves = jax.tree_util.tree_leaves_with_path(history)
    return next(leaf for path, leaf in leaves if path[-1] == _LARGEST)


_LARGEST = jax.tree_util.GetAttrKey("max_overlap")


class HeightGradient(AbstractEffect):
    """Density grows towards the base by e over the height: r -> r (1 + e (1/2 - z/h)/3)."""

    strength: Real = quantity(0.0)
    about: ClassVar[About] = _about(
        "relative change e", (-0.06, 0.06), False, "toe, or none", "specimen"
    )

    def packing(self, packing):
        share = 0.5 - packing.position.z / packing.height
        growth = 1 + self.strength * share / 3
        spheres = packing.spheres
        return eqx.tree_at(
            lambda p: (p.spheres.radius, p.spheres.mass),
            packing,
            (spheres.radius * growth, spheres.mass * growth**3),
        )


class EarlyTurn(AbstractEffect):
    """The platen turns `strength` (N) before its target: part of trapped air's realisation."""

    strength: Real = quantity(0.0)
    about: ClassVar[About] = _about("force N", (0.0, 100.0), True, "turns early", "specimen")

    def programme(self, programme, time_scale):
        target = jnp.asarray(programme.force_target).at[0].add(-self.strength)
        return eqx.tree_at(lambda p: p.force_target, programme, target)


def air_force(displacement_mm, height_m: float, diameter_m: float, share: float):
    """Force (N) of pore air under the platen by Boyle's law; `share` of it cannot escape.

    p0 e/(n - e): strain e of a specimen whose pores with air are n of its volume.
    """
    strain = jnp.clip(1e-3 * displacement_mm / height_m, 0.0, 0.9 * PORES)
    pressure = share * ATMOSPHERE * strain / (PORES - strain)
    return pressure * jnp.pi * diameter_m**2 / 4


# Strengths by which one sees most of them at all: in the third set, half of those at 0.7 to 1.6,
# 0.05 to 0.4, 0.06 to 0.15 lay below a signal-to-noise of 6, where nothing can be told of them.
OUTSIDE: dict[str, tuple[float, float]] = {
    "aggregate_crushing": (1.0, 2.0),
    "trapped_air": (0.3, 0.9),
    "height_gradient": (0.15, 0.3),
}
CARRIED: dict[str, type[AbstractEffect]] = {  # by the simulator; trapped air turns early
    "aggregate_crushing": AggregateCrushing,
    "height_gradient": HeightGradient,
    "early_turn": EarlyTurn,
}
