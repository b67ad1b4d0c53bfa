"""The soil under test: its parameters under our names, their prior, what LIGGGHTS calls them.

    E = 2 G (1 + nu),   k2/k1 = 1/(1 - plasticity_ratio),   gamma = surface_energy d/d_ref

Stiffness k1 = 2 E* R* is the same in both codes.  Friction is LIGGGHTS' `tan_luding`, rolling
its `luding` (elastic, with a limit), the tensile exponent 1: `tan_luding` measures adhesion by a
stiffness per metre of overlap and knows no other.  Walls carry no surface energy.
"""

from dataclasses import dataclass

import numpy as np

POISSON_RATIO = 0.3
REFERENCE_DIAMETER = 8e-5  # m, of the surface energy
SPHERES = 1000  # fill the mould to about 100 mm
STATED_FOR = 8e-3  # m, of the spheres for which strengths of effects are stated
MEAN_DIAMETER = STATED_FOR * (370 / SPHERES) ** (1 / 3)  # m; 370 of 8 mm fill it too
SIZE = MEAN_DIAMETER / STATED_FOR
TENSILE_EXPONENT = 1.0
TYPES = 8  # 1 soil, 2 mould, 3 platens, 4-7 layers of soil above the first, 8 crushed spheres
MOULD, PLATEN, WEAK = 2, 3, 8


@dataclass(frozen=True)
class Soil:
    """Contact parameters in SI, under the names of `calibrate` (surface_energy at 80 um)."""

    shear_modulus: float = 8.5e6
    surface_energy: float = 17.0
    plasticity_ratio: float = 0.7
    static_friction: float = 0.6
    rolling_friction: float = 0.3
    restitution: float = 0.3
    tangential_multiplier: float = 1.0
    wall_friction: float = 0.1
    platen_friction: float = 0.3

    @property
    def young(self) -> float:
        """Young's modulus of the spheres, Pa."""
        return 2 * self.shear_modulus * (1 + POISSON_RATIO)

    @property
    def scaled_energy(self) -> float:
        """Surface energy between spheres of the mean diameter, J/m2."""
        return self.surface_energy * MEAN_DIAMETER / REFERENCE_DIAMETER

    @property
    def stiffness_ratio(self) -> float:
        """k2/k1, which LIGGGHTS calls UnloadingStiffness."""
        return 1 / (1 - self.plasticity_ratio)


# ln-normal scatter around the defaults of `Soil`, and the limits it is cut to.  Mould and platens
# are what the laboratory says they are.
PRIOR: dict[str, tuple[float, float, float]] = {
    "shear_modulus": (0.20, 5.5e6, 13e6),
    "surface_energy": (0.30, 9.0, 32.0),
    "plasticity_ratio": (0.07, 0.58, 0.80),
    "static_friction": (0.15, 0.40, 0.90),
    "rolling_friction": (0.25, 0.18, 0.50),
    "restitution": (0.20, 0.20, 0.45),
    "tangential_multiplier": (0.15, 0.70, 1.40),
}


def draw_soil(random: np.random.Generator) -> Soil:
    """A soil from the prior, each parameter drawn again until it lies within its limits."""
    drawn = {}
    for name, (scatter, low, high) in PRIOR.items():
        centre, value = getattr(Soil(), name), -1.0
        while not low <= value <= high:
            value = centre * float(np.exp(scatter * random.standard_normal()))
        drawn[name] = value
    return Soil(**drawn)


def pairs(inside: float, wall: float, platen: float) -> np.ndarray:
    """A property of pairs, (TYPES, TYPES): between soils, against mould, against platens."""
    table = np.full((TYPES, TYPES), inside)
    for number, value in ((MOULD, wall), (PLATEN, platen)):
        table[number - 1, :] = table[:, number - 1] = value
    return table


def global_property(number: int, name: str, kind: str, values: np.ndarray | float) -> str:
    """One LIGGGHTS line for `name`; kind is peratomtype, peratomtypepair or scalar."""
    count = f"{TYPES} " if kind == "peratomtypepair" else ""
    numbers = " ".join(f"{value:.6g}" for value in np.ravel(values))
    return f"fix p{number} all property/global {name} {kind} {count}{numbers}"
