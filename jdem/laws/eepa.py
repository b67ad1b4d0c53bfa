"""EEPA: Edinburgh elasto-plastic adhesion, normal direction (Thakur et al. 2014).

    f_hys = f0 + max( k2 (d^n - dp^n) , -f_min (d/d_min)^x )
    k2 = k1/(1 - lambda_p)       dp^n = lambda_p d_max^n
    f_min = min( 3/2 pi dgamma a , k2 dp^n / 2 )        a^2 = R dp - dp^2/4
    d_min^n = dp^n - f_min/k2    (d_min = dp/2 where f_min is capped)

The published outer minimum with k1 d^n needs no code: the memory d_max is updated
first, and then k2 (d^n - lambda_p d_max^n) <= k1 d^n with equality on virgin loading.
Adhesive reload from the overlap l < d_min lowers the memory for good, to
dp'^n = l^n + (f_min/k2) (l/d_min)^x; the hand-over is spread over a small reload
distance (`Smoothing.reload`).  Separation clears the memory.
"""

from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jdem.core import smooth
from jdem.core.fusion import once
from jdem.core.parameter import FRACTION, NOT_NEGATIVE, Accepted, Parameter, Search
from jdem.core.quantity import Real, quantity
from jdem.core.smooth import Smoothing
from jdem.laws.base import AbstractNormalLaw
from jdem.mechanics.contact import Contact, NormalForce
from jdem.mechanics.dashpot import damping_ratio, dashpot_constant
from jdem.mechanics.elasticity import AbstractStiffness


class Adhesion(eqx.Module):
    """The adhesive branch that belongs to one plastic overlap."""

    strength: Array  #: N; f_min, largest tension
    overlap: Array  #: m; d_min, where it is reached


class PlasticMemory(eqx.Module):
    """What EEPA remembers of one contact; zero while the bodies are apart."""

    max_overlap: Array  #: m; largest overlap, which carries the plastic memory
    low_overlap: Array  #: m; smallest overlap since, from which adhesive reload starts


class EEPA(AbstractNormalLaw):
    """EEPA normal force; every field but the two components is a number in SI units.

    surface_energy (J/m2) is the one that acts between these bodies (already scaled
    to their size); pull_off_force (N) is f0 <= 0; plasticity_ratio is lambda_p in
    (0, 1); tensile_exponent is x; restitution is the dashpot's e in (0, 1].
    """

    stiffness: AbstractStiffness
    restitution: Real = quantity()
    surface_energy: Real = quantity()
    plasticity_ratio: Real = quantity()
    tensile_exponent: Real = quantity(2.0)
    pull_off_force: Real = quantity(0.0)
    smoothing: Smoothing = eqx.field(default_factory=Smoothing)

    @staticmethod
    def of(
        values: Mapping[str, Real],
        diameter: Real,
        adhesion: Real,
        stiffness: AbstractStiffness,
        smoothing: Smoothing,
    ) -> "EEPA":
        """The law of a soil (`jdem.materials.soil`).

        Its surface energy is scaled from reference_diameter to bodies of `diameter` (m).
        """
        scaled = values["surface_energy"] * diameter / values["reference_diameter"]
        return EEPA(
            stiffness=stiffness,
            restitution=values["restitution"],
            surface_energy=adhesion * scaled,
            plasticity_ratio=values["plasticity_ratio"],
            tensile_exponent=values["tensile_exponent"],
            pull_off_force=values["pull_off_force"],
            smoothing=smoothing,
        )

    def force(self, contact: Contact, history: PlasticMemory):
        overlap = jnp.maximum(contact.overlap, 0.0)
        touching = jnp.where(contact.overlap > 0, 1.0, 0.0)
        history = self._loaded(overlap, history)
        plastic = self._plastic_overlap(history.max_overlap)
        plastic, history = once(self._reloaded(contact, overlap, plastic, history))
        adhesion = once(self._adhesion(contact, plastic))
        tension = once(self._tension(overlap, adhesion))
        hysteretic = self._branches(contact, overlap, plastic, tension, adhesion)
        hysteretic = once(hysteretic)
        force = NormalForce(
            hysteretic=touching * hysteretic + self._pull_off(contact, overlap),
            viscous=self._viscous(contact, overlap),
            frictional_load=touching * jnp.maximum(hysteretic + tension, 0.0),
        )
        return once((force, jax.tree.map(lambda leaf: leaf * touching, history)))

    def memory(self, shape, dtype):
        zero = jnp.zeros(shape, dtype)
        return PlasticMemory(zero, zero)

    def loading_stiffness(self, contact: Contact):
        """k1, N/m^n: virgin loading follows k1 d^n."""
        return self.stiffness.normal(contact.radius)

    def unloading_stiffness(self, contact: Contact):
        """k2 = k1 / (1 - lambda_p), N/m^n."""
        return self.loading_stiffness(contact) / (1 - self.plasticity_ratio)

    def stiffness_bound(self, radius: Array):
        return self.stiffness.bound(radius) / (1 - self.plasticity_ratio)

    def damping_ratio(self):
        return damping_ratio(jnp.log(self.restitution))

    def _loaded(self, overlap, history: PlasticMemory):
        """Virgin loading carries the plastic memory with it and forgets earlier reloads."""
        virgin = overlap >= history.max_overlap
        return PlasticMemory(
            max_overlap=jnp.maximum(history.max_overlap, overlap),
            low_overlap=jnp.where(virgin, overlap, jnp.minimum(history.low_overlap, overlap)),
        )

    def _plastic_overlap(self, max_overlap):
        """d_p = lambda_p^(1/n) d_max, m."""
        return self.stiffness.root(self.plasticity_ratio * self.stiffness.raised(max_overlap))

    def _adhesion(self, contact: Contact, plastic) -> Adhesion:
        """Largest tension f_min and its overlap d_min for the plastic overlap dp."""
        k2 = self.unloading_stiffness(contact)
        raised = self.stiffness.raised(plastic)
        cap = 0.5 * k2 * raised
        free = 1.5 * jnp.pi * self.surface_energy * lens_radius(2 * contact.radius, plastic)
        strength = smooth.minimum(free, cap, self.smoothing.cap * cap)
        uncapped = self.stiffness.root(raised - smooth.divide(strength, k2))
        capped = smooth.step(free / jnp.maximum(cap, _TINY) - 1, self.smoothing.cap)
        return Adhesion(strength, uncapped + capped * (0.5 * plastic - uncapped))

    def _tension(self, overlap, adhesion: Adhesion):
        """f_min (d/d_min)^x, N, with a finite slope at d = 0 also for x < 1."""
        ratio = smooth.divide(overlap, adhesion.overlap)
        return adhesion.strength * smooth.power(ratio, self.tensile_exponent, _RATIO_FLOOR)

    def _reloaded(self, contact: Contact, overlap, plastic, history: PlasticMemory):
        """Plastic overlap after adhesive reload, and the memory once it has taken over.

        On the unloading line `lowered` is above `plastic`, so the minimum leaves it alone; a
        reload that has come back to virgin loading takes the memory of the present overlap.
        """
        low = history.low_overlap
        adhesion = once(self._adhesion(contact, plastic))
        tension = once(self._tension(low, adhesion))
        raised = self.stiffness.raised(low) + tension / self.unloading_stiffness(contact)
        lowered = jnp.minimum(self.stiffness.root(raised), plastic)
        lowered = jnp.maximum(lowered, self._plastic_overlap(overlap))  # never above k1 d^n
        lowered = once(lowered)
        share = smooth.step(overlap - low, self.smoothing.reload * plastic)
        done = (share >= 1.0) & (lowered < plastic)
        raised_max = self.stiffness.raised(lowered) / self.plasticity_ratio
        memory = self.stiffness.root(raised_max)
        history = PlasticMemory(
            max_overlap=jnp.where(done, memory, history.max_overlap),
            low_overlap=jnp.where(done, memory, low),
        )
        return plastic + share * (lowered - plastic), history

    def _branches(self, contact: Contact, overlap, plastic, tension, adhesion: Adhesion):
        """The unloading line, or the adhesive branch where that is higher, N."""
        raised = self.stiffness.raised
        line = self.unloading_stiffness(contact) * (raised(overlap) - raised(plastic))
        return smooth.maximum(line, -tension, self.smoothing.branch * adhesion.strength)

    def _pull_off(self, contact: Contact, overlap):
        """The constant f0, switched on with the overlap, N."""
        return self.pull_off_force * self._onset(contact, overlap)

    def _viscous(self, contact: Contact, overlap):
        stiffness = self.stiffness.damping_stiffness(contact.radius, overlap)
        beta = dashpot_constant(self.restitution, contact.mass, _positive(stiffness))
        return beta * contact.approach_speed * self._onset(contact, overlap)

    def _onset(self, contact: Contact, overlap):
        return smooth.step(overlap, self.smoothing.onset * contact.radius)


def lens_radius(radius, overlap):
    """Radius a of the circle in which two equal spheres intersect, a^2 = R d - d^2/4, m."""
    square = radius * overlap - 0.25 * overlap * overlap
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


def _positive(x):
    return jnp.maximum(x, _TINY)


_TINY = 1e-30  # below any stiffness (N/m) or force (N) of interest, and normal in float32
_RATIO_FLOOR = 1e-3  # overlap ratio d/d_min below which the adhesive branch is a chord

PARAMETERS = (
    Parameter(
        name="surface_energy",
        symbol="dgamma",
        label="surface energy at the reference diameter",
        unit="J/m^2",
        accepted=NOT_NEGATIVE,
        repair='give 0 or a positive value, such as "17 J/m^2"',
        search=Search(1.0, 150.0, 1.0, calibrated_sd=0.45),
        names={
            "EDEM": "EEPA model soil - soil / Surface Energy",
            "LIGGGHTS": "surfaceEnergy",
            "Yade": "kc",
        },
    ),
    Parameter(
        name="plasticity_ratio",
        symbol="lambda_p",
        label="contact plasticity ratio",
        accepted=FRACTION,
        repair="give a number above 0 and below 1, such as 0.4",
        search=Search(0.05, 0.85, 0.4, calibrated_sd=0.08),
        names={
            "EDEM": "EEPA model soil - soil / Contact Plasticity Ratio",
            "LIGGGHTS": "UnloadingStiffness",
            "Yade": "kp",
        },
    ),
    Parameter(
        name="tensile_exponent",
        symbol="x",
        label="exponent of the adhesive branch",
        accepted=Accepted(0.5, 5.0),
        repair="give a number from 0.5 to 5, such as 2",
        search=Search(0.5, 5.0, 0.4, calibrated_sd=0.3),
        names={
            "EDEM": "EEPA model soil - soil / Tensile Exp",
            "LIGGGHTS": "adhesionExponent",
        },
    ),
    Parameter(
        name="pull_off_force",
        symbol="f0",
        label="constant pull-off force",
        unit="N",
        accepted=Accepted(most=0.0),
        repair='give 0 or a negative (tensile) force, such as "0 N"',
        names={
            "EDEM": "EEPA model soil - soil / Constant Pull-Off Force",
            "LIGGGHTS": "pullOffForce",
        },
    ),
)
