"""The result of `calibrate fit` as a record."""

import math
from typing import Any, Literal

from pydantic import Field
from pydantic import model_validator as check

from calibrate.inference.misfit import misses
from calibrate.records.base import (
    Curve,
    Measured,
    Number,
    Observable,
    Origin,
    Parameter,
    Record,
    Test,
)


class Packing(Record):
    """One simulated specimen: its seed, observables, curves; why it failed, or ""."""

    seed: int
    failure: str
    curves: dict[Test, Curve]
    observables: dict[Observable, Number]

    @check(mode="before")
    @classmethod
    def _observables_stand_beside(cls, data: Any) -> Any:
        """In the file observables are entries of their own, by name."""
        if not isinstance(data, dict) or "observables" in data:
            return data
        own = {"seed", "failure", "curves"}
        return {
            **{name: data[name] for name in own & data.keys()},
            "observables": {n: v for n, v in data.items() if n not in own},
        }

    def observable(self, name: Observable) -> float:
        return float(self.observables.get(name, float("nan")))


class Packings(Record):
    """Specimens at the fitted values: those of the fit, and those that it has not seen."""

    fitted: list[Packing]
    fresh: list[Packing]


class Summary(Record):
    """Means over packings, and the scatter of one."""

    observables: dict[Observable, Number]
    spread: dict[Observable, Number]


class Feature(Record):
    """One number that was fitted: measured, simulated, deviation of their difference."""

    measured: Number
    simulated: Number
    sd: Number
    test: Test = ""  # "" and None: not known, in results of earlier versions
    target: bool | None = None


class Direction(Record):
    """A combination of free parameters in ln p and how well the data see it; they fix what they
    see only where the fit met them."""

    weights: dict[Parameter, Number]
    signal_to_noise: Number
    fixed_by_data: bool
    seen_by_data: bool = False

    @property
    def verdict(self) -> str:
        """In words."""
        if self.fixed_by_data:
            return "fixed"
        return "seen, but the fit missed" if self.seen_by_data else "left open"


class Identifiability(Record):
    """Intervals of the free parameters (SI), their correlation, directions."""

    interval_95: dict[Parameter, tuple[Number, Number]]
    correlation: list[list[Number]]
    directions: list[Direction]


class ProfilePoint(Record):
    """The objective at one value of a parameter: by simulation, and as the covariance implies."""

    value: Number
    linearised: Number
    simulated: Number
    failure: str = ""


class Step(Record):
    """One evaluation of the fit."""

    evaluation: int
    status: Literal["better", "rejected", "failed", "explored"]
    failure: str
    forward_runs: Number
    cost: Number
    parameters: dict[Parameter, Number]
    features: dict[str, Number]


class Screening(Record):
    """How the free parameters were chosen; empty where the user chose them.  `alike`: for each,
    others that the data see about as well."""

    free: list[Parameter] = Field(default_factory=list)
    alike: dict[Parameter, list[Parameter]] = Field(default_factory=dict)
    slopes_per_ln: dict[str, dict[Parameter, Number]] = Field(default_factory=dict)


class Rate(Record):
    """Platen speed of the laboratory and of the simulation (mm/s)."""

    nominal_mm_s: Number
    simulated_mm_s: Number


class FitRecord(Origin, Summary):
    """Everything that figures and report of a fit show."""

    seeds: list[int]
    fresh_seeds: list[int]
    spheres: int
    measured: Measured
    parameters: dict[str, Number]
    free: list[Parameter]
    fresh_packings: Summary
    packings: Packings
    features: dict[str, Feature]
    simulations: int
    stopped: str
    strategy: str
    profiles: dict[Parameter, list[ProfilePoint]]
    identifiability: Identifiability
    screening: Screening
    history: list[Step]
    named_sets: dict[str, Summary]
    at_bound: list[Parameter]
    quality: dict[str, Number | bool]
    rates: dict[Test, Rate]
    notes: list[str] = Field(default_factory=list)
    warnings: list[str] = Field(default_factory=list)

    @check(mode="after")
    def _free_parameters_are_described(self) -> "FitRecord":
        if not self.history:
            raise ValueError("history has no evaluation")
        for name in self.free:
            found = [
                self.parameters.get(name, 0.0),
                self.history[0].parameters.get(name, 0.0),
                *self.identifiability.interval_95.get(name, (0.0,)),
            ]
            if not all(0 < number < math.inf for number in found):
                problem = "its value, start or interval is missing or not positive"
                raise ValueError(f"{name} is free, but {problem}")
        size = len(self.free)
        if [len(row) for row in self.identifiability.correlation] != [size] * size:
            raise ValueError("identifiability.correlation has not one row for each free parameter")
        return self

    @check(mode="after")
    def _observables_are_there(self) -> "FitRecord":
        groups = (self, self.fresh_packings, *self.named_sets.values())
        for name in self.measured.targets:
            if any(name not in group.observables or name not in group.spread for group in groups):
                raise ValueError(f"{name} is measured, but a simulated value is missing")
        return self

    @property
    def met(self) -> bool:
        """Whether the fit missed nothing."""
        return not self.misses

    @property
    def misses(self) -> list[str]:
        """One sentence for each number that it missed."""
        return [str(miss) for miss in misses({k: f.model_dump() for k, f in self.features.items()})]

    def all_warnings(self) -> list[str]:
        """What its command warned of, or what results of earlier versions would; and every packing
        that failed."""
        said = self.warnings or [*self.misses, *(f"{n} ended at its bound" for n in self.at_bound)]
        failed = [
            f"packing {packing.seed} failed: {packing.failure}"
            for packing in (*self.packings.fitted, *self.packings.fresh)
            if packing.failure
        ]
        return [*said, *(sentence for sentence in failed if sentence not in said)]

    def start(self, name: str) -> float:
        """The value of a free parameter at which the fit began."""
        return float(self.history[0].parameters[name])
