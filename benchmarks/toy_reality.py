"""Laboratories whose truth is known: the toy soil measured, in two tiers.

    linear   features drawn from the exact slopes and the exact covariance of specimens
    curves   whole curves, away from the centre, specimens that scatter more and more
             smoothly than the simulated ones, noise, sampling and zero of an instrument

In both, the diagnosis knows sixty simulated specimens.  Signal-to-noise is projected, with the
generator's own slopes and the covariance of sixty specimens of its own: as well as any
diagnosis could know it that may simulate sixty.
"""

from dataclasses import dataclass

import numpy as np
import toy_bank as bank
import toy_soil as toy

from calibrate.diagnosis.features import CONFINED, tests_of, vector
from calibrate.diagnosis.noise import best_shape
from calibrate.diagnosis.projection import project
from calibrate.diagnosis.repeats import Measured, from_vectors
from calibrate.diagnosis.score import lengths

REPEATS = 4  # of each test, on specimens of its own
LARGEST = 4.0  # typical strengths, of any effect
REALITY_AMPLITUDE, REALITY_LENGTH = 1.25, 0.2  # simulated specimens: 1 and 0.15
REFERENCE_SPECIMENS = 600
STRATA = {"0.5-2": (0.5, 2.0), "2-6": (2.0, 6.0), "above 6": (6.0, 15.0)}
OUTSIDE_SNR = (3.0, 15.0)
FRESH = 10  # times eight specimens, against which a shrinkage is checked


@dataclass(frozen=True)
class Case:
    """One laboratory: kind (null, single, pair, outside), stratum, true effects with
    strengths and signal-to-noise, and what was measured."""

    kind: str
    stratum: str
    strengths: dict[str, float]
    snr: float
    delta: np.ndarray
    measured: Measured

    @property
    def truth(self) -> tuple[str, ...]:
        if self.kind == "null":
            return ("none",)
        return ("unknown",) if self.kind == "outside" else tuple(self.strengths)


def plan() -> np.ndarray:
    """Which specimen (s, m) has which feature: REPEATS of each test."""
    confined = tests_of(toy.FEATURES) == CONFINED
    return np.array([confined] * REPEATS + [~confined] * REPEATS)


class Reality:
    """Draws cases of one tier."""

    def __init__(self, tier: str, seed: int):
        self.tier, self.rng = tier, np.random.default_rng(seed)
        amplitude = REALITY_AMPLITUDE if tier == "curves" else 1.0
        self.shape = (amplitude, REALITY_LENGTH if tier == "curves" else toy.FIELD_LENGTH)
        bodies = [toy.specimen(self.rng, *self.shape) for _ in range(REFERENCE_SPECIMENS)]
        read = np.array(
            [
                vector(toy.FEATURES, toy.curves(toy.Soil(), body, bank.LABORATORY, self.rng))
                for body in bodies
            ]
        )
        few = read[: bank.SIMULATED] - read[: bank.SIMULATED].mean(axis=0)
        self.known = best_shape(few).of(few)
        self.mean, self.covariance = read.mean(axis=0), np.cov(read.T)
        self.covariance += 1e-9 * np.diag(np.diag(self.covariance))
        self.root = np.linalg.cholesky(self.covariance)

    def case(self, kind: str, stratum: str) -> Case:
        """One case; redrawn while the strength would be beyond LARGEST."""
        while True:
            delta = self.rng.standard_normal(bank.P) * np.array(list(toy.BASE.values()))
            if kind == "null":
                return Case(kind, "", {}, 0.0, delta, self._measured(delta, {}))
            names = list(toy.OUTSIDE) if kind == "outside" else [e.name for e in toy.EFFECTS]
            count = 2 if kind == "pair" else 1
            chosen = [str(n) for n in self.rng.choice(names, count, replace=False)]
            low, high = OUTSIDE_SNR if kind == "outside" else STRATA[stratum]
            snr = float(self.rng.uniform(low, high))
            strengths = self._strengths(delta, chosen, snr)
            if max(abs(e) for e in strengths.values()) <= LARGEST:
                measured = self._measured(delta, strengths)
                return Case(kind, stratum, strengths, snr, delta, measured)

    def fresh(self, case: Case) -> np.ndarray:
        """Features (n, m) of fresh specimens of a case's soil, or its mean in the linear tier."""
        if self.tier == "linear":
            return self._linear_mean(case.delta, case.strengths)[None, :]
        return np.vstack([self._curves(case.delta, case.strengths) for _ in range(FRESH)])

    def typical_snr(self) -> dict[str, tuple[float, float]]:
        """Signal-to-noise of each effect at typical strength at the centre: with the
        covariance of sixty specimens, and with that of all."""
        zero = np.zeros(bank.P)
        slopes = np.array([self._slope(zero, effect.name) for effect in toy.EFFECTS]).T
        found = [self._snr(zero, slopes, c) for c in (self.known, self.covariance)]
        return {
            effect.name: (float(few), float(every))
            for effect, few, every in zip(toy.EFFECTS, *found, strict=True)
        }

    def _snr(self, delta, slopes, specimen) -> np.ndarray:
        """Projected lengths (k,) of changes of features (m, k)."""
        base = np.array([self._base_slope(delta, i) for i in range(bank.P)]).T
        tests = tests_of(toy.FEATURES)
        covariance = specimen / REPEATS * (tests[:, None] == tests[None, :])
        prior = np.array(list(toy.BASE.values()))
        return lengths(project(np.zeros(len(base)), base, prior, slopes, covariance).effects)

    def _strengths(self, delta, chosen, snr) -> dict[str, float]:
        slopes = np.array([self._slope(delta, name) for name in chosen]).T
        two_sided = {e.name for e in toy.EFFECTS if not e.one_sided}
        sign = [self.rng.choice([-1, 1]) if n in two_sided else 1 for n in chosen]
        values = np.array(sign) * snr / self._snr(delta, slopes, self.known)
        return {n: float(v) for n, v in zip(chosen, values, strict=True)}

    def _measured(self, delta, strengths) -> Measured:
        specimens = (
            self._linear(delta, strengths)
            if self.tier == "linear"
            else self._curves(delta, strengths)
        )
        return from_vectors(toy.FEATURES, np.where(plan(), specimens, np.nan))

    def _curves(self, delta, strengths) -> np.ndarray:
        soil = toy.Soil(delta, strengths)
        return np.array(
            [
                vector(
                    toy.FEATURES,
                    toy.curves(
                        soil, toy.specimen(self.rng, *self.shape), bank.LABORATORY, self.rng
                    ),
                )
                for _ in range(2 * REPEATS)
            ]
        )

    def _linear(self, delta, strengths) -> np.ndarray:
        mean = self._linear_mean(delta, strengths)
        return mean + self.rng.standard_normal((2 * REPEATS, len(mean))) @ self.root.T

    def _linear_mean(self, delta, strengths) -> np.ndarray:
        zero = np.zeros(bank.P)
        base = np.array([self._base_slope(zero, i) for i in range(bank.P)]).T
        mean = self.mean + base @ delta
        for name, strength in strengths.items():
            mean = mean + strength * self._slope(zero, name)
        return mean

    def _slope(self, delta, name, step=0.25) -> np.ndarray:
        delta = np.zeros(bank.P) if self.tier == "linear" else delta
        return (_at(delta, {name: step}) - _at(delta, {name: -step})) / (2 * step)

    def _base_slope(self, delta, i, step=0.05) -> np.ndarray:
        delta = np.zeros(bank.P) if self.tier == "linear" else delta
        unit = step * np.eye(bank.P)[i]
        return (_at(delta + unit, {}) - _at(delta - unit, {})) / (2 * step)


def _at(delta, strengths) -> np.ndarray:
    soil = toy.Soil(delta, strengths)
    return vector(toy.FEATURES, toy.curves(soil, toy.MIDDLE, bank.FINE))
