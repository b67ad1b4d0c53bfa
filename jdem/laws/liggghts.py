"""What LIGGGHTS 3.8 puts beside a normal law: sliding, rolling, and the load that both feel.

Sliding (`tan_luding`, `history`): the spring alone has the limit.

    f_t = -k_t u - beta v        while k_t |u| < mu N
    f_t = -mu N u/|u|            beyond, without dashpot; u is cut to mu N/k_t
    beta = 2 b zeta sqrt(m* k1)

Luding 2008, Granular Matter 10, 235, section 2.3, with equal static and dynamic friction.  The
dashpot is a share b of the normal one's, k1 its virgin stiffness.  N is the load that the normal
law gives.  `CoulombSpring` differs in that spring and dashpot share the limit and that its dashpot
goes with k_t.  Separation clears the stretch u.

Rolling (`luding`, `epsd2`): an elastic spring with a limit, against the relative spin.

    M = -k_r phi            k_r = k_t R*^2        |M| <= mu_r N R*

phi is the relative rotation across the line of centres.  Iwashita and Oda 1998, Journal of
Engineering Mechanics 124, 285; Ai et al. 2011, Powder Technology 206, 269, model C without its
dashpot.  This is `rolling_friction epsd2` with N = |f_n|, and `rolling_friction luding` with
`coeffRollingStiffness 1` and no viscous damping where N holds the adhesive share.  The lever arm
R* is r/2 between equal spheres and r at a wall, where `ConstantTorque` has r both times.
Separation clears phi.

Load: friction feels the dashpot as well, with or without the adhesive share.

    N = |N_0 + f_damp|           adhesive: N_0 is the load of the law itself
    N = |f_hys + f_damp|         else

`tan_luding` and `luding` add the adhesive share, `history` and `epsd2` do not.  Contacts that
adhesion holds together, f_n near 0, then neither stick nor resist rolling with the latter:
cohesive specimens hardly stand.
"""

import equinox as eqx
import jax.numpy as jnp

from jdem.core import smooth
from jdem.core.fusion import once
from jdem.core.quantity import Real, quantity
from jdem.core.smooth import Smoothing
from jdem.core.vector import Vector
from jdem.laws.base import AbstractNormalLaw, AbstractRollingLaw, AbstractTangentialLaw
from jdem.mechanics.contact import Contact, NormalForce
from jdem.mechanics.dashpot import TOGETHER, damping_ratio, dashpot_constant
from jdem.mechanics.elasticity import AbstractStiffness


class LudingSpring(AbstractTangentialLaw):
    """Spring and slider, and a dashpot while it sticks.

    `restitution` and `stiffness` are those of the normal law, `viscosity` (-) is b; `softest` (-)
    is the least tangential over normal stiffness that the time step reckons with.
    """

    stiffness: AbstractStiffness
    restitution: Real = quantity()
    viscosity: Real = quantity(1.0)
    softest: Real = quantity(1.0)
    smoothing: Smoothing = eqx.field(default_factory=Smoothing)

    def force(self, contact: Contact, normal: NormalForce, stiffness, history: Vector):
        limit = contact.friction * normal.frictional_load
        loaded = jnp.where(limit > 0, 1.0, 0.0)
        stretch = history.without(contact.normal) + contact.slip * contact.time_step
        stretch = once(stretch * loaded)
        load = smooth.divide(stiffness * smooth.norm(stretch), limit)
        stretch, share = once(smooth.limited(stretch, load, self.smoothing.slip))
        sticks = loaded * smooth.saturate_slope(load, self.smoothing.slip)
        normal_stiffness = self.stiffness.damping_stiffness(contact.radius, contact.overlap)
        beta = self.viscosity * dashpot_constant(self.restitution, contact.mass, normal_stiffness)
        spring = stretch * (-stiffness * share)
        return once((spring, contact.slip * (-beta * sticks), stretch))

    def damping_ratio(self):
        """TOGETHER times beta/(2 sqrt(m* k_t)) = b zeta sqrt(k1/k_t)."""
        ratio = self.viscosity * damping_ratio(jnp.log(self.restitution))
        return TOGETHER * ratio / jnp.sqrt(self.softest)

    def memory(self, shape, dtype):
        """Elastic stretch of the spring, m."""
        return Vector.zeros(shape, dtype)


class RollingSpring(AbstractRollingLaw):
    """rolling_friction is mu_r (-); k_t is the tangential stiffness of `shear`, whatever multiplier
    sliding has."""

    shear: AbstractStiffness
    rolling_friction: Real = quantity()
    smoothing: Smoothing = eqx.field(default_factory=Smoothing)

    def limit(self, normal: NormalForce):
        """None: all of it is in the moment."""
        return jnp.zeros_like(normal.hysteretic)

    def moment(self, contact: Contact, normal: NormalForce, history: Vector):
        overlap = jnp.maximum(contact.overlap, 0.0)
        sliding = self.shear.tangential(contact.radius, overlap)
        stiffness = sliding * contact.radius * contact.radius
        limit = self.rolling_friction * normal.frictional_load * contact.radius
        turn = history + contact.spin.without(contact.normal) * (stiffness * contact.time_step)
        turn = once(turn.without(contact.normal) * jnp.where(limit > 0, 1.0, 0.0))
        load = smooth.divide(smooth.norm(turn), limit)
        turn, share = once(smooth.limited(turn, load, self.smoothing.slip))
        return once((turn * -share, turn))

    def memory(self, shape, dtype):
        """The spring's moment before it is rounded, N m."""
        return Vector.zeros(shape, dtype)


class WholeLoad(AbstractNormalLaw):
    """The law `inner` in all but the load that friction feels."""

    inner: AbstractNormalLaw
    adhesive: bool = eqx.field(static=True, default=True)

    def force(self, contact: Contact, history):
        force, history = self.inner.force(contact, history)
        without_dashpot = force.frictional_load if self.adhesive else force.hysteretic
        load = smooth.absolute(without_dashpot + force.viscous, 0.0)
        return NormalForce(force.hysteretic, force.viscous, load), history

    def stiffness_bound(self, radius):
        return self.inner.stiffness_bound(radius)

    def damping_ratio(self):
        return self.inner.damping_ratio()

    def memory(self, shape, dtype):
        return self.inner.memory(shape, dtype)
