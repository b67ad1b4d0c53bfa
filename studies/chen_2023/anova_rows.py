"""Rows of the paper's analyses of variance (Tables 9 and 10) out of our own.

The paper prints a model, some main effects, a residual and a total, each with sum of squares,
degrees of freedom, mean square, F and p.
"""

from collections.abc import Iterator, Mapping

from calibrate.designs.anova import Anova
from studies.chen_2023.tables import Table
from studies.chen_2023.verdict import Attempt, Figure, Numbers, Ranges, judge

COLUMNS = {
    "sum_of_squares": "sum of squares",
    "df": "degrees of freedom",
    "mean_square": "mean square",
    "f_value": "F",
    "p_value": "p",
}


def entries(analysis: Anova, sources: Mapping[str, str]) -> Numbers:
    """Entries "row.column" of the paper's rows; `sources` names our line for each of them."""
    found: Numbers = {}
    for row, source in sources.items():
        line = analysis[source]
        values = (line.sum_of_squares, float(line.df), line.mean_square, line.f, line.p)
        found |= {f"{row}.{column}": v for column, v in zip(COLUMNS, values, strict=True)}
    return found


def judged(
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
