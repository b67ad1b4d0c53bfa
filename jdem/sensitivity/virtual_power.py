"""Virtual power: the platen's force from the power balance, differentiated with the motion frozen.

    F v = sum over contacts of force . velocity + rolling + damping + dK/dt - gravity

F is the platen's force and v its speed.  Every value is that of the ordinary simulation; only
derivatives differ.  Until the segment `first` they are pathwise.  From then on they see

    velocities of spheres and walls as constants, and with them kinetic energy and damping;
    each contact's force through the law's parameters, its history and its overlap;
    the platen's force through the balance above.

What the tests before did to positions and histories is dropped when the motion is frozen, or
carried along (`carried`): constant velocities then keep the derivatives of all positions, and
overlaps change accordingly, so that histories, which remember overlaps, stay consistent with
them.  (A derivative of a plastic overlap beside an overlap without one is a force of the size
of the stiffness.)  Carried derivatives come with a stiffness and are balanced only while no contact
opens or yields; measured, they swamp the slopes of the crushing force.  Hence dropped by default.

Bias: a parameter also changes how the bed moves (docs/derivatives.md).  For a rigid-plastic body it
would not matter, as the collapse mechanism makes the dissipation stationary (upper bound theorem:
Drucker, Prager and Greenberg 1952, Quarterly of Applied Mathematics 9, 381).
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jdem.bodies.spheres import Motion, kinetic_energy
from jdem.boundaries.composite import PLATEN
from jdem.core import smooth
from jdem.core.quantity import Real
from jdem.core.tangents import with_derivative_of
from jdem.core.vector import Vector
from jdem.engine.energy import Ledger
from jdem.engine.loop import AbstractDerivative
from jdem.engine.step import Bed, BedState, Command, next_motion, step
from jdem.laboratory.virtual_lab import VirtualLab
from jdem.sensitivity.base import AbstractTraced


class VirtualPower(AbstractTraced):
    """Forward mode in which the motion is frozen from some movement on.

    `first` names the segment from which on the motion is frozen; `carried` as in
    `FrozenMotion`; `cost` is that of one tangent in forward runs
    (docs/decisions/2026-11-21-slopes-for-fits.md).
    """

    first: str = eqx.field(static=True, default="crushing")
    carried: bool = eqx.field(static=True, default=False)
    cost: float = eqx.field(static=True, default=1.3)

    def laboratory(self, lab: VirtualLab) -> VirtualLab:
        return replace(
            lab, derivative=FrozenMotion(lab.tests.names.index(self.first), self.carried)
        )

    def runs(self, parameters: int, packings: int) -> float:
        return 1 + self.cost * parameters

    def describe(self) -> str:
        return f"virtual power: pathwise until {self.first}, then with the motion frozen"


class FrozenMotion(AbstractDerivative):
    """Derivatives see a frozen motion from segment number `first` on.

    Derivatives of positions, walls and histories at that moment are `carried` along or dropped.
    """

    first: int = eqx.field(static=True)
    carried: bool = eqx.field(static=True, default=False)

    def begun(self, state: BedState) -> BedState:
        """The state at the moment when the motion is frozen."""
        if not self.carried:
            return jax.lax.stop_gradient(state)
        speeds = (state.motion.velocity, state.motion.spin)
        motion = Motion(state.motion.position, *jax.lax.stop_gradient(speeds))
        return eqx.tree_at(lambda s: s.motion, state, motion)

    def step(self, bed: Bed, state: BedState, command: Command) -> BedState:
        """One time step; its work is taken alone, free of what the sum so far rounds off."""
        before = eqx.tree_at(
            lambda s: s.energy, state, Ledger.zeros(len(state.boundaries), state.time.dtype)
        )
        after = step(bed, before, jax.lax.stop_gradient(command), _as_it_went)
        balanced = force_by_power(bed, state.motion, after)
        columns = jnp.array([2, 6])  # the axial force, upward, and the push
        force = with_derivative_of(after.loads[PLATEN, columns], balanced)
        loads, energy = after.loads.at[PLATEN, columns].set(force), state.energy + after.energy
        return eqx.tree_at(lambda s: (s.loads, s.energy), after, (loads, energy))


def force_by_power(bed: Bed, before: Motion, after: BedState) -> Array:
    """Platen force (N) from the power balance of one time step; 0 where the platen rests.

    The energy of `after` holds the work of this step alone, which began with the motion `before`.
    """
    work = after.energy
    kinetic = kinetic_energy(bed.spheres, after.motion) - kinetic_energy(bed.spheres, before)
    others = jnp.sum(work.boundaries.at[PLATEN].set(0.0))
    taken = work.absorbed() + kinetic - work.gravity - others
    travel = after.boundaries[PLATEN].rates.speed * bed.time_step
    return smooth.divide(taken - jax.lax.stop_gradient(work.integration), travel)


def _as_it_went(bed: Bed, motion: Motion, stretching: Real, loads: Array, command: Command):
    """`next_motion` as numbers; positions keep their derivative, and rolling feels its limit."""
    still = jax.lax.stop_gradient((bed, motion, stretching, loads, command))
    moved, absorbed = next_motion(*still)
    position = with_derivative_of(moved.position, motion.position)
    rolling = bed.time_step * _rolling_power(moved.spin, loads[:, 6], bed.roll_width)
    rolling = with_derivative_of(absorbed[1], rolling)
    return Motion(position, moved.velocity, moved.spin), absorbed.at[1].set(rolling)


def _rolling_power(spin: Vector, limit: Array, width) -> Array:
    """Power (W) of rolling torques with their limits in N m."""
    rate = smooth.norm(spin)
    return jnp.sum(limit * rate * rate / (rate + width))
