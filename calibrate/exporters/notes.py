"""What every export says beside the numbers: origin, uncertainty, and how to change the size.

Strength of a cohesive packing scales as surface energy over diameter (Rumpf 1962), hence

    surface energy between particles of diameter d = surface_energy d / reference_diameter
"""

import textwrap

from calibrate.exporters.source import UNITS, Found, in_order
from jdem.materials.contact_laws import SHRINKING
from jdem.materials.conventions import DEFAULT

PRESSURE = 2e5  # Pa; 400 N on a specimen of 50 mm: where laws are matched that differ
_NOT_EXPORTED = ("wall_adhesion", "stiffness_factor", "reference_diameter")
_HARMLESS = str.maketrans({"&": "and", "\\": "/", '"': "'"})
LONGEST = 1000  # characters of a sentence
_OTHER_SIZES = (0.5, 1.0, 2.0)  # times the exported diameter


def warned(found: Found) -> list[str]:
    """What the fit warned of, one sentence a line."""
    return [f"WARNING of the fit: {_one_line(sentence, LONGEST)}" for sentence in found.warnings]


def heading(found: Found) -> list[str]:
    """Which soil, from where, what the fit warned of, for which particles."""
    law = "EEPA" if found.law == DEFAULT else found.law
    lines = [f"{law} soil: {_one_line(found.soil)}", f"from {_one_line(found.origin)}"]
    lines += [line for sentence in warned(found) for line in textwrap.wrap(sentence, 98)]
    if found.conventions not in (DEFAULT, found.law):
        lines.append(
            f"with the conventions {found.conventions}: tangential_multiplier and rolling_friction "
            "are LIGGGHTS', and mean other things elsewhere"
        )
    size = f"for particles of mean diameter {1e3 * found.diameter:.4g} mm"
    if found.fitted_diameter is None:
        return [*lines, size]
    return [*lines, f"{size} (simulated with spheres of {1e3 * found.fitted_diameter:.4g} mm)"]


def uncertainty(found: Found) -> list[str]:
    """Intervals of what was fitted, and the names of what was held."""
    lines = [
        f"{name} = {found[name]:.5g} {UNITS[name]}".rstrip() + f", 95 %: {low:.4g} to {high:.4g}"
        for name in in_order(found.intervals)
        for low, high in [found.intervals[name]]
    ]
    said_above = (*found.intervals, *_NOT_EXPORTED)
    held = [name for name in in_order(found.values) if name not in said_above]
    head = ["Fitted, with 95 % intervals:", *lines] if lines else ["Nothing here was fitted."]
    return [*head, "Held at stated values, without interval:", *textwrap.wrap(", ".join(held), 90)]


def scale_up(found: Found) -> list[str]:
    """What to use for particles of another size."""
    sized = [*_surface_energies(found), *_bond_stiffnesses(found)]
    return [
        *sized,
        f"The {'other ' if sized else ''}parameters do not change with size (stiffness grows "
        "with the radius by itself),",
        "but the strength and stiffness of a bed still depend on the number of particles: run both",
        "tests at the new size before use.",
    ]


def _surface_energies(found: Found) -> list[str]:
    """The surface energy at several diameters; nothing where the law has none."""
    if found.sized is None:
        return []
    reference, stated = found["reference_diameter"], found[found.sized]
    lines = [
        f"Surface energy {stated:.5g} J/m^2 belongs to the reference diameter "
        f"{1e6 * reference:.4g} um;",
        f"between particles of diameter d use {stated:.5g} J/m^2 * d / {reference:.4g} m:",
    ]
    for share in _OTHER_SIZES:
        size = share * found.diameter
        energy = stated * size / reference
        lines.append(f"  d = {1e3 * size:.4g} mm: {energy:.5g} J/m^2{_interval_at(found, size)}")
    return lines


def _bond_stiffnesses(found: Found) -> list[str]:
    """How stiffnesses of bonds go with the diameter; nothing where the law has none."""
    if not set(SHRINKING) <= set(found.values):
        return []
    reference = f"{found['reference_diameter']:.4g} m"
    return [
        f"normal_stiffness and shear_stiffness belong to the reference diameter {reference};",
        f"between particles of diameter d multiply both by {reference} / d.",
    ]


def _interval_at(found: Found, size: float) -> str:
    interval = found.intervals.get(found.sized or "")
    if interval is None:
        return ""
    low, high = (end * size / found["reference_diameter"] for end in interval)
    return f" (95 %: {low:.4g} to {high:.4g})"


def overlap_under(pressure: float, found: Found) -> float:
    """Overlap (m) of a contact that carries `pressure` (Pa) on the square of the diameter, at
    slope exponent 1: F = pressure d^2 = k1 overlap."""
    modulus = found["shear_modulus"] / (1 - found["poisson_ratio"])
    k1 = found["stiffness_factor"] * modulus * found.diameter / 4
    return pressure * found.diameter**2 / k1


def comment(lines: list[str], mark: str = "# ") -> str:
    """Lines as comments."""
    return "".join(f"{mark}{line}".rstrip() + "\n" for line in lines)


def _one_line(text: str, longest: int = 200) -> str:
    """Text from a file as part of a comment: one line, printable, without quotation marks or
    signs of continuation."""
    line = " ".join(text.translate(_HARMLESS).split())
    return "".join(c if c.isprintable() else "?" for c in line)[:longest]
