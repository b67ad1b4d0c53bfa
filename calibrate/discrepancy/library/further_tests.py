"""Further tests that a laboratory can make, what each explanation predicts for them, and what a
lab file holds of them.

    test again     f(delta + decades rho, c e)     the same emulator, under another condition: c
                                                   keeps effects away or scales them by the rate
    machine alone  the effects' own equations      no soil, so nothing of the base parameters:
                   steel block, return to zero, a known weight
    hold           -F rho decades + drift          what is lost at rest

Over decades of rate, rate dependence rho multiplies contact forces by exp(rho decades): stiffness
and surface energy move alike.  Costs are hours of a laboratory technician, a guess.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import jax.numpy as jnp
import numpy as np

from calibrate.discrepancy.comparison.further import FurtherTest, LinearResponse
from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.next_test import Outcome, Proposal
from calibrate.discrepancy.comparison.noise import Noise
from calibrate.discrepancy.library.instruments import emulator_of
from calibrate.discrepancy.library.lab_size import SHAPE_TOLERANCE
from calibrate.discrepancy.library.run_library import Cylinder
from calibrate.io.lab import Lab
from calibrate.labtests.base import AbstractLabTest
from calibrate.labtests.diagnosis.base import APART, Condition, Variation
from calibrate.labtests.diagnosis.contact import begins_before_contact, force_before_contact
from calibrate.labtests.diagnosis.curves import (
    TEST_FEATURES,
    TESTS,
    recorded_feature_values,
    tests_of,
)
from calibrate.labtests.machine import MachineTest
from calibrate.labtests.measured import Curve
from calibrate.labtests.measured import Cylinder as LabCylinder
from calibrate.labtests.reading import displacement_on_rise, loading
from calibrate.labtests.relaxation import RelaxationTest
from jdem.effects.base import AbstractEffect
from jdem.effects.composite import EFFECTS

FROM = 0.025  # share of the force from which displacement counts on the bare machine
SHARES = (0.05, 0.125, 0.25, 0.5, 0.95)  # of the force, where it is read
BLOCK_SD = 5e-3  # mm
AT_REST_SD = 0.3  # N, of a mean of many readings
RETURN_SD = 0.5  # N, of the difference of two of these and creep; assumed
WEIGHT_SD = 0.5  # N, of one reading with a weight on; assumed
WEIGHT = 200.0  # N, at most half the force: what a laboratory can lay on
HOLD = 60.0  # s
HOLD_SD = 1.5  # N
DECADES_OF_A_HOLD = 2.7  # of the rate that the soil feels, from 8 mm/s to a minute of rest
STILL_MM = 0.01  # within which a platen stands still
BEGINNING = 10  # of the readings of a hold, one in so many tells the force that it begins with
REPEATS = 2
RATE, GAP, COMPLIANCE = "rate_dependence", "seating_gap", "load_frame_compliance"
# A loose seat closes by another way each time, and not by its formula; a frame bends nearly so.
SEATING_SD, SHAPE_SD = 0.35, {GAP: 0.2, COMPLIANCE: 0.1}  # shares of the way; assumed
OFFSET, DRIFT, GAIN = "load_cell_offset", "load_cell_drift", "load_cell_gain"
ANSWER = "next_lab.toml"
CURVES = "next_{number}.csv"  # of repeats, from 1 on
HEAD = """# What `{command}` proposes: {name}.
# Put the curve of each repeat beside this file{filled}, then:
#   calibrate diagnose LAB.toml --further {file}

[soil]
name = "{soil}"

[specimen]
diameter = "{diameter:g} mm"
height = "{height:g} mm"

[[tests]]
{entries}
"""
CURVE = """
[[tests.curves]]
file = "{file}"
displacement = {{ column = "displacement", unit = "mm" }}
force = {{ column = "force", unit = "N" }}
"""
OF_NAME: Mapping[str, Callable[..., AbstractEffect]] = EFFECTS


@dataclass(frozen=True, eq=False)
class Varied:
    """The response of a test of the description under another condition: `rows` of its features."""

    description: Linearised
    rows: np.ndarray
    condition: Condition

    def __call__(self, delta: np.ndarray, strengths: np.ndarray):
        values, base, effects = self._moved.at(delta, strengths)
        return values[self.rows], base[self.rows], effects[self.rows]

    def wrong(self, delta: np.ndarray, strengths: np.ndarray) -> np.ndarray:
        return self._moved.wrong_at(delta, strengths)[self.rows]

    def scatter(self, strengths: np.ndarray) -> np.ndarray:
        return np.zeros((len(self.rows), len(self.rows)))

    def of_rows(self, keep: np.ndarray) -> "Varied":
        """The response of some of the features."""
        return Varied(self.description, self.rows[keep], self.condition)

    @cached_property
    def _moved(self) -> Linearised:
        """The description under this condition, its emulator's effects among them."""
        d, condition = self.description, self.condition
        factors = np.array([condition.factors.get(name, 1.0) for name in d.effect_names])
        faster = np.zeros((len(d.prior_sd), len(factors)))
        if condition.decades and RATE in d.effect_names:
            rate = d.effect_names.index(RATE)
            forces = [n in ("shear_modulus", "surface_energy") for n in d.base_names]
            faster[forces, rate] = condition.decades * d.effects[rate].typical
        if d.on is not None:
            on, few = d.on, (factors, faster)
            factors, faster = np.ones(len(on)), np.zeros((len(faster), len(on)))
            factors[on], faster[:, on] = few
        return replace(d, emulator=emulator_of(d).under(factors, faster))


def menu(
    d: Linearised, noise: Noise, rates: Mapping[str, float], force: float
) -> list[FurtherTest]:
    """All further tests that apply to a description; rates (m/s) of the tests made so far; `force`
    (N): of the machine alone and of a hold."""
    present = [test for test in TESTS if (tests_of(d.features) == test).any()]
    again = [
        replace(
            _again(d, noise, test, TEST_FEATURES[test].varied(v.faster, v.entries), v.name, v.cost),
            entries=_entries(test, v, rates[test]),
        )
        for test in present
        for v in TEST_FEATURES[test].variations
    ]
    weight = min(WEIGHT, force / 2)
    return [machine_alone(d, force, REPEATS, weight=weight), _hold(d, force, HOLD, REPEATS), *again]


def _entries(test: str, variation: Variation, rate: float) -> dict[str, str | bool]:
    """The table of a test again, in a lab file."""
    speed = f"{1e3 * rate * variation.faster:g} mm/s"
    return {"type": test, "name": variation.name, "rate": speed,
            **dict.fromkeys(variation.entries, True)}  # fmt: skip


def outcomes(lab: Lab, further: Sequence[Lab], cylinder: Cylinder, d: Linearised, noise: Noise):
    """What the lab's tests after the first two, and those of further lab files, have shown; and the
    names of tests that say nothing here."""
    first = {t.type_name: t for t in (lab.pair().compression, lab.pair().crushing)}
    found: list[Outcome] = []
    unused: list[str] = []
    for file, test in _after_the_pair(lab, further):
        curves = [curve for curve in file.curves if curve.test == test.called]
        one = _outcome(test, curves, file, first, cylinder, d, noise) if curves else None
        unused += [] if one else [test.called]
        found += [one] if one else []
    return found, unused


def _after_the_pair(lab: Lab, further: Sequence[Lab]) -> Iterator[tuple[Lab, AbstractLabTest]]:
    pair = (lab.pair().compression.called, lab.pair().crushing.called)
    yield from ((lab, test) for test in lab.tests if test.called not in pair)
    yield from ((file, test) for file in further for test in file.tests)


def _outcome(test, curves, file: Lab, first, cylinder: Cylinder, d: Linearised, noise: Noise):
    """The outcome of one test; None where the library knows nothing of it."""
    if isinstance(test, MachineTest):
        longer, wider = _to_size(file.specimen, cylinder)
        loads = (wider * test.force, len(curves), test.loading, wider * (test.weight or 0.0))
        rows = np.array([_of_machine(test, c) * _scale(longer, wider) for c in curves])
        return _known(machine_alone(d, *loads), rows)
    if isinstance(test, RelaxationTest) and not test.protocol:
        wider = _to_size(file.cylinder_of(test.called), cylinder)[1]
        held = _hold(d, wider * test.force, test.hold, len(curves))
        change = [_change_at_rest(c) for c in curves]
        return Outcome(held, wider * np.mean(change, keepdims=True))
    if test.type_name in first and not test.protocol and _of_shape(file, test, cylinder):
        name, (longer, wider) = test.type_name, _to_size(file.cylinder_of(test.called), cylinder)
        condition = TEST_FEATURES[name].condition(first[name], test)
        features = [d.features[i] for i in _of_test(d, name)]
        records = [(c.displacement_mm, c.force_n) for c in curves]
        begun = () if begins_before_contact(records) else (name,)
        scaled = ({name: (longer * x, wider * force)} for x, force in records)
        rows = [recorded_feature_values(features, curve, begun=begun) for curve in scaled]
        return _known(_again(d, noise, name, condition, test.called, 0.0), np.array(rows))
    return None


def _change_at_rest(curve: Curve) -> float:
    """By what the force (N) changes while the platen stands still."""
    still = curve.displacement_mm >= curve.displacement_mm.max() - STILL_MM
    force = curve.force_n[still]
    begun = max(len(force) // BEGINNING, 1)
    return float(force[-1] - force[:begun].max())


def _known(test: FurtherTest, rows: np.ndarray) -> Outcome | None:
    """The outcome of features that every repeat (n, m) shows; None if there are none."""
    keep = np.flatnonzero(np.isfinite(rows).all(axis=0))
    if not len(keep):
        return None
    assert isinstance(test.response, Varied | LinearResponse)
    some = replace(
        test, labels=tuple(test.labels[i] for i in keep), response=test.response.of_rows(keep),
        specimen=test.specimen[np.ix_(keep, keep)], repeats=len(rows),
        specimens=0 if test.rows is None else len(rows),
        rows=None if test.rows is None else test.rows[keep],
    )  # fmt: skip
    return Outcome(some, rows[:, keep].mean(axis=0))


def _to_size(own: LabCylinder, cylinder: Cylinder) -> tuple[float, float]:
    """What takes displacements and forces of a specimen to a cylinder's size."""
    return cylinder.height / own.height, (cylinder.diameter / own.diameter) ** 2


def _of_shape(file: Lab, test: AbstractLabTest, cylinder: Cylinder) -> bool:
    """Whether a test's specimen is as slender as a cylinder."""
    own = file.cylinder_of(test.called)
    slender = own.height / own.diameter / (cylinder.height / cylinder.diameter)
    return bool(abs(np.log(slender)) <= SHAPE_TOLERANCE)


def _scale(longer: float, wider: float) -> np.ndarray:
    return np.array([wider, wider, wider, *[longer] * len(SHARES)])


def _of_machine(test: MachineTest, curve: Curve) -> np.ndarray:
    """What a bare machine shows: reading at rest, by how much it returns elsewhere and that of the
    known weight is off (N), displacements (mm) from the first of its forces on, which count from
    the reading at rest; NaN: what a curve does not show."""
    force, before = test.force, force_before_contact(curve.force_n)
    at_rest = before if np.isfinite(before) else float(curve.force_n[0])
    after = force_before_contact(curve.force_n[::-1])  # in the air again
    off = np.nan if test.reads is None or test.weight is None else test.reads - test.weight
    rise = loading(curve.displacement_mm, curve.force_n - at_rest)
    places = displacement_on_rise(*rise, force * np.array([FROM, *SHARES]))
    return np.array([at_rest, after - before, off, *(places[1:] - places[0])])


def machine_alone(
    d: Linearised, force: float, repeats: int, loading: float = 60.0, weight: float = 0.0
) -> FurtherTest:
    """Loading on a steel block or the bare base to a force (N) within `loading` (s) and back, and a
    known weight (N) on the load cell."""
    labels = [
        "reading at rest, N", "change of it by the test, N", f"error at {weight:g} N of weights, N",
        *(f"displacement at {share * force:g} N, mm" for share in SHARES),
    ]  # fmt: skip
    once = WEIGHT_SD * np.sqrt(repeats)  # it is laid on once
    sd = np.array([AT_REST_SD, RETURN_SD, once, *[BLOCK_SD] * len(SHARES)])
    what = "steel block and a known weight" if weight else "steel block"
    columns = _slopes_of_machine(force, loading, weight)
    found = _without_soil(d, f"{what} in the machine", 1.0, labels, columns, sd, repeats)
    entries = {"type": MachineTest.type_name, "name": found.name, "force": f"{force:g} N"}
    entries |= {"weight": f"{weight:g} N", "reads": ""} if weight else {}
    return replace(found, entries=entries)


def _slopes_of_machine(force: float, loading: float, weight: float) -> dict[str, np.ndarray]:
    """What one unit of each effect changes in such a run (m,)."""
    forces = jnp.asarray([FROM * force, *(share * force for share in SHARES)])
    still = np.zeros(len(SHARES))
    columns = {
        OFFSET: np.array([1.0, 0.0, 1.0, *still]),
        DRIFT: np.array([0.0, 2 * loading, 0.0, *still]),
        GAIN: np.array([0.0, 0.0, weight, *still]),
    }
    for name in (COMPLIANCE, GAP):
        way = 1e3 * np.asarray(OF_NAME[name](1.0).travel_error(forces))
        columns[name] = np.array([0.0, 0.0, 0.0, *(way[1:] - way[0])])
    return columns


def _without_soil(d, name: str, cost: float, labels, columns, sd, repeats: int) -> FurtherTest:
    m = len(labels)
    slopes = np.zeros((m, len(d.effects)))
    for k, effect in enumerate(d.effects):
        if effect.name in columns:
            slopes[:, k] = columns[effect.name] * effect.typical
    names, still = d.effect_names, np.zeros((m, len(d.prior_sd)))
    whole = np.array([SEATING_SD / np.sqrt(repeats) if name == GAP else 0.0 for name in names])
    apart = np.array([SHAPE_SD.get(name, 0.0) for name in names])
    response = LinearResponse(np.zeros(m), still, slopes, whole, apart)
    noise = np.diag(np.broadcast_to(np.asarray(sd, float) ** 2, (m,)))
    return FurtherTest(name, cost, tuple(labels), response, noise, repeats)


def _hold(d: Linearised, force: float, hold: float, repeats: int) -> FurtherTest:
    """A hold in the mould; what it loses is not seen by the other effects."""
    decades = DECADES_OF_A_HOLD + np.log10(hold / HOLD)
    columns = {RATE: np.array([-force * decades]), DRIFT: np.array([hold])}
    label = f"change of force in a hold of {hold:g} s at {force:g} N, N"
    found = _without_soil(
        d, f"hold at {force:g} N for {hold:g} s", 1.0, [label], columns, HOLD_SD, repeats
    )
    entries = {"type": RelaxationTest.type_name, "name": found.name, "force": f"{force:g} N",
               "hold": f"{hold:g} s"}  # fmt: skip
    return replace(found, specimens=repeats, entries=entries)


def _again(
    d: Linearised, noise: Noise, test: str, condition: Condition, name: str, cost: float
) -> FurtherTest:
    """A test repeated on fresh specimens under another condition."""
    mine = _of_test(d, test)
    labels = tuple(d.features[i].name for i in mine)
    covariance = noise.specimen[np.ix_(mine, mine)]
    response = Varied(d, mine, condition)
    return FurtherTest(name, cost, labels, response, covariance, REPEATS, REPEATS, mine)


def _of_test(d: Linearised, test: str) -> np.ndarray:
    """Which features of a description a test shows again."""
    apart = np.array([feature.kind in APART for feature in d.features])
    return np.flatnonzero((tests_of(d.features) == test) & ~apart)


def answer_file(lab: Lab, proposal: Proposal) -> str:
    """A lab file that waits for the curves of a proposed test."""
    first = lab.pair().compression
    given = dict(proposal.entries)
    if given["type"] == first.type_name:  # pressed as far as the first
        given |= {n: f"{getattr(first, n):g} N" for n in ("force_low", "force_high")}
    size = {"diameter": 1e3 * lab.specimen.diameter, "height": 1e3 * lab.specimen.height}
    entries = "\n".join(f"{key} = {_toml(value)}" for key, value in given.items())
    filled = ', fill in `reads = ""`' if given.get("reads") == "" else ""
    head = HEAD.format(
        filled=filled,
        command="calibrate next", name=proposal.name, file=ANSWER, soil=lab.name.replace('"', "'"),
        entries=entries, **size,
    )  # fmt: skip
    return head + "".join(CURVE.format(file=CURVES.format(number=n)) for n in range(1, REPEATS + 1))


def _toml(value: str | bool) -> str:
    return str(value).lower() if isinstance(value, bool) else f'"{value}"'
