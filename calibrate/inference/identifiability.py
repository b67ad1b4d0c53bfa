"""What the data fix: undamped covariance, directions, and which parameters to free.

All of it in ln p.  With whitened slopes J (m, p) and the prior's standard deviations:

    covariance of the data alone      (J' J)^-1           (inf along directions J cannot see)
    covariance with the prior         (J' J + P^-1)^-1

The solver's damping never enters.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

IDENTIFIED = 0.5  # a direction counts as fixed if the data halve the prior's deviation


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Uncertainty of fitted parameters and the directions that the data leave open.

    sd_log (p,) with the prior, sd_log_data (p,) without; interval (p, 2) at 95 % in the
    parameter's unit; directions (p, p) in columns in ln p over the prior's deviation, with
    `information` (p,): squared signal-to-noise of one prior deviation along each.
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance_log: np.ndarray
    sd_log: np.ndarray
    sd_log_data: np.ndarray
    interval: np.ndarray
    directions: np.ndarray
    information: np.ndarray

    def fixed(self) -> np.ndarray:
        """For each direction: do the data fix it?"""
        return 1 / np.sqrt(1 + self.information) < IDENTIFIED

    def as_json(self) -> dict:
        """Plain numbers under the names of the parameters."""
        fixed = self.fixed()
        return {
            "sd_log": dict(zip(self.names, self.sd_log.tolist(), strict=True)),
            "sd_log_data_alone": {
                name: (float(sd) if np.isfinite(sd) else None)
                for name, sd in zip(self.names, self.sd_log_data, strict=True)
            },
            "interval_95": dict(zip(self.names, self.interval.tolist(), strict=True)),
            "correlation": _correlation(self.covariance_log).tolist(),
            "directions": [
                {
                    "weights": dict(zip(self.names, self.directions[:, k].tolist(), strict=True)),
                    "signal_to_noise": float(np.sqrt(self.information[k])),
                    "fixed_by_data": bool(fixed[k]),
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
) -> Identifiability:
    """Identifiability at a fit; `freedom` are the degrees of freedom behind the noise."""
    scaled = whitened_slopes * prior_sd
    information, directions = np.linalg.eigh(scaled.T @ scaled)
    order = np.argsort(information)[::-1]
    information, directions = np.maximum(information[order], 0.0), directions[:, order]
    scale = np.outer(prior_sd, prior_sd)
    covariance = (directions / (1 + information)) @ directions.T * scale
    sd = np.sqrt(np.diag(covariance))
    reach = stdtrit(max(freedom, 1), 0.975) * sd
    return Identifiability(
        names=names,
        values=values,
        covariance_log=covariance,
        sd_log=sd,
        sd_log_data=_data_alone(information, directions, prior_sd),
        interval=np.stack([values * np.exp(-reach), values * np.exp(reach)], axis=1),
        directions=directions,
        information=information,
    )


def choose_free(
    names: tuple[str, ...], whitened_slopes: np.ndarray, prior_sd: np.ndarray, most: int
) -> list[tuple[str, float]]:
    """Parameters that the data can fix together, best first, with their signal-to-noise.

    Greedy: the largest whitened slope times prior deviation, then the largest of what is
    left after projecting the chosen ones out, while it exceeds what `IDENTIFIED` asks for.
    """
    remaining = whitened_slopes * prior_sd
    chosen: list[tuple[str, float]] = []
    while len(chosen) < most:
        strength = np.linalg.norm(remaining, axis=0)
        best = int(np.argmax(strength))
        if 1 / np.sqrt(1 + strength[best] ** 2) >= IDENTIFIED:
            break
        chosen.append((names[best], float(strength[best])))
        unit = remaining[:, best] / strength[best]
        remaining = remaining - np.outer(unit, unit @ remaining)
    return chosen


def _data_alone(information, directions, prior_sd) -> np.ndarray:
    seen = information > 1e-12 * max(information.max(), 1e-300)
    inverse = np.where(seen, 1 / np.where(seen, information, 1.0), 0.0)
    variance = (directions**2) @ inverse * prior_sd**2
    blind = (directions[:, ~seen] ** 2).sum(axis=1) > 1e-9
    return np.where(blind, np.inf, np.sqrt(variance))


def _correlation(covariance: np.ndarray) -> np.ndarray:
    sd = np.sqrt(np.diag(covariance))
    return covariance / np.outer(sd, sd)
