"""The result of `calibrate audit` as a record."""

from typing import Literal

from pydantic import model_validator as check

from calibrate.records.base import Number, Observable, Origin, Parameter, Record

Strategy = Literal[
    "fit", "ensemble", "regression", "pathwise", "blend", "virtual_power", "virtual_power_blend"
]


class Slope(Record):
    """One slope per unit of ln p (mm or N) by a strategy and by the reference."""

    parameter: Parameter
    observable: Observable
    estimate: Number
    estimate_se: Number
    reference: Number
    reference_se: Number
    judged: bool
    passed: bool | None


class StrategyRecord(Record):
    """One strategy's slopes, and what they cost in forward runs a packing."""

    passed: bool
    rows: list[Slope]
    forward_runs: Number
    described: str

    def judged(self) -> list[Slope]:
        return [row for row in self.rows if row.judged]

    def of(self, observable: Observable) -> list[Slope]:
        return [row for row in self.rows if row.observable == observable]


class CurveSlope(Record):
    """Slope of a curve at its points, and its standard error."""

    slope: list[Number]
    se: list[Number]


class SlopesOfCurve(Record):
    """Slopes of one test's mean curve: by parameter, then by "reference" or strategy."""

    mean: list[Number]
    slopes: dict[Parameter, dict[Literal["reference"] | Strategy, CurveSlope]]

    def _sizes(self) -> set[int]:
        pairs = [pair for by_name in self.slopes.values() for pair in by_name.values()]
        return {len(self.mean)} | {len(part) for p in pairs for part in (p.slope, p.se)}


class LoadingSlopes(SlopesOfCurve):
    """Displacement (mm) at a force while loading."""

    force_n: list[Number]

    @check(mode="after")
    def _same_length(self) -> "LoadingSlopes":
        if self._sizes() != {len(self.force_n)}:
            raise ValueError("slopes and forces differ in length")
        return self


class CrushingSlopes(SlopesOfCurve):
    """Force (N) at a displacement while crushing."""

    displacement_mm: list[Number]

    @check(mode="after")
    def _same_length(self) -> "CrushingSlopes":
        if self._sizes() != {len(self.displacement_mm)}:
            raise ValueError("slopes and displacements differ in length")
        return self


class CurvesRecord(Record):
    """Slopes of both tests' curves."""

    confined: LoadingSlopes
    unconfined: CrushingSlopes

    @check(mode="after")
    def _same_parameters(self) -> "CurvesRecord":
        if list(self.confined.slopes) != list(self.unconfined.slopes):
            raise ValueError("the two tests have slopes in different parameters")
        if any(
            "reference" not in by_name
            for test in (self.confined, self.unconfined)
            for by_name in test.slopes.values()
        ):
            raise ValueError("a reference slope is missing")
        return self


class AuditSlopes(Record):
    """The slopes of an audit, whatever made them.

    `within` is how far an estimate may lie from the reference, relative to it; slopes below
    `judged_from` standard errors are not judged.
    """

    strategy: Strategy
    packings: int
    within: dict[Observable, Number]
    judged_from: Number
    strategies: dict[Strategy, StrategyRecord]
    curves: CurvesRecord

    @check(mode="after")
    def _complete(self) -> "AuditSlopes":
        if self.strategy not in self.strategies:
            raise ValueError(f"strategy {self.strategy} has no rows")
        found = {row.observable for each in self.strategies.values() for row in each.rows}
        if not found <= set(self.within):
            raise ValueError("within lacks an observable that has slopes")
        return self


class AuditRecord(Origin, AuditSlopes):
    """Everything that figures and report of an audit show."""

    seeds: list[int]
    spheres: int
    parameters: dict[str, Number]
