"""What stated probabilities turned out to be worth, and how they are bent to it.

    ln p'(class) = b ln p(class), then scaled to 1

Rehearsed cases come from the bank, so they have no faults of the bank and no effect that looks
otherwise than the bank expects; an opinion fitted to them is too sure.  b is fitted by its
logarithmic score to verdicts on withheld cases whose seal has been opened
(`benchmarks/tempering.py`); a fresh set must show whether it holds.  Likelier explanations stay
likelier.  Temperature scaling: Guo et al. 2017, On Calibration of Modern Neural Networks.
"""

import json
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources

import numpy as np
from scipy.optimize import minimize_scalar

LEARNED = "tempering.json"  # beside this file
LEAST = 1e-9  # probability; logarithms end there
ODD = 1e-6  # what a case may be without having been foreseen
POWERS = (0.1, 3.0)


def tempered(by_class: Mapping[str, float], power: float) -> dict[str, float]:
    """Probabilities by class, tempered with b = `power`."""
    score = power * np.log(np.maximum(list(by_class.values()), LEAST))
    values = np.exp(score - np.logaddexp.reduce(score))
    return dict(zip(by_class, values.tolist(), strict=True))


def fitted_power(stated: Sequence[Mapping[str, float]], truths: Sequence[str]) -> float:
    """The b with the best logarithmic score: what was stated by class, and the right class, of
    each case."""

    def loss(power: float) -> float:
        said = [tempered(p, power).get(t, 0.0) for p, t in zip(stated, truths, strict=True)]
        return -float(np.log(ODD + (1 - ODD) * np.array(said)).sum())

    return float(minimize_scalar(loss, bounds=POWERS, method="bounded").x)  # pyright: ignore


@cache
def learned_power() -> float:
    """The one that comes with the package."""
    text = (resources.files("calibrate.diagnosis") / LEARNED).read_text()
    return float(json.loads(text)["power"])
