"""The result of `calibrate doe` as a record, and the objects that its numbers stand for.

Effects and surfaces are fitted again from the designs and their responses, which takes no
simulation.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydantic import model_validator as check

from calibrate.designs.comparison import Comparison, Enhanced, MethodResult, SlopePair
from calibrate.designs.design import Design
from calibrate.designs.factors import Factor
from calibrate.designs.screening import Screening, screen
from calibrate.designs.study import Experiment
from calibrate.designs.surface import Surface, fit_surface
from calibrate.designs.terms import parse
from calibrate.records.base import Measured, Number, Observable, Origin, Parameter, Record

SCREENING = "screening"
METHODS = 2  # that are compared: designs and gradients
STAGES = 3  # two surfaces and the refinement


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
        shapes = {(len(rows), *map(len, rows)) for rows in self.responses.values()}
        packings = next((shape[1:2] for shape in shapes), ())
        if not packings or shapes != {(len(self.coded), *(packings * len(self.coded)))}:
            raise ValueError("responses are not one row a point and one number a packing")
        return self

    def experiment(self, title: str) -> Experiment:
        """The experiment; `ValueError` where shapes do not agree."""
        factors = tuple(Factor(**dict(factor)) for factor in self.factors)
        design = Design(factors, np.array(self.coded), self.kind, np.array(self.dummies))
        columns = np.stack([np.array(rows) for rows in self.responses.values()], axis=-1)
        return Experiment(title, design, columns, dict(self.held), tuple(self.responses))


class SurfaceRecord(Record):
    """The terms of a surface without the intercept, as text in its factors' names."""

    terms: list[str]


class StageRecord(Record):
    """Where a designed experiment ended."""

    optimum: dict[Parameter, Number]
    desirability: Number
    surfaces: dict[Observable, SurfaceRecord]


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
    """Where a method ended; `fitted` and `fresh` hold each observable packing by packing."""

    method: str
    values: dict[Parameter, Number]
    simulations: int
    stopped: str
    fitted: dict[Observable, list[Number]]
    fresh: dict[Observable, list[Number]]

    @check(mode="before")
    @classmethod
    def _observables_stand_beside(cls, data: Any) -> Any:
        """In the file observables are entries of their own: fitted_crushing_force_n."""
        if not isinstance(data, dict):
            return data
        return {**data, **{where: _behind(f"{where}_", data) for where in ("fitted", "fresh")}}

    def ending(self, observables: Sequence[Observable]) -> MethodResult:
        if any(set(group) != set(observables) for group in (self.fitted, self.fresh)):
            raise ValueError(f"where {self.method} ended, an observable is missing")
        fitted, fresh = (
            np.column_stack([group[name] for name in observables])
            for group in (self.fitted, self.fresh)
        )
        return MethodResult(
            self.method, dict(self.values), fitted, fresh, self.simulations, self.stopped
        )


def _behind(begin: str, data: dict) -> dict:
    """The entries whose names begin so, by what follows."""
    return {name[len(begin) :]: value for name, value in data.items() if name.startswith(begin)}


class EnhancedRecord(Record):
    """Error of a surface from that many points, without and with the gradient."""

    points: int
    values_only: Number
    with_gradient: Number


class ComparisonRecord(Record):
    """Designs and gradients side by side."""

    slopes: list[SlopeRecord]
    endings: list[EndingRecord]
    enhanced: list[EnhancedRecord]
    gradient_runs: Number

    def comparison(self, observables: Sequence[Observable]) -> Comparison:
        if {row.observable for row in self.slopes} - set(observables):
            raise ValueError("there are slopes of an observable that has no responses")
        return Comparison(
            tuple(SlopePair(**dict(row)) for row in self.slopes),
            tuple(ending.ending(observables) for ending in self.endings),
            tuple(Enhanced(**dict(row)) for row in self.enhanced),
            self.gradient_runs,
        )


class StudyRecord(Origin):
    """Everything that the report of a study by designed experiments shows."""

    seeds: list[int]
    fresh_seeds: list[int]
    measured: Measured
    optimum: dict[Parameter, Number]
    comparison: ComparisonRecord
    designs: dict[str, DesignRecord]
    stages: dict[str, StageRecord]

    @check(mode="before")
    @classmethod
    def _stages_stand_beside(cls, data: Any) -> Any:
        """In the file stages are entries of their own, called as their designs."""
        if not isinstance(data, dict) or not isinstance(data.get("designs"), dict):
            return data
        named = [title for title in data["designs"] if title != SCREENING]
        return {**data, "stages": {title: data[title] for title in named if title in data}}

    @check(mode="after")
    def _complete(self) -> "StudyRecord":
        if len(self.stages) != STAGES or set(self.designs) != {SCREENING, *self.stages}:
            raise ValueError("it has not a screening, two surfaces and a refinement")
        if len({tuple(design.responses) for design in self.designs.values()}) != 1:
            raise ValueError("the designs have responses of different observables")
        if not self.goals:
            raise ValueError("no observable has a target")
        names = set(self.optimum)
        if not self.comparison.slopes or len(self.comparison.endings) != METHODS:
            raise ValueError("the comparison has no slopes, or not two endings")
        if any(names != set(ending.values) for ending in self.comparison.endings):
            raise ValueError("the methods ended with values of different parameters")
        self.screens()
        for title in self.stages:
            self.surfaces(title)
        self.compared()
        return self

    @property
    def observables(self) -> tuple[Observable, ...]:
        """The responses, in the order of their numbers."""
        return tuple(self.designs[SCREENING].responses)

    @property
    def goals(self) -> tuple[Observable, ...]:
        """Those that have a target."""
        return tuple(name for name in self.observables if name in self.measured.targets)

    def compared(self) -> Comparison:
        return self.comparison.comparison(self.observables)

    def experiment(self, title: str) -> Experiment:
        return self.designs[title].experiment(title)

    def screens(self) -> dict[str, Screening]:
        """Effects of the screening on each observable."""
        found = self.experiment(SCREENING)
        return {name: screen(found.replicated(), found.blocked(name)) for name in self.observables}

    def surfaces(self, title: str) -> dict[str, Surface]:
        """The whole surface of each observable over a design."""
        found, stage = self.experiment(title), self.stages[title]
        if set(stage.surfaces) != set(self.observables):
            raise ValueError("the surface of an observable is missing")
        names = found.design.names
        return {
            name: fit_surface(
                found.points(),
                found.blocked(name),
                parse(" + ".join(stage.surfaces[name].terms), names),
                names,
            )
            for name in self.observables
        }
