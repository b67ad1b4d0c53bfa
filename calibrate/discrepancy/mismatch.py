"""What simulations are wrong by where nothing is hidden, learned from cases known to hide nothing.

Two simulators of one soil differ, and so do a simulator and a soil, even without any of the
effects of the library.  Reference cases of the same kind (other soils, other specimens, nothing
hidden) tell by how much: the mean of what the base fit leaves is a constant shift, and the leading
directions in which it varies from soil to soil, as many as predict left-out references best, become
further base coordinates, so that neither is taken for an effect.  The price is power along these
directions.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from calibrate.core.errors import InputError
from calibrate.core.files import write_json
from calibrate.discrepancy.comparison.evidence import log_base
from calibrate.discrepancy.comparison.fits import fitted_base
from calibrate.discrepancy.comparison.noise import packing_covariance
from calibrate.discrepancy.comparison.projection import project
from calibrate.discrepancy.comparison.reduction import hat_of
from calibrate.discrepancy.diagnosis import described
from calibrate.discrepancy.library.description import Discrepancy, Ready
from calibrate.io.lab import Lab

DIRECTIONS = 8  # at most; as many as predict left-out references best
FOLDS = 5  # in which references are left out
FEWEST = 6  # reference cases


@dataclass(frozen=True, eq=False)
class Left:
    """What a base fit leaves of a lab's warped features `known` (indices, k): `working` (k,),
    measured minus simulated plus B delta of the fit; B itself, slopes (k, p), with prior
    deviations (p,); covariance (k, k)."""

    known: np.ndarray
    working: np.ndarray
    slopes: np.ndarray
    prior_sd: np.ndarray
    covariance: np.ndarray

    @cached_property
    def _keep(self) -> np.ndarray:
        return np.eye(len(self.known)) - hat_of(self.slopes, self.prior_sd, self.covariance)

    def row(self, m: int) -> np.ndarray:
        """What is left of all m features, 0 where not measured."""
        row = np.zeros(m)
        row[self.known] = self._keep @ self.working
        return row

    def scatter(self, m: int) -> np.ndarray:
        """Covariance (m, m) of that which scatter of specimens explains."""
        scatter = np.zeros((m, m))
        scatter[np.ix_(self.known, self.known)] = self._keep @ self.covariance @ self._keep.T
        return scatter

    def predicted_by(self, found: Discrepancy) -> float:
        """ln density of this reference where a mismatch holds."""
        return log_base(
            project(
                self.working - found.mean[self.known],
                np.hstack([self.slopes, found.directions[self.known]]),
                np.concatenate([self.prior_sd, np.ones(found.directions.shape[1])]),
                np.zeros((len(self.known), 0)),
                self.covariance,
            )
        )


def learn(labs: Sequence[Lab], ready: Ready, seed: int, most: int = DIRECTIONS) -> Discrepancy:
    """The mismatch from at least `FEWEST` reference labs that have all of the bank's features."""
    found = [left for lab in labs if (left := left_by_fit(lab, ready, seed)) is not None]
    if len(found) < FEWEST:
        problem = f"only {len(found)} of {len(labs)} have whole curves of both tests"
        raise InputError("reference labs", "curves", problem, f"give at least {FEWEST} that do")
    return of_references(found, len(ready.bank.features), most)


def left_by_fit(lab: Lab, ready: Ready, seed: int) -> Left | None:
    """What a base fit, made as a diagnosis makes it, leaves of a lab; None if it lacks more than
    a few features.

    Fits are made without any shift: repeating them with the shift would let it run away along
    what base parameters can do as well.
    """
    lab_curves, d, measured = described(lab, ready, seed, baseline=False)
    chosen = lab_curves.chosen
    if len(chosen) < len(ready.bank.features) - 2:  # all but the two targets
        return None
    _, fit = fitted_base(d, measured, packing_covariance(d), 1.0)
    scale = ready.emulator.scale[chosen]
    steep = np.hypot(scale, fit.values)[:, None]
    residual = np.arcsinh(measured.mean / scale) - np.arcsinh(fit.values / scale)
    slopes = fit.base_slopes / steep
    covariance = fit.covariance / (steep * steep.T)
    return Left(chosen, residual + slopes @ fit.delta, slopes, d.prior_sd, covariance)


def of_references(found: Sequence[Left], m: int, most: int = DIRECTIONS) -> Discrepancy:
    """The mismatch of what fits leave of m features: the mean, and the leading directions in which
    it varies beyond what scatter explains.

    Left-out references tell how many: the fewest that predict them as well as the best number
    does, within one standard error of the difference (Breiman et al. 1984, Classification and
    regression trees, section 3.4.3).
    """
    by_number = np.array([_predicted(found, m, number) for number in range(most + 1)])
    behind = by_number[by_number.sum(axis=1).argmax()] - by_number
    enough = behind.sum(axis=1) <= np.sqrt(len(found)) * behind.std(axis=1)
    return _with_directions(found, m, int(np.argmax(enough)))


def _predicted(found: Sequence[Left], m: int, directions: int) -> np.ndarray:
    """ln density (n,) of each reference where it is left out with its fold."""
    density = np.zeros(len(found))
    for fold in range(FOLDS):
        others = [left for i, left in enumerate(found) if i % FOLDS != fold]
        learned = _with_directions(others, m, directions)
        density[fold::FOLDS] = [left.predicted_by(learned) for left in found[fold::FOLDS]]
    return density


def _with_directions(found: Sequence[Left], m: int, directions: int) -> Discrepancy:
    rows = np.array([left.row(m) for left in found])
    excess = np.cov(rows.T) - np.mean([left.scatter(m) for left in found], axis=0)
    values, axes = np.linalg.eigh(excess)
    kept = np.flatnonzero(values > 0)[::-1][:directions]
    return Discrepancy(rows.mean(axis=0), axes[:, kept] * np.sqrt(values[kept]))


def save(found: Discrepancy, path: Path, source: str) -> None:
    """Writes a mismatch as JSON."""
    parts = ("mean", "directions")
    content = {name: getattr(found, name).tolist() for name in parts}
    write_json(path, {"source": source, **content})


def load(path: Path, ready: Ready) -> Discrepancy:
    """Reads a mismatch for a bank; `InputError` for anything else."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        parts = (np.array(content[name], float) for name in ("mean", "directions"))
        found = Discrepancy(*parts)
    except (OSError, ValueError, KeyError, TypeError) as error:
        problem = f"no mismatch can be read ({type(error).__name__})"
        raise InputError(
            str(path), "", problem, "give a file that `calibrate mismatch` wrote"
        ) from None
    m = len(ready.bank.features)
    shapes = {found.mean.shape, found.directions.shape[:1]}
    if shapes != {(m,)} or found.directions.ndim != 2:
        problem = f"it is for {len(found.mean)} features, the bank has {m}"
        raise InputError(str(path), "mean", problem, "learn it again with this bank")
    return found
