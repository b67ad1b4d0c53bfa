"""The result of `calibrate audit` as a record."""

from typing import TYPE_CHECKING, Literal

from pydantic import model_validator as check

from calibrate.inference.audit import STRATEGIES
from calibrate.records.base import Number, Observable, Origin, Parameter, Record, Test

if TYPE_CHECKING:  # a checker of types knows no Literal that is made from a dictionary
    StrategyName = str
else:
    StrategyName = Literal[tuple(STRATEGIES)]


class Slope(Record):
    """One slope per unit of ln p (mm or N) by a strategy and by the reference; on each packing
    where the strategy has it."""

    parameter: Parameter
    observable: Observable
    estimate: Number
    estimate_se: Number
    reference: Number
    reference_se: Number
    estimate_by_packing: list[Number] | None = None
    reference_by_packing: list[Number] | None = None
    judged: bool
    passed: bool | None


class CertificateRow(Record):
    """How far a derivative that JAX took has grown on one packing, and whether it is believed
    (`jdem.sensitivity.base`)."""

    seed: int
    test: Test
    parameter: Parameter
    growth: Number
    imbalance: Number
    accepted: bool
    refused: str


class StrategyRecord(Record):
    """One strategy's slopes, and what they cost in forward runs a packing."""

    passed: bool
    rows: list[Slope]
    forward_runs: Number
    described: str
    certificate: list[CertificateRow] | None = None

    def judged(self) -> list[Slope]:
        return [row for row in self.rows if row.judged]

    def of(self, observable: Observable) -> list[Slope]:
        return [row for row in self.rows if row.observable == observable]


class CurveSlope(Record):
    """Slope of a curve at its points, and its standard error."""

    slope: list[Number]
    se: list[Number]


class SlopesOfCurve(Record):
    """Slopes of one test's mean curve, by parameter, then by "reference" or strategy: of the
    displacement (mm) at forces (N) while loading, or of the force (N) at displacements (mm)."""

    mean: list[Number]
    slopes: dict[Parameter, dict[Literal["reference"] | StrategyName, CurveSlope]]
    force_n: list[Number] | None = None
    displacement_mm: list[Number] | None = None

    @property
    def points(self) -> list[float]:
        """Where the curve is read, N or mm."""
        return (self.displacement_mm if self.force_n is None else self.force_n) or []

    @check(mode="after")
    def _same_length(self) -> "SlopesOfCurve":
        if (self.force_n is None) == (self.displacement_mm is None):
            raise ValueError("give force_n or displacement_mm, one of them")
        pairs = [pair for by_name in self.slopes.values() for pair in by_name.values()]
        sizes = {len(self.mean)} | {len(part) for p in pairs for part in (p.slope, p.se)}
        if sizes != {len(self.points)}:
            name = "displacements" if self.force_n is None else "forces"
            raise ValueError(f"slopes and {name} differ in length")
        if any("reference" not in by_name for by_name in self.slopes.values()):
            raise ValueError("a reference slope is missing")
        return self


class AuditSlopes(Record):
    """The slopes of an audit, whatever made them.

    `within` is how far an estimate may lie from the reference, relative to it; slopes below
    `judged_from` standard errors are not judged.
    """

    strategy: StrategyName
    packings: int
    within: dict[Observable, Number]
    judged_from: Number
    strategies: dict[StrategyName, StrategyRecord]
    curves: dict[Test, SlopesOfCurve]

    @property
    def observables(self) -> list[Observable]:
        """Of all rows, in their order."""
        return list(dict.fromkeys(row.observable for row in self.strategies[self.strategy].rows))

    @property
    def parameters_of_curves(self) -> list[str]:
        """Parameters in which the curves have slopes."""
        return list(next(iter(self.curves.values())).slopes)

    @check(mode="after")
    def _complete(self) -> "AuditSlopes":
        if len({tuple(curve.slopes) for curve in self.curves.values()}) != 1:
            raise ValueError("the tests have no slopes, or slopes in different parameters")
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
