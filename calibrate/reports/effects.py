"""Effects in plain words, for readers who have never opened the code.

An effect without an entry here is shown under its own name with what `jdem` says about it, so
adding an effect needs nothing of this file.
"""

from dataclasses import dataclass

from calibrate.discrepancy.comparison.classes import JOINED, TOGETHER
from calibrate.reports.html import number, words
from jdem.effects.base import About
from jdem.effects.composite import EFFECTS


@dataclass(frozen=True)
class Plain:
    """A name for the page, one sentence, and the unit in which strength is shown: its factor
    on SI and its symbol."""

    name: str
    sentence: str
    factor: float = 1.0
    unit: str = ""


PLAIN: dict[str, Plain] = {
    "load_frame_compliance": Plain(
        "machine gives way",
        "The load frame bends under force, and its travel is read as travel of the platen.",
        1e6, "mm/kN",
    ),
    "seating_gap": Plain(
        "loose seating",
        "Gaps between specimen, plates and spherical seats close at small forces and lengthen the "
        "toe.",
        1e3, "mm",
    ),
    "load_cell_gain": Plain(
        "load cell reads by a wrong factor",
        "Every force is shown too large or too small by the same share.",
        100.0, "%",
    ),
    "load_cell_offset": Plain(
        "load cell not tared",
        "Every force is shown too large or too small by the same amount, also with nothing on the "
        "cell.",
        1.0, "N",
    ),
    "load_cell_drift": Plain(
        "load cell drifts",
        "The reading runs away slowly with time, which only the long crushing test is slow enough "
        "to show.",
        3600.0, "N/h",
    ),
    "acquisition_lag": Plain(
        "force is read late",
        "The reading lags behind the platen, so the fast test in the mould turns late and presses "
        "harder than intended.",
        1e3, "ms",
    ),
    "wall_friction": Plain(
        "friction on the mould",
        "The wall of the mould carries part of the load, more than its grease is taken to let it.",
    ),
    "platen_friction": Plain(
        "friction on the platens",
        "Plates hold the specimen's ends back, which makes the crushing test stronger and its peak "
        "later.",
    ),
    "second_test_factor": Plain(
        "soil changed before the crushing test",
        "Drying, ageing or handling scaled every contact force of the second test alone.",
        100.0, "%",
    ),
    "capillary_tension": Plain(
        "water bridges",
        "Water between particles pulls even where they have parted, so strength outlasts the peak.",
        1e-3, "kPa",
    ),
    "cementation": Plain(
        "cemented bonds",
        "Bonds grow before the crushing test and break for good: a stiffer, higher, brittle peak.",
        1e-3, "kPa",
    ),
    "rate_dependence": Plain(
        "soil depends on speed",
        "Contacts are weaker when pressed slowly, and the two tests differ in speed by decades.",
        100.0, "% per tenfold speed",
    ),
    "specimen_density": Plain(
        "denser or looser filling",
        "Specimens hold more or less soil in the same mould than the simulated ones.",
        100.0, "%",
    ),
}  # fmt: skip
ENDS = {
    "none": Plain("no gap", "The calibrated model fits as well as repeats agree."),
    "unknown": Plain("something not in the library", "No effect of the library explains the gap."),
}


def plain(name: str) -> Plain:
    """One effect, `none` or `unknown` in plain words."""
    if name in ENDS:
        return ENDS[name]
    if name in PLAIN or name not in EFFECTS:
        return PLAIN.get(name, Plain(words(name), ""))
    about: About = EFFECTS[name].about
    sentence = f"In the mould: {about.in_mould}. Free: {about.free}."
    return Plain(words(name), sentence, 1.0, "" if about.unit == "1" else about.unit)


def members(label: str) -> list[list[str]]:
    """The effects that a class's label, or that of two classes at once, is made of."""
    return [part.split(JOINED) for part in label.split(TOGETHER)]


def title(label: str) -> str:
    """A class's label in plain words: `or` within a class, `and` between classes."""
    parts = [_one_of([plain(name).name for name in group]) for group in members(label)]
    if len(parts) > 1:
        parts = [f"({part})" if " or " in part else part for part in parts]
    return " and ".join(parts)


def _one_of(names: list[str]) -> str:
    *others, last = names
    return f"{', '.join(others)} or {last}" if others else last


def strength(name: str, value: float, error: float | None = None) -> str:
    """A strength (SI) for reading, with its standard error if given."""
    shown = plain(name)
    text = number(shown.factor * value, 3)
    text += "" if error is None else f" ± {number(shown.factor * error, 2)}"
    return f"{text} {shown.unit}".strip()
