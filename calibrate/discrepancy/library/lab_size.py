"""A lab's own size beside the library's, how one is turned into the other, and a lab's prior.

Quasi-static tests on specimens of one shape depend on strain and stress alone, so displacements go
as diameters, forces as areas, times as displacements over the platens' speeds, and strengths of
effects by their units.  Height over diameter and the largest stress are coordinates of the library
(`design.SHAPE`).  Everything that a description says is in the lab's own mm, N and s.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibrate.core.errors import InputError
from calibrate.discrepancy.library.design import (
    FURTHEST,
    SETTINGS,
    SHAPE,
    SHAPE_COLUMNS,
    SMOOTHING,
    SPEEDS,
)
from calibrate.discrepancy.library.run_library import Cylinder, RunLibrary
from calibrate.io.conventions import HELD
from calibrate.io.lab import Lab
from calibrate.io.soil import base_soil
from calibrate.labtests.diagnosis.base import Curves, Feature
from calibrate.labtests.diagnosis.curves import TESTS
from jdem.effects.composite import EFFECTS

# A soil has no roundings and finer grains; another simulator's bed may have roundings.  The pace is
# known; its deviation is for what real grains lose otherwise than in dashpots.
SETTING_PRIOR_MEAN = {"smoothing": SMOOTHING[0], "porosity": 0.0, "sphere_size": -0.3}
SETTING_PRIOR_SD = {
    "smoothing": 0.4, "porosity": 0.012, "pace": 0.05, "slenderness": 0.01, "stress": 0.01,
    "sphere_size": 0.35,
}  # fmt: skip
HELD_SD = 1e-3  # of ln p of what conventions hold
EDGE = 0.3  # prior deviations beyond the runs, up to which they still carry
CARRYING = 4  # runs beside a soil, from which on the library reaches it
SHAPE_TOLERANCE = 0.12  # of height over diameter and of the largest stress, beyond all runs
RAISED_BY_TIME = {"acquisition_lag": TESTS[0], "load_cell_drift": TESTS[1]}  # where each counts


@dataclass(frozen=True, eq=False)
class LabSize:
    """A lab's cylinder, its shape (2,) over the library's, and what takes lengths, forces and the
    times of each test from the library's size to the lab's."""

    cylinder: Cylinder
    shape: np.ndarray
    length: float
    force: float
    time: Mapping[str, float]

    @staticmethod
    def of(lab: Lab, library: RunLibrary) -> "LabSize":
        """The size of a lab; `InputError` where its shape is too far from all of the library's."""
        own = Cylinder.of(lab)
        shape = _within(own.shape_over(library.cylinder), library, lab)
        like = library.cylinder.shaped(shape)
        length = own.height / like.height
        time = {
            test: length * library.speeds[test] / (1e3 * lab.pair().rates[test]) for test in TESTS
        }
        return LabSize(own, shape, length, (own.diameter / like.diameter) ** 2, time)

    @staticmethod
    def of_library(library: RunLibrary) -> "LabSize":
        """The library's own size."""
        none, same = np.zeros(len(SHAPE)), dict.fromkeys(TESTS, 1.0)
        return LabSize(library.cylinder, none, 1.0, 1.0, same)

    @property
    def features(self) -> tuple[Feature, ...]:
        """The library's features, read at the lab's own displacements and forces."""
        return self.cylinder.features()

    def of_features(self, features: Sequence[Feature]) -> np.ndarray:
        """By what values (m,) at the library's size are multiplied."""
        return np.array([self.length if f.unit == "mm" else self.force for f in features])

    def of_effects(self, names: Sequence[str]) -> np.ndarray:
        """By what strengths (k,) at the library's size are multiplied.  Stresses and shares stay:
        they belong to the soil."""
        return np.array([self._of_unit(name) for name in names])

    def curves(self, curves: Curves) -> Curves:
        """Curves of the library's own cylinder, stretched to this size and shape."""
        slender, stress = np.exp(self.shape)
        further = {TESTS[0]: stress}
        return {
            test: (x * self.length * slender, force * self.force * further.get(test, 1.0))
            for test, (x, force) in curves.items()
        }

    def _of_unit(self, name: str) -> float:
        time = self.time[RAISED_BY_TIME.get(name, TESTS[0])]
        of_unit = {
            "m/N": self.length / self.force, "m": self.length, "N": self.force,
            "N/s": self.force / time, "s": time,
        }  # fmt: skip
        return of_unit.get(EFFECTS[name].about.unit, 1.0)


def _within(shape: np.ndarray, library: RunLibrary, lab: Lab) -> np.ndarray:
    """A shape (2,) brought within those of the runs; refused where it is too far from them."""
    covered = library.rows.base[:, SHAPE_COLUMNS]
    low, high = covered.min(axis=0), covered.max(axis=0)
    inside = np.clip(shape, low, high)
    for axis, (what, field) in enumerate(_CALLED):
        if abs(shape[axis] - inside[axis]) > SHAPE_TOLERANCE:
            runs = library.cylinder.shaped(low), library.cylinder.shaped(high)
            least, most = (_in_words(axis, cylinder) for cylinder in runs)
            own = _in_words(axis, Cylinder.of(lab))
            problem = f"{what} is {own:.3g}, and the library's runs have {least:.3g} to {most:.3g}"
            raise InputError(lab.file, field, problem, _REPAIR)
    return inside


_CALLED = (
    ("height over diameter", "specimen"),
    ("the largest stress in kPa", f"{TESTS[0]}.force_high"),
)
_REPAIR = "make a library for this lab: calibrate library LAB.toml --centred --out FILE"


def _in_words(axis: int, cylinder: Cylinder) -> float:
    """Height over diameter, or the largest stress in kPa."""
    area = np.pi / 4 * cylinder.diameter**2
    both = (cylinder.height / cylinder.diameter, 1e-3 * cylinder.force_high / area)
    return both[axis]


@dataclass(frozen=True, eq=False)
class SoilPrior:
    """A lab's prior in the coordinates of a library: offset (p,) of its mean, prior_sd (p,)."""

    offset: np.ndarray
    prior_sd: np.ndarray


def soil_prior_of(
    library: RunLibrary,
    soil: dict[str, float],
    pace: float,
    soil_sd: dict[str, float] | None = None,
    shape: np.ndarray | None = None,
) -> SoilPrior:
    """The prior about a soil (SI values by name) that is pressed at a pace, the platen's speed in
    the mould over the library's fast one; soil_sd: deviations of ln p where they differ; shape (2,)
    of the specimen over the library's."""
    design, given = library.design, soil_sd or {}
    names = design.soil_names
    offset = [np.log(soil[name] / design.centre[name]) for name in names]
    spread = [given.get(name, design.soil_sd[name]) for name in names]
    of_shape = dict(zip(SHAPE, np.zeros(len(SHAPE)) if shape is None else shape, strict=True))
    mean = {**SETTING_PRIOR_MEAN, "pace": pace, **of_shape}
    return SoilPrior(
        np.array([*offset, *(mean[name] for name in SETTINGS)]),
        np.array([*spread, *(SETTING_PRIOR_SD[name] for name in SETTINGS)]),
    )


def soil_prior_for(lab: Lab, library: RunLibrary) -> SoilPrior:
    """The prior about a lab's own starting soil, with the deviations that it states, at the speed
    of its test in the mould and in the shape of its specimen."""
    soil, names = base_soil(lab), library.design.soil_names
    stated = {n: c.prior_sd for n, c in lab.parameters.items() if c.prior_sd is not None}
    values = {name: float(getattr(soil, name)) for name in names}
    pace = _pace(lab)
    held = dict.fromkeys(HELD.get(lab.particles.conventions, ()), HELD_SD)
    of_soil = {n: s for n, s in {**stated, **held}.items() if n in names}
    return soil_prior_of(library, values, pace, of_soil, LabSize.of(lab, library).shape)


def _pace(lab: Lab) -> float:
    """The platen's speed in the mould over the library's fast one; faster ones are refused."""
    test = lab.pair().compression
    if test.speed > SPEEDS[0]:
        field = "rate" if test.pressed_at is None else "pressed_at"
        raise InputError(
            lab.file,
            f"{test.called}.{field}",
            f"{1e3 * test.speed:g} mm/s is faster than any run of the library, {1e3 * SPEEDS[0]:g}",
            "test more slowly; what dashpots carry at this speed is not known here",
        )
    return test.speed / SPEEDS[0]


def parameters_beyond(library: RunLibrary, offset: np.ndarray) -> tuple[str, ...]:
    """Soil parameters, at ln p of `offset` (q,) from the library's centre, that lie clearly farther
    from it than its runs, of its design or added about a lab."""
    low, high = reach(library)
    beyond = (offset < low) | (offset > high)
    return tuple(n for n, by in zip(library.design.soil_names, beyond, strict=True) if by)


def reach(library: RunLibrary) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest ln p over the library's centre (q,), each, to which its runs carry."""
    sd = soil_sd(library)
    runs = np.sort(library.rows.base[:, : len(sd)] / sd, axis=0)
    last = min(CARRYING, len(runs))
    high = np.maximum(runs[-last], FURTHEST) + EDGE
    return sd * (np.minimum(runs[last - 1], -FURTHEST) - EDGE), sd * high


def soil_sd(library: RunLibrary) -> np.ndarray:
    return np.array([*library.design.soil_sd.values()])
