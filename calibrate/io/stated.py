"""The tests that a lab file states, with where each of their targets and curves stands in it.

[[tests]]                          a list, each test with its targets and curves
[NAME] [targets] [[curves]] ...    plain tests, each in a table called after its type
"""

from dataclasses import dataclass
from typing import Any

from calibrate.core.errors import InputError, shown, suggestion
from calibrate.io.labfile import validated
from calibrate.io.tables import AbstractLabTables, targets_of
from calibrate.labtests.base import AbstractLabTest, Observable
from calibrate.labtests.composite import PLAIN, TYPES
from calibrate.labtests.measured import CurveTable, TargetTable

MOST_TESTS = 50


@dataclass(frozen=True)
class StatedTarget:
    """A target: the field it stands in, the number of its test, the observable, its table."""

    field: str
    test: int
    observable: Observable
    table: TargetTable


@dataclass(frozen=True)
class StatedCurve:
    """A curve: the field it stands in, the number of its test, its table."""

    field: str
    test: int
    table: CurveTable


@dataclass(frozen=True)
class StatedTests:
    """All tests of a lab file in their order, with what was measured in them."""

    tests: tuple[AbstractLabTest, ...]
    targets: tuple[StatedTarget, ...]
    curves: tuple[StatedCurve, ...]


def stated_tests(tables: AbstractLabTables, file: str) -> StatedTests:
    """The tests of a lab file; both ways at once are refused."""
    plain = [n for n in (*PLAIN, "targets", "curves") if n in tables.model_fields_set]
    if not tables.tests:
        return _plain_tests(tables, file)
    if plain:
        problem = f"there are [[tests]], too: which test is [{plain[0]}] of?"
        raise InputError(file, plain[0], problem, "put it into one of [[tests]]")
    return _listed_tests(tables, file)


def _plain_tests(tables: AbstractLabTables, file: str) -> StatedTests:
    """One test of every plain type, whether or not it has a table."""
    tests = [getattr(tables, name) or kind() for name, kind in PLAIN.items()]
    targets = [target for k, test in enumerate(tests) for target in _targets(test, k, test.called)]
    for k, test in enumerate(tests):
        tables_of = {o: getattr(targets_of(tables), o.short) for o in test.every()}
        given = {o: table for o, table in tables_of.items() if table is not None}
        targets += [StatedTarget(f"targets.{o.short}", k, o, table) for o, table in given.items()]
        tests[k] = test.asked_of({o.name: table for o, table in given.items()})
    curves = [curve for k, test in enumerate(tests) for curve in _curves(test, k, test.called)]
    for number, table in enumerate(tables.curves):
        field = f"curves[{number}]"
        curves.append(StatedCurve(field, _number_of(table, file, f"{field}.test"), table))
    return StatedTests(tuple(tests), tuple(targets), tuple(curves))


def _number_of(table: CurveTable, file: str, field: str) -> int:
    """Number of the plain test that a curve names."""
    known = list(PLAIN)
    if table.test is None:
        raise InputError(file, field, "missing", f'add test = "{known[0]}"')
    if table.test not in known:
        problem = f"{shown(table.test)} is no test of this file"
        repair = "give " + " or ".join(map(repr, known))
        raise InputError(file, field, problem, repair)
    return known.index(table.test)


def _listed_tests(tables: AbstractLabTables, file: str) -> StatedTests:
    if len(tables.tests) > MOST_TESTS:
        problem = f"{len(tables.tests)} tests are too many"
        raise InputError(file, "tests", problem, f"give at most {MOST_TESTS}")
    tests = [_listed(table, file, f"tests[{k}]") for k, table in enumerate(tables.tests)]
    for number, test in enumerate(tests):
        if test.called in [other.called for other in tests[:number]]:
            problem = f"two tests are called {shown(test.called)}"
            raise InputError(file, f"tests[{number}].name", problem, "give each its own name")
    targets = [t for k, test in enumerate(tests) for t in _targets(test, k, f"tests[{k}]")]
    curves = [c for k, test in enumerate(tests) for c in _curves(test, k, f"tests[{k}]")]
    for curve in curves:
        if curve.table.test not in (None, tests[curve.test].called):
            problem = f"{shown(curve.table.test)} is not the test that this curve is in"
            raise InputError(file, f"{curve.field}.test", problem, "leave it out")
    return StatedTests(tuple(tests), tuple(targets), tuple(curves))


def _listed(table: dict[str, Any], file: str, field: str) -> AbstractLabTest:
    """One of [[tests]]."""
    kind = table.get("type")
    if kind is None:
        raise InputError(file, f"{field}.type", "missing", f'add type = "{next(iter(TYPES))}"')
    if not isinstance(kind, str) or kind not in TYPES:
        repair = suggestion(kind if isinstance(kind, str) else "", TYPES)
        raise InputError(file, f"{field}.type", f"no type of test is called {shown(kind)}", repair)
    return validated(TYPES[kind], table, file, field)


def _targets(test: AbstractLabTest, number: int, field: str) -> list[StatedTarget]:
    return [
        StatedTarget(f"{field}.targets.{name}", number, test.observable(name), table)
        for name, table in test.targets.items()
    ]


def _curves(test: AbstractLabTest, number: int, field: str) -> list[StatedCurve]:
    return [
        StatedCurve(f"{field}.curves[{place}]", number, table)
        for place, table in enumerate(test.curves)
    ]
