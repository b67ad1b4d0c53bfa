"""Levels of the designs, means of Table 6, and numbers that the paper prints in several places.

Levels are settings: they are compared exactly, but for the star points of Table 3, which are
irrational.
"""

from collections.abc import Iterator

import numpy as np

from calibrate.designs.factors import Factor
from calibrate.designs.surface import Surface
from calibrate.designs.terms import matrix
from studies.chen_2023.tables import Range, Table, in_text, place, printed, table
from studies.chen_2023.verdict import (
    Attempt,
    Figure,
    judge,
    judge_value,
    rounded,
    without_data,
)

FACTORS = (
    "restitution",
    "static_friction",
    "rolling_friction",
    "surface_energy",
    "plasticity_ratio",
    "tensile_exponent",
    "tangential_multiplier",
)
UNITS = {"surface_energy": "J/m²"}


def figures() -> Iterator[Figure]:
    """Everything of this file, in the order of the paper."""
    yield from screening_ranges()
    yield from middle_values()
    yield from star_points()
    yield from held_for_force()
    yield from soil_means()
    yield from repeated_numbers()


def screening_ranges() -> Iterator[Figure]:
    """The ranges that the text states for the screening against the levels of Table 2."""
    for name in FACTORS:
        levels = table(2).values(name)
        for end, level in (("low", levels.min()), ("high", levels.max())):
            text = in_text(f"range.{name}.{end}")
            remark = f"Table 2 sets it to {level:g}"
            yield _setting("Table 2", f"{name}, {end} level", text, level, remark, name)


def middle_values() -> Iterator[Figure]:
    """The "middle values of the Plackett-Burman test" that Table 3 holds the other factors at."""
    for name in FACTORS[2:]:
        text = in_text(f"held_for_depth.{name}")
        middle = _middle_of_stated_range(name)
        of_table = _middle(table(2).values(name))
        remark = f"the middle is {middle:g}"
        if of_table != middle:
            remark += f" ({of_table:g} with the levels of Table 2)"
        yield _setting("Table 3", f"{name}, held at its middle", text, middle, remark, name)


def star_points() -> Iterator[Figure]:
    """Axial levels of the rotatable central composite: centre ± sqrt(2) half ranges."""
    factorial = ("1", "8", "9", "13")
    for name in FACTORS[:2]:
        levels = [table(3).cell(run, name).value for run in factorial]
        reach = np.sqrt(2) * (max(levels) - min(levels)) / 2
        middle = _middle(np.array(levels))
        column = [row[name] for row in table(3).rows.values()]
        for end, text, level in (
            ("low", min(column, key=float), middle - reach),
            ("high", max(column, key=float), middle + reach),
        ):
            title = f"{name.replace('_', ' ')}, {end} star level"
            yield judge("Table 3", title, text, [Attempt(Range(float(level)))])


def held_for_force() -> Iterator[Figure]:
    """What Table 4 holds: the depth optimum, and middle values of the screening."""
    for name in ("restitution", "static_friction"):
        optimum = printed(in_text(f"optimum.{name}")).value
        text = in_text(f"held_for_force.{name}")
        remark = f"the optimum of section 3.3.2 is {optimum:g}"
        yield _setting("Table 4", f"{name}, held at its optimum", text, optimum, remark, name)
    for name in ("rolling_friction", "tensile_exponent"):
        middle = _middle_of_stated_range(name)
        text = in_text(f"held_for_force.{name}")
        remark = f"the middle is {middle:g}"
        yield _setting("Table 4", f"{name}, held at its middle", text, middle, remark, name)


def soil_means() -> Iterator[Figure]:
    """Averages of Table 6, in the table and in section 3.1."""
    for column, name, unit in (
        ("density_kg_m3", "density", "kg/m³"),
        ("moisture_content_percent", "moisture_content", "%"),
    ):
        values, half = table(6).values(column)[:-1], table(6).half_units(column)[:-1]
        mean = rounded(lambda x: {"mean": float(x.mean())}, values, half)["mean"]
        for where, text in (
            ("average", table(6).text("average", column)),
            (place(f"mean.{name}"), in_text(f"mean.{name}")),
        ):
            title = f"mean {name.replace('_', ' ')} ({where})"
            yield judge("Table 6", title, text, [Attempt(mean)], unit=unit)


def repeated_numbers() -> Iterator[Figure]:
    """Abstract and conclusions against the body."""
    for name in FACTORS:
        body = printed(in_text(f"final.{name}")).value
        for where in ("abstract", "conclusion"):
            remark = f"section 3.3.4 says {body:g}"
            text = in_text(f"{where}.{name}")
            yield _setting("Text", f"{name}, final value ({where})", text, body, remark, name)
    for name, unit in (("depression_depth", "mm"), ("crushing_force", "N")):
        body = printed(in_text(f"measured.{name}"))
        remark = f"the body gives {body.value:g} {unit} as the measured mean ({_place(name)})"
        text = in_text(f"abstract.{name}")
        title = f"measured {name.replace('_', ' ')} (abstract)"
        yield judge("Text", title, text, [Attempt(body)], remark, unit)
    for name, unit in (("depression_depth", "mm"), ("crushing_force", "N")):
        remark = f"the four curves behind it are a picture without numbers ({_place(name)})"
        title = f"measured {name.replace('_', ' ')} (body)"
        yield without_data("Text", title, in_text(f"measured.{name}"), remark, unit)


def _place(name: str) -> str:
    return place(f"measured.{name}")


def _setting(
    source: str, name: str, text: str, computed: float, remark: str, factor: str
) -> Figure:
    """A level, which is compared exactly."""
    exact = Range(printed(text).value)
    attempts = [Attempt(Range(float(computed)))]
    title = name.replace("_", " ")
    return judge_value(source, title, exact, text, attempts, remark, UNITS.get(factor, ""))


def _middle(levels: np.ndarray) -> float:
    return float((levels.min() + levels.max()) / 2)


def _middle_of_stated_range(name: str) -> float:
    ends = [printed(in_text(f"range.{name}.{end}")).value for end in ("low", "high")]
    return _middle(np.array(ends))


def coded(source: Table, names: tuple[str, ...]) -> np.ndarray:
    """Two-level columns (n, p) of a table as exact -1 and +1."""
    points = source.points(names)
    return np.where(points == points.max(axis=0), 1.0, -1.0)


def coded_points(factors: tuple[Factor, ...], natural: np.ndarray) -> np.ndarray:
    """Coded values (n, p) of natural points (n, p)."""
    return np.column_stack([f.coded(column) for f, column in zip(factors, natural.T, strict=True)])


def run_interval(surface: Surface, at: np.ndarray) -> tuple[float, float]:
    """The 95 % interval of a new run at one coded point (1, p)."""
    predicted = surface.fit.get_prediction(matrix(surface.terms, at))
    low, high = predicted.conf_int(obs=True, alpha=0.05)[0]
    return float(low), float(high)
