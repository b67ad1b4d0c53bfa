"""The model discrepancy: what simulations are wrong by although no effect is at work.

Two simulators of one soil differ, and so do a simulator and a soil, even without any effect
(Kennedy and O'Hagan 2001).  It is estimated from reference labs (other soils, nothing hidden): the
mean of what the base fit leaves is a constant shift; the leading directions in which it varies from
soil to soil, as many as cross-validation supports, become further base coordinates.
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
from calibrate.discrepancy.library.description import EmulatedLibrary, ModelDiscrepancy
from calibrate.io.lab import Lab
from calibrate.labtests.diagnosis.curves import declare_targets

DIRECTIONS = 8  # at most; as many as cross-validation supports
FOLDS = 5  # of the cross-validation
FEWEST = 6  # reference cases
LACKING = 3  # features that one of them may lack, beside the targets
TARGETS = len(declare_targets())


@dataclass(frozen=True, eq=False)
class BaseFitResidual:
    """What a base fit leaves of a lab's warped features `measured` (indices, k): `working` (k,),
    measured minus simulated plus B delta of the fit; B itself, slopes (k, p), with prior
    deviations (p,); covariance (k, k)."""

    measured: np.ndarray
    working: np.ndarray
    slopes: np.ndarray
    prior_sd: np.ndarray
    covariance: np.ndarray

    @cached_property
    def _keep(self) -> np.ndarray:
        return np.eye(len(self.measured)) - hat_of(self.slopes, self.prior_sd, self.covariance)

    def row(self, m: int) -> np.ndarray:
        """What is left of all m features, NaN where not measured."""
        row = np.full(m, np.nan)
        row[self.measured] = self._keep @ self.working
        return row

    def scatter(self, m: int) -> np.ndarray:
        """Covariance (m, m) of that which scatter of specimens explains."""
        scatter = np.zeros((m, m))
        scatter[np.ix_(self.measured, self.measured)] = self._keep @ self.covariance @ self._keep.T
        return scatter

    def predicted_by(self, found: ModelDiscrepancy) -> float:
        """ln density of this reference under a model discrepancy."""
        left, none = self.working - found.mean[self.measured], np.zeros((len(self.measured), 0))
        slopes = np.hstack([self.slopes, found.directions[self.measured]])
        prior = np.append(self.prior_sd, np.ones(found.directions.shape[1]))
        return log_base(project(left, slopes, prior, none, self.covariance))


def estimate(
    labs: Sequence[Lab], emulated: EmulatedLibrary, seed: int, most: int = DIRECTIONS
) -> ModelDiscrepancy:
    """The model discrepancy from at least `FEWEST` labs with nearly all features of the library."""
    found = [left for lab in labs if (left := base_fit_residual(lab, emulated, seed)) is not None]
    if len(found) < FEWEST:
        problem = f"only {len(found)} of {len(labs)} have whole curves of both tests"
        raise InputError("reference labs", "curves", problem, f"give at least {FEWEST} that do")
    return of_references(found, len(emulated.library.features), most)


def base_fit_residual(lab: Lab, emulated: EmulatedLibrary, seed: int) -> BaseFitResidual | None:
    """What a base fit leaves of a lab; None if it lacks more than a few features.  Made without any
    shift, which would else run away along what base parameters can do as well."""
    lab_curves, d, measured = described(lab, emulated, seed, before_contact=False)
    chosen = lab_curves.chosen
    if len(chosen) < len(emulated.library.features) - TARGETS - LACKING:
        return None
    _, fit = fitted_base(d, measured, packing_covariance(d), 1.0)
    scale = (emulated.library.scale() * emulated.for_lab(lab).units)[chosen]
    steep = np.hypot(scale, fit.values)[:, None]
    residual = np.arcsinh(measured.mean / scale) - np.arcsinh(fit.values / scale)
    slopes = fit.base_slopes / steep
    covariance = fit.covariance / (steep * steep.T)
    return BaseFitResidual(chosen, residual + slopes @ fit.delta, slopes, d.prior_sd, covariance)


def of_references(
    found: Sequence[BaseFitResidual], m: int, most: int = DIRECTIONS
) -> ModelDiscrepancy:
    """The model discrepancy of what fits leave of m features: the mean, and the leading directions
    in which it varies beyond what scatter explains, the fewest that predict held-out labs as well
    as the best number does, within one standard error of the difference (Breiman et al. 1984,
    Classification and regression trees, section 3.4.3)."""
    by_number = np.array([_predicted(found, m, number) for number in range(most + 1)])
    behind = by_number[by_number.sum(axis=1).argmax()] - by_number
    enough = behind.sum(axis=1) <= np.sqrt(len(found)) * behind.std(axis=1)
    return _with_directions(found, m, int(np.argmax(enough)))


def _predicted(found: Sequence[BaseFitResidual], m: int, directions: int) -> np.ndarray:
    """ln density (n,) of each reference where its fold is held out."""
    density = np.zeros(len(found))
    for fold in range(FOLDS):
        others = [left for i, left in enumerate(found) if i % FOLDS != fold]
        fitted = _with_directions(others, m, directions)
        density[fold::FOLDS] = [left.predicted_by(fitted) for left in found[fold::FOLDS]]
    return density


def _with_directions(found: Sequence[BaseFitResidual], m: int, directions: int) -> ModelDiscrepancy:
    rows = _filled(np.array([left.row(m) for left in found]))
    excess = np.cov(rows.T) - np.mean([left.scatter(m) for left in found], axis=0)
    values, axes = np.linalg.eigh(excess)
    kept = np.flatnonzero(values > 0)[::-1][:directions]
    return ModelDiscrepancy(rows.mean(axis=0), axes[:, kept] * np.sqrt(values[kept]))


def _filled(rows: np.ndarray) -> np.ndarray:
    """Rows (n, m) with the mean of the others where one lacks a feature; 0 where all do."""
    some = np.isfinite(rows)
    mean = np.where(some, rows, 0.0).sum(axis=0) / np.maximum(some.sum(axis=0), 1)
    return np.where(some, rows, mean)


def save(found: ModelDiscrepancy, path: Path, source: str) -> None:
    """Writes a model discrepancy as JSON."""
    parts = {name: part.tolist() for name, part in vars(found).items()}
    write_json(path, {"source": source, **parts})


def load(path: Path, emulated: EmulatedLibrary) -> ModelDiscrepancy:
    """Reads a model discrepancy for a library; `InputError` for anything else."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        parts = (np.array(content[name], float) for name in ("mean", "directions"))
        found = ModelDiscrepancy(*parts)
    except (OSError, ValueError, KeyError, TypeError) as error:
        problem = f"no model discrepancy can be read ({type(error).__name__})"
        raise InputError(
            str(path), "", problem, "give a file that `calibrate discrepancy` wrote"
        ) from None
    m = len(emulated.library.features)
    shapes = {found.mean.shape, found.directions.shape[:1]}
    if shapes != {(m,)} or found.directions.ndim != 2:
        problem = f"it is for {len(found.mean)} features, the library has {m}"
        raise InputError(str(path), "mean", problem, "learn it again with this library")
    return found
