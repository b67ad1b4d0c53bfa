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

from calibrate.bank.description import Discrepancy, Ready
from calibrate.diagnosed import described
from calibrate.diagnosis.noise import estimate, packing_covariance
from calibrate.diagnosis.refit import refit
from calibrate.errors import InputError
from calibrate.measurements import Lab
from calibrate.output import write_json

DIRECTIONS = 3
FEWEST = 6  # reference cases


def learn(
    labs: Sequence[Lab], ready: Ready, seed: int, directions: int = DIRECTIONS
) -> Discrepancy:
    """The mismatch from at least `FEWEST` reference labs that have all of the bank's features."""
    rows = [row for lab in labs if (row := left_by_fit(lab, ready, seed)) is not None]
    if len(rows) < FEWEST:
        raise ValueError(f"{len(rows)} reference cases have all features, {FEWEST} are needed")
    return of_rows(np.array(rows), directions)


def left_by_fit(lab: Lab, ready: Ready, seed: int) -> np.ndarray | None:
    """What a base fit leaves (m,) of a lab's warped features; None if it lacks some.

    Fits are made without any shift: repeating them with the shift would let it run away along
    what base parameters can do as well.
    """
    m, scale = len(ready.bank.features), ready.emulator.scale
    lab_curves, d, measured = described(lab, ready, seed, baseline=False)
    chosen = lab_curves.chosen
    if len(chosen) < m - 2:  # all but the two targets
        return None
    noise = estimate(d, measured, packing_covariance(d), d.prior_sd**2)
    fit = refit(d, measured.mean, noise.mean)
    row = np.zeros(m)
    row[chosen] = np.arcsinh(measured.mean / scale[chosen]) - np.arcsinh(fit.values / scale[chosen])
    return row


def of_rows(rows: np.ndarray, directions: int = DIRECTIONS) -> Discrepancy:
    """The mismatch of what fits leave (cases, m): mean, leading directions, and the rest."""
    centred = rows - rows.mean(axis=0)
    freedom = len(rows) - 1
    _, values, axes = np.linalg.svd(centred, full_matrices=False)
    lead = (axes[:directions] * (values[:directions] / np.sqrt(freedom))[:, None]).T
    left = centred - centred @ axes[:directions].T @ axes[:directions]
    rest = np.sqrt((left**2).sum(axis=0) / max(freedom - directions, 1))
    return Discrepancy(rows.mean(axis=0), lead, rest)


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
