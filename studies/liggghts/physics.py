"""What else happens to the specimen: physics and apparatus beyond the base soil, as LIGGGHTS input.

`Physics` says how much of each; its defaults are none.  `materials` turns soil and physics into
the contact law and the properties of every type of particle and wall, `machine` into what the
testing machine feels, `between` into what the specimen meets between the two tests.
"""

from dataclasses import dataclass

import numpy as np

from studies.liggghts.soil import (
    MEAN_DIAMETER,
    PLATEN,
    POISSON_RATIO,
    SIZE,
    TENSILE_EXPONENT,
    TYPES,
    WEAK,
    Soil,
    global_property,
    pairs,
)

LAYERS = (1, 4, 5, 6, 7)  # types of soil from the bottom to the top of the specimen
ELASTIC = 1.02  # k2/k1 of a contact that gives back what it took
CRUSHED_STIFFNESS = 0.3  # of the soil's, of a sphere that has crushed
AREA = np.pi * 0.025**2  # m2, of the mould
AIR_CONTENT = 0.11  # of the specimen's volume
ATMOSPHERE = 101325.0  # Pa
BRIDGE_RATIO = 1.2  # furthest reach of a liquid bridge, in radii
BASE_LAW = "edinburgh tangential tan_luding rolling_friction luding"
BRIDGED_LAW = (
    "edinburgh tangential tan_luding cohesion easo/capillary/viscous rolling_friction luding"
)


@dataclass(frozen=True)
class Physics:
    """Strength of everything beyond the base soil; tensions and forces are those of spheres of
    8 mm, smaller ones have as much stress.

    platen_modulus     Young's modulus of elastic platens, Pa (None: as the soil)
    bridge_tension     surface tension of liquid bridges between spheres, N/m
    liquid             liquid on a sphere, percent of its volume; sets a bridge's reach
    bond_strength      tension that breaks a bond between spheres, N
    second_factor      soil's stiffness and surface energy in the second test over the first
    gradient           soil's stiffness and surface energy at the top over the mean, minus one
    crushing_force     contact force at which a sphere weakens for good, N (None: never)
    trapped_air        share of the pore air that cannot leave during the first test
    tilt               of both platens' upper one, degrees
    fill_scatter       ln-scatter of the friction of filling between specimens
    mass_scatter       of the number of spheres between specimens
    """

    platen_modulus: float | None = None
    bridge_tension: float = 0.0
    liquid: float = 1.0
    bond_strength: float = 0.0
    second_factor: float = 1.0
    gradient: float = 0.0
    crushing_force: float | None = None
    trapped_air: float = 0.0
    tilt: float = 0.0
    fill_scatter: float = 0.2
    mass_scatter: float = 0.01


def layer_factors(physics: Physics) -> np.ndarray:
    """Factor on stiffness and surface energy of each type, (TYPES,)."""
    factors = np.ones(TYPES)
    factors[np.array(LAYERS) - 1] = 1 + physics.gradient * np.linspace(-1, 1, len(LAYERS))
    return factors


def filling_materials(friction: float) -> str:
    """Property lines while the spheres settle with Hertz contacts and `friction` among them."""
    every = np.ones((TYPES, TYPES))
    rows: list[tuple[str, str, np.ndarray | float]] = [
        ("youngsModulus", "peratomtype", np.full(TYPES, 31.2e6)),
        ("poissonsRatio", "peratomtype", np.full(TYPES, POISSON_RATIO)),
        ("coefficientRestitution", "peratomtypepair", 0.3 * every),
        ("coefficientFriction", "peratomtypepair", pairs(friction, 0.1, 0.1)),
    ]
    return "\n".join(global_property(n, *row) for n, row in enumerate(rows)) + "\n"


def materials(soil: Soil, physics: Physics, factor: float = 1.0) -> str:
    """The property lines; `factor` multiplies stiffness and surface energy of the soil."""
    modulus = soil.young * factor * layer_factors(physics)
    modulus[PLATEN - 1] = physics.platen_modulus or soil.young
    modulus[WEAK - 1] *= CRUSHED_STIFFNESS
    ratio = pairs(soil.stiffness_ratio, soil.stiffness_ratio, soil.stiffness_ratio)
    if physics.platen_modulus:
        ratio[PLATEN - 1, :] = ratio[:, PLATEN - 1] = ELASTIC
    scale = np.sqrt(np.outer(layer_factors(physics), layer_factors(physics)))
    energy = pairs(soil.scaled_energy * factor, 0.0, 0.0) * scale
    friction = pairs(soil.static_friction, soil.wall_friction, soil.platen_friction)
    every = np.ones((TYPES, TYPES))
    rows: list[tuple[str, str, np.ndarray | float]] = [
        ("youngsModulus", "peratomtype", modulus),
        ("poissonsRatio", "peratomtype", np.full(TYPES, POISSON_RATIO)),
        ("coefficientRestitution", "peratomtypepair", soil.restitution * every),
        ("coefficientFriction", "peratomtypepair", friction),
        ("coefficientRollingFriction", "peratomtypepair", pairs(soil.rolling_friction, 0.1, 0.1)),
        ("coefficientRollingViscousDamping", "peratomtypepair", 0.3 * every),
        ("coeffRollingStiffness", "peratomtypepair", every),
        ("FluidViscosity", "peratomtypepair", every),  # tan_luding: static over dynamic friction
        ("FrictionViscosity", "peratomtypepair", every),  # tan_luding: its damping
        ("coeffFrictionStiffness", "peratomtypepair", soil.tangential_multiplier * every),
        ("UnloadingStiffness", "peratomtypepair", ratio),
        ("coefficientAdhesionStiffness", "peratomtypepair", 0.5 * every),
        ("overlapExponent", "scalar", 1.0),
        ("adhesionExponent", "scalar", TENSILE_EXPONENT),
        ("pullOffForce", "peratomtypepair", 0.0 * every),
        ("surfaceEnergy", "peratomtypepair", energy),
    ]
    lines = [global_property(n, *row) for n, row in enumerate(rows)]
    return "\n".join([*lines, *_bridges(physics, len(rows))]) + "\n"


def _bridges(physics: Physics, number: int) -> list[str]:
    """Properties of the liquid bridges."""
    if not physics.bridge_tension:
        return []
    rows: list[tuple[str, str, np.ndarray | float]] = [
        ("surfaceLiquidContentInitial", "scalar", physics.liquid),
        ("surfaceTension", "scalar", SIZE * physics.bridge_tension),
        ("contactAngle", "peratomtype", np.zeros(TYPES)),
        ("minSeparationDistanceRatio", "scalar", 1.01),
        ("maxSeparationDistanceRatio", "scalar", BRIDGE_RATIO),
        ("fluidViscosity", "scalar", 1e-3),
    ]
    return [global_property(number + n, *row) for n, row in enumerate(rows)]


def laws(physics: Physics) -> str:
    """The contact laws between spheres and with walls, and springs of the bonds if any."""
    law = BRIDGED_LAW if physics.bridge_tension else BASE_LAW
    lines = [
        f'variable walllaw index "{BASE_LAW}"',
        f"pair_style gran model {law}",
        "pair_coeff * *",
    ]
    return "\n".join(lines) + "\n"


def machine(physics: Physics, gain: float, offset: float, smoothing: float, height: float) -> str:
    """What the machine reads, `Fm`: soil and trapped air through load cell and lag.

    smoothing: share of a change that the reading takes over in one round of the loop.
    """
    air = "0"
    if physics.trapped_air:
        share = f"({AIR_CONTENT * height:.8g}-v_disp)"
        air = f"{physics.trapped_air * ATMOSPHERE * AREA:.8g}*v_disp/{share}"
    lines = [
        f"variable felt equal {1 + gain:.8g}*(${{F}}+{air})+{offset:.8g}",
        "variable feels equal ${felt}",
        f"variable Fm equal ${{Fm}}+{smoothing:.8g}*(${{feels}}-${{Fm}})",
    ]
    return "\n".join(lines) + "\n"


def trapped_air_force(physics: Physics, displacement: np.ndarray, height: float) -> np.ndarray:
    """Force of the trapped air on the platen, N; Boyle's law, `displacement` (points,) in m."""
    travel = np.clip(displacement, 0, None)
    pressure = ATMOSPHERE * travel / (AIR_CONTENT * height - travel)
    return physics.trapped_air * AREA * pressure


def between(soil: Soil, physics: Physics) -> str:
    """What changes in the specimen between the tests."""
    if physics.second_factor == 1.0:
        return "\n"
    old = [line.split()[1] for line in materials(soil, physics).splitlines()]
    changed = materials(soil, physics, physics.second_factor)
    return "\n".join([f"unfix {name}" for name in old]) + "\n" + changed


def bridge_reach() -> float:
    """Distance between centres that a liquid bridge can span, m."""
    return BRIDGE_RATIO * MEAN_DIAMETER
