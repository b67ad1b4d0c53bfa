"""A bank as `discrepancy.comparison` sees it: mean, slopes and scatter around one lab's soil.

    delta   base coordinates from the lab's own starting soil, with its prior
    e       strengths in typical ones

The description is linear about the best fit of the base coordinates to the measured means, and
keeps the emulator for what is not linear.  Simulated scatter is carried to the soil at hand as the
emulator warps features: large forces scatter in proportion.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibrate.discrepancy.comparison.linear import Effect, Linearised
from calibrate.discrepancy.comparison.refit import refit
from calibrate.discrepancy.library.cross_validation import Missed
from calibrate.discrepancy.library.design import SHARP, Design
from calibrate.discrepancy.library.emulator import FeatureEmulator, fit_emulator
from calibrate.discrepancy.library.load_cell_lag import LAG, Late
from calibrate.discrepancy.library.store import Bank, Rows, limits
from calibrate.io.lab import Lab
from calibrate.io.soil import base_soil
from jdem.effects.composite import EFFECTS

SETTING_PRIOR_MEAN = (SHARP[0], 0.0, 0.15)  # soil has no roundings and more particles
SETTING_PRIOR_SD = (0.1, 0.2, 0.3)
MOISTURE_SD = 0.03  # of stiffness and surface energy from specimen to specimen
DENSITY_SD = 0.004  # of density, where the lab does not say
TWO_SIDED = ("platen_friction",)  # may be smoother than assumed, though its docstring says >= 0
MEASURING = ("load_frame_compliance", "seating_gap", "load_cell_gain", "load_cell_offset",
             "load_cell_drift", "acquisition_lag")  # fmt: skip
CERTAIN = 10**9  # packings; the emulator states its errors itself
SPECIMEN = ("specimen_density", "second_test_factor")


@dataclass(frozen=True, eq=False)
class Point:
    """Where a lab's soil lies in a bank: offset (p,) of the prior's mean, prior_sd (p,)."""

    offset: np.ndarray
    prior_sd: np.ndarray


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """What simulations of this kind are known to be wrong by, where nothing is hidden: mean (m,)
    and directions (m, q), one standard deviation each; in a bank's features, warped as its
    emulator warps them."""

    mean: np.ndarray
    directions: np.ndarray


@dataclass(frozen=True, eq=False)
class Ready:
    """A bank with its emulator, residuals of one row a packing, and how certain values are."""

    bank: Bank
    emulator: FeatureEmulator

    @staticmethod
    def of(bank: Bank) -> "Ready":
        return Ready(bank, bank.emulator())

    def joined(self, rows: Rows, own: Bank) -> "Ready":
        """With further simulations behind the rows of the bank's `own`, near which its errors are
        taken for as wide as left-out packings have shown: their noise counts by that much less,
        as errors are widened afterwards (`AtSoil.wrong`)."""
        emulator, missed = self.emulator, self.missed
        bank = self.bank.joined(rows)
        if self.bank.late is not None:
            behind = bank.late_by(emulator)[len(self.bank.late) :]
            bank = replace(bank, late=np.vstack([self.bank.late, behind]))
        noise = np.ones((len(bank.values), len(emulator.components)))
        noise[len(own.values) :] = missed.scatter / missed.widening
        fitted = fit_emulator(
            *bank.scaled(), bank.packing, bank.in_time, bank.scale(), bank.kernels, emulator.basis,
            noise,
        )  # fmt: skip
        return Ready(bank, fitted)

    @cached_property
    def specimens(self) -> np.ndarray:
        """Warped residuals (packings, m) of independent specimens: one row of each packing."""
        _, first = np.unique(self.bank.packing, return_index=True)
        return self.emulator.rescaled(self.emulator.residuals[first], self.missed.scatter)

    @property
    def missed(self) -> Missed:
        """What the bank knows that its emulator misses."""
        known = len(self.emulator.components), len(self.bank.features)
        return self.bank.missed or Missed.nothing(*known)

    def at(self, point: Point) -> "AtSoil":
        """The emulator in the coordinates of a diagnosis."""
        design = self.bank.design
        return AtSoil(
            self.emulator, point.offset, design.spread(), design.typical() / limits(design),
            self.missed, self.bank.reader() if self.bank.late is not None else None, _lag(design),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class AtSoil:
    """`linear.Emulator` about a lab's soil: values (m,), slopes (m, p) per delta, (m, k) per
    typical strength; with a discrepancy, its directions are further base coordinates.
    `missed` is what its errors are beyond what it states, as left-out packings have shown; `late`
    turns what it says of readings in time to late ones, lag (k,) being seconds per typical
    strength."""

    emulator: FeatureEmulator
    offset: np.ndarray
    scale: np.ndarray
    strength: np.ndarray
    missed: Missed
    late: Late | None
    lag: np.ndarray
    discrepancy: Discrepancy | None = None

    def __call__(self, delta, strengths):
        x, s = self._scaled(delta, strengths)
        values, base, effects = self.emulator(x, s)
        found = values, base / self.scale, effects * self.strength
        if self.discrepancy is not None:
            found = self._shifted(self.discrepancy, delta[len(self.offset) :], *found)
        return self._read(self.late, strengths, *found) if self.late else found

    def wrong(self, delta, strengths):
        """Directions (m, c) in which the emulator may be wrong at a point."""
        x, s = self._scaled(delta, strengths)
        stated = self.emulator.error_directions(x, s) * np.sqrt(self.missed.widening)
        roots = np.hstack([stated, self.missed.along(s)])
        return self.emulator.steepness(x, s)[:, None] * roots

    def _scaled(self, delta, strengths):
        return (self.offset + delta[: len(self.offset)]) / self.scale, strengths * self.strength

    def _read(self, late: Late, strengths, values, base, effects):
        """The same as a machine reads it."""
        slopes = np.hstack([base, effects])
        values, slopes, along = late.read(values, slopes, float(self.lag @ strengths))
        base, effects = np.split(slopes, [base.shape[1]], axis=1)
        return values, base, effects + along[:, None] * self.lag

    def _shifted(self, wrong: Discrepancy, share, values, base, effects):
        """The same with the discrepancy added to the warped features."""
        scale = self.emulator.scale
        before = values / scale
        warped = np.arcsinh(before) + wrong.mean + wrong.directions @ share
        steep = np.cosh(warped)
        turned = (steep / np.sqrt(1 + before**2))[:, None]
        base = np.hstack([base * turned, (scale * steep)[:, None] * wrong.directions])
        return scale * np.sinh(warped), base, effects * turned


def _lag(design: Design) -> np.ndarray:
    """How late readings are (k,), s per typical strength."""
    return np.where(np.array(design.effect_names) == LAG, design.typical(), 0.0)


def candidates(bank: Bank) -> tuple[Effect, ...]:
    """The library of a bank, with typical strengths in SI."""
    rows = zip(bank.design.effect_names, bank.design.typical(), limits(bank.design), strict=True)
    return tuple(
        Effect(n, EFFECTS[n].about.one_sided and n not in TWO_SIDED, float(t),
               EFFECTS[n].about.unit, _kind(n), float(largest / t))
        for n, t, largest in rows
    )  # fmt: skip


def _kind(name: str) -> str:
    if name in MEASURING:
        return "measuring"
    return "specimen" if name in SPECIMEN else "contact"


def point_of(bank: Bank, soil: dict[str, float], soil_sd: dict[str, float] | None = None) -> Point:
    """The prior about a soil (SI values by name); soil_sd: deviations of ln p where they differ."""
    design, given = bank.design, soil_sd or {}
    names = design.soil_names
    offset = [np.log(soil[name] / design.centre[name]) for name in names]
    spread = [given.get(name, design.soil_sd[name]) for name in names]
    return Point(np.array([*offset, *SETTING_PRIOR_MEAN]), np.array([*spread, *SETTING_PRIOR_SD]))


def point_for(lab: Lab, bank: Bank) -> Point:
    """The prior about a lab's own starting soil, with the deviations that it states."""
    soil, names = base_soil(lab), bank.design.soil_names
    stated = {n: c.prior_sd for n, c in lab.parameters.items() if c.prior_sd is not None}
    values = {name: float(getattr(soil, name)) for name in names}
    return point_of(bank, values, {n: s for n, s in stated.items() if n in names})


def describe(
    ready: Ready,
    point: Point,
    measured: np.ndarray,
    chosen: np.ndarray,
    density_sd: float = DENSITY_SD,
    discrepancy: Discrepancy | None = None,
) -> Linearised:
    """The description for measured means (m_chosen,) of the bank's features `chosen` (indices).

    Sensor terms are left at zero for the caller to add.
    """
    d = _rough(ready, point, discrepancy)
    d = _local(ready, d, np.zeros(d.base_slopes.shape[1]), density_sd, point)
    for _ in range(2):  # scatter depends on the fit, the fit on scatter
        few = d.only_features(chosen)
        covariance = first_covariance(few)
        fit = refit(few, measured, covariance)
        d = _local(ready, d, fit.delta, density_sd, point)
    return d.only_features(chosen)


def _rough(ready: Ready, point: Point, discrepancy: Discrepancy | None) -> Linearised:
    """The frame of a description; everything that depends on the point is filled by `_local`."""
    bank, emulator = ready.bank, ready.at(point)
    names, prior = bank.design.base_names, point.prior_sd
    if discrepancy is not None:
        emulator = replace(emulator, discrepancy=discrepancy)
        extra = discrepancy.directions.shape[1]
        names = (*names, *(f"mismatch {i + 1}" for i in range(extra)))
        prior = np.concatenate([prior, np.ones(extra)])
    values, base, effects = emulator(np.zeros(len(prior)), np.zeros(len(bank.design.limits)))
    m = len(values)
    return Linearised(
        features=bank.features, mean=values, base_names=names, base_slopes=base, prior_sd=prior,
        effects=candidates(bank), effect_slopes=effects,
        packing_residuals=ready.specimens, mean_specimens=CERTAIN,
        base_errors=np.zeros_like(base), extra=np.zeros((m, m)), sensor=np.zeros((m, m)),
        wrong=np.zeros((m, 0)), emulator=emulator,
    )  # fmt: skip


def _local(
    ready: Ready, d: Linearised, delta: np.ndarray, density_sd: float, point: Point
) -> Linearised:
    """The description linearised at a shift of the base coordinates."""
    none = np.zeros(len(d.effects))
    values, base, effects = d.at(delta, none)
    scaled = (point.offset + delta[: len(point.offset)]) / ready.bank.design.spread()
    steep = ready.emulator.steepness(scaled, none)
    typical = ready.bank.design.typical()
    return replace(
        d, mean=values - base @ delta, base_slopes=base, effect_slopes=effects,
        packing_residuals=ready.specimens * steep,
        extra=_scatter(d, base, effects, density_sd, typical),
        wrong=d.wrong_at(delta, none),
    )  # fmt: skip


def _scatter(d: Linearised, base, effects, density_sd: float, typical) -> np.ndarray:
    """Covariance (m, m) of density and moisture from specimen to specimen."""
    names = d.base_names
    moisture = base[:, names.index("shear_modulus")] + base[:, names.index("surface_energy")]
    column = d.effect_names.index("specimen_density")
    density = effects[:, column] * density_sd / typical[column]
    return MOISTURE_SD**2 * np.outer(moisture, moisture) + np.outer(density, density)


def first_covariance(d: Linearised) -> np.ndarray:
    """A covariance good enough for a first fit: that of one simulated specimen, shrunk."""
    residuals = d.packing_residuals
    raw = residuals.T @ residuals / len(residuals) + d.extra
    return 0.8 * raw + 0.2 * np.diag(np.diag(raw)) + 1e-9 * np.diag(np.diag(raw))
