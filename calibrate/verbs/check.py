"""Read a lab file and say what it holds and what a fit would make of it; nothing is simulated."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rich.console import RenderableType
from rich.table import Table

from calibrate.core.errors import InputError
from calibrate.inference.parameters import not_held, ranges_of, space, stated_free
from calibrate.inference.problem import Problem, begun_late, pose
from calibrate.io.choices import unit_of
from calibrate.io.conventions import origin, said
from calibrate.io.lab import Lab, lab_of
from calibrate.io.soil import base_soil
from calibrate.labtests.base import AbstractLabTest
from calibrate.labtests.composite import label, names_of
from calibrate.verbs import options
from calibrate.verbs.base import AbstractResult, line, verb


@dataclass(frozen=True, eq=False, repr=False)
class CheckResult(AbstractResult):
    """What a lab file holds.

    Attributes:
        lab: the lab file, read.
        folder: where it is.
        content: tests, the numbers that a fit compares, starting values, warnings.
    """

    lab: Lab
    folder: Path
    content: dict

    @property
    def warnings(self) -> list[str]:
        """What to know before the lab file is used, one sentence each."""
        return self.content["warnings"]

    def words(self) -> Iterator[RenderableType]:
        found = self.content
        yield line(f"{found['soil']}: {found['file']}")
        for test in found["tests"]:
            size = "no specimen"
            if test["diameter_mm"]:
                size = (
                    f"a specimen {test['diameter_mm']:.4g} mm wide, {test['height_mm']:.4g} mm high"
                )
            given = f"{_count(test['curves'], 'curve')}, {_count(len(test['targets']), 'target')}"
            yield line(f"{test['name']}: {size}, {given}")
        yield self._numbers()
        yield line(f"contacts follow {said(self.lab.particles.conventions)}")
        yield self._parameters()
        yield line(_freed(found["free"], len(found["numbers"])))
        yield line(f"calibrate diagnose {found['diagnosis']}")
        yield from (line(f"warning: {sentence}") for sentence in self.warnings)

    def _numbers(self) -> Table:
        columns = ("", "measured", "± one repeat", "from")
        table = Table(*columns, title="numbers that a fit compares (mm or N)", title_justify="left")
        for name, row in self.content["numbers"].items():
            known = self.lab.targets.get(name)
            scatter = "" if known is None else f"{known.scatter:.2g}"
            source = f"{row['repeats']} {'curves' if known is None else 'repeats'}"
            called = name if known is None else label(name)
            table.add_row(called, f"{row['measured']:.4g}", scatter, source)
        return table

    def _parameters(self) -> Table:
        columns = ("", "value", "unit", "in a fit")
        table = Table(*columns, title="starting values", title_justify="left")
        for name, value in self.content["parameters"].items():
            role = "held" if name in self.content["held"] else "may be freed"
            role = "free" if name in self.content["free"] else role
            table.add_row(name, f"{value:.4g}", unit_of(name), role)
        return table


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"


def _freed(free: list[str], numbers: int) -> str:
    """Which parameters a fit frees, and how many of them the data can fix at most."""
    most = (
        f"{numbers} {'number fixes' if numbers == 1 else 'numbers fix'} as many parameters at most"
    )
    if free:
        return f"a fit frees {', '.join(free)}; {most}"
    return f"a fit chooses by its first simulations what it frees; {most}"


@verb
def check(lab: options.LabFile = None) -> CheckResult:
    """Reads a lab file and says what it holds and what a fit would make of it.

    Nothing is simulated and no file is written.

    Args:
        lab: a lab file's path, or what `load_lab` returned; None: the bundled soil.

    Returns:
        Tests, the numbers that a fit compares, starting values, warnings.

    Raises:
        InputError: the lab file is wrong, or holds nothing that a fit can compare.

    Example:
        >>> calibrate.check("my_soil.toml").warnings
    """
    read = lab_of(lab)
    problem, soil = pose(read), base_soil(read)
    chosen, law = read.parameters, read.particles.conventions
    content = {
        "soil": read.name,
        "file": read.file,
        "tests": [_test(read, test) for test in read.tests],
        "numbers": _compared(read, problem),
        **origin(law),
        "parameters": {name: float(soil.values()[name]) for name in ranges_of(read)},
        "free": [name for name, choice in chosen.items() if choice.free],
        "held": [name for name, choice in chosen.items() if choice.free is False],
        "diagnosis": _diagnosis(read),
        "warnings": [*begun_late(read), *_not_compared(read), *_refused(read)],
    }
    return CheckResult(read, Path(read.file).parent, content)


def _test(lab: Lab, test: AbstractLabTest) -> dict:
    """One test: its specimen (mm), its curves, its targets (mm or N)."""
    cylinder = lab.cylinder_of(test.called) if test.with_soil else None
    names = [name for (of, _), (name, _) in names_of(lab.tests).items() if of == test.called]
    return {
        "name": test.called,
        "diameter_mm": None if cylinder is None else 1e3 * cylinder.diameter,
        "height_mm": None if cylinder is None else 1e3 * cylinder.height,
        "curves": sum(curve.test == test.called for curve in lab.curves),
        "targets": {name: lab.targets[name].mean for name in names if name in lab.targets},
    }


def _compared(lab: Lab, problem: Problem) -> dict[str, dict]:
    """The numbers that a fit compares, in mm or N, and how many measurements are behind each."""
    rows = zip(problem.features, problem.measured, problem.repeats, strict=True)
    return {
        feature.name: {
            "measured": float(mean),
            "repeats": int(count) or lab.targets[feature.name].repeats,
        }
        for feature, mean, count in rows
    }


def _diagnosis(lab: Lab) -> str:
    """What `diagnose` does with the lab."""
    try:
        lab.pair()
    except InputError as error:
        return f"refuses it: {error.problem}; {error.repair}"
    return "takes it" if lab.curves else "names no effect, since the lab file has no curves"


def _refused(lab: Lab) -> Iterator[str]:
    """Why a fit would not begin: a start on or beyond its bounds."""
    try:
        space(lab, stated_free(lab) or not_held(lab))
    except InputError as error:
        yield f"a fit refuses {error.field}: {error.problem}; {error.repair}"


def _not_compared(lab: Lab) -> Iterator[str]:
    """Tests of which nothing was measured, nor in a later test on the same specimen."""
    called, measured = names_of(lab.tests), {c.test for c in lab.curves if c.compared}
    measured |= {test for (test, _), (name, _) in called.items() if name in lab.targets}
    for specimen in lab.specimens():
        names = [test.called for test in specimen.tests]
        last = max((place for place, name in enumerate(names) if name in measured), default=-1)
        for name in names[last + 1 :]:
            yield f"{name} has neither a target nor a curve: a fit simulates it in vain"
