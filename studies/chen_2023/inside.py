"""Inside the tables: what their own entries say about each other, without any raw data.

In a row of an analysis of variance the mean square is the sum of squares over its degrees of
freedom, F the mean square over that of the residual, p the tail of the F distribution.  In a
two-level design of 12 runs a sum of squares is 3 effect^2, and a contribution is its share of
one total.
"""

from collections.abc import Callable, Iterator

import numpy as np
from scipy import stats

from studies.chen_2023.tables import Range, Table, table
from studies.chen_2023.verdict import COLUMNS, Attempt, Figure, judge, rounded

RUNS = 12


def checks() -> Iterator[Figure]:
    """Every relation between printed entries, judged like a figure."""
    for number in (7, 8):
        yield from effects(table(number))
    for number in (9, 10):
        yield from analysis_of_variance(table(number))


def effects(source: Table) -> Iterator[Figure]:
    """Sums of squares from effects; contributions from sums of squares and the first row's."""
    first = next(iter(source.rows))
    for row in source.rows:
        name = row.replace("_", " ")
        square = _from([source.cell(row, "effect")], lambda e: RUNS * e**2 / 4)
        yield _check(source, row, "sum_of_squares", f"{name}: 3 effect²", square)
        cells = [
            source.cell(row, "sum_of_squares"),
            source.cell(first, "sum_of_squares"),
            source.cell(first, "contribution_percent"),
        ]
        if row != first:
            share = _from(cells, lambda s, s1, c1: c1 * s / s1)
            title = f"{name}: contribution by the total of the first row"
            yield _check(source, row, "contribution_percent", title, share)


def analysis_of_variance(source: Table) -> Iterator[Figure]:
    """Totals, mean squares, F and p from the other entries of the same table."""
    for column in ("sum_of_squares", "df"):
        parts = [source.cell(row, column) for row in ("model", "residual")]
        known = [_exact(part) for part in parts] if column == "df" else parts
        title = f"total: {COLUMNS[column]} of model and residual"
        yield _check(source, "total", column, title, _from(known, lambda a, b: a + b))
    residual, residual_df = source.cell("residual", "mean_square"), source.cell("residual", "df")
    for row in [row for row in source.rows if row != "total"]:
        squares, df = source.cell(row, "sum_of_squares"), source.cell(row, "df")
        name = row.replace("_", " ")
        mean = _from([squares, _exact(df)], lambda s, d: s / d)
        yield _check(source, row, "mean_square", f"{name}: mean square", mean)
        if row == "residual":
            continue
        printed_mean, f = source.cell(row, "mean_square"), source.cell(row, "f_value")
        ratio = _from([printed_mean, residual], lambda m, r: m / r)
        yield _check(source, row, "f_value", f"{name}: F by the printed residual", ratio)
        tail = _from([f, _exact(df), _exact(residual_df)], _tail)
        yield _check(source, row, "p_value", f"{name}: p by the printed residual", tail)
        implied = _implied_residual_df(source)
        tail = _from([f, _exact(df), Range(implied)], _tail)
        title = f"{name}: p with total - model = {implied:g} degrees of freedom"
        yield _check(source, row, "p_value", title, tail)


def _implied_residual_df(source: Table) -> float:
    return source.cell("total", "df").value - source.cell("model", "df").value


def _tail(f: float, df: float, residual_df: float) -> float:
    return float(stats.f.sf(f, df, residual_df))


def _exact(count: Range) -> Range:
    return Range(count.value)


def _from(cells: list[Range], formula: Callable[..., float]) -> Range:
    """A formula of printed entries with the reach of their rounding."""
    values = np.array([cell.value for cell in cells])
    reach = np.array([cell.reach for cell in cells])
    return rounded(lambda x: {"it": float(formula(*x))}, values, reach)["it"]


def _check(source: Table, row: str, column: str, title: str, computed: Range) -> Figure:
    text = source.text(row, column)
    return judge(source.title, title, text, [Attempt(computed)])
