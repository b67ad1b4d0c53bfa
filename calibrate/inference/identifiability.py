"""What the data fix: undamped covariance, directions, and which parameters to free.

All of it in ln p.  With whitened slopes J (m, p) and the prior's standard deviations:

    covariance of the data alone      (J' J)^-1           (inf along directions J cannot see)
    covariance with the prior         (J' J + P^-1)^-1

The solver's damping never enters.  Intervals are those of Student's t in ln p, cut at the bounds
of a parameter, beyond which it is impossible.  Where a simulated profile rises less than the
covariance says, an interval reaches as much farther on that side.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

IDENTIFIED = 0.5  # a direction counts as fixed if the data halve the prior's deviation
ALIKE = 0.7  # of the largest signal-to-noise: slopes of one screening do not tell these apart
WIDEST = 4.0  # times an interval may reach farther than its covariance says
TOO_NEAR = 0.25  # deviations; points of a profile that are nearer say nothing of an interval


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Uncertainty of fitted parameters and the directions that the data leave open.

    sd_log (p,) with the prior, sd_log_data (p,) without; interval (p, 2) at 95 % in the
    parameter's unit, linearised: as the covariance alone says; bounds (p, 2); directions (p, p) in
    columns in ln p over the prior's deviation, with `information` (p,): squared signal-to-noise of
    one prior deviation along each.
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance_log: np.ndarray
    sd_log: np.ndarray
    sd_log_data: np.ndarray
    interval: np.ndarray
    linearised: np.ndarray
    bounds: np.ndarray
    directions: np.ndarray
    information: np.ndarray

    def fixed(self) -> np.ndarray:
        """For each direction: do the data fix it?"""
        return 1 / np.sqrt(1 + self.information) < IDENTIFIED

    def as_json(self, met: bool = True) -> dict:
        """Plain numbers under the names of the parameters; a fit that has not `met` its data does
        not know what they fix, only what they see."""
        seen = self.fixed()
        return {
            "sd_log": dict(zip(self.names, self.sd_log.tolist(), strict=True)),
            "sd_log_data_alone": {
                name: (float(sd) if np.isfinite(sd) else None)
                for name, sd in zip(self.names, self.sd_log_data, strict=True)
            },
            "interval_95": dict(zip(self.names, self.interval.tolist(), strict=True)),
            "interval_95_linearised": dict(zip(self.names, self.linearised.tolist(), strict=True)),
            "bounds": dict(zip(self.names, np.minimum(self.bounds, 1e300).tolist(), strict=True)),
            "correlation": _correlation(self.covariance_log).tolist(),
            "directions": [
                {
                    "weights": dict(zip(self.names, self.directions[:, k].tolist(), strict=True)),
                    "signal_to_noise": float(np.sqrt(self.information[k])),
                    "seen_by_data": bool(seen[k]),
                    "fixed_by_data": bool(seen[k]) and met,
                }
                for k in range(len(self.names))
            ],
        }


def assess(
    names: tuple[str, ...],
    values: np.ndarray,
    whitened_slopes: np.ndarray,
    prior_sd: np.ndarray,
    freedom: int,
    bounds: np.ndarray | None = None,
) -> Identifiability:
    """Identifiability at a fit; `freedom` are the degrees of freedom behind the noise, `bounds`
    (p, 2) what the parameters cannot leave (None: any positive number)."""
    scaled = whitened_slopes * prior_sd
    information, directions = np.linalg.eigh(scaled.T @ scaled)
    order = np.argsort(information)[::-1]
    information, directions = np.maximum(information[order], 0.0), directions[:, order]
    scale = np.outer(prior_sd, prior_sd)
    covariance = (directions / (1 + information)) @ directions.T * scale
    sd = np.sqrt(np.diag(covariance))
    reach = stdtrit(max(freedom, 1), 0.975) * sd
    bounds = np.tile([0.0, np.inf], (len(values), 1)) if bounds is None else bounds
    interval = _within(bounds, values[:, None] * np.exp(np.stack([-reach, reach], axis=1)))
    return Identifiability(
        names=names,
        values=values,
        covariance_log=covariance,
        sd_log=sd,
        sd_log_data=_data_alone(information, directions, prior_sd),
        interval=interval,
        linearised=interval,
        bounds=bounds,
        directions=directions,
        information=information,
    )


def by_profiles(
    found: Identifiability, profiles: Mapping[str, Sequence[Mapping]], floor: float
) -> Identifiability:
    """The same with intervals as wide as simulated profiles ask for.

    At the farthest simulated point of a side, s deviations away, the covariance says that the
    objective is s^2/2 above its `floor`.  Where it is less, d, that side's deviation is s/sqrt(2 d)
    of the covariance's, at most WIDEST times.
    """
    interval = found.interval.copy()
    for row, name in enumerate(found.names):
        value, sd = found.values[row], found.sd_log[row]
        for side, sign in enumerate((-1, 1)):
            farther = _farther(profiles.get(name, ()), value, sign * sd, floor)
            interval[row, side] = value * (interval[row, side] / value) ** farther
    return replace(found, interval=_within(found.bounds, interval))


def _farther(points: Sequence[Mapping], value: float, sd: float, floor: float) -> float:
    """How much farther than the covariance says one side of a profile reaches."""
    steps = {
        float(np.log(point["value"] / value) / sd): point["simulated"] - floor
        for point in points
        if not point["failure"]
    }
    farthest = max(steps, default=0.0)
    if farthest < TOO_NEAR:
        return 1.0
    rise = max(steps[farthest], 0.5 * (farthest / WIDEST) ** 2)
    return max(1.0, farthest / np.sqrt(2 * rise))


def _within(bounds: np.ndarray, interval: np.ndarray) -> np.ndarray:
    return np.clip(interval, bounds[:, :1], bounds[:, 1:])


class Choice(NamedTuple):
    """A parameter to free, its signal-to-noise, and others that would have served as well."""

    name: str
    signal_to_noise: float
    alike: tuple[str, ...]


def choose_free(
    names: tuple[str, ...], whitened_slopes: np.ndarray, prior_sd: np.ndarray, most: int
) -> list[Choice]:
    """Parameters that the data can fix together, best first.

    Greedy: the largest whitened slope times prior deviation, then the largest of what is
    left after projecting the chosen ones out, while it exceeds what `IDENTIFIED` asks for.  Of
    those that are ALIKE the one is taken of which least was known beforehand, so that errors of
    the slopes do not decide which it is.
    """
    remaining = whitened_slopes * prior_sd
    chosen: list[Choice] = []
    while len(chosen) < most:
        strength = np.linalg.norm(remaining, axis=0)
        fixed = 1 / np.sqrt(1 + strength**2) < IDENTIFIED
        alike = np.flatnonzero(fixed & (strength >= ALIKE * strength.max()))
        if not alike.size:
            break
        best = max(alike.tolist(), key=lambda i: (prior_sd[i], strength[i]))
        others = tuple(names[i] for i in alike if i != best)
        chosen.append(Choice(names[best], float(strength[best]), others))
        unit = remaining[:, best] / strength[best]
        remaining = remaining - np.outer(unit, unit @ remaining)
    return chosen


def strongest(names: tuple[str, ...], whitened_slopes: np.ndarray, prior_sd: np.ndarray) -> Choice:
    """The parameter that the data see best, and its signal-to-noise, however small."""
    strength = np.linalg.norm(whitened_slopes * prior_sd, axis=0)
    return Choice(names[int(np.argmax(strength))], float(strength.max()), ())


def _data_alone(information, directions, prior_sd) -> np.ndarray:
    seen = information > 1e-12 * max(information.max(), 1e-300)
    inverse = np.where(seen, 1 / np.where(seen, information, 1.0), 0.0)
    variance = (directions**2) @ inverse * prior_sd**2
    blind = (directions[:, ~seen] ** 2).sum(axis=1) > 1e-9
    return np.where(blind, np.inf, np.sqrt(variance))


def _correlation(covariance: np.ndarray) -> np.ndarray:
    sd = np.sqrt(np.diag(covariance))
    return covariance / np.outer(sd, sd)
