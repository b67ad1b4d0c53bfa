"""The effects that a case may hide: how strong, in which unit, and what they change.

An effect turns one `Setup` into another.  Where LIGGGHTS can, the change is one of material or
apparatus, not of the curve: elastic platens for a compliant frame, liquid bridges for long-range
tension, bonds for cementation.  Effects of the second list are not meant to be known to a
diagnosis.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from studies.liggghts.instrument import Instrument
from studies.liggghts.physics import Physics
from studies.liggghts.soil import SIZE, Soil


@dataclass(frozen=True)
class Setup:
    """Everything that the specimens of one case share."""

    soil: Soil
    physics: Physics = field(default_factory=Physics)
    instrument: Instrument = field(default_factory=Instrument)

    def with_soil(self, **changes: float) -> "Setup":
        return replace(self, soil=replace(self.soil, **changes))

    def with_physics(self, **changes: float) -> "Setup":
        return replace(self, physics=replace(self.physics, **changes))

    def with_instrument(self, **changes: float) -> "Setup":
        return replace(self, instrument=replace(self.instrument, **changes))


@dataclass(frozen=True)
class Effect:
    """One effect: `unit` of its strength, `weak` and `strong` end of the range it is drawn from
    (ln-uniform), whether it can act in both directions (`signed`), and what it changes."""

    name: str
    unit: str
    weak: float
    strong: float
    signed: bool
    realise: Callable[[Setup, float], Setup]

    def draw(self, random: np.random.Generator, third: int) -> float:
        """A strength from the lower, middle or upper third (0, 1, 2) of the range."""
        share = (third + random.uniform()) / 3
        size = self.weak * (self.strong / self.weak) ** share
        return float(size * (random.choice([-1, 1]) if self.signed else 1))


# Compliance of both platens between 100 and 395 N, mm/kN, for each 1/MPa by which the inverse of
# their modulus exceeds the soil's: 12.49 at 5 MPa, 12.50 at 10 MPa, soil of 22.1 MPa, 370 spheres.
# As many smaller ones as touch a platen are stiffer together: each goes with d, their number d^-2.
PLATEN_COMPLIANCE = 12.5 * SIZE


def elastic_platens(setup: Setup, compliance: float) -> Setup:
    """Platens of an elastic material so soft that they give `compliance` mm/kN more."""
    inverse = 1e6 / setup.soil.young + compliance / PLATEN_COMPLIANCE
    return setup.with_physics(platen_modulus=1e6 / inverse)


def rough_mould(setup: Setup, extra: float) -> Setup:
    """More friction of the mould than the laboratory believes."""
    return setup.with_soil(wall_friction=setup.soil.wall_friction + extra)


def other_platens(setup: Setup, factor: float) -> Setup:
    """Platens rougher (positive) or smoother (negative) by this factor than believed."""
    times = factor if factor > 0 else -1 / factor
    return setup.with_soil(platen_friction=setup.soil.platen_friction * times)


def filling(setup: Setup, scatter: float) -> Setup:
    """Specimens filled by different hands: friction of filling and mass scatter."""
    return setup.with_physics(fill_scatter=scatter, mass_scatter=0.05 * scatter)


def second_soil(setup: Setup, change: float) -> Setup:
    """Soil stronger and stiffer (or weaker) by ln-`change` when the second test begins."""
    return setup.with_physics(second_factor=float(np.exp(change)))


LIBRARY = (
    Effect("frame_compliance", "mm/kN", 0.3, 3.0, False, elastic_platens),
    Effect("seating", "mm", 0.15, 1.5, False, lambda s, x: s.with_instrument(seat=1e-3 * x)),
    Effect("load_cell_gain", "1", 0.03, 0.20, True, lambda s, x: s.with_instrument(gain=x)),
    Effect("load_cell_offset", "N", 3, 30, True, lambda s, x: s.with_instrument(offset=x)),
    Effect("load_cell_drift", "N/h", 20, 200, True, lambda s, x: s.with_instrument(drift=x)),
    Effect("acquisition_lag", "s", 0.03, 0.25, False, lambda s, x: s.with_instrument(lag=x)),
    Effect("wall_friction", "1", 0.1, 0.7, False, rough_mould),
    Effect("platen_friction", "factor", 1.5, 8.0, True, other_platens),
    Effect("capillary_tension", "N/m", 5, 60, False, lambda s, x: s.with_physics(bridge_tension=x)),
    Effect("cementation", "N", 1.5, 10, False, lambda s, x: s.with_physics(bond_strength=x)),
    Effect("second_test_strength", "ln", 0.1, 0.6, True, second_soil),
    Effect("density_scatter", "ln", 0.5, 2.0, False, filling),
)

OUTSIDE = (
    Effect(
        "aggregate_crushing", "1/N", 1 / 60, 1 / 15, False,
        lambda s, x: s.with_physics(crushing_force=1 / x),
    ),
    Effect("trapped_air", "1", 0.1, 0.8, False, lambda s, x: s.with_physics(trapped_air=x)),
    Effect("height_gradient", "1", 0.2, 0.7, True, lambda s, x: s.with_physics(gradient=x)),
    Effect("platen_tilt", "degrees", 0.5, 2.5, False, lambda s, x: s.with_physics(tilt=x)),
)  # fmt: skip

BY_NAME = {effect.name: effect for effect in LIBRARY + OUTSIDE}
