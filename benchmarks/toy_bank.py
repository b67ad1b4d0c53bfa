"""What a diagnosis knows of the toy soil: a description filled from simulated specimens.

Sixty specimens at the centre give mean and packing scatter; splines along every base parameter and
strength, with mixed differences, of the specimen without deviations are the emulator; what
it misses on fresh points is its tolerance.
"""

from dataclasses import dataclass, replace

import numpy as np
import toy_soil as toy
from scipy.interpolate import CubicSpline

from calibrate.discrepancy.comparison.features import CONFINED, UNCONFINED, vector
from calibrate.discrepancy.comparison.linear import Linearised, simple
from calibrate.discrepancy.comparison.sensor import Channel, recording

SIMULATED = 60
SD = np.array(list(toy.BASE.values()))
P = len(toy.BASE)
STEP = np.concatenate([SD, np.ones(len(toy.EFFECTS))])  # of mixed differences
LOW = np.concatenate([-3 * SD, [-0.5 if e.one_sided else -4.5 for e in toy.EFFECTS]])
HIGH = np.concatenate([3 * SD, [4.5] * len(toy.EFFECTS)])
KNOTS = 11  # on each axis; LOW and HIGH put one at zero
FINE = toy.Instrument(0.02, 0.02)
NOISE = (0.5, 0.004)  # N, mm
LABORATORY = toy.Instrument(0.15, 0.05, *NOISE)
CHECKS = 40


@dataclass(frozen=True, eq=False)
class Bank:
    """f(x) = f0 + sum_i h_i(x_i) + sum_{i<j} Q_ij x_i x_j in x = (delta, strengths).

    Along each axis a cubic spline h_i through simulated points: knots (d, n) and coefficients
    (d, n - 1, 4, m); Q (m, d, d) symmetric with zero diagonal.
    """

    value: np.ndarray
    knots: np.ndarray
    pieces: np.ndarray
    cross: np.ndarray
    either: np.ndarray

    def wrong(self, delta: np.ndarray, strengths: np.ndarray) -> np.ndarray:
        """What machines of two kinds differ by, half of it, shape (m, 1)."""
        return self.either[:, None]

    def __call__(self, delta: np.ndarray, strengths: np.ndarray):
        x = np.clip(np.concatenate([delta, strengths]), LOW, HIGH)
        bend = self.cross @ x
        axis = np.arange(len(x))
        piece = (self.knots[:, 1:-1] <= x[:, None]).sum(axis=1)
        t = (x - self.knots[axis, piece])[:, None]
        a, b, c, d = self.pieces[axis, piece].swapaxes(0, 1)
        value = self.value + (((a * t + b) * t + c) * t + d).sum(axis=0) + 0.5 * bend @ x
        slopes = ((3 * a * t + 2 * b) * t + c).T + bend
        return value, slopes[:, :P], slopes[:, P:]


def soil_at(x: np.ndarray) -> toy.Soil:
    """The soil at x = (delta, strengths)."""
    names = [effect.name for effect in toy.EFFECTS]
    given = zip(names, x[P:], strict=True)
    return toy.Soil(x[:P], {n: float(e) for n, e in given if e})


def middle(x: np.ndarray) -> np.ndarray:
    """Features (m,) of the specimen without deviations."""
    return vector(toy.FEATURES, toy.curves(soil_at(x), toy.MIDDLE, FINE))


def description(seed: int, linear: bool = False) -> Linearised:
    """The description; linear: without the emulator."""
    rng = np.random.default_rng(seed)
    simulated = np.array(
        [
            vector(toy.FEATURES, toy.curves(toy.Soil(), toy.specimen(rng), FINE))
            for _ in range(SIMULATED)
        ]
    )
    bank = _bank(simulated.mean(axis=0))
    channels = {
        CONFINED: Channel(LABORATORY.step_confined, *NOISE),
        UNCONFINED: Channel(LABORATORY.step_unconfined, *NOISE),
    }
    typical = toy.curves(toy.Soil(), toy.MIDDLE, FINE)
    shift, sensor, either = recording(toy.FEATURES, typical, channels, rng)
    bank = replace(bank, value=bank.value + shift, either=either)
    _, slopes, strengths = bank(np.zeros(P), np.zeros(len(toy.EFFECTS)))
    base = {name: (slopes[:, i], sd) for i, (name, sd) in enumerate(toy.BASE.items())}
    effects = [(e, strengths[:, k]) for k, e in enumerate(toy.EFFECTS)]
    plain = simple(toy.FEATURES, bank.value, base, effects, simulated - simulated.mean(axis=0))
    if linear:
        return replace(plain, sensor=sensor, wrong=either[:, None])
    return replace(
        plain, sensor=sensor, wrong=either[:, None], emulator=bank, tolerance=_tolerance(bank, rng)
    )


def _bank(mean: np.ndarray) -> Bank:
    """Splines along the axes and mixed differences, from the specimen without deviations."""
    d = len(STEP)
    centre = middle(np.zeros(d))
    axes, ends = [], []
    for i in range(d):
        knots = np.linspace(LOW[i], HIGH[i], KNOTS)
        values = np.array([middle(t * np.eye(d)[i]) for t in knots]) - centre
        axes.append(CubicSpline(knots, values))
        ends.append(axes[i](STEP[i]))
    cross = np.zeros((len(mean), d, d))
    for i in range(d):
        for j in range(i):
            both = middle(STEP[i] * np.eye(d)[i] + STEP[j] * np.eye(d)[j]) - centre
            mixed = (both - ends[i] - ends[j]) / (STEP[i] * STEP[j])
            cross[:, i, j] = cross[:, j, i] = mixed
    knots = np.array([axis.x for axis in axes])
    pieces = np.array([axis.c.transpose(1, 0, 2) for axis in axes])
    return Bank(mean, knots, pieces, cross, np.zeros(len(mean)))


def _tolerance(bank: Bank, rng: np.random.Generator) -> np.ndarray:
    """Median size (m,) of what the bank misses at points drawn from the prior, with one effect
    at up to three typical strengths; sized as a normal deviation."""
    sd = np.array(list(toy.BASE.values()))
    missed = []
    origin = bank.value - middle(np.zeros(len(STEP)))
    for _ in range(CHECKS):
        x = np.concatenate([sd * rng.standard_normal(P), np.zeros(len(toy.EFFECTS))])
        x[P + rng.integers(len(toy.EFFECTS))] = rng.uniform(0, 3)
        missed.append(middle(x) + origin - bank(x[:P], x[P:])[0])
    return np.median(np.abs(missed), axis=0) / 0.6745
