"""`calibrate contact`: the force-overlap loop of two equal spheres."""

from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from calibrate.io.soil import with_values
from jdem.apparatus.pair import SpherePair, drive_overlap, overlap_path
from jdem.core.smooth import Smoothing
from jdem.materials.soil import SoilParameters, particle_law

POINTS_PER_LEG = 500


@dataclass(frozen=True)
class Spheres:
    """Radius (m), Young's modulus (Pa) and Poisson's ratio of both spheres."""

    radius: float
    young: float
    poisson: float


def drive(
    pair: Spheres, values: dict[str, float], turning_points_m: list[float], smooth: bool
) -> dict:
    """Overlaps (m) and normal forces (N); surface energy acts unscaled on these spheres."""
    shear = pair.young / (2 * (1 + pair.poisson))
    own = {
        "shear_modulus": shear,
        "poisson_ratio": pair.poisson,
        "reference_diameter": 2 * pair.radius,
    }
    soil = with_values(SoilParameters(), {**own, **values})
    law = particle_law(
        soil, jnp.asarray(2 * pair.radius), Smoothing() if smooth else Smoothing.sharp()
    )
    overlaps = overlap_path(turning_points_m, POINTS_PER_LEG)
    force = eqx.filter_jit(drive_overlap)(law, SpherePair(jnp.asarray(pair.radius)), overlaps)
    return {
        "overlap_m": np.asarray(overlaps).tolist(),
        "normal_force_n": np.asarray(force).tolist(),
    }
