"""What a whole run is differentiated as: its observables, and points along the curves of its tests.

force that a test has to reach:  displacements (mm) at shares of it on loading
no such force:                   forces (N) at shares of the platen's stroke
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jax import Array

from calibrate.labtests.composite import names_observed
from calibrate.labtests.features import (
    AbstractCurveFeature,
    DisplacementOnLoading,
    ForceAtDisplacement,
)
from calibrate.labtests.reading import AS_RECORDED
from calibrate.simulation import Run
from calibrate.simulation.joint import AbstractCampaign
from jdem.apparatus.base import AbstractApparatus
from jdem.laboratory.virtual_lab import Outcome
from jdem.observables import Curve

POINTS = 20  # of each curve


@dataclass(frozen=True)
class CurveReading:
    """Where one test's curve is read: displacements (mm) at forces (N) on loading, or forces at
    displacements, both as recorded; `along` says which of the two the `points` are."""

    test: str
    along: Literal["force_n", "displacement_mm"]
    points: np.ndarray

    @staticmethod
    def of(test: AbstractApparatus) -> "CurveReading":
        """At equal shares of the force that the test has to reach, else of the platen's stroke."""
        share = np.arange(1, POINTS + 1) / POINTS
        if test.required_force is not None:
            return CurveReading(test.name, "force_n", float(test.required_force) * share)
        return CurveReading(test.name, "displacement_mm", 1e3 * float(test.stroke) * share)

    def feature(self, window: float = 0.0) -> AbstractCurveFeature:
        """All points as one feature, whose derivative is taken over a window."""
        if self.along == "displacement_mm":
            return ForceAtDisplacement("", "N", self.test, self.points, AS_RECORDED, 0.0)
        return DisplacementOnLoading("", "mm", self.test, self.points, AS_RECORDED, window)

    def read(self, curve: np.ndarray) -> np.ndarray:
        """Of a curve (rows, 2) in mm and N."""
        return self.feature().of_curve(*curve.T)

    def shown(self, curve: Array) -> Array:
        """Of a curve (rows, 2) of a response, traced by JAX; NaN beyond its end."""
        end = curve[:, 1 if self.along == "force_n" else 0].max()
        return jnp.where(self.points <= end, self.feature().of_curve(*curve.T), jnp.nan)

    def traced(self, curve: Curve) -> Array:
        """Of a curve of a run that JAX traces."""
        filled = curve.filled()
        return self.feature(curve.window).of_curve(1e3 * filled.displacement, filled.force)


@dataclass(frozen=True, eq=False)
class CurvePoints:
    """What is differentiated: all observables by test and name there, and points of all curves."""

    called: dict[tuple[str, str], tuple[str, float]]
    readings: tuple[CurveReading, ...]

    @staticmethod
    def of(work: AbstractCampaign) -> "CurvePoints":
        tests = work.apparatus
        return CurvePoints(names_observed(tests), tuple(CurveReading.of(test) for test in tests))

    @property
    def observables(self) -> tuple[str, ...]:
        """Names in results."""
        return tuple(name for name, _ in self.called.values())

    def read(self, run: Run) -> np.ndarray:
        """Observables, then every curve's points (mm or N); NaN: failed."""
        if run.failure:
            return np.full(len(self.called) + POINTS * len(self.readings), np.nan)
        values = [run.observables[name] for name in self.observables]
        return np.concatenate([values, *(r.read(run.curves[r.test]) for r in self.readings)])

    def shown(self, observables: Mapping[str, Array], curves: Mapping[str, Array]) -> Array:
        """The same numbers of a response's observables and curves (rows, 2), traced by JAX; NaN:
        it does not have the number, or its curve ends before."""
        values = [jnp.asarray(observables.get(name, jnp.nan)) for name in self.observables]
        read = [each.shown(curves[each.test]) for each in self.readings]
        return jnp.concatenate([jnp.stack(values), *read])

    def traced(self, outcome: Outcome) -> Array:
        """The same numbers as `read`, traced by JAX."""
        values = [
            factor * outcome.observables[test][source]
            for (test, source), (_, factor) in self.called.items()
        ]
        curves = [reading.traced(outcome.curves[reading.test]) for reading in self.readings]
        return jnp.concatenate([jnp.stack(values), *curves])

    def tests(self) -> np.ndarray:
        """Number of the test that each of the numbers comes from."""
        order = [reading.test for reading in self.readings]
        single = [order.index(test) for test, _ in self.called]
        return np.array([*single, *np.repeat(np.arange(len(order)), POINTS)])

    def by_group(self, of: Mapping[str, float]) -> np.ndarray:
        """A number for each of those that `read` returns: the largest that `of` has of its test by
        name, or of one of the test's observables; 1 where there is none."""
        found = {reading.test: of.get(reading.test, 1.0) for reading in self.readings}
        for (test, _), (name, _) in self.called.items():
            found[test] = max(found[test], of.get(name, 1.0))
        return np.array([*found.values()])[self.tests()]

    def slices(self) -> dict[str, slice]:
        """Where each test's curve stands among what `read` returns."""
        first = len(self.called)
        return {
            reading.test: slice(first + POINTS * k, first + POINTS * (k + 1))
            for k, reading in enumerate(self.readings)
        }
