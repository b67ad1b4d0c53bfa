"""Stress, strain and void ratio become force and displacement of a specimen of known size.

    F = sigma pi d^2/4        x = epsilon h        epsilon = (e0 - e)/(1 + e0)

d and h are the diameter and height before the test and e0 the void ratio then: engineering
strain, and stress on the initial area.  Sizes come from the command line, else from the file.
"""

import re
from dataclasses import dataclass, replace

import numpy as np

from calibrate.core.errors import BadValue, shown
from calibrate.core.units import (
    AREA,
    LENGTH,
    STRAIN,
    STRESS,
    VOID_RATIO,
    number_of,
    number_or_quantity,
    positive_quantity,
    quantity,
)
from calibrate.instrument_import.preamble import Stated
from calibrate.instrument_import.vocabulary import Quantity

FIRST = "first"  # e0 is the void ratio of a specimen's first load step
DRAINAGE = "its course in time is drainage of pore water, which the model does not have"
ASSUMPTION = "engineering strain, and stress on the initial area, are assumed"
_OPTIONS = {
    "diameter": '--diameter "50 mm"',
    "height": '--height "100 mm"',
    "void_ratio": "--void-ratio 1.2 (e0) or --void-ratio first",
}
_LARGEST_VOID_RATIO = 20.0
_SAME = 0.02  # relative; two statements of one area agree within this


@dataclass(frozen=True)
class Size:
    """What the user says of the specimens, SI; None where the file is to say it.

    `void_ratios` holds e0 of all specimens or of each in file order, or is `FIRST`;
    `settlements` the whole settlement of a degree of consolidation, as written, one or each.
    `tool` are the sizes of a tool, its width first; `normal_stresses` (Pa) one or each.
    """

    diameter: float | None = None
    height: float | None = None
    void_ratios: tuple[float, ...] | str | None = None
    settlements: tuple[str, ...] | None = None
    tool: tuple[float, ...] = ()
    normal_stresses: tuple[float, ...] | None = None

    def over(self, stated: Stated) -> tuple[Stated, tuple[str, ...]]:
        """What the file states with the user's sizes in place, and where the two differ."""
        given = {"diameter": self.diameter, "height": self.height}
        given = {name: value for name, value in given.items() if value is not None}
        notes = tuple(
            f"{name} {1e3 * value:.5g} mm as given, not {1e3 * stated.quantities[name]:.5g} mm "
            "as the file states"
            for name, value in given.items()
            if name in stated.quantities and abs(stated.quantities[name] / value - 1) > 1e-3
        )
        replaced = {*given, *(["area"] if "diameter" in given else [])}
        quantities, impossible = (
            {name: each for name, each in known.items() if name not in replaced}
            for known in (stated.quantities, stated.impossible)
        )
        return replace(stated, quantities=quantities | given, impossible=impossible), notes


@dataclass(frozen=True, eq=False)
class Column:
    """One column as recorded: its kind, how a sentence names it, values (points,) in kPa or N, in
    mm, or as a fraction."""

    kind: Quantity
    words: str
    values: np.ndarray

    def of(self, rows: np.ndarray) -> "Column":
        """These rows of it."""
        return replace(self, values=self.values[rows])


@dataclass(frozen=True, eq=False)
class Converted:
    """Force (N) and displacement (mm) of shape (points,); the size that is known, SI; what was
    computed from it, as sentences (none: force and displacement were recorded)."""

    force_n: np.ndarray
    displacement_mm: np.ndarray
    diameter: float | None
    height: float | None
    void_ratio: float | None
    sentences: tuple[str, ...]


def converted(load: Column, travel: Column, stated: Stated, size: Size, place: int) -> Converted:
    """The two columns of the specimen with this place in the file, as force and displacement.

    Raises `BadValue` for a size that is missing, impossible or contradictory, and for values
    that no specimen can have.
    """
    if (load.kind, travel.kind) == (Quantity.FORCE, Quantity.DISPLACEMENT):
        known = stated.quantities
        sizes = (known.get("diameter"), known.get("height"), None)
        return Converted(load.values, travel.values, *sizes, ())
    if travel.kind == Quantity.CONSOLIDATION and size.settlements is None:
        raise _only_drainage(travel)
    if not len(load.values):
        problem = f"{load.words} and {travel.words} hold no point in common"
        raise BadValue(problem, "export the whole record")
    diameter, height = stated_diameter(stated), stated.quantities.get("height")
    void_ratio = _initial_void_ratio(travel, stated, size, place)
    _check_sizes(load, travel, stated, diameter, height, void_ratio)
    force, why_force = _force(load, diameter)
    displacement, why_travel = _displacement(travel, height, void_ratio, size, place)
    if height is not None:
        _check_strain(travel, 1e-3 * displacement / height)
    why = tuple(sentence for sentence in (why_force, why_travel) if sentence)
    return Converted(force, displacement, diameter, height, void_ratio, (*why, ASSUMPTION))


def stated_diameter(stated: Stated) -> float | None:
    """The diameter (m) as stated, or of the circle of the stated area."""
    diameter, area = stated.quantities.get("diameter"), stated.quantities.get("area")
    if area is None:
        return diameter
    if diameter is not None and abs(np.pi / 4 * diameter**2 / area - 1) > _SAME:
        problem = (
            f"its diameter {1e3 * diameter:.4g} mm and its area {1e4 * area:.4g} cm2 "
            "contradict each other"
        )
        raise BadValue(problem, 'give the right one as --diameter "50 mm"')
    return float(np.sqrt(4 * area / np.pi)) if diameter is None else diameter


def _initial_void_ratio(travel: Column, stated: Stated, size: Size, place: int) -> float | None:
    """e0 of this specimen, None where it is not known or no void ratio was recorded."""
    if travel.kind != Quantity.VOID_RATIO:
        return None
    if size.void_ratios is None:
        return stated.quantities.get("void_ratio")
    if isinstance(size.void_ratios, str):
        return float(travel.values[0])
    return _of_specimen(size.void_ratios, place)


def _of_specimen(values: tuple, place: int):
    """The value of the specimen with this place in the file; one value serves all."""
    return values[0] if len(values) == 1 else values[place]


def _check_sizes(load: Column, travel: Column, stated: Stated, *known: float | None) -> None:
    """Refuses a conversion without its sizes (diameter, height, e0): which column, what to give."""
    uses = (
        ("diameter", load, load.kind == Quantity.STRESS),
        (
            "height",
            travel,
            travel.kind in (Quantity.STRAIN, Quantity.VOID_RATIO, Quantity.CONSOLIDATION),
        ),
        ("void_ratio", travel, travel.kind == Quantity.VOID_RATIO),
    )
    missing = {
        name: column
        for (name, column, is_used), value in zip(uses, known, strict=True)
        if is_used and value is None
    }
    for name in missing:
        for stated_as in ("area", name) if name == "diameter" else (name,):
            if stated_as in stated.impossible:
                line = shown(stated.impossible[stated_as], 50)
                problem = f"its {stated_as.replace('_', ' ')} is not above zero: {line}"
                raise BadValue(problem, f"correct it, or give {_OPTIONS[name]}")
    if missing:
        give = ", ".join(_OPTIONS[name] for name in missing)
        texts = (f"{c.kind} without a size, in {c.words}" for c in missing.values())
        problem = ", ".join(dict.fromkeys(texts))
        if list(missing) == ["void_ratio"]:
            problem = f"void ratio without the initial one (e0), in {travel.words}"
        raise BadValue(problem, f"give {give}, or state it above the table")


def _force(load: Column, diameter: float | None) -> tuple[np.ndarray, str]:
    if load.kind == Quantity.FORCE or diameter is None:
        return load.values, ""
    area = np.pi / 4 * diameter**2
    text = f"force is the stress of {load.words} times the initial area, {1e4 * area:.5g} cm2"
    return 1e3 * load.values * area, f"{text} ({1e3 * diameter:.5g} mm in diameter)"


def _displacement(
    travel: Column, height: float | None, void_ratio: float | None, size: Size, place: int
) -> tuple[np.ndarray, str]:
    if travel.kind == Quantity.DISPLACEMENT or height is None:
        return travel.values, ""
    tall = f"the initial height, {1e3 * height:.5g} mm"
    if travel.kind == Quantity.CONSOLIDATION:
        if size.settlements is None:
            raise _only_drainage(travel)
        whole = settlement(_of_specimen(size.settlements, place), height)
        text = f"displacement is {travel.words} times the step's settlement, {1e3 * whole:.4g} mm"
        return 1e3 * whole * travel.values, f"{text}; a fit compares its end alone: {DRAINAGE}"
    if void_ratio is None:
        text = f"displacement is the strain of {travel.words} times {tall}"
        return 1e3 * height * travel.values, text
    _check_void_ratios(travel, void_ratio)
    strain = (void_ratio - travel.values) / (1 + void_ratio)
    text = f"displacement is (e0 - e)/(1 + e0) times {tall}, e0 = {void_ratio:.4g}"
    if size.void_ratios == FIRST:
        text += ", that of the first step, where displacement starts"
    return 1e3 * height * strain, text


def _check_void_ratios(travel: Column, void_ratio: float) -> None:
    finite = travel.values[np.isfinite(travel.values)]
    for value in (void_ratio, *finite):
        if not 0 < value <= _LARGEST_VOID_RATIO:
            problem = f"{travel.words}: a void ratio of {value:.4g} cannot be"
            raise BadValue(problem, "check which column holds the void ratio")


def _check_strain(travel: Column, strain: np.ndarray) -> None:
    finite = np.abs(strain[np.isfinite(strain)])
    if len(finite) and finite.max() >= 1:
        problem = f"{travel.words} means a strain of {100 * finite.max():.4g} %, above 100 %"
        raise BadValue(problem, 'correct its unit, the height, or give --strain-unit "%"')


def _only_drainage(travel: Column) -> BadValue:
    """Why a degree of consolidation alone says nothing that a fit could use."""
    problem = f"{travel.words} is a degree of consolidation, which has no size, and {DRAINAGE}"
    repair = "to fit the whole settlement of each step alone, give it in file order, such as"
    return BadValue(problem, f'{repair} --settlement "0.2 mm, 0.5 mm" or "1 %, 2.5 %"')


def settlement(text: str, height: float) -> float:
    """A settlement (m) written as a length or, in per cent, as a share of `height` (m)."""
    if text.strip().endswith("%"):
        return quantity(text, STRAIN) * height
    return quantity(text, LENGTH)


def initial_void_ratios(text: str) -> tuple[float, ...] | str:
    """--void-ratio: "first", a number, or one for each specimen, separated by commas."""
    if text.strip().casefold() == FIRST:
        return FIRST
    values = tuple(number_or_quantity(part.strip(), VOID_RATIO.unit) for part in text.split(","))
    if any(not 0 < value <= _LARGEST_VOID_RATIO for value in values):
        raise BadValue(f"{shown(text)} holds no possible void ratio", 'give one such as "1.2"')
    return values


def settlements(text: str) -> tuple[str, ...]:
    """--settlement: one for all steps or one for each, separated by commas, each checked."""
    parts = tuple(part.strip() for part in text.split(","))
    for part in parts:
        if not settlement(part, 1.0) > 0:
            raise BadValue(f"{shown(part)} is no settlement", 'give one such as "0.2 mm"')
    return parts


def tool_sizes(text: str) -> tuple[float, ...]:
    """--tool: its width and perhaps a further size (m), "20 mm" or "20 x 40 mm"; or an area,
    "130 mm^2", of which the diameter of a circle is meant."""
    *before, last = (part.strip() for part in re.split(r"[x×*,]", text))
    unit = last.removeprefix(number_of(last)).strip()
    sizes = [f"{part} {unit}" if number_of(part) == part else part for part in (*before, last)]
    try:
        if not before and quantity(text, AREA) > 0:
            return (float(np.sqrt(4 * quantity(text, AREA) / np.pi)),)
    except BadValue:
        pass
    return tuple(positive_quantity(each, LENGTH) for each in sizes)


def normal_stresses(text: str) -> tuple[float, ...]:
    """--normal-stress: one for all specimens or one for each, separated by commas, Pa."""
    return tuple(1e3 * positive_quantity(part.strip(), STRESS) for part in text.split(","))


def check_counts(size: Size, specimens: int) -> None:
    """Refuses a list of void ratios or settlements that is not one for each specimen."""
    for option, values in (
        ("--void-ratio", size.void_ratios),
        ("--settlement", size.settlements),
        ("--normal-stress", size.normal_stresses),
    ):
        if isinstance(values, tuple) and len(values) not in (1, specimens):
            problem = f"{len(values)} values of {option} for {specimens} specimens"
            raise BadValue(problem, "give one for all, or one for each in file order")
