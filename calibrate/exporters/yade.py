"""YADE: a material script for the nearest law that it has.

YADE (2023.02) has no EEPA.  Nearest is Law2_ScGeom_LudingPhys_Basic (Luding 2008): linear
loading k1, unloading k2, adhesion -kc d.  Its k2 grows with the largest overlap up to kp at
d_p and is constant beyond, where loading becomes elastic; EEPA has one k2 for all overlaps.
The two are therefore matched at one overlap, that of a contact under `PRESSURE`:

    kp = k1/(1 - lambda_p)      d_p = OVERLAP      kc = f_min/d_min at OVERLAP

YADE's stiffness of a pair is the harmonic mean of both materials' (k1 = 2 a b/(a + b)), whatever
the radii.  With k1 in proportion to the radius that mean is EEPA's 2 E* R*, so spheres of each
radius get a material of their own.
"""

from calibrate.core.errors import InputError
from calibrate.exporters.notes import PRESSURE, comment, heading, scale_up, uncertainty
from calibrate.exporters.source import Found
from jdem.materials.catalogue import CATALOGUE
from jdem.materials.conventions import DEFAULT

NAME, FILE = "yade", "soil_yade.py"
NAME, FILE = "yade", "soil_yade.py"
DENSITY = 2650.0  # kg/m^3; a placeholder that the script says to change

_LOST = (
    "YADE has no EEPA law; this is the nearest, Law2_ScGeom_LudingPhys_Basic. What is lost:",
    "- the unloading stiffness equals EEPA's only for contacts once loaded to OVERLAP; contacts",
    "  loaded less are softer on unloading and keep less plastic overlap; beyond, they are elastic",
    "- adhesion is -kc d: tensile exponent 1 instead of {exponent:.4g}, and f_min grows in",
    "  proportion to the overlap instead of its square root",
    "- friction is limited by mu |F_n|, without the adhesive share",
    "- a material belongs to one radius: give spheres of another size soil_of(their radius)",
    "- no rolling resistance (rolling_friction {rolling:.4g} is not used), no constant pull-off",
    "- walls: a Wall felt no force when tried with YADE 2023.02, because the law divides by the",
    "  radius that it has not (Facet and Box neither): build mould and platens of fixed spheres",
)

_SCRIPT = """
from math import atan, log, pi, sqrt

from yade import *

RADIUS = {radius:.7g}  # m, mean of the particles
DENSITY = {density:.7g}  # kg/m^3, of the particles: SET IT so that the bed has your bulk density
PRESSURE = {pressure:.7g}  # Pa; contacts are matched at the overlap that this load gives them

SURFACE_ENERGY = {energy:.7g} * (2 * RADIUS) / {reference:.7g}  # J/m^2, between these particles
PLASTICITY_RATIO = {plasticity:.7g}
RESTITUTION = {restitution:.7g}
STATIC_FRICTION = {friction:.7g}
TANGENTIAL_MULTIPLIER = {multiplier:.7g}
CONTACT_MODULUS = {modulus:.7g}  # Pa, E* = G/(1 - nu)


def soil_of(radius, label):
    # the material of spheres of this radius (m)
    k1 = {factor:.7g} * CONTACT_MODULUS * radius / 2  # N/m
    k2 = k1 / (1 - PLASTICITY_RATIO)
    plastic = PLASTICITY_RATIO * PRESSURE * (2 * radius) ** 2 / k1  # m, of the matched overlap
    lens = sqrt(radius * plastic - plastic**2 / 4)  # m, radius of the contact's circle
    strength = min(1.5 * pi * SURFACE_ENERGY * lens, k2 * plastic / 2)  # N, largest tension
    mass = DENSITY * 4 / 3 * pi * radius**3 / 2  # effective
    return LudingMat(
        {names[shear_modulus]}=k1,
        {names[plasticity_ratio]}=k2,
        {names[surface_energy]}=strength / (plastic - strength / k2),
        {names[tangential_multiplier]}=TANGENTIAL_MULTIPLIER * k1,
        PhiF=plastic / radius,
        {names[restitution]}=sqrt(4 * mass * k1 / (1 + (pi / log(RESTITUTION)) ** 2)),
        {names[static_friction]}=atan(STATIC_FRICTION),
        density=DENSITY,
        label=label,
    )


O.materials.append(soil_of(RADIUS, "soil"))

# In O.engines:
#   InteractionLoop([Ig2_Sphere_Sphere_ScGeom()], [Ip2_LudingMat_LudingMat_LudingPhys()],
#                   [Law2_ScGeom_LudingPhys_Basic()])
# and a step well below sqrt(mass / k2).
"""


def text(found: Found) -> str:
    """The material script; only slope exponent 1 has a law to go with."""
    found.check_law((DEFAULT,), NAME)
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
        names={name: entry.names.get("Yade", "") for name, entry in CATALOGUE.items()},
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
