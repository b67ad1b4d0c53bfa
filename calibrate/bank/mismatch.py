"""What simulations are wrong by where nothing is hidden, learned from cases known to hide nothing.

Two simulators of one soil differ, and so do a simulator and a soil, even without any of the
effects of the library.  Reference cases of the same kind (other soils, other specimens, nothing
hidden) tell by how much: the mean of what the base fit leaves is a constant shift, and the leading
directions in which it varies from soil to soil become further base coordinates, so that neither
is taken for an effect.  The price is power along these directions.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibrate.bank.description import Discrepancy, Ready
from calibrate.diagnosed import described
from calibrate.diagnosis.fits import fitted_base
from calibrate.diagnosis.how_far import hat_of
from calibrate.diagnosis.noise import packing_covariance
from calibrate.errors import InputError
from calibrate.measurements import Lab
from calibrate.output import write_json

DIRECTIONS = 8  # at most; those in which references vary by more than scatter explains
FEWEST = 6  # reference cases


@dataclass(frozen=True, eq=False)
class Left:
    """What a base fit leaves of a lab's warped features (m,), and the covariance (m, m) of that
    which scatter of specimens explains."""

    row: np.ndarray
    scatter: np.ndarray


def learn(
    labs: Sequence[Lab], ready: Ready, seed: int, directions: int = DIRECTIONS
) -> Discrepancy:
    """The mismatch from at least `FEWEST` reference labs that have all of the bank's features."""
    found = [left for lab in labs if (left := left_by_fit(lab, ready, seed)) is not None]
    if len(found) < FEWEST:
        problem = f"only {len(found)} of {len(labs)} have whole curves of both tests"
        raise InputError("reference labs", "curves", problem, f"give at least {FEWEST} that do")
    return of_rows(found, directions)


def left_by_fit(lab: Lab, ready: Ready, seed: int) -> Left | None:
    """What a base fit, made as a diagnosis makes it, leaves of a lab; None if it lacks more than
    a few features.

    Fits are made without any shift: repeating them with the shift would let it run away along
    what base parameters can do as well.
    """
    m, scale = len(ready.bank.features), ready.emulator.scale
    lab_curves, d, measured = described(lab, ready, seed, baseline=False)
    chosen = lab_curves.chosen
    if len(chosen) < m - 2:  # all but the two targets
        return None
    _, fit = fitted_base(d, measured, packing_covariance(d), 1.0)
    noise = fit.covariance
    row, scatter = np.zeros(m), np.zeros((m, m))
    row[chosen] = np.arcsinh(measured.mean / scale[chosen]) - np.arcsinh(fit.values / scale[chosen])
    steep = np.sqrt(scale[chosen] ** 2 + fit.values**2)
    keep = (np.eye(len(chosen)) - hat_of(fit.base_slopes, d.prior_sd, noise)) / steep[:, None]
    scatter[np.ix_(chosen, chosen)] = keep @ noise @ keep.T
    return Left(row, scatter)


def of_rows(found: Sequence[Left], directions: int = DIRECTIONS) -> Discrepancy:
    """The mismatch of what fits leave: mean, leading directions, and the rest, each beyond what
    scatter explains."""
    rows = np.array([left.row for left in found])
    excess = np.cov(rows.T) - np.mean([left.scatter for left in found], axis=0)
    values, axes = (part[..., -directions:] for part in np.linalg.eigh(excess))
    lead = axes[:, values > 0] * np.sqrt(values[values > 0])
    rest = np.diag(excess) - (lead**2).sum(axis=1)
    return Discrepancy(rows.mean(axis=0), lead, np.sqrt(np.maximum(rest, 0.0)))


def save(found: Discrepancy, path: Path, source: str) -> None:
    """Writes a mismatch as JSON."""
    parts = ("mean", "directions", "rest")
    content = {name: getattr(found, name).tolist() for name in parts}
    write_json(path, {"source": source, **content})


def load(path: Path, ready: Ready) -> Discrepancy:
    """Reads a mismatch for a bank; `InputError` for anything else."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        parts = (np.array(content[name], float) for name in ("mean", "directions", "rest"))
        found = Discrepancy(*parts)
    except (OSError, ValueError, KeyError, TypeError) as error:
        problem = f"no mismatch can be read ({type(error).__name__})"
        raise InputError(
            str(path), "", problem, "give a file that `calibrate mismatch` wrote"
        ) from None
    m = len(ready.bank.features)
    shapes = {found.mean.shape, found.rest.shape, found.directions.shape[:1]}
    if shapes != {(m,)} or found.directions.ndim != 2:
        problem = f"it is for {len(found.mean)} features, the bank has {m}"
        raise InputError(str(path), "mean", problem, "learn it again with this bank")
    return found
