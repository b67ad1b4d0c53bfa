"""What all records share: numbers that may be missing, known names, provenance, measurements.

JSON has no NaN: what is not known stands there as null, and here as NaN.
"""

from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
)
from pydantic import model_validator as check
from pydantic_core import ErrorDetails

from calibrate.core.errors import BadValue, InputError, shown
from calibrate.core.files import as_json
from calibrate.io.choices import plain
from calibrate.io.labfile import PARAMETER_UNITS, read_file
from calibrate.labtests.base import AXES

LARGEST = 1e150  # larger numbers count as not known; squares of these are finite
RUN_AGAIN = "run the command that wrote it again (finished simulations are on disk)"


def _nan_for_null(value: Any) -> Any:
    return float("nan") if value is None else value


def _known_parameter(name: str) -> str:
    if plain(name) not in PARAMETER_UNITS:
        raise ValueError(f"{shown(name)} is no parameter")
    return name


def _of_this_world(value: float) -> float:
    return value if abs(value) <= LARGEST else float("nan")


Number = Annotated[float, BeforeValidator(_nan_for_null), AfterValidator(_of_this_world)]
Parameter = Annotated[str, AfterValidator(_known_parameter)]
Observable = str  # its name in results (`calibrate.labtests`)
Test = str  # its name in the lab file


class Record(BaseModel):
    """Part of a result; keys that we do not know are left alone."""

    model_config = ConfigDict(frozen=True, strict=True, extra="ignore")


class Origin(Record):
    """What made a result."""

    command: str
    soil: str
    preset: str
    versions: dict[str, str]
    physics: int = 0  # its version; 0 in files from before it had one


class Curve(Record):
    """Displacement (mm) and force (N) of one test of one specimen, as drawn."""

    displacement_mm: list[Number]
    force_n: list[Number]

    @staticmethod
    def of(points: np.ndarray) -> "Curve":
        """Of points (n, 2) in mm and N."""
        return Curve(displacement_mm=points[:, 0].tolist(), force_n=points[:, 1].tolist())

    @check(mode="after")
    def _same_length(self) -> "Curve":
        if len(self.displacement_mm) != len(self.force_n):
            raise ValueError("displacement_mm and force_n differ in length")
        return self


class MeasuredCurve(Curve):
    """A curve of the laboratory; `file` is its name in the lab file."""

    test: Test
    file: str


class Target(Record):
    """A measured observable: mean of `repeats` tests, standard deviation of one (mm or N), and the
    relative error of a published simulation."""

    mean: Annotated[float, Field(gt=0)]
    scatter: Annotated[float, Field(ge=0)]
    repeats: int
    published_error: float | None = None


class TestShown(Record):
    """What figures have to know of a test: its title, what its curve's columns are, whether its
    displacement counts from a seating force, the forces (N) that they mark, the observables that
    they show as forces."""

    __test__ = False  # for pytest

    title: str
    axes: Annotated[tuple[str, str], Field(strict=False)] = AXES  # also from a list
    seated: bool = True
    guides_n: list[Number] = []
    drawn: list[Observable] = []


class Measured(Record):
    """All that was compared with, and the tests in which it was measured."""

    targets: dict[Observable, Target]
    curves: list[MeasuredCurve] = []
    tests: dict[Test, TestShown]

    @check(mode="after")
    def _tests_are_known(self) -> "Measured":
        for curve in self.curves:
            if curve.test not in self.tests:
                raise ValueError(f"a curve is of {shown(curve.test)}, which tests do not have")
        return self


R = TypeVar("R", bound=Record)


def record(kind: type[R], content: dict) -> R:
    """The record of plain data as it would be read from its file."""
    return kind.model_validate_json(as_json(content))


def read(path: Path, kind: type[R]) -> R:
    """The record in a JSON file; `InputError` for the first thing that is wrong."""
    try:
        return kind.model_validate_json(read_file(path))
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"])
        raise InputError(str(path), field, _words(first), RUN_AGAIN) from None


def _words(error: ErrorDetails) -> str:
    """What pydantic says, for one who has never heard of it."""
    if error["type"] == "missing":
        return "missing: the file is of an earlier version or not of this kind"
    reason = error.get("ctx", {}).get("error")
    if isinstance(reason, BadValue):
        return reason.problem
    return error["msg"].removeprefix("Value error, ").replace("Input should be", "it should be")
