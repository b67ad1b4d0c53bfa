"""The one rule by which a published figure is judged against what the printed data give.

A printed number stands for its value ± half a unit of its last printed digit.  A figure computed
from printed responses inherits their rounding: to first order it lies within

    f(x) ± sum_i |f(x + h_i) - f(x - h_i)| / 2        h_i: half a unit of the last digit of x_i

whatever the digits were that rounding took away (the worst case: all of them conspire).  Levels
of a design are settings and count as exact.  A published figure is

    reproduced                            if both intervals meet, with the data as printed;
    reproduced after a stated correction  if they meet once the data, the label of a row or the
                                          published number are read as the correction says;
    not reproduced                        otherwise, or if nothing is printed to compute it from.

Published words (an order of factors, a choice) are reproduced if they are the same words.

Analyses of variance (Tables 9 and 10) are judged row by row: the paper prints a model, some main
effects, a residual and a total, each with sum of squares, degrees of freedom, mean square, F and p.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from calibrate.designs.anova import Anova
from studies.chen_2023.tables import Range, Table, printed

Numbers = dict[str, float]
Ranges = dict[str, Range]


class Verdict(StrEnum):
    """What became of a published figure."""

    REPRODUCED = "reproduced"
    CORRECTED = "reproduced after a stated correction"
    NOT_REPRODUCED = "not reproduced"


@dataclass(frozen=True)
class Attempt:
    """One way to compute a figure; `correction` says what is read otherwise than printed.

    `reading` replaces the published number where the correction is to that number itself.
    """

    computed: Range
    correction: str = ""
    reading: Range | None = None


@dataclass(frozen=True)
class Figure:
    """A published figure with its verdict; numbers in `unit` ("" for a pure number).

    `published` and `computed` are numbers or words; `computed` is None where the paper prints
    nothing to compute it from.  `tolerance` is the sum of both intervals' reaches.  `correction`
    is the correction that reproduces it, or a remark on what the data give instead.
    """

    table: str
    name: str
    published: float | str
    printed_as: str
    computed: float | str | None
    tolerance: float | None
    verdict: Verdict
    correction: str
    unit: str = ""

    @property
    def deviation(self) -> float | None:
        """(computed - published)/|published|; None for words and where published is 0."""
        if isinstance(self.published, str) or not isinstance(self.computed, float):
            return None
        return (self.computed - self.published) / abs(self.published) if self.published else None

    def as_json(self) -> dict:
        return {
            "table": self.table,
            "name": self.name,
            "published": self.published,
            "computed": self.computed,
            "verdict": str(self.verdict),
            "correction": self.correction,
            "tolerance": self.tolerance,
            "deviation": self.deviation,
            "unit": self.unit,
            "printed_as": self.printed_as,
        }


def judge(
    table: str, name: str, text: str, attempts: Sequence[Attempt], remark: str = "", unit: str = ""
) -> Figure:
    """The verdict on the number printed as `text`: that of the first attempt that meets it.

    If none does, the last attempt is shown, with `remark`.
    """
    return judge_value(table, name, printed(text), text, attempts, remark, unit)


def judge_value(
    table: str,
    name: str,
    published: Range,
    text: str,
    attempts: Sequence[Attempt],
    remark: str = "",
    unit: str = "",
) -> Figure:
    """As `judge`, for a value that is not printed as one number, such as an equation's."""
    met = [a for a in attempts if (a.reading or published).meets(a.computed)]
    if met:
        chosen, words = met[0], [met[0].correction]
        verdict = Verdict.CORRECTED if chosen.correction else Verdict.REPRODUCED
    else:
        chosen, words = attempts[-1], [attempts[-1].correction, remark]
        verdict = Verdict.NOT_REPRODUCED
    return Figure(
        table,
        name,
        published.value,
        text,
        float(chosen.computed.value),
        float(published.reach + chosen.computed.reach),
        verdict,
        "; ".join(word for word in words if word),
        unit,
    )


def judge_words(table: str, name: str, published: str, computed: str, remark: str = "") -> Figure:
    """The verdict on published words."""
    same = published == computed
    verdict = Verdict.REPRODUCED if same else Verdict.NOT_REPRODUCED
    note = "" if same else remark
    return Figure(table, name, published, published, computed, None, verdict, note)


def without_data(table: str, name: str, text: str, remark: str, unit: str = "") -> Figure:
    """A number for which the paper prints nothing that it could be computed from."""
    number = printed(text).value
    return Figure(table, name, number, text, None, None, Verdict.NOT_REPRODUCED, remark, unit)


def rounded(
    function: Callable[[np.ndarray], Numbers], inputs: np.ndarray, half_units: np.ndarray
) -> Ranges:
    """All numbers that `function` makes of inputs (n,), with the reach of the inputs' rounding."""
    centre = function(inputs)
    reach = dict.fromkeys(centre, 0.0)
    for shift in np.diag(half_units)[half_units > 0]:
        above, below = function(inputs + shift), function(inputs - shift)
        for name in reach:
            reach[name] += abs(above[name] - below[name]) / 2
    return {name: Range(float(value), reach[name]) for name, value in centre.items()}


# ---------------------------------------------------------------- rows of an analysis of variance

COLUMNS = {
    "sum_of_squares": "sum of squares",
    "df": "degrees of freedom",
    "mean_square": "mean square",
    "f_value": "F",
    "p_value": "p",
}


def row_entries(analysis: Anova, sources: Mapping[str, str]) -> Numbers:
    """Entries "row.column" of the paper's rows; `sources` names our line for each of them."""
    found: Numbers = {}
    for row, source in sources.items():
        line = analysis[source]
        values = (line.sum_of_squares, float(line.df), line.mean_square, line.f, line.p)
        found |= {f"{row}.{column}": v for column, v in zip(COLUMNS, values, strict=True)}
    return found


def judge_rows(
    printed_table: Table,
    computations: Mapping[str, Ranges],
    units: Mapping[str, str],
    readings: Mapping[str, Attempt] | None = None,
    remark: str = "",
) -> Iterator[Figure]:
    """Verdicts on every printed entry.

    `computations` are ranges by the correction that they need ("" for none), in the order in
    which they are tried; an entry that a computation lacks is skipped there.  `readings` are
    further attempts for single entries, tried last.
    """
    for row in printed_table.rows:
        for column, words in COLUMNS.items():
            text = printed_table.text(row, column)
            if not text:
                continue
            entry = f"{row}.{column}"
            attempts = [
                Attempt(ranges[entry], correction)
                for correction, ranges in computations.items()
                if entry in ranges
            ]
            attempts += [readings[entry]] if readings and entry in readings else []
            title = f"{row.replace('_', ' ')}, {words}"
            unit = units.get(column, "")
            yield judge(printed_table.title, title, text, attempts, remark, unit)
