"""YADE: a material script for the nearest law that it has.

YADE (2023.02) has no EEPA.  Nearest is Law2_ScGeom_LudingPhys_Basic (Luding 2008): linear
loading k1, unloading k2, adhesion -kc d.  Its k2 grows with the largest overlap up to kp at
d_p and is constant beyond, where loading becomes elastic; EEPA has one k2 for all overlaps.
The two are therefore matched at one overlap, that of a contact under `PRESSURE`:

    kp = k1/(1 - lambda_p)      d_p = OVERLAP      kc = f_min/d_min at OVERLAP
"""

from calibrate.errors import InputError
from calibrate.export.notes import PRESSURE, comment, heading, scale_up, uncertainty
from calibrate.export.source import Found

DENSITY = 2650.0  # kg/m^3; a placeholder that the script says to change

_LOST = (
    "YADE has no EEPA law; this is the nearest, Law2_ScGeom_LudingPhys_Basic. What is lost:",
    "- the unloading stiffness equals EEPA's only for contacts once loaded to OVERLAP; contacts",
    "  loaded less are softer on unloading and keep less plastic overlap; beyond, they are elastic",
    "- adhesion is -kc d: tensile exponent 1 instead of {exponent:.4g}, and f_min grows in",
    "  proportion to the overlap instead of its square root",
    "- friction is limited by mu |F_n|, without the adhesive share",
    "- no rolling resistance (rolling_friction {rolling:.4g} is not used), no constant pull-off",
    "- walls: a Wall felt no force when tried with YADE 2023.02, because the law divides by the",
    "  radius that it has not (Facet and Box neither): build mould and platens of fixed spheres",
)

_SCRIPT = """
from math import atan, log, pi, sqrt

from yade import *

RADIUS = {radius:.7g}  # m, of the particles
DENSITY = {density:.7g}  # kg/m^3, of the particles: SET IT so that the bed has your bulk density
PRESSURE = {pressure:.7g}  # Pa; contacts are matched at the overlap that this load gives them

SURFACE_ENERGY = {energy:.7g} * (2 * RADIUS) / {reference:.7g}  # J/m^2, between these particles
PLASTICITY_RATIO = {plasticity:.7g}
RESTITUTION = {restitution:.7g}
STATIC_FRICTION = {friction:.7g}
TANGENTIAL_MULTIPLIER = {multiplier:.7g}
CONTACT_MODULUS = {modulus:.7g}  # Pa, E* = G/(1 - nu)

K1 = {factor:.7g} * CONTACT_MODULUS * RADIUS / 2  # N/m
K2 = K1 / (1 - PLASTICITY_RATIO)
OVERLAP = PRESSURE * (2 * RADIUS) ** 2 / K1  # m
PLASTIC = PLASTICITY_RATIO * OVERLAP
LENS = sqrt(RADIUS * PLASTIC - PLASTIC**2 / 4)  # radius of the contact's circle
STRENGTH = min(1.5 * pi * SURFACE_ENERGY * LENS, K2 * PLASTIC / 2)  # N, largest tension
MASS = DENSITY * 4 / 3 * pi * RADIUS**3 / 2  # effective

soil = LudingMat(
    k1=K1,
    kp=K2,
    kc=STRENGTH / (PLASTIC - STRENGTH / K2),
    ks=TANGENTIAL_MULTIPLIER * K1,
    PhiF=PLASTIC / RADIUS,
    G0=sqrt(4 * MASS * K1 / (1 + (pi / log(RESTITUTION)) ** 2)),
    frictionAngle=atan(STATIC_FRICTION),
    density=DENSITY,
    label="soil",
)
O.materials.append(soil)

# In O.engines:
#   InteractionLoop([Ig2_Sphere_Sphere_ScGeom()], [Ip2_LudingMat_LudingMat_LudingPhys()],
#                   [Law2_ScGeom_LudingPhys_Basic()])
# and a step well below sqrt(MASS / K2).
"""


def text(found: Found) -> str:
    """The material script; only slope exponent 1 has a law to go with."""
    if found["slope_exponent"] != 1:
        raise InputError(
            "--to yade",
            "slope_exponent",
            "YADE has no plastic adhesive law with slope exponent 1.5",
            "calibrate with slope exponent 1, or export to another program",
        )
    lost = [
        line.format(exponent=found["tensile_exponent"], rolling=found["rolling_friction"])
        for line in _LOST
    ]
    notes = [*heading(found), "", *uncertainty(found), "", *scale_up(found), "", *lost]
    script = _SCRIPT.format(
        radius=found.diameter / 2,
        density=DENSITY,
        pressure=PRESSURE,
        energy=found["surface_energy"],
        reference=found["reference_diameter"],
        plasticity=found["plasticity_ratio"],
        restitution=found["restitution"],
        friction=found["static_friction"],
        multiplier=found["tangential_multiplier"],
        modulus=found["shear_modulus"] / (1 - found["poisson_ratio"]),
        factor=found["stiffness_factor"],
    )
    return comment(notes) + script
