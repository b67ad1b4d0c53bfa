"""JKR: elastic spheres that stick to each other (Johnson, Kendall and Roberts 1971).

    f_n = 4 E* a^3/(3 R*) - sqrt(8 pi w E* a^3)        d = a^2/R* - sqrt(2 pi w a/E*)

w = 2 gamma is the work of adhesion of the PAIR, gamma the surface energy of each body: the gamma
of LAMMPS, and of EDEM's formula of the force.  (EDEM's manual states a pull-off of 3/2 pi gamma R*
beside it, which would need w = gamma.)  With the radius at tear-off, a_t, and a = a_t s^2,

    a_t^3 = pi w R*^2/(8 E*)     d = (a_t^2/R*) (s^4 - 4 s)     f_n = F_c (s^6/9 - 2 s^3/3)

F_c = 3/2 pi w R* is the pull-off.  A contact begins where the spheres touch, with -8/9 F_c, and
ends under a given displacement at s = 1: d = -3 a_t^2/R*, f_n = -5/9 F_c.  That it has touched is
all it remembers.  A cycle of touching and tearing off costs 0.5354 (F_c^5/(E*^2 R*))^(1/3).

LAMMPS of 2025 ends at the pull-off instead, at 0.48 of that gap; EDEM's first version (V1) acts
inside the gap on approach too.  Friction's load is one of `Load`: a limit mu |f_n| would let
contacts slide that adhesion holds with f_n = 0.
"""

import enum

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jdem.core import smooth
from jdem.core.elementary import cube_root
from jdem.core.fusion import once
from jdem.core.parameter import POSITIVE, Parameter, Search
from jdem.core.quantity import Real, quantity
from jdem.laws.base import AbstractNormalLaw
from jdem.mechanics.contact import Contact, NormalForce
from jdem.mechanics.dashpot import HERTZIAN, damping_ratio, hertzian_dashpot
from jdem.mechanics.elasticity import DEEP, AbstractStiffness, HertzStiffness

NEWTON = 8  # steps; the worst start needs seven to the last digit


class Load(enum.Enum):
    """What friction feels."""

    PULL_OFF = "pull_off"  #: |f_n + 2 F_c| without the dashpot (Thornton 1991; LAMMPS)
    REPULSIVE = "repulsive"  #: 4 E* a^3/(3 R*) (EDEM)
    TOTAL = "total"  #: |f_n|, dashpot and all


def torn(dtype) -> float:
    """d R*/a_t^2 where contacts end, s = 1.00005: 5e-9 of the gap short of an infinite slope; in
    single precision 3e-7."""
    return -3 + max(1.5e-8, 8 * float(jnp.finfo(dtype).eps))


@jax.custom_jvp
def relative_root(gap: Array) -> Array:
    """The s >= 1 with s^4 - 4 s = gap for gap > -3: Newton from above, where the curve is convex.

    Both starts are above the root: s = 1 + x has 6 x^2 <= gap + 3, and from 4^(1/3) + g^(1/4) the
    curve is above g.
    """
    near = 1 + jnp.sqrt((gap + 3) / 6)
    far = 4 ** (1 / 3) + jnp.sqrt(jnp.sqrt(jnp.maximum(gap, 0.0)))
    root = jnp.minimum(near, far)
    for _ in range(NEWTON):
        root = root - (root**4 - 4 * root - gap) / (4 * root**3 - 4)
    return root


@relative_root.defjvp
def _relative_root_jvp(primals, tangents):
    """ds/dgap = 1/(4 s^3 - 4), of the root and not of the way to it."""
    root = relative_root(*primals)
    return root, tangents[0] / (4 * root**3 - 4)


class JKRStiffness(AbstractStiffness):
    """Hertz' moduli E* and G* (Pa) with JKR's contact radius a; work_of_adhesion is w in J/m2."""

    hertz: HertzStiffness
    work_of_adhesion: Real = quantity()

    def normal(self, radius):
        return self.hertz.normal(radius)

    def tangential(self, radius, overlap):
        """8 G* a, also where the neck is stretched (d < 0)."""
        return 8 * self.hertz.shear_modulus * self.contact_radius(radius, overlap)

    def raised(self, overlap):
        return self.hertz.raised(overlap)

    def root(self, raised):
        return self.hertz.root(raised)

    def damping_stiffness(self, radius, overlap):
        return 2 * self.hertz.modulus * self.contact_radius(radius, overlap)

    def bound(self, radius):
        """The slope df_n/dd = 2 E* a (s^3 - 3)/(s^3 - 1) stays below 2 E* a."""
        return self.damping_stiffness(radius, DEEP * radius)

    def pull_off(self, radius):
        """F_c = 3/2 pi w R*, N."""
        return 1.5 * jnp.pi * self.work_of_adhesion * radius

    def tear_off_radius(self, radius):
        """a_t, m."""
        return cube_root(jnp.pi * self.work_of_adhesion * radius**2 / (8 * self.hertz.modulus))

    def reach(self, radius):
        """The gap at which contacts tear off, 3 a_t^2/R*, m."""
        return 3 * self.tear_off_radius(radius) ** 2 / radius

    def relative_gap(self, radius, overlap):
        """d R*/a_t^2."""
        return overlap * radius / self.tear_off_radius(radius) ** 2

    def relative_radius(self, radius, overlap):
        """s = sqrt(a/a_t); beyond tear-off its value there."""
        gap = self.relative_gap(radius, overlap)
        return once(relative_root(jnp.maximum(gap, torn(gap.dtype))))

    def contact_radius(self, radius, overlap):
        """a, m."""
        return self.tear_off_radius(radius) * self.relative_radius(radius, overlap) ** 2


class JKR(AbstractNormalLaw):
    """restitution is the dashpot's e in (0, 1], which acts in the neck too, as in LAMMPS.

    Lists of pairs must reach R1 + R2 + `reach`, or stretched contacts are lost.
    """

    stiffness: JKRStiffness
    restitution: Real = quantity(1.0)
    load: Load = eqx.field(static=True, default=Load.PULL_OFF)

    def force(self, contact: Contact, history: Array):
        radius, overlap = contact.radius, contact.overlap
        gap = self.stiffness.relative_gap(radius, overlap)
        holds = (history > 0) & (gap > torn(gap.dtype))
        touching = jnp.where((overlap > 0) | holds, jnp.ones_like(overlap), 0.0)
        root = self.stiffness.relative_radius(radius, overlap)
        cube, most = root**3, self.stiffness.pull_off(radius)
        repulsive = most * cube * cube / 9
        elastic = repulsive - most * cube * (2 / 3)
        viscous = self._dashpot(contact, root) * contact.approach_speed
        load = self._load(elastic, viscous, repulsive, most)
        force = NormalForce(touching * elastic, touching * viscous, touching * load)
        return once((force, touching))

    def memory(self, shape, dtype):
        """1 since the bodies touched, until they tear off."""
        return jnp.zeros(shape, dtype)

    def reach(self, radius):
        """The gap (m) at which contacts of effective radius R* (m) tear off."""
        return self.stiffness.reach(radius)

    def stiffness_bound(self, radius):
        return self.stiffness.bound(radius)

    def damping_ratio(self):
        return HERTZIAN * damping_ratio(jnp.log(self.restitution))

    def _load(self, elastic, viscous, repulsive, most):
        """What friction feels, N."""
        if self.load is Load.PULL_OFF:
            return elastic + 2 * most  # never negative: f_n >= -F_c
        return repulsive if self.load is Load.REPULSIVE else smooth.absolute(elastic + viscous, 0.0)

    def _dashpot(self, contact: Contact, root):
        """2 sqrt(5/6) zeta sqrt(2 E* a m*), N s/m."""
        radius = self.stiffness.tear_off_radius(contact.radius) * root * root
        stiffness = 2 * self.stiffness.hertz.modulus * radius
        return hertzian_dashpot(self.restitution, contact.mass, stiffness)


PARAMETERS = (
    Parameter(
        name="gamma",
        symbol="gamma",
        label="surface energy of each body, half the work of adhesion",
        unit="J/m^2",
        accepted=POSITIVE,
        repair='give a positive value, such as "0.5 J/m^2"; without adhesion take hertz_mindlin',
        # At 5 mm.  A packing bears about the pull-off over d^2, 3/4 pi gamma/d: 24 Pa to 14 kPa,
        # from next to nothing to a stiff loam's.  Beyond, spheres of a soft soil sink into each
        # other.
        search=Search(0.05, 30.0, 1.0),
        names={"EDEM": "JKR soil - soil / Surface Energy"},
    ),
)
