"""The soil that a lab file describes, as the simulator's parameters."""

from collections.abc import Mapping
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp

from calibrate.io.choices import AT, at, differing
from calibrate.io.lab import Lab
from jdem.core.quantity import Real
from jdem.materials.catalogue import needed_by, soil_of
from jdem.materials.soil import SoilParameters


def with_values(soil: SoilParameters, values: Mapping[str, Real]) -> SoilParameters:
    """The soil with some parameters replaced, by name."""
    left = dict(values)
    exponent = left.pop("slope_exponent", None)
    further = {name: jnp.asarray(left.pop(name), float) for name in soil.further if name in left}
    if further:
        soil = replace(soil, further={**soil.further, **further})
    if left:
        given = [jnp.asarray(value, float) for value in left.values()]
        soil = eqx.tree_at(lambda s: [getattr(s, name) for name in left], soil, given)
    if exponent is not None:
        soil = replace(soil, slope_exponent=float(exponent))
    return soil


def base_soil(lab: Lab) -> SoilParameters:
    """The soil that a lab file describes: its law, defaults, its particles, its parameters."""
    law, particles = lab.particles.conventions, lab.particles
    chosen = {n: c.value for n, c in lab.parameters.items() if c.value is not None}
    soil = soil_of(law, **{name: chosen[name] for name in needed_by(law)})
    soil = with_values(soil, {"poisson_ratio": particles.poisson_ratio})
    if particles.reference_diameter is not None:
        soil = with_values(soil, {"reference_diameter": particles.reference_diameter})
    moist = {name: jnp.asarray(chosen[name], float) for name in chosen if AT in name}
    if moist:
        soil = replace(soil, further={**soil.further, **moist})
    return with_values(soil, chosen)


def soil_at(soil: SoilParameters, moisture: float | None) -> SoilParameters:
    """The soil of a specimen: where parameters differ, with those at its moisture."""
    every = differing(soil.further)
    if not every:
        return soil
    assert moisture is not None, "a lab file gives such specimens their moisture"
    own = {name: soil.further[at(name, moisture)] for name in every}
    left = {name: value for name, value in soil.further.items() if AT not in name}
    return with_values(replace(soil, further=left), own)
