"""Energy by channel: where the work of boundaries and gravity went.

    sum W_boundary + W_gravity = dK + sum of what springs, dashpots, rolling and the
                                 background absorbed

Power of contacts and gravity is evaluated at the start of a step.  What that misses,
because velocities change within the step, is kept as `integration`: an error of first
order in the time step, and the reason why the balance closes to round-off.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jdem.boundaries.composite import PLATEN


class Ledger(eqx.Module):
    """Work (J) since the start; springs hold what they store and what they dissipate.

    boundaries, shape (boundaries,), is what each of them gave.
    """

    boundaries: Array
    gravity: Array
    normal_spring: Array
    normal_dashpot: Array
    tangential_spring: Array
    tangential_dashpot: Array
    rolling: Array
    background: Array
    integration: Array

    @property
    def platen(self) -> Array:
        """Work of the testing cell's platen, J."""
        return self.boundaries[..., PLATEN]

    @staticmethod
    def zeros(boundaries: int, dtype) -> "Ledger":
        return Ledger(jnp.zeros(boundaries, dtype), *[jnp.zeros((), dtype) for _ in range(8)])

    def __add__(self, other: "Ledger") -> "Ledger":
        return jax.tree.map(jnp.add, self, other)

    def supplied(self) -> Array:
        """Work of boundaries, gravity, and of the integration error."""
        return jnp.sum(self.boundaries) + self.gravity + self.integration

    def absorbed(self) -> Array:
        """Work that went into springs, dashpots, rolling and background damping."""
        springs = self.normal_spring + self.tangential_spring
        dashpots = self.normal_dashpot + self.tangential_dashpot
        return springs + dashpots + self.rolling + self.background

    @staticmethod
    def of_step(
        contacts: Array,
        rolling: Array,
        boundaries: Array,
        absorbed: Array,
        gravity: Array,
        time_step,
    ) -> "Ledger":
        """One step: power (W) of contacts (4,), of moments, boundaries and gravity, energies
        absorbed (3,) in J."""
        return Ledger(
            boundaries=boundaries * time_step,
            gravity=gravity * time_step,
            normal_spring=contacts[0] * time_step,
            normal_dashpot=contacts[1] * time_step,
            tangential_spring=contacts[2] * time_step,
            tangential_dashpot=contacts[3] * time_step,
            rolling=absorbed[1] + rolling * time_step,
            background=absorbed[0],
            integration=absorbed[2],
        )
