"""Canonical analysis of a second-order surface: its stationary point and principal axes.

    y = b0 + b'x + x'Bx,   x_s = -B^-1 b/2,   y = y_s + sum_i lambda_i w_i^2

(Myers, Montgomery and Anderson-Cook, chapter 6): all eigenvalues negative is a maximum, all
positive a minimum, mixed signs a saddle, one near zero a ridge.
"""

from dataclasses import dataclass

import numpy as np

from calibrate.core.errors import BadValue
from calibrate.designs.surface import Surface


@dataclass(frozen=True, eq=False)
class Canonical:
    """Of the factors that have second-order terms, in coded units.

    factors (k,) are their names, point (k,) the stationary point, value the response there
    (other factors at 0), eigenvalues (k,) falling, axes (k, k) their directions as columns.
    """

    factors: tuple[str, ...]
    point: np.ndarray
    value: float
    eigenvalues: np.ndarray
    axes: np.ndarray

    @property
    def kind(self) -> str:
        if np.all(self.eigenvalues < 0):
            return "maximum"
        return "minimum" if np.all(self.eigenvalues > 0) else "saddle"


def canonical(surface: Surface) -> Canonical:
    """The canonical analysis; `BadValue` for terms above second order or a flat direction."""
    if max(term.order for term in surface.terms) > 2:
        raise BadValue("the surface has cubic terms", "fit a quadratic", "surface")
    p = len(surface.names)
    linear, second = np.zeros(p), np.zeros((p, p))
    for term, b in zip(surface.terms, surface.coefficients[1:], strict=True):
        factors = [j for j, power in enumerate(term.powers) for _ in range(power)]
        if term.order == 1:
            linear[factors[0]] = b
        else:
            second[factors[0], factors[1]] += b / 2
            second[factors[1], factors[0]] += b / 2
    bent = np.flatnonzero(np.any(second != 0, axis=1))
    core = second[np.ix_(bent, bent)]
    if not len(bent) or np.linalg.matrix_rank(core) < len(bent):
        raise BadValue("the surface is flat along a direction", "fit a quadratic", "surface")
    x = np.zeros(p)
    x[bent] = -np.linalg.solve(core, linear[bent]) / 2
    eigenvalues, axes = np.linalg.eigh(core)
    names = tuple(surface.names[j] for j in bent)
    value = float(surface(x[None])[0])
    return Canonical(names, x[bent], value, eigenvalues[::-1], axes[:, ::-1])
