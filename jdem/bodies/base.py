"""The contract of bodies: rigid, each of a fixed number of spheres that touch for it.

    spheres 0 .. members-1 belong to body 0, the next `members` to body 1, ...

The neighbour search and the contact laws see spheres; motion is that of bodies.  Members of one
body never touch each other: where a body has more than one, the search leaves such pairs out, and
whether it does is decided as the program is compiled.  Single spheres are the first case: they
are their own members, and nothing is computed for the sake of others.

A kind of several members adds to its motion what tells its orientation, states where its
members are and how fast they move there (`rows`), and takes the moments of their forces about
its centre (`collected`).
"""

import abc
from typing import Any

import equinox as eqx
from jax import Array

from jdem.core.vector import Vector


class AbstractBodies(eqx.Module):
    """N bodies of `members` spheres each; radius (N members,) in m, mass (N,) in kg."""

    radius: eqx.AbstractVar[Array]
    mass: eqx.AbstractVar[Array]

    @property
    @abc.abstractmethod
    def members(self) -> int:
        """Spheres of each body; static."""

    @property
    @abc.abstractmethod
    def inertia(self) -> Array:
        """Moments of inertia, kg m2: (N,) where all three are equal, else (N, 3), principal."""

    @abc.abstractmethod
    def positions(self, motion: Any) -> Vector:
        """Centres (m) of all members, (N members,)."""

    @abc.abstractmethod
    def rows(self, motion: Any) -> Array:
        """What a contact needs of every member, (N members, 11), for one gather.

        Columns: position 0-2, velocity 3-5, spin 6-8, radius 9, mass of its body 10.
        """

    @abc.abstractmethod
    def collected(self, loads: Array, motion: Any) -> Array:
        """Loads (N, 8) on the bodies from those on their members (N members, 8).

        Columns: force 0-2 (N), torque about the centre 3-5 (N m), rolling limit 6 (N m), load 7
        (N).
        """

    @property
    def count(self) -> int:
        """Number of spheres."""
        return self.radius.shape[0]

    def one_body(self, first: Array, second: Array) -> Array | None:
        """Whether spheres belong to one body; None where no two can."""
        if self.members == 1:
            return None
        return first // self.members == second // self.members
