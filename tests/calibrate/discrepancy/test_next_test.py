"""`calibrate next` and what becomes of its answer: responses, the bare machine, lab files."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from calibrate.core.errors import InputError
from calibrate.discrepancy.comparison import next_test
from calibrate.discrepancy.comparison.compare import compare
from calibrate.discrepancy.comparison.further import LinearResponse, predicted
from calibrate.discrepancy.comparison.next_test import UNFORESEEN, Proposal, next_tests
from calibrate.discrepancy.comparison.probability_calibration import ProbabilityCalibration
from calibrate.discrepancy.diagnosis import described, prepared_diagnosis
from calibrate.discrepancy.library.description import EmulatedLibrary
from calibrate.discrepancy.library.further_tests import (
    ANSWER,
    FROM,
    SHARES,
    Varied,
    _of_machine,
    machine_alone,
    menu,
    outcomes,
)
from calibrate.io.lab import Lab, load_lab
from calibrate.labtests.diagnosis.base import Condition
from calibrate.labtests.diagnosis.curves import TEST_FEATURES
from calibrate.labtests.machine import MachineTest
from calibrate.labtests.measured import Curve
from jdem.apparatus.platen_on_base import PlatenOnBase
from jdem.effects.composite import EFFECTS
from jdem.laboratory.bare_machine import BareMachine
from jdem.laboratory.virtual_lab import TestSequence
from studies.sealed.further import Asking, FurtherLaboratory, under
from studies.sealed.laboratory import SpecimenRecords
from studies.sealed.plan import Hidden, WithheldCase
from studies.sealed.trial import InferenceSetup
from tests.support import toy_library
from tests.support.toy_library import call

jax.config.update("jax_enable_x64", True)

OFFSET = 10.0  # N
BLOCK_AND_WEIGHT = "steel block and a known weight in the machine"


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("next")
    toy_library.write_library(folder / "library.nc")
    toy_library.write_lab(folder / "lab", "toy", OFFSET)
    return folder


@pytest.fixture(scope="module")
def lab(place) -> Lab:
    return load_lab(place / "lab" / "lab.toml")


@pytest.fixture(scope="module")
def prepared(lab):
    """Description, measured sample and null distributions of the toy laboratory."""
    emulated = EmulatedLibrary.of(toy_library.library())
    _, d, measured = described(lab, emulated, 0)
    return d, measured, prepared_diagnosis(d, measured, 0, ProbabilityCalibration(), 100)


@pytest.fixture(scope="module")
def known(prepared):
    """Description, measured sample and comparison of the toy laboratory."""
    d, measured, nulls = prepared
    return d, measured, compare(nulls, measured)


def block(readings: np.ndarray) -> Curve:
    """A curve of the bare machine: columns mm, N."""
    return Curve("steel block", readings[:, 0], readings[:, 1], "block.csv")


@pytest.mark.parametrize(
    ("name", "strength"),
    [("load_frame_compliance", 2e-7), ("seating_gap", 3e-4), ("load_cell_offset", 7.0),
     ("load_cell_drift", 0.014), ("load_cell_gain", -0.02)],
)  # fmt: skip
def test_a_bare_machine_shows_what_its_response_predicts(name, strength, known):
    """The virtual machine, whose equations are those of `jdem.laboratory.bare_machine`."""
    d, _, _ = known
    press, effect = PlatenOnBase(force=400.0, loading=60.0), EFFECTS[name](strength)
    (reading,) = BareMachine(TestSequence((press,)), (effect,)).run().values()
    curve = np.column_stack([1e3 * reading.curve.displacement, reading.curve.force])
    in_air = [np.repeat(curve[[row]], 9, axis=0) for row in (0, -1)]
    weighed = 200 + float(effect.force_error(jnp.asarray(200.0), jnp.asarray(0.0)))
    test = MachineTest.model_validate({"weight": "200 N", "reads": f"{weighed} N"})
    candidate = replace(d.effects[0], name=name, typical=1.0)
    alone = replace(d, effects=(candidate,), effect_slopes=d.effect_slopes[:, :1], emulator=None)
    known_weight = machine_alone(alone, 400.0, 1, weight=200.0)
    told = known_weight.response(np.zeros(len(d.prior_sd)), np.array([strength]))[0]
    found = _of_machine(test, block(np.concatenate([in_air[0], curve, in_air[1]])))
    assert found == pytest.approx(told, abs=0.02 if name == "load_cell_offset" else 2e-3)
    assert np.abs(told).max() > 0.02


def test_a_seat_that_closes_otherwise_than_its_formula_is_still_foreseen(known):
    """A bilinear seat that closes at 40 N, and by a third more than the first tests told; both
    repeats of a frame bend alike."""
    d, measured, comparison = known
    gap = replace(d.effects[0], name="seating_gap", typical=1e-3)
    alone = replace(d, effects=(gap,), effect_slopes=0 * d.effect_slopes[:, :1], emulator=None)
    unseen = np.zeros((len(d.mean), 1))  # by the first tests
    fit = replace(comparison.base, chosen=(0,), strengths=np.array([0.9]), effect_slopes=unseen)
    test = machine_alone(alone, 400.0, 2)
    forces = 400.0 * np.array([FROM, *SHARES])
    way = 1.2 * np.clip(forces / 40.0, 0.0, 1.0)
    found = np.array([0.0, 0.0, 0.0, *(way[1:] - way[0])])
    told = predicted(test, alone, fit, measured.mean)
    without_seat = predicted(test, alone, replace(fit, strengths=np.zeros(1)), measured.mean)
    assert told.p_value(found) > UNFORESEEN
    assert without_seat.p_value(found) < 1e-3 * UNFORESEEN
    bends = replace(gap, name="load_frame_compliance", typical=1e-6)
    frame = replace(alone, effects=(bends,))
    stiff = machine_alone(frame, 400.0, 2).response
    assert isinstance(stiff, LinearResponse)
    scatter = stiff.scatter(np.ones(1))
    assert np.count_nonzero(scatter - np.diag(np.diag(scatter))) == 0 < scatter.max()


def test_a_machine_test_without_a_weight_or_a_return_tells_the_rest(known, lab, place):
    """A curve that ends at its largest force, and no known weight; the load cell is so far from
    zero that it shows the first of the forces in the air already."""
    d, _, comparison = known
    folder = place / "no_weight"
    folder.mkdir()
    write_block(folder, 12.0)
    cylinder = toy_library.library().cylinder
    ((outcome,), unused) = outcomes(
        lab, [load_lab(folder / "block.toml")], cylinder, d, comparison.noise
    )
    assert outcome.test.name == "steel block in the machine" and not unused
    assert len(outcome.found) == 1 + len(SHARES) == len(outcome.test.labels)
    assert outcome.found == pytest.approx([12.0, *np.zeros(len(SHARES))])
    slopes = outcome.test.response(np.zeros(len(d.prior_sd)), np.zeros(len(d.effects)))[2]
    assert slopes.shape == (1 + len(SHARES), len(d.effects))


@pytest.mark.parametrize(
    ("entries", "field"),
    [('weight = "200 N"', "reads"), ('reads = "200 N"', "weight"),
     ('weight = "200 N"\nreads = ""', "reads")],
)  # fmt: skip
def test_a_weight_comes_with_its_reading(entries, field, tmp_path):
    write_block(tmp_path, 0.0)
    text = BLOCK.replace('force = "400 N"', f'force = "400 N"\n{entries}')
    (tmp_path / "block.toml").write_text(text)
    with pytest.raises(InputError, match=field):
        load_lab(tmp_path / "block.toml")


def test_slopes_under_another_condition_are_derivatives(known):
    d, _, _ = known
    rows = np.arange(0, len(d.features), 5)
    again = Varied(d, rows, Condition({"load_cell_gain": 0.5}, 0.0))
    delta = 0.1 * np.arange(len(d.prior_sd)) / len(d.prior_sd)
    strengths, step = np.array([0.3, 0.2, 0.1]), 1e-4
    values, base, effects = again(delta, strengths)
    assert values == pytest.approx(d.at(delta, strengths * [0.5, 1, 1])[0][rows])
    for k in range(3):
        ahead, back = (again(delta, strengths + s * step * np.eye(3)[k])[0] for s in (1, -1))
        scale = np.abs(effects[:, k]).max()
        assert effects[:, k] == pytest.approx((ahead - back) / (2 * step), abs=2e-3 * scale)
    ahead, back = (again(delta + s * step * np.eye(len(delta))[0], strengths)[0] for s in (1, -1))
    assert base[:, 0] == pytest.approx((ahead - back) / (2 * step), rel=1e-3, abs=1e-3)


def test_conditions_follow_from_tables_of_tests(lab):
    first = lab.pair().compression
    slower = first.model_copy(update={"rate": 0.1 * first.rate, "fresh_grease": True})
    found = TEST_FEATURES["confined"].condition(first, slower)
    assert found.factors == {"acquisition_lag": pytest.approx(0.1), "wall_friction": 0.0}
    assert found.decades == pytest.approx(-1.0)
    crushing = lab.pair().crushing
    quick = crushing.model_copy(update={"rate": 10 * crushing.rate})
    assert TEST_FEATURES["unconfined"].condition(crushing, quick).factors == {
        "load_cell_drift": pytest.approx(0.1)
    }


def test_every_offer_can_come_back(known, lab):
    d, _, comparison = known
    for offer in menu(d, comparison.noise, lab.pair().rates, 400.0):
        assert {"type", "name"} <= set(offer.entries), offer.name


def test_a_run_of_the_first_test_again_reads_as_the_first(known, lab):
    """The same curves as a further test: their outcome is the measured mean."""
    d, measured, comparison = known
    curves = tuple(replace(c, test="again") for c in lab.curves if c.test == "confined")
    again = lab.pair().compression.model_copy(update={"name": "again"})
    more = replace(lab, tests=(again,), curves=curves)
    (found,), unused = outcomes(lab, [more], toy_library.library().cylinder, d, comparison.noise)
    assert not unused and found.test.repeats == 4
    assert found.found == pytest.approx(measured.specimens[:, found.test.rows].mean(axis=0))


def test_a_further_specimen_of_another_shape_is_not_used(known, lab):
    d, _, comparison = known
    curves = tuple(replace(c, test="again") for c in lab.curves if c.test == "confined")
    again = lab.pair().compression.model_copy(update={"name": "again"})
    short = replace(lab.specimen, height=0.5 * lab.specimen.height)
    more = replace(lab, tests=(again,), curves=curves, specimen=short)
    cylinder = toy_library.library().cylinder
    assert outcomes(lab, [more], cylinder, d, comparison.noise) == ([], ["again"])


@pytest.fixture(scope="module")
def proposed(place) -> Path:
    out = place / "proposed"
    options = ("--library", place / "library.nc", "--out", out)
    assert call("next", place / "lab" / "lab.toml", *options) == 0
    return out


def test_next_writes_a_list_a_drawing_and_a_lab_file(proposed):
    found = json.loads((proposed / "next.json").read_text())
    gains = [test["gain_nats"] for test in found["tests"]]
    assert gains == sorted(gains, reverse=True) and gains[0] >= 0
    assert all(0 <= test["chance"] <= 1 and test["cost"] > 0 for test in found["tests"])
    drawn = ElementTree.parse(proposed / "figures" / "next_test.svg").getroot()
    assert drawn.tag.endswith("svg")
    written = (proposed / ANSWER).read_text()
    (proposed / ANSWER).write_text(written.replace('reads = ""', 'reads = "201 N"'))
    for number in (1, 2):
        rows = [f"{0.1 * k:.1f},{50 * k}" for k in range(10)]
        (proposed / f"next_{number}.csv").write_text("\n".join(["displacement,force", *rows]))
    assert load_lab(proposed / ANSWER).tests[0].called == found["tests"][0]["name"]


BLOCK = """[soil]
name = "toy"
[specimen]
diameter = "50 mm"
height = "100 mm"
[[tests]]
type = "machine"
name = "steel block"
force = "400 N"
[[tests.curves]]
file = "block.csv"
displacement = { column = "mm", unit = "mm" }
force = { column = "N", unit = "N" }
"""


def offset_after(place: Path, reading: float) -> dict:
    """What a diagnosis says with a bare machine that shows a reading (N) at rest."""
    folder = place / f"block_{reading:g}"
    folder.mkdir()
    write_block(folder, reading)
    options = ("--library", place / "library.nc", "--out", folder / "out")
    more = ("--further", folder / "block.toml")
    assert call("diagnose", place / "lab" / "lab.toml", *options, *more) == 0
    return json.loads((folder / "out" / "result.json").read_text())


def write_block(folder: Path, reading: float) -> None:
    """A lab file of a bare machine that shows a reading (N) at rest."""
    (folder / "block.toml").write_text(BLOCK)
    force = np.concatenate([np.full(40, reading), np.linspace(reading, 400, 80)])
    way = np.concatenate([np.linspace(-0.5, 0, 40), np.zeros(80)])
    rows = [f"{x:.4f},{f:.2f}" for x, f in zip(way, force, strict=True)]
    (folder / "block.csv").write_text("\n".join(["mm,N", *rows]))


@pytest.mark.slow
def test_an_answer_comes_back_as_a_lab_file_and_moves_the_verdict(place):
    """A machine that reads the offset at rest without soil, and one that reads nothing."""
    seen, unseen = offset_after(place, OFFSET), offset_after(place, 0.0)
    assert seen["further_tests"]["tests"] == ["steel block in the machine"]
    assert seen["further_tests"]["foreseen"]

    def share(found: dict) -> float:
        every = found["which"]["probability"]
        return sum(p for name, p in every.items() if "load_cell_offset" in name)

    assert share(seen) > 0.95 > 0.05 > share(unseen)
    page = (place / f"block_{OFFSET:g}" / "out" / "diagnosis.html").read_text()
    assert "Further tests (steel block in the machine)" in page


# ---------------------------------------------------------------- the laboratory behind the seal


def sealed_case(*hidden: Hidden, soil: dict | None = None) -> WithheldCase:
    return WithheldCase(
        name="0a1b2", kind="single", stratum="", snr=3.0, hidden=hidden,
        soil={"shear_modulus": 1e6, "surface_energy": 5.0} if soil is None else soil, spheres=1100,
        porosity=0.005, packings=tuple(range(16)), seed=7, nonce="",
    )  # fmt: skip


class FakeLaboratory:
    """Hands out curves whose force says which specimen of which soil was asked for."""

    def __init__(self):
        self.asked: list[tuple[WithheldCase, range]] = []

    def specimens(self, case: WithheldCase, numbers: range) -> list[SpecimenRecords]:
        self.asked.append((case, numbers))
        way = np.linspace(0.0, 5.0, 60)
        curves = [np.column_stack([way, number + 10 * way]) for number in numbers]
        return [SpecimenRecords(dict.fromkeys(("confined", "unconfined"), c), 1.0) for c in curves]


@pytest.fixture(scope="module")
def proposal_of(known, prepared, lab) -> Callable[[str], Proposal]:
    """What is proposed of the further test of a name; each is weighed once."""
    d, measured, comparison = known
    offers = menu(d, comparison.noise, lab.pair().rates, 400.0)

    @cache
    def proposal(name: str) -> Proposal:
        chosen = [offer for offer in offers if offer.name == name]
        (found,) = next_tests(prepared[-1], comparison, measured.mean, chosen)
        return found

    return proposal


def test_a_test_again_is_made_on_fresh_specimens_under_its_condition(proposal_of, lab, tmp_path):
    fake = FakeLaboratory()
    made = FurtherLaboratory(fake, tmp_path)  # pyright: ignore
    case = sealed_case(Hidden("wall_friction", 0.3), Hidden("load_cell_gain", 0.1))
    greased = proposal_of("confined test in a freshly greased mould")
    answer = made.answer(case, lab, greased)
    again = made.answer(case, lab, greased)
    assert answer is not None and again is not None
    ((asked, numbers),) = fake.asked  # the second answer is the first
    assert asked.hidden == (Hidden("wall_friction", 0.0), Hidden("load_cell_gain", 0.1))
    assert numbers.start >= 4 and len(numbers) == 2
    assert answer.tests[0].called == greased.name and answer.tests[0].force_high == 400.0
    means = [curve.force_n.mean() for curve in again.curves]
    assert means == pytest.approx([number + 25.0 for number in numbers], abs=0.1)


def test_rates_change_the_soil_that_depends_on_them():
    case = sealed_case(Hidden("rate_dependence", 0.1), Hidden("acquisition_lag", 0.02))
    slow = under(case, TEST_FEATURES["confined"].varied(0.1, ()))
    assert slow.soil["shear_modulus"] == pytest.approx(1e6 * np.exp(-0.1))
    assert [h.strength for h in slow.hidden] == pytest.approx([0.1, 0.002])
    quick = under(case, TEST_FEATURES["unconfined"].varied(10.0, ()))
    assert quick.soil["surface_energy"] == pytest.approx(5.0 * np.exp(0.1))


@pytest.mark.parametrize(
    ("hidden", "change"),
    [((), 0.0), ((Hidden("rate_dependence", 0.02),), -400 * 0.02 * 2.7),
     ((Hidden("load_cell_drift", 0.2),), 12.0)],
)  # fmt: skip
def test_a_hold_shows_what_is_lost_and_what_drifts(
    hidden, change, known, proposal_of, lab, tmp_path
):
    """The answer's curves through the file into an outcome."""
    d, _, comparison = known
    made = FurtherLaboratory(FakeLaboratory(), tmp_path)  # pyright: ignore
    asked = proposal_of("hold at 400 N for 60 s")
    answer = made.answer(sealed_case(*hidden), lab, asked)
    assert answer is not None
    cylinder = toy_library.library().cylinder
    (found,), _ = outcomes(lab, [answer], cylinder, d, comparison.noise)
    assert found.found == pytest.approx([change], abs=3.0)


def test_a_bare_machine_answers_with_its_faults(known, proposal_of, lab, tmp_path):
    d, _, comparison = known
    made = FurtherLaboratory(FakeLaboratory(), tmp_path)  # pyright: ignore
    asked = proposal_of(BLOCK_AND_WEIGHT)
    case = sealed_case(
        Hidden("load_cell_offset", 6.0), Hidden("load_frame_compliance", 1e-6),
        Hidden("load_cell_drift", 0.02), Hidden("load_cell_gain", 0.03),
    )  # fmt: skip
    answer = made.answer(case, lab, asked)
    assert answer is not None
    cylinder = toy_library.library().cylinder
    (found,), _ = outcomes(lab, [answer], cylinder, d, comparison.noise)
    stretch = 1e3 * 1e-6 * 400 * (np.array(SHARES) - FROM)
    assert found.found[:3] == pytest.approx([6.0, 0.02 * 120, 200 * 0.03 + 6.0], abs=1.5)
    assert found.found[3:] == pytest.approx(stretch, abs=0.02)


def test_the_loop_asks_takes_in_and_stops(place, lab, monkeypatch):
    """An offset of the load cell, on which the bare machine has the last word; asked for although
    the first tests have told it nearly."""
    monkeypatch.setattr(next_test, "WORTH", 0.0)
    toy_library.with_few_draws(monkeypatch)
    asked: list[str] = []

    def answer(proposal: Proposal) -> Lab | None:
        asked.append(proposal.name)
        if proposal.name != BLOCK_AND_WEIGHT:
            return None
        folder = place / "answered"
        folder.mkdir(exist_ok=True)
        write_block(folder, OFFSET)
        return load_lab(folder / "block.toml")

    emulated = EmulatedLibrary.of(toy_library.library())
    loop = Asking.of(lab, emulated, InferenceSetup(ProbabilityCalibration()), answer)
    said = loop.by_proposals()
    assert asked and len(said) <= 2 and said[0]["verdict"] == loop.first.verdict
    cheap = loop.all_cheap()
    assert sum(p for n, p in cheap["by_class"].items() if "load_cell_offset" in n) > 0.9
    drawn = loop.at_random([3])
    assert drawn == loop.at_random([3]) and drawn[-1]["test"] == BLOCK_AND_WEIGHT
