"""Tables 7 and 8, effects and contributions, against the twelve runs of Table 2."""

from collections.abc import Iterator

import numpy as np

from calibrate.designs.screening import Screening, screen
from studies.chen_2023.levels import FACTORS, coded
from studies.chen_2023.tables import in_text, printed, table
from studies.chen_2023.verdict import (
    Attempt,
    Figure,
    Numbers,
    judge,
    judge_words,
    rounded,
)

RESPONSES = {"depression_depth": "depression_depth_mm", "crushing_force": "crushing_force_n"}
PRINTED_IN = {"depression_depth": 7, "crushing_force": 8}
COLUMNS = {
    "effect": "effect",
    "sum_of_squares": "sum of squares",
    "contribution_percent": "contribution",
}


def screening(response: str, scale: float = 1.0) -> Screening:
    """Table 2's effects on "depression_depth" (mm) or "crushing_force" (N), times `scale`."""
    return _screen(scale * table(2).values(RESPONSES[response]))


def figures() -> Iterator[Figure]:
    """Every entry of both tables, then what the text concludes from them."""
    for response in RESPONSES:
        yield from entries(response)
    for response in RESPONSES:
        yield from conclusions(response)


def entries(response: str) -> Iterator[Figure]:
    """Effect, sum of squares and contribution of each factor."""
    column = RESPONSES[response]
    found = rounded(_numbers, table(2).values(column), table(2).half_units(column))
    source = table(PRINTED_IN[response])
    unit = "mm" if response == "depression_depth" else "N"
    units = {"effect": unit, "sum_of_squares": f"{unit}²", "contribution_percent": "%"}
    for name in FACTORS:
        for entry, words in COLUMNS.items():
            title = f"{name.replace('_', ' ')}, {words}"
            attempts = [Attempt(found[f"{name}.{entry}"])]
            remark = _remark(response)
            text = source.text(name, entry)
            yield judge(source.title, title, text, attempts, remark, units[entry])


def conclusions(response: str) -> Iterator[Figure]:
    """Order of the contributions, and the factors that are kept."""
    found, source = screening(response), table(PRINTED_IN[response])
    order = " > ".join(effect.name for effect in found.ranked())
    title, text = "order of contributions", in_text(f"order.{response}")
    yield judge_words(source.title, title, text, order, "order of Table 2's contributions")
    threshold = printed(in_text("threshold.contribution")).value
    kept = _above(threshold, {name: found[name].contribution for name in FACTORS})
    column = source.values("contribution_percent")
    by_table = _above(threshold, dict(zip(FACTORS, column, strict=True)))
    title = f"factors that contribute more than {threshold:g} %"
    remark = f"by Table 2; by {source.title} itself: {by_table}"
    yield judge_words(source.title, title, in_text(f"selected.{response}"), kept, remark)


def implied_total(response: str) -> np.ndarray:
    """Total sums of squares (7,) that each row's sum of squares and contribution imply."""
    source = table(PRINTED_IN[response])
    return 100 * source.values("sum_of_squares") / source.values("contribution_percent")


def _remark(response: str) -> str:
    totals = implied_total(response)
    implied = f"{totals.min():,.0f} to {totals.max():,.0f}"
    if np.ptp(totals) < 1e-4 * totals.mean():
        implied = f"{totals.mean():.4g}"
    of_data = screening(response).total_sum_of_squares
    return f"the total sum of squares of Table 2 is {of_data:.4g}, the printed rows imply {implied}"


def _above(threshold: float, contributions: dict[str, float]) -> str:
    return ", ".join(name for name in FACTORS if contributions[name] > threshold)


def _screen(y: np.ndarray) -> Screening:
    return screen(coded(table(2), FACTORS), y, FACTORS)


def _numbers(y: np.ndarray) -> Numbers:
    found = _screen(y)
    return {
        f"{effect.name}.{entry}": value
        for effect in found.effects
        for entry, value in (
            ("effect", effect.effect),
            ("sum_of_squares", effect.sum_of_squares),
            ("contribution_percent", effect.contribution),
        )
    }
