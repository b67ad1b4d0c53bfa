"""Analysis of variance of a response surface, as response-surface programs print it.

The model's sum of squares is split into one line for each term: the partial ("type III") sum
of squares, what the residual grows by when that term alone is left out.  The residual is split
into pure error (scatter of replicated points) and lack of fit (the rest).  Every line and
every statistic carries its degrees of freedom.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
from scipy import stats

from calibrate.core.errors import BadValue
from calibrate.designs.surface import Surface

SAME_POINT = 9  # decimals to which coordinates of replicates agree, in units of each range


@dataclass(frozen=True)
class Line:
    """One line: sum of squares, degrees of freedom, mean square, F and p (NaN where none)."""

    source: str
    sum_of_squares: float
    df: int
    mean_square: float
    f: float = np.nan
    p: float = np.nan


@dataclass(frozen=True)
class Statistic:
    """A number with its degrees of freedom, numerator and denominator where it is a ratio."""

    value: float
    df: tuple[int, ...]


@dataclass(frozen=True)
class Anova:
    """The table, by source, and the statistics printed below it.

    Sources are "Model", the terms, "Residual", "Lack of fit", "Pure error", "Total"; lack of
    fit and pure error only where points are replicated.  r2, adjusted_r2, predicted_r2 are
    fractions; cv_percent is std_dev over mean; press is the sum of squared prediction errors of
    runs left out one at a time; adequate_precision is the range of predictions over their
    average standard error.
    """

    lines: tuple[Line, ...]
    std_dev: Statistic
    mean: Statistic
    cv_percent: Statistic
    r2: Statistic
    adjusted_r2: Statistic
    predicted_r2: Statistic
    press: Statistic
    adequate_precision: Statistic

    def __getitem__(self, source: str) -> Line:
        return {line.source: line for line in self.lines}[source]

    def __contains__(self, source: str) -> bool:
        return any(line.source == source for line in self.lines)

    def statistics(self) -> dict[str, Statistic]:
        """The numbers below the table, by name."""
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name != "lines"}

    def as_text(self) -> str:
        """The table and the statistics as lines of plain text."""
        return "\n".join(_text_lines(self))


def anova(surface: Surface) -> Anova:
    """The analysis of variance of a fit of values alone; `BadValue` for another."""
    if surface.slope_rows:
        raise BadValue("this surface was fitted with slopes", "fit the values alone", "surface")
    return Anova(tuple(_lines(surface)), **_statistics(surface))


def pure_error(X: np.ndarray, y: np.ndarray) -> tuple[float, int]:
    """Sum of squares and degrees of freedom of responses (n,) within equal points X (n, p)."""
    span = np.ptp(X, axis=0)
    scaled = np.round((X - X.min(axis=0)) / np.where(span > 0, span, 1.0), SAME_POINT)
    _, group = np.unique(scaled, axis=0, return_inverse=True)
    group = group.ravel()
    counts = np.bincount(group)
    means = np.bincount(group, y) / counts
    return float(np.sum((y - means[group]) ** 2)), int(len(y) - len(counts))


def _lines(surface: Surface) -> Iterator[Line]:
    y, df = surface.y, surface.df
    total = float(np.sum((y - y.mean()) ** 2))
    residual = float(surface.fit.ssr)
    noise = surface.variance
    yield _tested("Model", total - residual, len(surface.terms), noise, df)
    leverage = np.diag(np.asarray(surface.fit.normalized_cov_params))[1:]
    partial = surface.coefficients[1:] ** 2 / leverage
    for label, sum_of_squares in zip(surface.labels, partial, strict=True):
        yield _tested(label, float(sum_of_squares), 1, noise, df)
    yield _plain("Residual", residual, df)
    error, error_df = pure_error(surface.X, y)
    if error_df:
        lack_df = df - error_df
        yield _tested("Lack of fit", residual - error, lack_df, error / error_df, error_df)
        yield _plain("Pure error", error, error_df)
    yield _plain("Total", total, len(y) - 1)


def _plain(source: str, sum_of_squares: float, df: int) -> Line:
    return Line(source, sum_of_squares, df, sum_of_squares / df if df else np.nan)


def _tested(source: str, sum_of_squares: float, df: int, noise: float, noise_df: int) -> Line:
    """A line tested against a mean square `noise` that has `noise_df` degrees of freedom."""
    mean_square = sum_of_squares / df if df else np.nan
    f = mean_square / noise if noise > 0 else np.nan
    p = float(stats.f.sf(f, df, noise_df)) if df and noise_df else np.nan
    return Line(source, sum_of_squares, df, mean_square, f, p)


def _statistics(surface: Surface) -> dict[str, Statistic]:
    y, df, n, m = surface.y, surface.df, len(surface.y), len(surface.terms)
    total, residual = float(np.sum((y - y.mean()) ** 2)), float(surface.fit.ssr)
    std_dev, mean = float(np.sqrt(surface.variance)), float(y.mean())
    press = _press(surface)
    predictions = np.asarray(surface.fit.fittedvalues)
    average_se = std_dev * np.sqrt((m + 1) / n)
    adjusted = 1 - surface.variance / (total / (n - 1))
    return {
        "std_dev": Statistic(std_dev, (df,)),
        "mean": Statistic(mean, (n,)),
        "cv_percent": Statistic(100 * std_dev / abs(mean), (df,)),
        "r2": Statistic(1 - residual / total, (m, df)),
        "adjusted_r2": Statistic(float(adjusted), (df, n - 1)),
        "predicted_r2": Statistic(1 - press / total, (n, n - 1)),
        "press": Statistic(press, (n,)),
        "adequate_precision": Statistic(float(np.ptp(predictions) / average_se), (m + 1, df)),
    }


def _press(surface: Surface) -> float:
    """Sum of squared leave-one-out errors e/(1 - h); NaN if a point alone fixes a coefficient."""
    leverage = np.asarray(surface.fit.get_influence().hat_matrix_diag)
    if np.any(leverage > 1 - 1e-9):
        return np.nan
    return float(np.sum((np.asarray(surface.fit.resid) / (1 - leverage)) ** 2))


def _text_lines(table: Anova) -> Iterator[str]:
    width = max(len(line.source) for line in table.lines) + 2
    yield f"{'Source':{width}}{'SS':>13}{'df':>5}{'MS':>13}{'F':>10}{'p':>10}"
    for line in table.lines:
        mean_square, f, p = (_shown(v) for v in (line.mean_square, line.f, line.p))
        squares = _shown(line.sum_of_squares)
        yield f"{line.source:{width}}{squares:>13}{line.df:>5}{mean_square:>13}{f:>10}{p:>10}"
    for name, statistic in table.statistics().items():
        df = ", ".join(str(number) for number in statistic.df)
        yield f"{name.replace('_', ' '):22}{_shown(statistic.value):>13}   df {df}"


def _shown(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.4g}"
