"""What a diagnosis knows of the toy soil: a description filled from simulated specimens.

Sixty specimens at the centre give mean and packing scatter; a quadratic in base parameters and
strengths, from differences of the specimen without deviations, is the emulator; what it
misses on fresh points is its tolerance.
"""

from dataclasses import dataclass, replace

import numpy as np
import toy_soil as toy

from calibrate.diagnosis.features import CONFINED, UNCONFINED, vector
from calibrate.diagnosis.linear import Linearised, simple
from calibrate.diagnosis.sensor import Channel, recording

SIMULATED = 60
STEP = np.array([0.5 * sd for sd in toy.BASE.values()] + [0.5] * len(toy.EFFECTS))
P = len(toy.BASE)
FINE = toy.Instrument(0.02, 0.02)
NOISE = (0.5, 0.004)  # N, mm
LABORATORY = toy.Instrument(0.15, 0.05, *NOISE)
CHECKS = 40


@dataclass(frozen=True, eq=False)
class Quadratic:
    """f(x) = f0 + a x + x'Q x/2 in x = (delta, strengths): value (m,), a (m, d), Q (m, d, d)."""

    value: np.ndarray
    slope: np.ndarray
    curvature: np.ndarray

    def __call__(self, delta: np.ndarray, strengths: np.ndarray):
        x = np.concatenate([delta, strengths])
        bend = self.curvature @ x
        slopes = self.slope + bend
        value = self.value + self.slope @ x + 0.5 * bend @ x
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
    """The description; linear: without the emulator's curvature."""
    rng = np.random.default_rng(seed)
    simulated = np.array(
        [
            vector(toy.FEATURES, toy.curves(toy.Soil(), toy.specimen(rng), FINE))
            for _ in range(SIMULATED)
        ]
    )
    quadratic = _quadratic(simulated.mean(axis=0))
    channels = {
        CONFINED: Channel(LABORATORY.step_confined, *NOISE),
        UNCONFINED: Channel(LABORATORY.step_unconfined, *NOISE),
    }
    typical = toy.curves(toy.Soil(), toy.MIDDLE, FINE)
    shift, sensor = recording(toy.FEATURES, typical, channels, rng)
    quadratic = replace(quadratic, value=quadratic.value + shift)
    base = {name: (quadratic.slope[:, i], sd) for i, (name, sd) in enumerate(toy.BASE.items())}
    effects = [(e, quadratic.slope[:, P + k]) for k, e in enumerate(toy.EFFECTS)]
    plain = simple(toy.FEATURES, quadratic.value, base, effects, simulated - simulated.mean(axis=0))
    if linear:
        return replace(plain, sensor=sensor)
    return replace(plain, sensor=sensor, emulator=quadratic, tolerance=_tolerance(quadratic, rng))


def _quadratic(mean: np.ndarray) -> Quadratic:
    """Central differences of value, slopes and curvatures at the centre."""
    d = len(STEP)
    unit = np.diag(STEP)
    centre = middle(np.zeros(d))
    plus = np.array([middle(u) for u in unit])
    minus = np.array([middle(-u) for u in unit])
    slope = ((plus - minus) / (2 * STEP[:, None])).T
    curvature = np.zeros((len(mean), d, d))
    for i in range(d):
        curvature[:, i, i] = (plus[i] - 2 * centre + minus[i]) / STEP[i] ** 2
        for j in range(i):
            both = middle(unit[i] + unit[j]) - plus[i] - plus[j] + centre
            curvature[:, i, j] = curvature[:, j, i] = both / (STEP[i] * STEP[j])
    return Quadratic(mean, slope, curvature)


def _tolerance(quadratic: Quadratic, rng: np.random.Generator) -> np.ndarray:
    """Median size (m,) of what the quadratic misses at points drawn from the prior, with one
    effect at up to twice its typical strength; sized as a normal deviation."""
    sd = np.array(list(toy.BASE.values()))
    missed = []
    origin = quadratic.value - middle(np.zeros(len(STEP)))
    for _ in range(CHECKS):
        x = np.concatenate([sd * rng.standard_normal(P), np.zeros(len(toy.EFFECTS))])
        x[P + rng.integers(len(toy.EFFECTS))] = rng.uniform(0, 2)
        missed.append(middle(x) + origin - quadratic(x[:P], x[P:])[0])
    return np.median(np.abs(missed), axis=0) / 0.6745
