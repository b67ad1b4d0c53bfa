"""A specimen of spheres: what is to be filled, the bed that fills it, and its file.

porosity = 1 - volume of the spheres / volume between base, platen and mould
"""

import os
import uuid
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from jdem.bodies.spheres import Spheres
from jdem.core.quantity import Real, quantity
from jdem.core.vector import Vector
from jdem.engine.bed import Numerics, plan_grid
from jdem.engine.neighbors import Grid


class Specimen(eqx.Module):
    """What is to be filled: mould diameter and height of the soil (m), bulk density (kg/m3),
    number of spheres, half-width of the uniform distribution of radii over their mean, and the
    porosity (-) that the bed has to have; without one, spheres settle as they fall."""

    diameter: float = eqx.field(static=True, default=0.05)
    height: float = eqx.field(static=True, default=0.10)
    density: float = eqx.field(static=True, default=1829.6)
    count: int = eqx.field(static=True, default=150)
    spread: float = eqx.field(static=True, default=0.15)
    porosity: float | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        if self.porosity is not None and not 0 < self.porosity < 1:
            raise ValueError(f"a porosity of {self.porosity:g}: give one between 0 and 1, as 0.43")

    def mean_radius(self) -> float:
        """Mean radius (m) with which `count` spheres fill the specimen."""
        cylinder = np.pi / 4 * self.diameter**2 * self.height
        radius = 0.0
        for _ in range(20):
            usual = solid_fraction(2 * radius / self.diameter)
            solid = usual if self.porosity is None else 1 - self.porosity
            cube = solid * cylinder / self.count
            radius = float((cube / (4 / 3 * np.pi * (1 + self.spread**2))) ** (1 / 3))
        return radius

    def max_radius(self) -> float:
        """Radius (m) of the largest sphere there can be."""
        return self.mean_radius() * (1 + self.spread)

    def grid(
        self, numerics: Numerics, stretch: float = 1.5, reach: float = 0.0, touched: float = 0.0,
        spreads: float = 1.0,
    ) -> Grid:  # fmt: skip
        """Neighbour search for any packing of this specimen, `stretch` times its height, with
        forces across gaps up to `reach` (m), and tools of `touched` (m2) in it; its cells cover
        `spreads` times its diameter."""
        mean, largest = self.mean_radius(), self.max_radius()
        extent = (self.diameter, stretch * self.height)
        numerics = replace(numerics, wall_layer=numerics.wall_layer * self.wall_share())
        return plan_grid(self.count, mean, largest, extent, numerics, reach, touched, spreads)

    def wall_share(self) -> float:
        """Area of base, platen and mould over volume, beside a specimen twice as high as wide:
        flat ones have more wall to a sphere.  At least 1."""
        return max(1.0, (1 + 0.5 * self.diameter / self.height) / 1.25)

    def at_usual_porosity(self) -> "Specimen":
        """The same with the porosity that spheres of this size usually have in this mould."""
        usual = 1 - solid_fraction(2 * self.mean_radius() / self.diameter)
        return replace(self, porosity=round(usual, 4))


def solid_fraction(size_ratio: float) -> float:
    """Usual solid fraction of a bed at sphere over mould diameter: spheres leave more room at
    walls.  A fit to beds that settled with little friction (`jdem.packing.settling`)."""
    return 0.62 - 0.55 * size_ratio


class Packing(eqx.Module):
    """A bed at rest: centres (m), radii (m), masses (kg), and its mould (m)."""

    position: Vector
    spheres: Spheres
    height: Real = quantity()
    mould_radius: Real = quantity()

    def mean_diameter(self) -> Array:
        return 2 * jnp.mean(self.spheres.radius)

    def bulk_density(self) -> Array:
        """Mass of the spheres over the volume between base, platen and mould, kg/m3."""
        return jnp.sum(self.spheres.mass) / (jnp.pi * self.mould_radius**2 * self.height)

    def solid_fraction(self) -> Array:
        solid = 4 / 3 * jnp.pi * jnp.sum(self.spheres.radius**3)
        return solid / (jnp.pi * self.mould_radius**2 * self.height)


def with_density(packing: Packing, density: float) -> Packing:
    """The packing with all masses scaled to a bulk density (kg/m3)."""
    scale = density / packing.bulk_density()
    return eqx.tree_at(lambda p: p.spheres.mass, packing, packing.spheres.mass * scale)


def save(packing: Packing, path: Path) -> None:
    """Writes a packing as numbers only (.npz), atomically."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.{os.getpid()}-{uuid.uuid4().hex[:12]}.part")
    try:
        with part.open("wb") as file:
            np.savez(
                file,
                position=np.asarray(packing.position.stack()),
                radius=np.asarray(packing.spheres.radius),
                mass=np.asarray(packing.spheres.mass),
                height=np.asarray(packing.height),
                mould_radius=np.asarray(packing.mould_radius),
            )
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def load(path: Path | BinaryIO) -> Packing:
    """Reads what `save` wrote, from a path or an open file; raises OSError or ValueError where it
    is damaged."""
    try:
        with np.load(path, allow_pickle=False) as data:
            position = Vector.from_rows(jnp.asarray(data["position"]))
            spheres = Spheres(data["radius"], data["mass"])
            return Packing(position, spheres, data["height"], data["mould_radius"])
    except (zipfile.BadZipFile, zlib.error, EOFError, KeyError) as error:
        raise ValueError(f"{path} is damaged: {error}") from None
