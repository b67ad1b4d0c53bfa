"""A lab file in the terms of a bank: curves scaled to its cylinder, repeats, instruments.

Quasi-static tests on specimens of one shape depend on strain and stress alone, so a curve of
another size is read at the bank's: displacement times the ratio of heights, force times that of
areas.  The i-th confined and the i-th unconfined curve are taken for the same specimen where there
are as many of both.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibrate.bank.store import TARGETS, Bank, Cylinder
from calibrate.diagnosis.features import (
    CONFINED,
    UNCONFINED,
    Curves,
    Feature,
    declare_before_contact,
    declare_targets,
    force_before_contact,
    readings_before_contact,
    vector,
)
from calibrate.diagnosis.linear import Emulator, Linearised
from calibrate.diagnosis.repeats import (
    Measured,
    from_targets,
    from_vectors,
    measured_features,
)
from calibrate.diagnosis.sensor import Channel, recording
from calibrate.errors import InputError
from calibrate.measurements import Lab

SHAPE_TOLERANCE = 0.12  # of height over diameter, and of the largest stress
DISPLACEMENT_SD = 3e-3  # mm; resolution of a crosshead
LEAST_FORCE_SD = 0.1  # N
FEWEST_BEFORE_SD = 0.05  # N; of the mean before contact, at least
STRETCHED = (0.2, 5.0)  # of reference curves, at least and at most
TARGETS_ONLY_SD = 0.05  # of the mean, where a target's scatter is not given


@dataclass(frozen=True, eq=False)
class LabCurves:
    """What a lab measured, at the bank's size: specimens, the features they have, their means;
    `before` are means before contact (s, 2), NaN where there are none; channels by test."""

    measured: Measured
    chosen: np.ndarray
    before: np.ndarray
    channels: dict[str, Channel]
    specimens: tuple[Curves, ...]


def specimens_of(lab: Lab, cylinder: Cylinder) -> list[Curves]:
    """The lab's specimens with their curves in mm and N at the bank's size."""
    longer = cylinder.height / lab.specimen.height
    wider = (cylinder.diameter / lab.specimen.diameter) ** 2
    by_test = {
        test: [
            (c.displacement_mm * longer, c.force_n * wider) for c in lab.curves if c.test == test
        ]
        for test in (CONFINED, UNCONFINED)
    }
    counts = [len(curves) for curves in by_test.values()]
    if counts[0] == counts[1]:
        return [
            dict(zip(by_test, pair, strict=True)) for pair in zip(*by_test.values(), strict=True)
        ]
    return [{test: curve} for test, curves in by_test.items() for curve in curves]


def check_shape(lab: Lab, bank: Bank) -> None:
    """Refuses a lab whose specimen or largest stress is too far from the bank's."""
    mine, theirs = Cylinder.of(lab), bank.cylinder
    slender = mine.height / mine.diameter / (theirs.height / theirs.diameter)
    if abs(np.log(slender)) > SHAPE_TOLERANCE:
        problem = f"height over diameter is {slender:.2f} times that of the bank's specimen"
        raise InputError(lab.file, "specimen", problem, _REPAIR)
    stress = mine.force_high / mine.diameter**2 / (theirs.force_high / theirs.diameter**2)
    if abs(np.log(stress)) > SHAPE_TOLERANCE:
        problem = f"the largest stress is {stress:.2f} times the bank's"
        raise InputError(lab.file, "confined.force_high", problem, _REPAIR)


_REPAIR = "make a bank for this lab: calibrate bank LAB.toml --out FILE"


def read(lab: Lab, bank: Bank) -> LabCurves:
    """Features of a lab: of its curves if there are any, else of its targets."""
    check_shape(lab, bank)
    every = bank.features
    specimens = specimens_of(lab, bank.cylinder)
    if not specimens:
        return _targets(lab, bank)
    from_contact = [from_contact_on(curves) for curves in specimens]
    known = measured_features([f for f in every if f.kind != "target"], from_contact)
    if not known:
        raise InputError(lab.file, "curves", "no feature could be read from them",
                         "give whole curves: loading to the largest force and back, crushing "
                         "past the peak")  # fmt: skip
    vectors = np.array([vector(known, curves) for curves in from_contact])
    before = np.array([
        [force_before_contact(curves[test][1]) if test in curves else np.nan
         for test in (CONFINED, UNCONFINED)] for curves in specimens
    ])  # fmt: skip
    chosen = np.array([every.index(feature) for feature in known])
    channels = {test: _channel(test, specimens) for test in (CONFINED, UNCONFINED)}
    return LabCurves(from_vectors(known, vectors), chosen, before, channels, tuple(specimens))


def from_contact_on(curves: Curves) -> Curves:
    """The curves without the platen's way through the air, as a simulation records them."""
    found = {}
    for test, (displacement, force) in curves.items():
        first = max(readings_before_contact(force) - 1, 0)
        found[test] = (displacement[first:], force[first:])
    return found


def _targets(lab: Lab, bank: Bank) -> LabCurves:
    longer = bank.cylinder.height / lab.specimen.height
    wider = (bank.cylinder.diameter / lab.specimen.diameter) ** 2
    names = [name for name in TARGETS if name in lab.targets]
    features = declare_targets(names)
    values = {}
    for name in names:
        target, factor = lab.targets[name], longer if name.endswith("_mm") else wider
        values[name] = (target.mean * factor, target.scatter * factor, target.repeats)
    chosen = np.array([[f.name for f in bank.features].index(name) for name in names])
    return LabCurves(from_targets(features, values), chosen, np.empty((0, 2)), {}, ())


def _channel(test: str, specimens: Sequence[Curves]) -> Channel:
    """How a test was recorded: travel between readings, and the noise of force from second
    differences (their median, so that kinks of the soil do not count)."""
    curves = [curves[test] for curves in specimens if test in curves]
    if not curves:
        return Channel(0.05, LEAST_FORCE_SD, DISPLACEMENT_SD)
    spacing = np.median([np.median(np.abs(np.diff(x))) for x, _ in curves])
    seconds = np.concatenate([np.diff(force, 2) for _, force in curves])
    noise = 1.4826 * np.median(np.abs(seconds - np.median(seconds))) / np.sqrt(6)
    return Channel(max(float(spacing), 1e-3), max(float(noise), LEAST_FORCE_SD), DISPLACEMENT_SD)


def with_instruments(d: Linearised, found: LabCurves, bank: Bank, seed: int) -> Linearised:
    """The description with what recording adds to the features of curves."""
    if not found.channels:
        return d
    rng = np.random.default_rng(seed)
    reference = typical(bank, found)
    shift, sensor, either = recording(d.features, reference, found.channels, rng)
    emulator = None if d.emulator is None else Shifted(d.emulator, shift, either)
    wrong = np.column_stack([d.wrong, either])
    return replace(d, mean=d.mean + shift, sensor=d.sensor + sensor, wrong=wrong, emulator=emulator)


def typical(bank: Bank, found: LabCurves) -> Curves:
    """The bank's reference curves, stretched to the size of what the lab measured: travel above
    half the largest force; force and displacement of the peak."""
    high = f"displacement at {0.99 * bank.cylinder.force_high:g} N, loading"
    axes = {
        CONFINED: (high, ""),
        UNCONFINED: ("peak displacement, unconfined", "peak force, unconfined"),
    }
    curves = {}
    for test in found.channels:
        (displacement, force), (along, up) = bank.reference[test], axes[test]
        curves[test] = (
            displacement * _ratio(bank, found, along), force * _ratio(bank, found, up)
        )  # fmt: skip
    return curves


def _ratio(bank: Bank, found: LabCurves, name: str) -> float:
    """A measured feature over that of the reference curves, 1 where it is not known."""
    names = [f.name for f in found.measured.features]
    if name not in names:
        return 1.0
    feature = found.measured.features[names.index(name)]
    ratio = found.measured.mean[names.index(name)] / vector([feature], bank.reference)[0]
    least, most = STRETCHED
    return float(np.clip(ratio, least, most)) if np.isfinite(ratio) else 1.0


def with_baseline(d: Linearised, found: LabCurves) -> tuple[Linearised, Measured]:
    """The description and the sample with the forces before contact, where all specimens have
    them: only an untared load cell moves those."""
    have = np.isfinite(found.before) if len(found.before) else np.zeros((0, 2), bool)
    has_test = np.array([[t in c for t in (CONFINED, UNCONFINED)] for c in found.specimens])
    keep = [
        i for i in (0, 1) if len(have) and has_test[:, i].any() and have[has_test[:, i], i].all()
    ]
    if not keep:
        return d, found.measured
    before = declare_before_contact()
    vectors = np.hstack([found.measured.specimens, found.before[:, keep]])
    features = (*d.features, *(before[i] for i in keep))
    noise = max(c.force_sd for c in found.channels.values())
    return _extended(d, features, len(keep), noise), from_vectors(features, vectors)


def _extended(d: Linearised, features: tuple[Feature, ...], more: int, noise: float) -> Linearised:
    column = np.array([e.typical if e.name == "load_cell_offset" else 0.0 for e in d.effects])
    rows = np.tile(column, (more, 1))
    variance = max(noise / np.sqrt(3), FEWEST_BEFORE_SD) ** 2

    def taller(matrix: np.ndarray, below: np.ndarray | None = None) -> np.ndarray:
        below = np.zeros((more, *matrix.shape[1:])) if below is None else below
        return np.concatenate([matrix, below])

    def wider(matrix: np.ndarray, value: float = 0.0) -> np.ndarray:
        m = len(matrix)
        grown = np.zeros((m + more, m + more))
        grown[:m, :m] = matrix
        grown[range(m, m + more), range(m, m + more)] = value
        return grown

    empty = np.zeros((len(d.packing_residuals), more))
    return replace(
        d, features=features, mean=taller(d.mean), base_slopes=taller(d.base_slopes),
        effect_slopes=taller(d.effect_slopes, rows), base_errors=taller(d.base_errors),
        packing_residuals=np.hstack([d.packing_residuals, empty]),
        effect_errors=taller(d.effect_errors), extra=wider(d.extra),
        sensor=wider(d.sensor, variance), tolerance=taller(d.tolerance),
        wrong=taller(d.wrong),
        emulator=None if d.emulator is None else Taller(d.emulator, rows),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Shifted:
    """An emulator of values that all lie `shift` (m,) higher, give or take `either` (m,)."""

    emulator: Emulator
    shift: np.ndarray
    either: np.ndarray

    def __call__(self, delta, strengths):
        values, base, effects = self.emulator(delta, strengths)
        return values + self.shift, base, effects

    def wrong(self, delta, strengths):
        return np.column_stack([self.emulator.wrong(delta, strengths), self.either])


@dataclass(frozen=True, eq=False)
class Taller:
    """An emulator with further features that depend on effects alone, linearly: rows (q, k)."""

    emulator: Emulator
    rows: np.ndarray

    def __call__(self, delta, strengths):
        values, base, effects = self.emulator(delta, strengths)
        more = np.zeros((len(self.rows), base.shape[1]))
        return (
            np.concatenate([values, self.rows @ strengths]),
            np.concatenate([base, more]),
            np.concatenate([effects, self.rows]),
        )

    def wrong(self, delta, strengths):
        known = self.emulator.wrong(delta, strengths)
        return np.concatenate([known, np.zeros((len(self.rows), known.shape[1]))])
