"""A bed and its state: what stays while it is tested, what changes, what the machine does."""

import equinox as eqx
from jax import Array

from jdem.bodies.spheres import Motion, Spheres
from jdem.boundaries.composite import CELL_SURFACES, PLATEN, Boundaries
from jdem.core.quantity import Real, quantity
from jdem.engine.energy import Ledger
from jdem.engine.neighbors import ContactList, Grid
from jdem.laws.base import AbstractContactLaw

GRAVITY = 9.81  # m/s2


class TangentDrag(eqx.Module):
    """What holds derivatives of the motion back, and no value (`jdem.engine.equilibrium`).

    background (1/s) acts on each sphere's motion relative to the stretching that `Bed.follows`
    imposes; contact (-) x m*/time step is the constant of dashpots in all contacts.
    """

    background: Real = quantity()
    contact: Real = quantity()


class Bed(eqx.Module):
    """What does not change while a bed is tested: spheres, laws, numerics.

    friction (-) between spheres; wall_friction (-) of the boundaries, shape (boundaries,), whose
    materials `surfaces` names; time_step in s; roll_width (rad/s) is the spin at which half of the
    rolling torque acts.  Background damping acts on the motion relative to the stretching that
    boundary number `follows` imposes; `drag` acts on derivatives alone.
    """

    spheres: Spheres
    particle_law: AbstractContactLaw
    wall_law: AbstractContactLaw
    friction: Real = quantity()
    wall_friction: Array = quantity()
    time_step: Real = quantity()
    roll_width: Real = quantity()
    gravity: Real = quantity(GRAVITY)
    drag: TangentDrag | None = None
    grid: Grid = eqx.field(static=True, kw_only=True)
    surfaces: tuple[str, ...] = eqx.field(static=True, kw_only=True, default=CELL_SURFACES)
    follows: int | None = eqx.field(static=True, kw_only=True, default=PLATEN)


class BedState(eqx.Module):
    """What changes: motion, boundaries, contacts with their histories, loads, energy, time.

    loads (boundaries, 7) are force 0-2 (N), torque about the reference point 3-5 (N m), and push
    6 (N), the sum of normal forces; reading (N or N m) is what the load cell reads.
    """

    motion: Motion
    boundaries: Boundaries
    pairs: ContactList
    wall_contacts: ContactList
    loads: Array
    energy: Ledger
    time: Array
    reading: Array

    @property
    def wall_force(self) -> Array:
        """Push (N) on each boundary, shape (boundaries,)."""
        return self.loads[:, 6]

    @property
    def platen_height(self) -> Array:
        """Height (m) of the testing cell's platen."""
        return self.boundaries[PLATEN].reference.z


class Command(eqx.Module):
    """What the machine does during one step.

    rates (3, boundaries): speed along each boundary's axis (m/s), spin about it (rad/s), growth
    (m/s); damping (1/s) of the background; unloaded_damping (1/s) is added where a sphere carries
    next to no load.
    """

    rates: Array
    damping: Real
    unloaded_damping: Real
