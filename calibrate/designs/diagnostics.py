"""Is a surface's residual what least squares supposes?  Four looks at it.

Externally studentised residuals against normal quantiles and against predictions; Cook's distance;
the Box-Cox profile (J. R. Stat. Soc. B 26, 1964) of the power to which the response should be
raised.  The first three are those of statsmodels.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import optimize, stats

from calibrate.core.errors import BadValue
from calibrate.designs.surface import Surface
from calibrate.designs.terms import matrix


@dataclass(frozen=True, eq=False)
class Diagnostics:
    """One entry (n,) for each run: prediction in the response's unit, the others without unit.

    `outlier_limit` is the two-sided 5 % Bonferroni limit of studentised residuals, which are NaN
    for a run that alone fixes a coefficient; a Cook's distance above 1 marks an influential run.
    """

    predicted: np.ndarray
    studentised: np.ndarray
    normal_quantile: np.ndarray
    cooks_distance: np.ndarray
    outlier_limit: float


def diagnose(surface: Surface) -> Diagnostics:
    """Diagnostics of a surface with at least two residual degrees of freedom."""
    if surface.df < 2 or surface.slope_rows:
        problem = "fewer than two residual degrees of freedom, or slopes in the fit"
        raise BadValue(problem, "fit values alone, with fewer terms", "surface")
    influence = surface.fit.get_influence()
    studentised = np.asarray(influence.resid_studentized_external)
    n = len(surface.y)
    return Diagnostics(
        predicted=np.asarray(surface.fit.fittedvalues),
        studentised=studentised,
        normal_quantile=normal_quantiles(studentised),
        cooks_distance=np.asarray(influence.cooks_distance[0]),
        outlier_limit=float(stats.t.ppf(1 - 0.025 / n, surface.df - 1)),
    )


def normal_quantiles(values: np.ndarray) -> np.ndarray:
    """Expected normal quantile (n,) at each value's rank, (rank - 3/8)/(n + 1/4) (Blom)."""
    ranks = stats.rankdata(values, method="ordinal")
    return stats.norm.ppf((ranks - 0.375) / (len(values) + 0.25))


@dataclass(frozen=True, eq=False)
class BoxCox:
    """Powers (k,) of the response and ln of the residual sum of squares of each (k,).

    `best` is the power with the least; `interval` holds the powers that a likelihood ratio on
    one degree of freedom does not refuse at 5 %, where ln SS is below `limit`.  1 leaves the
    response as it is, 0 takes its logarithm.
    """

    powers: np.ndarray
    log_residual: np.ndarray
    best: float
    interval: tuple[float, float]
    limit: float


REACH = 5.0  # of the search for powers, in both directions
ROUNDING = 1e-12  # of the mean response; residuals below it are not scatter


def without_profile(surface: Surface) -> str:
    """Why a surface has no Box-Cox profile; "" if it has one."""
    if np.any(surface.y <= 0):
        return "a response is not positive"
    if np.std(surface.fit.resid) < ROUNDING * np.mean(surface.y):
        return "the surface fits every response exactly"
    return ""


def box_cox(surface: Surface) -> BoxCox:
    """The profile for the surface's own terms; `BadValue` where `without_profile` says why not."""
    y, rows = surface.y, matrix(surface.terms, surface.X)
    problem = without_profile(surface)
    if problem:
        raise BadValue(problem, "Box-Cox needs positive responses that scatter", "y")

    def log_residual(power: float) -> float:
        z = transformed(y, power)
        return float(np.log(np.sum((z - rows @ np.linalg.lstsq(rows, z)[0]) ** 2)))

    found: Any = optimize.minimize_scalar(log_residual, bounds=(-REACH, REACH), method="bounded")
    best = float(found.x)
    limit = log_residual(best) + float(stats.chi2.ppf(0.95, 1)) / len(y)
    low, high = (_crossing(log_residual, best, end, limit) for end in (-REACH, REACH))
    powers = np.linspace(max(low - 1, -REACH), min(high + 1, REACH), 61)
    profile = np.array([log_residual(power) for power in powers])
    return BoxCox(powers, profile, best, (low, high), limit)


def transformed(y: np.ndarray, power: float) -> np.ndarray:
    """(y^power - 1)/(power g^(power - 1)) with the geometric mean g, or g ln y at power 0."""
    mean = np.exp(np.mean(np.log(y)))
    if abs(power) < 1e-8:
        return mean * np.log(y)
    shift = mean * -np.expm1(-power * np.log(mean)) / power  # constant over the runs
    return mean * np.expm1(power * np.log(y / mean)) / power + shift


def _crossing(profile: Callable[[float], float], best: float, end: float, limit: float) -> float:
    """Where the profile crosses `limit` between `best` and `end`; `end` itself if nowhere."""
    if profile(end) <= limit:
        return end
    root: Any = optimize.brentq(lambda power: profile(power) - limit, best, end)
    return root
