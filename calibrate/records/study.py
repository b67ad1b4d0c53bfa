"""The result of `calibrate doe` as a record, and the objects that its numbers stand for.

Effects and surfaces are fitted again from the designs and their responses, which takes no
simulation.
"""

import numpy as np
from pydantic import model_validator as check

from calibrate.designs.comparison import Comparison, Ending, Enhanced, SlopePair
from calibrate.designs.design import Design
from calibrate.designs.factors import Factor
from calibrate.designs.screening import Screening, screen
from calibrate.designs.study import DEPTH, OBSERVABLES, Experiment
from calibrate.designs.surface import Surface, fit_surface
from calibrate.designs.terms import parse
from calibrate.records.base import Measured, Number, Observable, Origin, Parameter, Record


class FactorRecord(Record):
    """A factor and its levels."""

    name: Parameter
    low: float
    high: float
    unit: str
    log: bool


class DesignRecord(Record):
    """A design that was run: coded points, dummies, responses by observable, point, packing."""

    kind: str
    factors: list[FactorRecord]
    coded: list[list[float]]
    dummies: list[list[float]]
    held: dict[Parameter, float]
    responses: dict[Observable, list[list[float]]]

    @check(mode="after")
    def _every_point_has_responses(self) -> "DesignRecord":
        if set(self.responses) != set(OBSERVABLES):
            raise ValueError("the responses of an observable are missing")
        shapes = {np.array(self.responses[name]).shape for name in OBSERVABLES}
        rows, packings = len(self.coded), {len(row) for row in self.responses[DEPTH]}
        if len(packings) != 1 or shapes != {(rows, *packings)}:
            raise ValueError("responses are not one row a point and one number a packing")
        return self

    def experiment(self, title: str) -> Experiment:
        """The experiment; `ValueError` where shapes do not agree."""
        factors = tuple(Factor(**dict(factor)) for factor in self.factors)
        design = Design(factors, np.array(self.coded), self.kind, np.array(self.dummies))
        columns = [np.array(self.responses[name]) for name in OBSERVABLES]
        return Experiment(title, design, np.stack(columns, axis=-1), dict(self.held))


class SurfaceRecord(Record):
    """The terms of a surface without the intercept, as text in its factors' names."""

    terms: list[str]


class StageRecord(Record):
    """Where a designed experiment ended."""

    optimum: dict[Parameter, Number]
    desirability: Number
    surfaces: dict[Observable, SurfaceRecord]

    @check(mode="after")
    def _both_surfaces(self) -> "StageRecord":
        if set(self.surfaces) != set(OBSERVABLES):
            raise ValueError("the surface of an observable is missing")
        return self


class SlopeRecord(Record):
    """A factor's slope by the surface and by the gradient."""

    design: str
    factor: Parameter
    observable: Observable
    surface: Number
    surface_se: Number
    surface_df: int
    gradient: Number
    gradient_se: Number
    gradient_df: int
    matters: bool


class EndingRecord(Record):
    """Where a method ended, packing by packing."""

    method: str
    values: dict[Parameter, Number]
    simulations: int
    stopped: str
    fitted_depression_depth_mm: list[Number]
    fitted_crushing_force_n: list[Number]
    fresh_depression_depth_mm: list[Number]
    fresh_crushing_force_n: list[Number]

    def ending(self) -> Ending:
        fitted, fresh = (
            np.column_stack([getattr(self, f"{where}_{name}") for name in OBSERVABLES])
            for where in ("fitted", "fresh")
        )
        return Ending(self.method, dict(self.values), fitted, fresh, self.simulations, self.stopped)


class EnhancedRecord(Record):
    """Error of a surface from that many points, without and with the gradient."""

    points: int
    values_only: Number
    with_gradient: Number


class ComparisonRecord(Record):
    """Designs and gradients side by side."""

    slopes: list[SlopeRecord]
    endings: tuple[EndingRecord, EndingRecord]
    enhanced: list[EnhancedRecord]
    gradient_runs: Number

    def comparison(self) -> Comparison:
        return Comparison(
            tuple(SlopePair(**dict(row)) for row in self.slopes),
            tuple(ending.ending() for ending in self.endings),
            tuple(Enhanced(**dict(row)) for row in self.enhanced),
            self.gradient_runs,
        )


class DesignsRecord(Record):
    """The designs in the order in which they were run."""

    screening: DesignRecord
    depth: DesignRecord
    force: DesignRecord
    refinement: DesignRecord


class StudyRecord(Origin):
    """Everything that the report of a study by designed experiments shows."""

    seeds: list[int]
    fresh_seeds: list[int]
    measured: Measured
    optimum: dict[Parameter, Number]
    depth: StageRecord
    force: StageRecord
    refinement: StageRecord
    comparison: ComparisonRecord
    designs: DesignsRecord

    @check(mode="after")
    def _complete(self) -> "StudyRecord":
        if set(self.measured.targets) != set(OBSERVABLES):
            raise ValueError("measured.targets lacks an observable")
        names = set(self.optimum)
        if not self.comparison.slopes:
            raise ValueError("the comparison has no slopes")
        if any(names != set(ending.values) for ending in self.comparison.endings):
            raise ValueError("the methods ended with values of different parameters")
        self.screens()
        for title in ("depth", "force", "refinement"):
            self.surfaces(title)
        self.comparison.comparison()
        return self

    def experiment(self, title: str) -> Experiment:
        return getattr(self.designs, title).experiment(title)

    def screens(self) -> dict[str, Screening]:
        """Effects of the screening on each observable."""
        found = self.experiment("screening")
        return {name: screen(found.replicated(), found.blocked(name)) for name in OBSERVABLES}

    def surfaces(self, title: str) -> dict[str, Surface]:
        """The whole surface of each observable over a design."""
        found, stage = self.experiment(title), getattr(self, title)
        names = found.design.names
        return {
            name: fit_surface(
                found.points(),
                found.blocked(name),
                parse(" + ".join(stage.surfaces[name].terms), names),
                names,
            )
            for name in OBSERVABLES
        }
