"""What stated probabilities turned out to be worth, and how they are bent to it.

    ln p'(class) = b ln p(class) + a(kind)     then scaled to 1;  kinds: none, unknown, single, pair

Rehearsed cases come from the bank, so they have no faults of the bank and no effect that looks
otherwise than the bank expects; an opinion fitted to them is too sure, and takes too much for two
effects.  b and the a (that of singles is 0) are fitted by their logarithmic score, with a
pull to 1 and 0, to verdicts on withheld cases whose seal has been opened
(`benchmarks/tempering.py`); a fresh set must show whether they hold.  Temperature and bias
scaling: Guo et al. 2017, On Calibration of Modern Neural Networks.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from functools import cache
from importlib import resources

import numpy as np
from scipy.optimize import minimize

from calibrate.diagnosis.classes import TOGETHER
from calibrate.diagnosis.opinion import NONE, UNKNOWN

LEARNED = "tempering.json"  # beside this file
LEAST = 1e-9  # probability; logarithms end there
PULL_SD = 0.3  # of ln b and of the a; predicted left-out cases better than 1
ODD = 1e-6  # what a case may be without having been foreseen


@dataclass(frozen=True)
class Tempering:
    """The b of all classes and the a of three kinds; as it is, nothing changes."""

    power: float = 1.0
    none: float = 0.0
    unknown: float = 0.0
    pair: float = 0.0

    def of(self, by_class: Mapping[str, float]) -> dict[str, float]:
        """Probabilities by class, tempered."""
        plain = np.log(np.maximum(list(by_class.values()), LEAST))
        score = self.power * plain + np.array([self._odds(name) for name in by_class])
        values = np.exp(score - np.logaddexp.reduce(score))
        return dict(zip(by_class, values.tolist(), strict=True))

    def _odds(self, name: str) -> float:
        if TOGETHER in name:
            return self.pair
        return {NONE: self.none, UNKNOWN: self.unknown}.get(name, 0.0)


AS_STATED = Tempering()  # nothing bent


def fitted_tempering(stated: Sequence[Mapping[str, float]], truths: Sequence[str]) -> Tempering:
    """The one with the best logarithmic score: what was stated by class, and the right class, of
    each case."""

    def loss(numbers: np.ndarray) -> float:
        bent = _from(numbers)
        said = np.array([bent.of(p).get(t, 0.0) for p, t in zip(stated, truths, strict=True)])
        pull = 0.5 * numbers @ numbers / PULL_SD**2
        return float(pull - np.log(ODD + (1 - ODD) * said).sum())

    return _from(minimize(loss, np.zeros(len(astuple(AS_STATED))), method="BFGS").x)


def _from(numbers: np.ndarray) -> Tempering:
    """From ln b and the a."""
    return Tempering(float(np.exp(numbers[0])), *(float(a) for a in numbers[1:]))


@cache
def learned_tempering() -> Tempering:
    """The one that comes with the package."""
    text = (resources.files("calibrate.diagnosis") / LEARNED).read_text()
    return Tempering(**json.loads(text)["tempering"])
