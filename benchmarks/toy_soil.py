"""A soil of formulas that makes whole curves: reality and simulator of statistical benchmarks.

Both tests are written down with six base parameters, eleven effects of the library and four
gaps outside it, so that hundreds of laboratories cost seconds.  Nothing here is soil
mechanics; what matters is that curves bend, that effects resemble one another, that
specimens differ by smooth random curves, and that a laboratory chooses zero, sampling and
instrument.  Strength 0 of every effect is the base model.
"""

from dataclasses import dataclass, field
from functools import cache

import numpy as np

from calibrate.discrepancy.comparison.features import CONFINED, UNCONFINED, declare
from calibrate.discrepancy.comparison.linear import Effect

FORCE_HIGH = 400.0  # N
PEAK_MM, PEAK_N = 6.0, 200.0
FEATURES = declare(FORCE_HIGH, PEAK_MM, PEAK_N)
BASE = {  # prior deviation of ln p about a calibrated centre
    "shear_modulus": 0.2,
    "slope": 0.1,
    "plasticity_ratio": 0.15,
    "surface_energy": 0.2,
    "static_friction": 0.25,
    "rolling_friction": 0.25,
}
EFFECTS = (
    Effect("compliance", True, 1.0, "typical", "measuring"),
    Effect("seating", True, 1.0, "typical", "measuring"),
    Effect("wall friction", True, 1.0, "typical", "specimen"),
    Effect("platen friction", True, 1.0, "typical", "specimen"),
    Effect("strength factor", False, 1.0, "typical", "specimen"),
    Effect("rate", True, 1.0, "typical", "contact"),
    Effect("lag", True, 1.0, "typical", "measuring"),
    Effect("offset", False, 1.0, "typical", "measuring"),
    Effect("drift", False, 1.0, "typical", "measuring"),
    Effect("bonds", True, 1.0, "typical", "contact"),
    Effect("tension", True, 1.0, "typical", "contact"),
)
OUTSIDE = ("crushing", "trapped air", "gradient", "stick-slip")  # not in the library
SCATTER = {"stiff": 0.07, "recovery": 0.06, "strong": 0.08, "travel": 0.07, "toe": 0.15}
FIELD, FIELD_LENGTH = 0.03, 0.15  # smooth random part of a specimen's curves
ROUGH, ROUGH_LENGTH = 0.008, 0.03  # rearrangements: small and sudden
KNOTS = np.linspace(0.0, 2.2, 89)


@dataclass(frozen=True)
class Specimen:
    """What makes one specimen differ: deviations by name, and two fields on `KNOTS`."""

    deviation: dict[str, float]
    confined: np.ndarray
    unconfined: np.ndarray


@dataclass(frozen=True)
class Soil:
    """Shifts of the base parameters in ln p, strengths of effects by name (library or
    outside); missing means 0."""

    delta: np.ndarray = field(default_factory=lambda: np.zeros(len(BASE)))
    strength: dict[str, float] = field(default_factory=dict)

    def base(self) -> dict[str, float]:
        return dict(zip(BASE, np.exp(self.delta), strict=True))


@dataclass(frozen=True)
class Instrument:
    """Sampling interval of both tests (mm), noise of force (N) and displacement (mm)."""

    step_confined: float = 0.05
    step_unconfined: float = 0.05
    force_noise: float = 0.0
    displacement_noise: float = 0.0


def specimen(rng: np.random.Generator, amplitude: float = 1.0, length: float = FIELD_LENGTH):
    """A random specimen; amplitude scales all its deviations."""
    root = _root(length)
    confined, unconfined = amplitude * (root @ rng.standard_normal((len(KNOTS), 2))).T
    shared = 0.5 * rng.standard_normal()  # a dense specimen is stiff and strong
    deviation = {n: amplitude * s * rng.standard_normal() for n, s in SCATTER.items()}
    deviation["stiff"] += amplitude * SCATTER["stiff"] * shared
    deviation["strong"] += amplitude * SCATTER["strong"] * shared
    return Specimen(deviation, confined, unconfined)


@cache
def _root(length: float) -> np.ndarray:
    """Root of the covariance of a field on KNOTS."""
    apart = (KNOTS[:, None] - KNOTS) ** 2
    kernel = FIELD**2 * np.exp(-apart / (2 * length**2))
    kernel += ROUGH**2 * np.exp(-apart / (2 * ROUGH_LENGTH**2))
    return np.linalg.cholesky(kernel + 1e-9 * np.eye(len(KNOTS)))


MIDDLE = Specimen(dict.fromkeys(SCATTER, 0.0), np.zeros(len(KNOTS)), np.zeros(len(KNOTS)))


def curves(soil: Soil, body: Specimen, instrument: Instrument, rng=None) -> dict:
    """Both curves of one specimen as the laboratory records them."""
    return {
        CONFINED: _recorded(*confined(soil, body), instrument, instrument.step_confined, rng),
        UNCONFINED: _recorded(*unconfined(soil, body), instrument, instrument.step_unconfined, rng),
    }


def confined(soil: Soil, body: Specimen) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (mm) and force (N) of loading to FORCE_HIGH and back, finely sampled."""
    p, e = soil.base(), soil.strength.get
    dev = body.deviation
    share = np.linspace(0.0, 1.0, 300) ** 2
    whole = 7.2 * np.exp(-dev["stiff"]) / p["shear_modulus"]
    exponent = 0.8 * p["slope"]
    wavy = 1 + np.interp(share, KNOTS, body.confined)
    stiffer = 1 + 0.06 * e("bonds", 0.0) * np.exp(-((share / 0.25) ** 2))
    stiffer = stiffer - 0.10 * e("gradient", 0.0) * np.exp(-share / 0.15)
    late = 0.12 * e("crushing", 0.0) * np.maximum(share - 0.55, 0) ** 1.5
    air = 0.10 * e("trapped air", 0.0) * share**2.5
    toe = 0.15 * np.exp(dev["toe"]) * (1 - np.exp(-share / 0.02))
    up = whole * (share**exponent * wavy / stiffer + late - air * share) + toe
    up = up + 0.02 * e("stick-slip", 0.0) * whole * np.sin(40 * share) * share
    recovery = 0.27 * np.exp(dev["recovery"]) * p["plasticity_ratio"] ** -0.8
    down = up[-1] - whole * (recovery + 0.10 * e("trapped air", 0.0)) * (1 - share**0.55)
    down = down + whole * 0.3 * late[-1] * (1 - share)
    rate = 0.06 * e("rate", 0.0)
    friction = 0.10 * e("wall friction", 0.0)
    force_up = FORCE_HIGH * share
    up = up / (1 + rate + friction) ** (1 / exponent) * (1 + 0.3 * friction * share)
    nose = rate * 0.25 * whole * np.exp(-(1 - share) / 0.05)
    drop = 0.5 * friction * whole * recovery * np.exp(-(1 - share) / 0.12)
    shift = up[-1] - down[-1]
    down = down + shift + nose[-1] - 0.7 * (nose[-1] - nose) - 0.8 * (drop[-1] - drop)
    displacement = np.concatenate([up, [up[-1] + nose[-1]], down[::-1][1:]])
    force = np.concatenate([force_up, [FORCE_HIGH], force_up[::-1][1:]])
    return _lagged(*_measured_by(soil, displacement, force), e("lag", 0.0))


def unconfined(soil: Soil, body: Specimen) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (mm) and force (N) of crushing, finely sampled."""
    p, e = soil.base(), soil.strength.get
    dev = body.deviation
    peak = PEAK_N * np.exp(dev["strong"]) * p["surface_energy"] ** 0.9
    peak *= p["rolling_friction"] ** 0.4 * p["static_friction"] ** 0.15
    peak *= p["plasticity_ratio"] ** 0.5
    place = PEAK_MM * np.exp(dev["travel"]) * (peak / PEAK_N) ** 0.3
    place *= p["shear_modulus"] ** -0.3
    platen, bonds, tension = (
        e("platen friction", 0.0),
        e("bonds", 0.0),
        e("tension", 0.0),
    )
    peak *= 1 + 0.06 * platen + 0.05 * bonds - 0.04 * e("gradient", 0.0)
    place *= 1 + 0.08 * platen + 0.03 * tension
    x = np.linspace(0.0, 2.4 * PEAK_MM / place, 500)
    residual = np.clip(0.45 * p["rolling_friction"] ** 0.3 + 0.05 * tension, 0.05, 0.95)
    speed = 1.5 * p["static_friction"] ** -0.4
    speed *= (1 + 0.35 * bonds) / ((1 + 0.2 * tension) * (1 + 0.25 * platen))
    power = 2.2 * (1 + 0.12 * bonds)
    rising = 1 - np.abs(1 - np.minimum(x, 1.0)) ** power
    falling = residual + (1 - residual) / (1 + (speed * np.maximum(x - 1, 0)) ** 2)
    form = np.where(x < 1, rising, falling)
    form = form * (1 - 0.25 * e("gradient", 0.0) * np.exp(-x / 0.12) * np.minimum(x * 20, 1))
    form = form * (1 + 0.02 * e("stick-slip", 0.0) * np.sin(18 * x) * np.minimum(x, 1))
    form = form * (1 - 0.05 * e("crushing", 0.0) * np.exp(-(((x - 0.9) / 0.3) ** 2)))
    wavy = 1 + np.interp(x, KNOTS, body.unconfined)
    factor = np.exp(0.25 * e("strength factor", 0.0))
    force = peak * form * wavy * factor
    displacement = x * place + 0.1 * np.exp(dev["toe"]) * (1 - np.exp(-x / 0.03))
    force = force + 15.0 * e("drift", 0.0) * displacement / PEAK_MM * (x > 0)
    return _measured_by(soil, displacement, force)


def _measured_by(soil: Soil, displacement, force):
    """Compliance, seating and offset of the machine."""
    e = soil.strength.get
    true = np.maximum(force, 0.0)
    displacement = displacement + 0.15 * e("compliance", 0.0) * true / 200.0
    displacement = displacement + 0.25 * e("seating", 0.0) * (1 - np.exp(-true / 25.0))
    return displacement, force + 4.0 * e("offset", 0.0)


def _lagged(displacement, force, lag: float):
    """A first-order lag of force over path, of 0.12 mm at typical strength."""
    if lag == 0:
        return displacement, force
    rest = 60  # points recorded after the platen has stopped, in which the force catches up
    displacement = np.append(displacement, displacement[-1] - 1e-6 * np.arange(1, rest + 1))
    force = np.append(force, np.full(rest, force[-1]))
    path = np.concatenate([[0.0], np.cumsum(np.maximum(np.abs(np.diff(displacement)), 0.0))])
    path[-rest:] += 0.04 * np.arange(1, rest + 1)
    even = np.linspace(0.0, path[-1], 1200)
    length, level = 0.12 * abs(lag), np.interp(even, path, force)
    keep = np.exp(-(even[1] - even[0]) / length)
    slow = np.empty_like(level)
    slow[0] = level[0]
    for i in range(1, len(level)):
        slow[i] = keep * slow[i - 1] + (1 - keep) * level[i]
    late = np.interp(path, even, slow)
    return displacement, force + np.sign(lag) * (late - force)


def _recorded(displacement, force, instrument: Instrument, step: float, rng):
    """Samples every `step` mm of path, with noise and a zero of the operator's choice."""
    path = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(displacement)))])
    at = np.arange(0.0, path[-1], step)
    at = np.append(at, path[-1])
    x, f = np.interp(at, path, displacement), np.interp(at, path, force)
    if rng is None:
        return x, f
    lead = np.arange(-rng.integers(2, 12) * step, -0.5 * step, step)
    x, f = np.concatenate([x[0] + lead, x]), np.concatenate([np.full(len(lead), f[0]), f])
    x = x + rng.uniform(-3.0, 3.0) + instrument.displacement_noise * rng.standard_normal(len(x))
    return x, f + instrument.force_noise * rng.standard_normal(len(f))
