"""All kinds of boundaries, several of them together, and the cell of base, platen and mould.

A new kind is one file beside this one; a line in KINDS puts it under the tests of all kinds.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jdem.boundaries.base import DOWN, UP, AbstractBoundary, Rates, Surface, along, point
from jdem.boundaries.cylinder import Cylinder
from jdem.boundaries.mesh import Mesh
from jdem.boundaries.plane import Plane
from jdem.boundaries.revolved import Revolved
from jdem.boundaries.sphere import Sphere
from jdem.core.quantity import Real
from jdem.core.vector import Vector

KINDS: dict[str, type[AbstractBoundary]] = {
    "plane": Plane,
    "cylinder": Cylinder,
    "sphere": Sphere,
    "revolved": Revolved,
    "mesh": Mesh,
}

Boundaries = tuple[AbstractBoundary, ...]

BASE, PLATEN, MOULD = 0, 1, 2  # of the testing cell
CELL_SURFACES = ("platen", "platen", "mould")  # whose friction they have
FORCE, TORQUE, PUSH = 0, 1, 2  # what resists speed, spin and growth


def cell(platen_height: Real, mould_radius: Real, dtype) -> Boundaries:
    """Base at z = 0, platen at a height (m), and a mould of a radius (m), all at rest."""
    centre = point(0.0, 0.0, 0.0, dtype)
    platen = Plane.at(point(0.0, 0.0, platen_height, dtype), DOWN)
    return (Plane.at(centre, UP), platen, Cylinder.at(centre, UP, mould_radius))


def part_count(boundaries: Boundaries) -> int:
    """Of all boundaries together."""
    return sum(boundary.parts for boundary in boundaries)


def first_parts(boundaries: Boundaries) -> list[int]:
    """The number of each boundary's first part."""
    return [part_count(boundaries[:k]) for k in range(len(boundaries))]


def owner(boundaries: Boundaries, part: Array) -> Array:
    """The number of the boundary that each part belongs to."""
    if part_count(boundaries) == len(boundaries):
        return part
    return jnp.asarray(np.repeat(np.arange(len(boundaries)), [b.parts for b in boundaries]))[part]


def nearest(
    boundaries: Boundaries, number: Array, position: Vector, code: Array | None = None
) -> Surface:
    """The surface of boundary `number` as seen from `position`, and where there are faces, of what
    has this code; arrays of one shape."""
    seen = [b.surface(position) if code is None else b.touched(position, code) for b in boundaries]
    chosen, *others = _alike(seen)
    for k, surface in enumerate(others, start=1):
        chosen = jax.tree.map(lambda a, b, k=k: jnp.where(number == k, a, b), surface, chosen)
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, number.shape), chosen)


def _alike(surfaces: list[Surface]) -> list[Surface]:
    """All with a curvature where any has one: nothing is computed for flat surfaces alone."""
    if all(surface.curvature is None for surface in surfaces):
        return surfaces
    flat = jnp.zeros((), surfaces[0].distance.dtype)
    return [replace(s, curvature=flat) if s.curvature is None else s for s in surfaces]


def effective_radius(radius: Array, curvature: Array | None) -> Array:
    """R* = 1/(1/r + 1/R) (m) of a sphere on a surface of this curvature (1/m)."""
    return radius if curvature is None else radius / (1 + radius * curvature)


def spin_of(boundaries: Boundaries, number: Array) -> Vector:
    """Angular velocity (rad/s) of boundary `number`."""
    rows = [jnp.asarray(b.axis, b.rates.spin.dtype) * b.rates.spin for b in boundaries]
    return Vector.from_rows(jnp.stack(rows)[number])


def driven(boundaries: Boundaries, rates: Array) -> Boundaries:
    """The boundaries at rates (3, boundaries): speed (m/s), spin (rad/s), growth (m/s)."""
    return tuple(b.driven(Rates(*rates[:, k])) for k, b in enumerate(boundaries))


def moved(boundaries: Boundaries, time_step: Real) -> Boundaries:
    """All of them one time step (s) later."""
    return tuple(boundary.moved(time_step) for boundary in boundaries)


LOADS = 7  # columns of loads: force 0-2 (N), torque 3-5 (N m), push 6 (N)


def resistances(boundaries: Boundaries, loads: Array) -> Array:
    """What resists speed, spin and growth, shape (3, boundaries), from loads (boundaries, 7)."""
    rows = [
        (-along(b.axis, Vector(*load[0:3])), -along(b.axis, Vector(*load[3:6])), load[6])
        for b, load in zip(boundaries, loads, strict=True)
    ]
    return jnp.stack([jnp.stack(row) for row in rows], axis=1)


def power(boundaries: Boundaries, loads: Array) -> Array:
    """Power (W) that each boundary gives to the soil, shape (boundaries,)."""
    against = resistances(boundaries, loads)
    rates = jnp.stack([jnp.stack([*jax.tree.leaves(b.rates)]) for b in boundaries], axis=1)
    return against[FORCE] * rates[0] + against[TORQUE] * rates[1] - against[PUSH] * rates[2]


def about_references(boundaries: Boundaries, loads: Array) -> Array:
    """Loads with torques about the reference points, from torques about the origin."""
    rows = [
        jnp.concatenate([load[:3], (Vector(*load[3:6]) - _torque(b, load)).stack(), load[6:]])
        for b, load in zip(boundaries, loads, strict=True)
    ]
    return jnp.stack(rows)


def _torque(boundary: AbstractBoundary, load: Array) -> Vector:
    return boundary.reference.cross(Vector(*load[0:3]))


def strain_rate(boundaries: Boundaries, number: int | None) -> Real:
    """Rate (1/s) at which boundary `number` stretches the soil between it and z = 0; none: 0."""
    if number is None:
        return jnp.zeros_like(boundaries[0].rates.speed)  # a number would have no derivative
    chosen = boundaries[number]
    return chosen.axis[2] * chosen.rates.speed / chosen.reference.z
