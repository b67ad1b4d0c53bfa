"""Hertz-Mindlin: elastic spheres, with the memory that their tangential spring keeps; cohesion.

    f_n = 4/3 E* sqrt(R*) d^1.5 + 2 sqrt(5/6) zeta sqrt(S_n m*) d'        S_n = 2 E* sqrt(R* d)
    f_t = -S_t u, at most mu N                                            S_t = 8 G* sqrt(R* d)

The rebound is e at every speed, because the contact ends at d = 0 and may pull before (Antypov
and Elliott 2011, EPL 94, 50004; EDEM, LIGGGHTS `hertz`).  S_t changes with the load, so what the
spring remembers decides what a change of load does to it (`Kept`):

    STRETCH             u                                    LIGGGHTS `history`, LAMMPS `mindlin`
    FORCE               f_t, df_t = -S_t du                  YADE, LAMMPS `mindlin/force`
    STRETCH_RESCALED    u, smaller with S_t on unloading     LAMMPS `mindlin_rescale`
    FORCE_RESCALED      f_t, smaller with S_t on unloading   LAMMPS `mindlin_rescale/force`

Only the last one never gains energy from changes of load (Thornton, Cummins and Cleary 2013,
Powder Technology 233, 30): a kept stretch does on loading, a kept force on unloading.  Others
restore the length of the spring when its plane turns (LAMMPS, YADE) or not (LIGGGHTS, here): no
difference for small steps.  YADE makes slip larger by 1/(1 - d/(2 R)) unless told not to, and takes
G* from mean moduli.

Linear cohesion: -k_c A is added, A the area of the circle in which the spheres intersect
(LIGGGHTS `cohesion sjkr`, EDEM "Linear Cohesion"); it has no force beyond touching, and is no JKR.
"""

import enum
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.core import smooth
from jdem.core.fusion import once
from jdem.core.quantity import Real, quantity
from jdem.core.smooth import Smoothing
from jdem.core.vector import Vector
from jdem.laws.base import AbstractNormalLaw, AbstractTangentialLaw
from jdem.mechanics.contact import Contact, NormalForce, lens_area
from jdem.mechanics.dashpot import HERTZIAN, TOGETHER, damping_ratio, hertzian_dashpot
from jdem.mechanics.elasticity import DEEP, HertzStiffness


class Hertz(AbstractNormalLaw):
    """Elastic force and dashpot; restitution is e in (0, 1].  Friction feels |f_n|, dashpot and
    all, as in LIGGGHTS and LAMMPS; YADE takes 0 where f_n pulls."""

    stiffness: HertzStiffness
    restitution: Real = quantity(1.0)

    def force(self, contact: Contact, history):
        overlap = jnp.maximum(contact.overlap, 0.0)
        elastic = self.stiffness.normal(contact.radius) * self.stiffness.raised(overlap)
        stiffness = self.stiffness.damping_stiffness(contact.radius, overlap)
        beta = hertzian_dashpot(self.restitution, contact.mass, stiffness)
        viscous = beta * contact.approach_speed
        return NormalForce(elastic, viscous, smooth.absolute(elastic + viscous, 0.0)), history

    def stiffness_bound(self, radius):
        """At the overlap DEEP R*: soil of 30 MPa comes there at 100 kPa, and beds that reckoned
        with one of 0.01 R* were a seventh too weak, with a closed balance of energy."""
        return self.stiffness.damping_stiffness(radius, DEEP * radius)

    def damping_ratio(self):
        return HERTZIAN * damping_ratio(jnp.log(self.restitution))


class LinearCohesion(AbstractNormalLaw):
    """The law `inner` and -k_c A; cohesion is k_c in J/m3.

    Friction feels what `inner` says, or with `felt` the whole force (LIGGGHTS'
    `tangential_reduce on`).  A bed does not say which sphere is the smaller: both count as 2 R*,
    which makes A too large by 2e-4 for radii that differ by 35 % at an overlap of 2 % of R*, and by
    8e-3 on a plane.
    """

    inner: AbstractNormalLaw
    cohesion: Real = quantity()
    felt: bool = eqx.field(static=True, default=False)

    def force(self, contact: Contact, history):
        force, history = self.inner.force(contact, history)
        pull = self.cohesion * lens_area(contact)
        load = smooth.absolute(force.total() - pull, 0.0) if self.felt else force.frictional_load
        return NormalForce(force.hysteretic - pull, force.viscous, load), history

    def stiffness_bound(self, radius):
        return self.inner.stiffness_bound(radius)

    def damping_ratio(self):
        return self.inner.damping_ratio()

    def reach(self, radius):
        return self.inner.reach(radius)

    def memory(self, shape, dtype):
        return self.inner.memory(shape, dtype)


class Kept(enum.Enum):
    """What a tangential spring whose stiffness changes with the load keeps meanwhile."""

    STRETCH = "stretch"
    FORCE = "force"
    STRETCH_RESCALED = "stretch_rescaled"
    FORCE_RESCALED = "force_rescaled"

    @property
    def force(self) -> bool:
        """Whether the memory is a force (N) and not a stretch (m)."""
        return self in (Kept.FORCE, Kept.FORCE_RESCALED)

    @property
    def rescaled(self) -> bool:
        """Whether it shrinks with the stiffness on unloading."""
        return self in (Kept.STRETCH_RESCALED, Kept.FORCE_RESCALED)


class SpringMemory(NamedTuple):
    """What the spring remembers; zero while the bodies are apart."""

    spring: Vector  #: m or N; its stretch, or the force that resists it
    stiffness: Array  #: N/m; S_t at the time


class MindlinSpring(AbstractTangentialLaw):
    """Spring and slider, and LIGGGHTS' and EDEM's dashpot 2 sqrt(5/6) zeta sqrt(S_t m*) while it
    sticks; restitution is e in (0, 1]."""

    kept: Kept = eqx.field(static=True, default=Kept.STRETCH)
    restitution: Real = quantity(1.0)
    smoothing: Smoothing = eqx.field(default_factory=Smoothing)

    def force(self, contact: Contact, normal: NormalForce, stiffness, history: SpringMemory):
        limit = contact.friction * normal.frictional_load
        loaded = jnp.where(limit > 0, 1.0, 0.0)
        unit = jnp.ones_like(stiffness) if self.kept.force else stiffness  # force of the spring's 1
        rate = stiffness if self.kept.force else jnp.ones_like(stiffness)  # its change with slip
        spring = history.spring.without(contact.normal) * self._left(stiffness, history.stiffness)
        spring = once((spring + contact.slip * (rate * contact.time_step)) * loaded)
        load = smooth.divide(unit * smooth.norm(spring), limit)
        spring, share = once(smooth.limited(spring, load, self.smoothing.slip))
        sticks = loaded * smooth.saturate_slope(load, self.smoothing.slip)
        beta = hertzian_dashpot(self.restitution, contact.mass, stiffness)
        memory = SpringMemory(spring, stiffness * loaded)
        return once((spring * (-unit * share), contact.slip * (-beta * sticks), memory))

    def damping_ratio(self):
        """TOGETHER times that of one contact: with twice the step a plate sinks half as hard."""
        return TOGETHER * HERTZIAN * damping_ratio(jnp.log(self.restitution))

    def memory(self, shape, dtype):
        return SpringMemory(Vector.zeros(shape, dtype), jnp.zeros(shape, dtype))

    def _left(self, stiffness, before):
        """The share of the spring that a change of load leaves."""
        if not self.kept.rescaled:
            return 1.0
        less = stiffness < before
        return jnp.where(less, stiffness / jnp.where(less, before, 1.0), 1.0)
