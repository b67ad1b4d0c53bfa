"""Overdamped derivatives: forward mode, with the derivative of the motion held back.

The derivative of a bed that is loaded slowly is that of a sequence of equilibria, K dx = -df.
Pathwise tangents obey the equation of motion instead, m dv' = -K dx - df: where a contact softens
they grow with exp(t sqrt(k/m)), and at some hundred spheres nothing else is left of them.  Here
they also feel a drag that no value feels,

    dv -> affine + (dv - affine)/(1 + b)      relative to the stretching that the platen imposes
    df -> df - (c m*/t) dv_rel                in every contact, t the time step

so they relax towards the equilibrium and grow more slowly where there is none.  b = c = 0 are
pathwise tangents; b -> infinity is frozen motion (docs/gradients.md has both limits and between).

The machine turns at given forces, but a servo whose feedback is differentiated through a bed that
answers late is an unstable loop.  So derivatives see a platen that does not feel the force, and
the travels at which it turned follow from the forces G there (implicit function theorem):

    dG/dp + dG/de de/dp = 0,      d out/dp at given forces = d out/dp + d out/de de/dp

e (-) stretches each travel; its derivatives are further tangents, one a turn.
"""

from dataclasses import replace
from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jdem.core.quantity import Real, quantity
from jdem.engine.loop import AbstractDerivative, Sample
from jdem.engine.segment import Segment
from jdem.engine.state import Bed, BedState, Command, TangentDrag
from jdem.engine.step import step
from jdem.laboratory.virtual_lab import VirtualLab
from jdem.sensitivity.base import AbstractTraced, Read, Simulate, Traced, forward, stands_free

FINER = 0.5  # of the usual time step: the drag is explicit and takes its share of stability
CHORD = 5  # rows of a curve; between two neighbouring ones its slope is mostly roughness
TURN_ROWS = 3  # samples before a turn, over which its force is averaged


class OverdampedMotion(AbstractDerivative):
    """Derivatives under `drag`, of a machine that does not feel forces.

    stretches (-), one for each of the movements `turning`, are zero; derivatives in them are those
    in the logarithms of these movements' travels.
    """

    drag: TangentDrag
    stretches: Array = quantity()
    turning: tuple[int, ...] = eqx.field(static=True, kw_only=True)
    first: int = eqx.field(static=True, default=0, kw_only=True)

    @property
    def chord(self) -> int:
        return CHORD

    def programme(self, programme: Segment) -> Segment:
        speed = programme.speed
        for stretch, number in zip(self.stretches, self.turning, strict=True):
            speed = speed.at[number].multiply((1 + stretch).astype(speed.dtype))
        return eqx.tree_at(lambda p: p.speed, programme, speed)

    def seen(self, force: Array) -> Array:
        return jax.lax.stop_gradient(force)

    def step(self, bed: Bed, state: BedState, command: Command) -> BedState:
        return step(replace(bed, drag=self.drag), state, command)


class Overdamped(AbstractTraced):
    """Forward mode under a drag; background and contact (-) as in `TangentDrag`.

    Not believed are slopes of a test in which the specimen stands free, and those whose growth or
    imbalance (`jdem.sensitivity.base`) is above most_growth or most_imbalance.  `cost` is that of
    one tangent over that of values, 500 spheres (docs/decisions/2026-11-25-derivatives.md); `turns`
    is how many further ones a sequence of tests takes.
    """

    background: Real = quantity(0.04)
    contact: Real = quantity(0.12)
    cost: float = eqx.field(static=True, default=1.2)
    turns: int = eqx.field(static=True, default=2)
    most_growth: float = eqx.field(static=True, default=3.0)
    most_imbalance: float = eqx.field(static=True, default=0.3)

    def laboratory(self, lab: VirtualLab) -> VirtualLab:
        programme = lab.tests.programme()
        reached = np.isfinite(programme.force_target) & (np.asarray(programme.tolerance) > 0)
        turning = tuple(np.flatnonzero(reached).tolist())
        drag = TangentDrag(self.background, self.contact)
        derivative = OverdampedMotion(drag, jnp.zeros(len(turning)), turning=turning)
        finer = replace(lab.numerics, safety=FINER * lab.numerics.safety)
        return replace(lab, derivative=derivative, numerics=finer)

    def traced(self, lab: VirtualLab, simulate: Simulate, read: Read, point: Array) -> Traced:
        motion, count = cast(OverdampedMotion, lab.derivative), point.shape[0]
        turning = motion.turning

        def simulated(x: Array):
            stretched = replace(motion, stretches=x[count:])
            outcome = simulate(replace(lab, derivative=stretched), x[:count])
            turns = [_turning_force(outcome.record.samples, number) for number in turning]
            return outcome, jnp.stack(turns) if turns else jnp.zeros(0, x.dtype)

        everywhere = jnp.concatenate([point, jnp.zeros(len(turning), point.dtype)])
        return forward(lab, simulated, read, everywhere, len(turning))

    def refusals(self, lab: VirtualLab, found: Traced) -> list[list[str]]:
        grown, unbalanced = np.asarray(found.growth), np.asarray(found.imbalance)
        return [
            [self._refusal(grown[test, p], unbalanced[test, p], free) for p in range(len(row))]
            for test, (row, free) in enumerate(zip(grown, stands_free(lab), strict=True))
        ]

    def _refusal(self, growth: float, imbalance: float, free: bool) -> str:
        """Why a slope is not believed; "" if it is."""
        if free:
            return "the specimen stands free: contacts snap, and a derivative does not see when"
        if not (np.isfinite(growth) and np.isfinite(imbalance)):
            return "the derivative is not finite"
        if growth > self.most_growth:
            return f"the derivative of the force grew to {growth:.3g} times the force"
        if imbalance > self.most_imbalance:
            return f"its forces are out of balance by {imbalance:.3g} times the force"
        return ""

    def runs(self, parameters: int, packings: int) -> float:
        return (1 + self.cost * (parameters + self.turns)) / FINER

    def describe(self) -> str:
        return (
            "overdamped: forward mode through every step with a drag on the motion's derivative, "
            "at the forces where the machine turned"
        )


def _turning_force(samples: Sample, number: int) -> Array:
    """Mean reading (N) of a movement's last samples; NaN if it was not reached."""
    rows = jnp.arange(samples.segment.shape[0])
    last = jnp.max(jnp.where(samples.segment == number, rows, -1))
    chosen = (rows > last - TURN_ROWS) & (samples.segment == number)
    total = jnp.sum(jnp.where(chosen, samples.reading, 0.0))
    return jnp.where(last >= 0, total / jnp.maximum(jnp.sum(chosen), 1), jnp.nan)
