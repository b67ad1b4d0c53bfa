"""All types of laboratory tests, and what several tests of one lab are called in results."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

from calibrate.labtests.ball import BallTest
from calibrate.labtests.base import AbstractLabTest, Observable, ResultChannel
from calibrate.labtests.confined import ConfinedTest
from calibrate.labtests.direct_shear import DirectShearTest
from calibrate.labtests.machine import MachineTest
from calibrate.labtests.oedometer import OedometerTest
from calibrate.labtests.penetration import ConeTest, PlateTest
from calibrate.labtests.relaxation import RelaxationTest
from calibrate.labtests.repose import ReposeTest
from calibrate.labtests.unconfined import UnconfinedTest
from calibrate.labtests.vane import VaneTest
from jdem.apparatus.base import AbstractApparatus

TYPES: Mapping[str, type[AbstractLabTest]] = {
    kind.type_name: kind
    for kind in (
        ConfinedTest,
        UnconfinedTest,
        OedometerTest,
        RelaxationTest,
        MachineTest,
        ConeTest,
        PlateTest,
        DirectShearTest,
        ReposeTest,
        BallTest,
        VaneTest,
    )
}  # fmt: skip
PLAIN = {name: kind for name, kind in TYPES.items() if kind.plain}
OBSERVABLES = {o.source: o for kind in TYPES.values() for o in kind.every()}  # by source
CHANNELS = {c.source: c for kind in TYPES.values() for c in kind.channels}  # by source
BY_NAME = {o.name: o for o in OBSERVABLES.values()} | {
    o.name: o for kind in TYPES.values() for o in kind.combined
}

# Of observables, given as (test, source): names in results, and factors there.
Called = dict[tuple[str, str], tuple[str, float]]


def names(given: Iterable[tuple[str, str]]) -> Called:
    """What observables, given as (test, source), are called in results, and their factors there.

    The test's name stands before that of an observable which several tests give; an observable
    that no type of test knows stays in SI.
    """
    pairs = list(given)
    sources = [source for _, source in pairs]
    found = {}
    for test, source in pairs:
        known = OBSERVABLES.get(source)
        name, factor = (known.name, known.scale) if known else (source, 1.0)
        found[test, source] = (name if sources.count(source) == 1 else f"{test}.{name}", factor)
    return found


def names_of(tests: Iterable[AbstractLabTest]) -> Called:
    """The same for the tests of a lab."""
    return names((test.called, o.source) for test in tests for o in test.given)


def names_observed(tests: Iterable[AbstractApparatus]) -> Called:
    """The same for virtual tests."""
    return names((test.name, source) for test in tests for source in test.observables)


def channel(source: str) -> ResultChannel:
    """What a recorded channel is called in results; one that no type of test knows stays in SI."""
    return CHANNELS.get(source, ResultChannel(source, source))


def described(name: str) -> Observable:
    """The observable of a name in results, whatever test it belongs to."""
    test, _, plain = name.rpartition(".")
    known = BY_NAME.get(plain)
    if known is None:
        return Observable(name, name.replace("_", " "), "", plain, 1.0, within=0.25)
    if not test:
        return known
    symbol = f"{known.symbol or known.label}, {test}"
    return replace(known, name=name, label=f"{known.label}, {test}", symbol=symbol)


def label(name: str) -> str:
    """An observable's label with its unit: "depression depth (mm)"."""
    known = described(name)
    return f"{known.label} ({known.unit})" if known.unit else known.label
