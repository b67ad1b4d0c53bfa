"""What simulations are wrong by where nothing is hidden, learned from cases known to hide nothing.

Two simulators of one soil differ, and so do a simulator and a soil, even without any of the
effects of the library.  Reference cases of the same kind (other soils, other specimens, nothing
hidden) tell by how much: the mean of what the base fit leaves is a constant shift, and the leading
directions in which it varies from soil to soil become further base coordinates, so that neither
is taken for an effect.  The price is power along these directions.
"""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibrate.bank.description import Discrepancy, Ready, first_covariance
from calibrate.diagnosed import described
from calibrate.diagnosis.refit import refit
from calibrate.errors import InputError
from calibrate.measurements import Lab
from calibrate.output import write_json

DIRECTIONS = 3
FEWEST = 6  # reference cases
LEAST_SHARE = 0.25  # of a direction's variance that counts as mismatch, beside scatter
ROUNDS = 3  # the shift changes the fits, the fits the shift


def learn(labs: Sequence[Lab], ready: Ready, seed: int, directions: int = DIRECTIONS) -> Discrepancy:
    """The mismatch from at least `FEWEST` reference labs that have all of the bank's features."""
    m = len(ready.bank.features)
    found = Discrepancy(np.zeros(m), np.zeros((m, 0)))
    for _ in range(ROUNDS):
        left, noise = _left(labs, ready, seed, found)
        if len(left) < FEWEST:
            raise ValueError(f"{len(left)} reference cases have all features, {FEWEST} are needed")
        found = Discrepancy(found.mean + left.mean(axis=0), np.zeros((m, 0)))
    centred = left - left.mean(axis=0)
    return Discrepancy(found.mean, _directions(centred, noise, directions))


def _left(labs: Sequence[Lab], ready: Ready, seed: int, so_far: Discrepancy):
    """What base fits leave (cases, m), and the mean covariance (m, m) that scatter explains."""
    rows, noise = [], []
    m = len(ready.bank.features)
    for lab in labs:
        lab_curves, d, measured = described(lab, ready, seed, so_far, baseline=False)
        chosen = lab_curves.chosen
        if len(chosen) < m - 2:  # all but the two targets
            continue
        covariance = first_covariance(d) / measured.counts.mean()
        fit = refit(d, measured.mean, covariance)
        row, whole = np.zeros(m), np.zeros((m, m))
        row[chosen] = measured.mean - fit.values
        whole[np.ix_(chosen, chosen)] = covariance
        rows.append(row)
        noise.append(whole)
    return np.array(rows), np.mean(noise, axis=0) if noise else np.zeros((m, m))


def _directions(centred: np.ndarray, noise: np.ndarray, count: int) -> np.ndarray:
    """Leading directions (m, count), one standard deviation each."""
    scale = np.sqrt(np.maximum(np.diag(noise), 1e-12))
    _, values, axes = np.linalg.svd(centred / scale, full_matrices=False)
    variance = values[:count] ** 2 / max(len(centred) - 1, 1)
    by_scatter = np.einsum("im,mn,in->i", axes[:count] / scale, noise, axes[:count] / scale)
    beyond = np.maximum(variance - by_scatter, LEAST_SHARE * variance)
    return (axes[:count] * np.sqrt(beyond)[:, None] * scale).T


def save(found: Discrepancy, path: Path, source: str) -> None:
    """Writes a mismatch as JSON."""
    content = {"mean": found.mean.tolist(), "directions": found.directions.tolist()}
    write_json(path, {"source": source, **content})


def load(path: Path, ready: Ready) -> Discrepancy:
    """Reads a mismatch for a bank; `InputError` for anything else."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        found = Discrepancy(np.array(content["mean"], float), np.array(content["directions"], float))
    except (OSError, ValueError, KeyError, TypeError) as error:
        problem = f"no mismatch can be read ({type(error).__name__})"
        raise InputError(str(path), "", problem, "give a file that `calibrate mismatch` wrote") from None
    m = len(ready.bank.features)
    if found.mean.shape != (m,) or found.directions.ndim != 2 or len(found.directions) != m:
        problem = f"it is for {len(found.mean)} features, the bank has {m}"
        raise InputError(str(path), "mean", problem, "learn it again with this bank")
    return found
