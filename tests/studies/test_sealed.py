"""Withheld cases: recording, files, seal, canary.

No specimen is simulated: curves are formulas, verdicts are written by hand.
"""

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from calibrate.core.errors import InputError
from calibrate.core.progress import Silent
from calibrate.discrepancy.library.description import EmulatedLibrary
from calibrate.discrepancy.library.design import CENTRE
from calibrate.discrepancy.library.run_library import Cylinder
from calibrate.io.lab import load_lab
from calibrate.simulation import Here
from studies.sealed import laboratory, run
from studies.sealed.__main__ import sealed_command
from studies.sealed.labels import FEWEST_CHANGES, with_visibility
from studies.sealed.laboratory import READINGS, recorded, write_case
from studies.sealed.outside import ATMOSPHERE, PORES, air_force
from studies.sealed.plan import (
    PACKINGS,
    SPECIMENS,
    Hidden,
    Visibility,
    WithheldCase,
    relative_error,
)
from studies.sealed.seal import HASHES, LABELS, canary, digest, open_seal, write_seal
from tests.support import formulas, toy_library
from tests.support.toy_library import SEAT, label, specimens, there_and_back, verdict

FEATURES = Cylinder(0.05, 0.1, 200.0, 400.0).features()

# ---------------------------------------------------------------- recording


@pytest.fixture
def quiet(monkeypatch):
    """Readings without noise."""
    monkeypatch.setattr(laboratory, "FORCE_SD", 0.0)
    monkeypatch.setattr(laboratory, "DISPLACEMENT_SD", 0.0)


def test_a_quiet_record_lies_on_the_curve_after_a_way_through_the_air(quiet):
    way, force = recorded(there_and_back(), 0.0, np.random.default_rng(0)).T
    assert len(way) == READINGS
    turn = int(force.argmax())
    up = slice(np.flatnonzero(force > 20)[0], turn - 1)
    assert np.polyfit(way[up], force[up], 1)[0] == pytest.approx(100, abs=0.2)
    down = slice(turn + 2, np.flatnonzero(force > 20)[-1])
    assert np.polyfit(way[down], force[down], 1)[0] == pytest.approx(400, abs=2)
    contact = way[turn] - force[turn] / 100
    low, high = laboratory.GAP_MM
    assert low - 0.05 < contact - way[0] < high + 0.05
    assert abs(way[0]) <= laboratory.ZERO_MM + 0.05


def test_an_untared_load_cell_shows_before_contact(quiet):
    force = recorded(there_and_back() + np.array([0.0, 7.0]), 7.0, np.random.default_rng(0))[:, 1]
    assert force[:8] == pytest.approx(7.0)


def test_noise_scatters_readings_as_stated():
    flat = np.column_stack([np.linspace(0, 4, 50), np.zeros(50)])
    records = [recorded(flat, 0.0, np.random.default_rng(seed))[:, 1] for seed in range(20)]
    assert np.std(records) == pytest.approx(laboratory.FORCE_SD, rel=0.05)  # of 3200 readings


def test_trapped_air_is_compressed_by_boyle():
    """Air fills 20 % of the volume; at a strain of 5 % it has 15 % left: p0 (0.20/0.15 - 1)."""
    area = np.pi * 0.05**2 / 4
    assert PORES == 0.2 and ATMOSPHERE == 101325.0
    expected = 101325.0 * (0.20 / 0.15 - 1) * area
    force = air_force(np.array([0.0, 5.0]), 0.1, 0.05, 1.0)
    assert np.asarray(force) == pytest.approx([0.0, expected])
    assert float(air_force(5.0, 0.1, 0.05, 0.25)) == pytest.approx(expected / 4)


# ---------------------------------------------------------------- files


def test_a_written_case_reads_back_as_it_was_measured(tmp_path):
    made = specimens(1)
    write_case("0a1b2", made, CENTRE, tmp_path / "0a1b2")
    lab = load_lab(tmp_path / "0a1b2" / "lab.toml")
    assert [c.test for c in lab.curves] == ["confined"] * 4 + ["unconfined"] * 4
    for number, curve in enumerate(lab.curves):
        record = made[number % 4].records[curve.test]
        assert np.column_stack([curve.displacement_mm, curve.force_n]) == pytest.approx(record)
    assert lab.density_kg_m3 == pytest.approx([s.density for s in made], abs=0.5)
    assert set(lab.parameters) == set(CENTRE) and not lab.targets


def test_all_cases_have_the_same_form(tmp_path):
    """Same files, rows and digits whatever the curves are; lab files differ in name and density."""
    forms, texts = set(), set()
    for seed, stiff in enumerate((0.5, 1.0, 3.0)):
        folder = tmp_path / f"{seed:05x}"
        write_case(folder.name, specimens(seed, stiff), CENTRE, folder)
        files = sorted(folder.glob("*.csv"))
        lines = [file.read_text().splitlines() for file in files]
        assert all(re.fullmatch(r"-?\d+\.\d{3},-?\d+\.\d", line) for n in lines for line in n[1:])
        forms.add((*(f.name for f in files), *(len(n) for n in lines), *(n[0] for n in lines)))
        texts.add(re.sub(r"density = .*|name = .*", "", (folder / "lab.toml").read_text()))
    assert len(forms) == 1 and len(texts) == 1


def test_a_denser_specimen_is_a_bed_of_less_porosity(tmp_path):
    """Solid share 0.557 at 1100 spheres: 0.4 % denser is 0.0022 less porosity, 0.002 in steps."""
    there = laboratory.Laboratory(tmp_path, CENTRE)
    case = WithheldCase("a", "none", "", 0.0, (), dict(CENTRE), 1100, 0.0, (0,), 1, "")
    loose, density = there._filled(case, 0.004)
    assert loose == pytest.approx(-0.002) and density == pytest.approx(0.002 / 0.557, rel=0.01)
    assert there._filled(case, -0.004) == pytest.approx((-loose, -density))
    assert there._filled(replace(case, spheres=2200), 0.0004) == (0.0, 0.0)


# ---------------------------------------------------------------- specimens held back


def test_specimens_held_back_have_packings_of_their_own(tmp_path, monkeypatch):
    """Shrinkage is checked on packings of the plan that no diagnosis has seen."""
    used = {}

    class Standing:
        def __init__(self, *_):
            pass

        def specimens(self, case, numbers):
            used.setdefault(case.name, []).extend(case.packings[number] for number in numbers)
            return None if numbers.start == 7 else specimens(1, count=len(numbers))  # one collapses

    monkeypatch.setattr(run, "Laboratory", Standing)
    planned = run._plan(tmp_path, cast(EmulatedLibrary, None), {"none": 2}, 1)
    names = [attempts[0].name for attempts in planned]
    for name in names:
        (tmp_path / "sealed" / f"{name}.attempt").write_text("0")
    fits = {"features": ["peak force, unconfined"], "base": [0.0], "best": [200.0], "weight": [1.0]}
    said = {name: {"claimed": {}, "fits": fits} for name in names}
    said[names[0]]["claimed"] = {"shrinkage": 0.5, "low": 0.4, "high": 0.6}
    said[names[1]]["claimed"] = {"shrinkage": 0.5, "low": 0.2, "high": 0.9}  # shows nothing
    labels = {name: {"kind": "single", "snr": 5.0} for name in names}
    found = run._fresh(tmp_path, said, labels, Silent())
    assert list(found) == list(used) == names[:1]
    case = planned[0][0]
    assert len(used[case.name]) == PACKINGS - SPECIMENS > 0
    assert not set(used[case.name]) & set(case.packings[:4])
    assert len(set(case.packings)) == PACKINGS


# ---------------------------------------------------------------- seal


def test_a_changed_label_is_refused(tmp_path):
    sealed = [label("b", "none"), label("a", "single", "wall_friction")]
    write_seal(sealed, tmp_path)
    assert open_seal(tmp_path) == {entry["case"]: entry for entry in sealed}
    path = tmp_path / LABELS
    path.write_text(path.read_text().replace("wall_friction", "acquisition_lag"))
    with pytest.raises(InputError, match="do not match"):
        open_seal(tmp_path)


@pytest.mark.parametrize("missing", [LABELS, HASHES])
def test_a_seal_without_a_file_is_refused_in_one_sentence(missing, tmp_path):
    write_seal([label("a", "none")], tmp_path)
    (tmp_path / missing).unlink()
    with pytest.raises(InputError, match="cannot be read"):
        open_seal(tmp_path)


def test_a_missing_label_is_refused(tmp_path):
    write_seal([label("a", "none"), label("b", "none")], tmp_path)
    (tmp_path / LABELS).write_text(json.dumps([label("a", "none")]))
    with pytest.raises(InputError, match="do not match"):
        open_seal(tmp_path)


def test_a_hash_hides_its_label():
    assert digest(label("a", "none")) != digest({**label("a", "none"), "nonce": "0" * 64})


@pytest.fixture
def judged(tmp_path) -> Path:
    """Three cases with their verdicts and both lists of hashes, as a benchmark leaves them."""
    sealed = [label("00001", "single", "seating_gap"), label("00002", "none", snr=0.0),
              label("00003", "outside", "trapped_air", snr=0.0)]  # fmt: skip
    said = {"00001": SEAT, "00002": "wall_friction", "00003": "unknown"}
    for number, name in enumerate(said):
        write_case(name, specimens(number), CENTRE, tmp_path / "cases" / name)
        (tmp_path / "verdicts").mkdir(exist_ok=True)
        (tmp_path / "verdicts" / f"{name}.json").write_text(json.dumps(verdict(name, said[name])))
    write_seal(sealed, tmp_path)
    files = sorted((tmp_path / "verdicts").glob("*.json"))
    hashes = [f"{hashlib.sha256(f.read_bytes()).hexdigest()}  {f.stem}\n" for f in files]
    (tmp_path / "verdicts.sha256").write_text("".join(hashes))
    return tmp_path


NO_LIBRARY: Any = None  # labels with a signal-to-noise need none


def test_opening_scores_what_was_judged(judged):
    result, rows = run.opened(judged, judged, NO_LIBRARY, 0, Silent(), fresh=False)
    assert [r.verdict == r.truth for r in rows] == [True, False, True]
    assert result["accuracy_by_snr"]["above 6"]["value"] == 1.0
    assert result["false_alarm"]["value"] == 1.0 and result["unknown_recall"]["value"] == 1.0
    assert result["canary"]["right"] is None  # too few to tell
    assert json.loads((judged / "withheld.json").read_text())["cases"] == 3


def test_a_changed_verdict_is_refused(judged):
    path = judged / "verdicts" / "00002.json"
    path.write_text(path.read_text().replace("wall_friction", "none"))
    with pytest.raises(InputError, match="changed after it was stated"):
        run.opened(judged, judged, NO_LIBRARY, 0, Silent(), fresh=False)
    with pytest.raises(InputError, match="changed after it was stated"):
        run._state(judged)  # what `judge` ends with


# ---------------------------------------------------------------- canary


def case_folders(folder: Path, count: int) -> list[Path]:
    random = np.random.default_rng(5)
    names = [f"{n:05x}" for n in random.permutation(2**20)[:count]]
    for number, name in enumerate(names):
        write_case(name, specimens(number, count=1), CENTRE, folder / name)
    return [folder / name for name in names]


def test_the_canary_finds_a_planted_leak_and_no_other(tmp_path):
    """Every other case gets trailing blanks in its files, which no reader of curves notices."""
    folders = case_folders(tmp_path, 40)
    kinds = ["none", "single"] * 20
    honest = canary(folders, kinds, seed=0)
    assert honest["p_value"] > 0.05
    for folder in folders[::2]:
        for file in folder.glob("*.csv"):
            file.write_text(file.read_text() + "\n" * 200)
    caught = canary(folders, kinds, seed=0)
    assert caught["right"] > 0.9 and caught["p_value"] < 0.01
    assert caught["shuffled"] == pytest.approx(0.5, abs=0.1)
    shuffled = list(np.random.default_rng(1).permutation(kinds))
    assert canary(folders, shuffled, seed=0)["p_value"] > 0.05


# ---------------------------------------------------------------- signal-to-noise


def nothing_absorbed() -> Any:
    """A soil at which calibration absorbs nothing, features in units of scatter."""
    generator = SimpleNamespace(projected=lambda changes: changes)
    plain: Any = SimpleNamespace(generator=generator, left=np.linalg.norm)
    plain.scatter = lambda changes: Visibility.scatter(plain, changes)
    plain.length = lambda change: Visibility.length(plain, change)
    return plain


def test_calibration_leaves_less_of_a_change_that_another_soil_makes():
    """A change to what the library says of another soil is absorbed, but for its prior; a bent
    one is not absorbed by a line."""
    visible = Visibility(EmulatedLibrary.of(toy_library.library()), toy_library.CENTRE)
    d, none = visible.description, np.zeros(3)
    here = d.at(np.zeros(len(d.prior_sd)), none)[0]
    shift = np.zeros(len(d.prior_sd))
    shift[0] = 1.5 * d.prior_sd[0]
    change = d.at(shift, none)[0] - here
    assert visible.left(change) <= 1.6
    assert visible.left(0.0 * change) == pytest.approx(0.0, abs=1e-6)
    assert visible.left(-0.9 * here) > 10


def test_a_realised_signal_is_free_of_what_packings_differ_by():
    """Changes of length 5, each packing off by a normal deviate of 3 in all of 40 directions: the
    squared length of their mean is 25 + 9 40/4."""
    random, truth = np.random.default_rng(2), np.zeros(40)
    truth[:2] = 3.0, 4.0
    plain = nothing_absorbed()
    draws = [truth + 3 * random.standard_normal((4, 40)) for _ in range(400)]
    squares = [Visibility.realised(plain, changes) ** 2 for changes in draws]
    naive = [np.sum(changes.mean(axis=0) ** 2) for changes in draws]
    assert np.mean(naive) == pytest.approx(25 + 9 * 40 / 4, rel=0.05)
    assert np.mean(squares) == pytest.approx(25, abs=4)


def drawn_changes(slips: float, rng) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A predicted change of length 5, the true one, wrong by 0.8 of that across many directions,
    and what four packings show of it; in one case of five one of them slips."""
    predicted, wrong = np.zeros(40), rng.standard_normal(40)
    predicted[:2] = 3.0, 4.0
    truth = predicted + 0.8 * 5 / np.sqrt(40) * wrong
    changes = truth + rng.standard_normal((4, 40))
    changes[0] += slips * (rng.random() < 0.2) * rng.standard_normal(40)
    return predicted, truth, changes


@pytest.mark.parametrize("slips", [0.0, 20.0])
def test_an_expected_signal_lies_between_the_predicted_and_the_true_one_whatever_packings_do(slips):
    rng, plain = np.random.default_rng(3), nothing_absorbed()
    cases = [drawn_changes(slips, rng) for _ in range(300)]
    length = [Visibility.length(plain, p) for p, _, _ in cases]
    scatter = [Visibility.scatter(plain, c) for _, _, c in cases]
    away = [Visibility.length(plain, c.mean(axis=0) - p) for p, _, c in cases]
    error = relative_error(length, scatter, away)
    assert error == pytest.approx(0.8**2, rel=0.1)
    estimated = np.array([Visibility.expected_snr(plain, c, p, error) for p, _, c in cases])
    plainly = np.array([np.linalg.norm(c.mean(axis=0)) for _, _, c in cases])
    true = np.array([np.linalg.norm(t) for _, t, _ in cases])
    wrong = error * 25
    expected = 25 + wrong**2 / (wrong + np.array(scatter))  # the share of the error that is known
    assert np.mean(estimated**2) == pytest.approx(np.mean(expected), rel=0.05)
    assert 5 < np.sqrt(np.mean(estimated**2)) < np.sqrt(np.mean(true**2))
    assert np.abs(estimated - true).max() < 3
    if slips:
        assert np.abs(plainly - true).max() > 30


def test_without_scatter_the_simulated_change_is_expected_and_without_error_the_predicted_one():
    predicted, simulated = np.array([3.0, 4.0]), np.array([[6.0, 8.0]] * 3)
    plain = nothing_absorbed()
    assert Visibility.scatter(plain, simulated) == 0.0
    assert Visibility.expected_snr(plain, simulated, predicted, 0.5) == pytest.approx(10.0)
    assert Visibility.expected_snr(plain, simulated, predicted, 0.0) == pytest.approx(5.0)
    assert relative_error([25.0], [9.0], [4.0]) == 0.0


def test_changes_are_those_of_the_same_packings_with_and_without(tmp_path, monkeypatch):
    """An effect that doubles all forces; one packing does not stand without it."""
    made = laboratory.Laboratory(tmp_path, CENTRE)
    hidden = (Hidden("load_cell_gain", 1.0),)
    case = WithheldCase("a", "single", "2-6", 3.0, hidden, dict(CENTRE), 130, 0.0,
                        tuple(range(8)), 1, "")  # fmt: skip

    def specimen(case, number):
        run = formulas.specimen(formulas.BASE, number)
        factor = 2.0 if case.hidden else 1.0
        twice = replace(
            run, curves={**run.curves, "unconfined": run.curves["unconfined"] * [1.0, factor]}
        )
        return (None if number == 2 and not case.hidden else twice), 0.0

    monkeypatch.setattr(made, "_specimen", specimen)
    changes = made.changes(case)
    peak = [f.name for f in FEATURES].index("peak force, unconfined")
    expected = [
        formulas.specimen(formulas.BASE, n).curves["unconfined"][:, 1].max() for n in (0, 1, 3)
    ]
    assert changes[:, peak] == pytest.approx(expected, rel=1e-3)  # averaged over a window
    confined = [i for i, f in enumerate(FEATURES[:-2]) if f.test == "confined"]
    assert not changes[:, confined].any()


def test_a_feature_that_one_simulation_lacks_hides_no_other():
    """As large a change of the other features is as visible as where that feature never was."""
    emulated = EmulatedLibrary.of(toy_library.library())
    change = 40.0 * np.ones(len(FEATURES) - 2)
    lacking = change.copy()
    lacking[[0, 5]] = np.nan
    rows = [[None if x != x else x for x in row] for row in (change, lacking)]
    air = [{"name": "trapped_air", "strength": 0.5}]
    label = {"kind": "outside", "hidden": air, "soil": toy_library.CENTRE, "planned_snr": 0.0}
    found = with_visibility({"a": {**label, "changes": rows}}, emulated, None)["a"]["snr"]
    seen = np.isfinite(lacking)
    visible = Visibility(emulated, toy_library.CENTRE, seen=seen)
    assert found == pytest.approx(visible.realised(np.array([change[seen]] * 2)))
    assert found > 0.5
    none = with_visibility({"a": {**label, "changes": []}}, emulated, None)["a"]["snr"]
    assert none == 0.0


def test_a_label_with_changes_tells_how_visible_its_effect_was():
    emulated, strengths = EmulatedLibrary.of(toy_library.library()), {"load_cell_gain": 0.1}
    visible = Visibility(emulated, toy_library.CENTRE)
    change = visible.change(strengths)
    hidden = [{"name": name, "strength": value} for name, value in strengths.items()]
    air = [{"name": "trapped_air", "strength": 0.5}]
    label = {"kind": "single", "soil": toy_library.CENTRE, "planned_snr": 3.0}
    found = with_visibility(
        {
            "as predicted": {**label, "hidden": hidden, "changes": [change.tolist()] * 3},
            "one packing": {**label, "hidden": hidden, "changes": [change.tolist()]},
            "no packing": {**label, "hidden": hidden, "changes": []},
            "outside": {**label, "hidden": air, "changes": [(2 * change).tolist()] * 2},
            "another code": {"kind": "single", "soil": {}, "hidden": hidden},
            "outside of another code": {"kind": "outside", "hidden": air},
            "nothing": {**label, "hidden": [], "changes": [(0 * change).tolist()] * 3},
            "told": {**label, "snr": 7.0, "hidden": hidden},
        },
        emulated,
        None,
    )
    estimated = {name: entry["snr"] for name, entry in found.items()}
    assert (
        estimated["as predicted"] == pytest.approx(visible.left(change))
        and estimated["as predicted"] > 1
    )
    assert (estimated["one packing"], estimated["nothing"], estimated["told"]) == (3.0, 0.0, 7.0)
    assert (estimated["no packing"], estimated["outside of another code"]) == (3.0, 0.0)
    assert estimated["outside"] == pytest.approx(visible.left(2 * change))
    assert 1 < estimated["another code"] < estimated["as predicted"]  # three specimens


def test_cases_with_the_same_effect_are_pooled_for_the_error_of_predictions():
    """Four packings show twice what the library predicts, scattering; a sixth case is quiet."""
    emulated, strengths = EmulatedLibrary.of(toy_library.library()), {"load_cell_gain": 0.1}
    visible, rng = Visibility(emulated, toy_library.CENTRE), np.random.default_rng(1)
    change = visible.change(strengths)
    hidden = [{"name": name, "strength": value} for name, value in strengths.items()]
    label = {"kind": "single", "soil": toy_library.CENTRE, "planned_snr": 3.0, "hidden": hidden}
    twice = [2 * change * (1 + 0.05 * rng.standard_normal((4, 1))) for _ in range(5)]
    labels = {str(i): {**label, "changes": rows.tolist()} for i, rows in enumerate(twice)}
    few = {name: labels[name] for name in "0123"}
    alone, estimated = (with_visibility(some, emulated, None) for some in (few, labels))
    assert alone["0"]["snr"] == pytest.approx(visible.left(change), rel=1e-3)
    assert estimated["0"]["snr"] == pytest.approx(visible.left(2 * change), rel=0.1)


def test_a_half_made_set_goes_on_from_its_cases_and_seals(tmp_path, monkeypatch):
    """Its simulations may be gone."""
    case = WithheldCase(
        name="0a1b2", kind="single", stratum="", snr=3.0, hidden=(Hidden("seating_gap", 1e-3),),
        soil={}, spheres=1100, porosity=0.005, packings=tuple(range(8)), seed=7, nonce="",
    )  # fmt: skip
    asked = []

    class FakeLaboratory:
        def __init__(self, folder, centre, place):
            pass

        def specimens(self, case):
            return specimens(3)

        def changes(self, case, packings):
            asked.append(packings)
            return np.ones((len(packings), 2))

    monkeypatch.setattr(run, "Laboratory", FakeLaboratory)
    monkeypatch.setattr(run, "_plan", lambda *any: [[case]])
    library = cast(EmulatedLibrary, None)
    run.generate(tmp_path, library, None, None, Silent())
    sealed = (tmp_path / HASHES).read_text()
    run.generate(tmp_path, library, None, None, Silent())
    assert asked == [range(FEWEST_CHANGES)] and (tmp_path / HASHES).read_text() == sealed
    assert open_seal(tmp_path)["0a1b2"]["changes"] == [[1.0, 1.0]] * FEWEST_CHANGES
    (tmp_path / "sealed" / "0a1b2.changes").write_text("[[2.0, 2.0]]")
    with pytest.raises(InputError, match="no longer give the labels that were sealed"):
        run.generate(tmp_path, library, None, None, Silent())


def test_a_place_for_many_is_given_all_cases_at_once(tmp_path, monkeypatch):
    """The second case lies out of range at its first attempt.  Specimens without the effect come
    last, none for the case that hides nothing; what was simulated ahead is asked for again."""
    first = WithheldCase(
        name="0a1b2", kind="single", stratum="", snr=3.0, hidden=(Hidden("seating_gap", 1e-3),),
        soil={}, spheres=1100, porosity=0.005, packings=tuple(range(8)), seed=7, nonce="",
    )  # fmt: skip
    far, near = (replace(first, name="0a1b3", hidden=(), seed=seed) for seed in (8, 9))
    ahead = []

    class FakeLaboratory:
        def __init__(self, folder, centre, place):
            assert place is there

        def simulate(self, wanted, progress):
            ahead.append([(case.name, case.seed, bool(case.hidden), k) for case, k in wanted])

        def specimens(self, case):
            return None if case is far else specimens(3)

        def changes(self, case, packings):
            return np.ones((len(packings) if case.hidden else 0, 2))

    there = Here()
    monkeypatch.setattr(run, "Laboratory", FakeLaboratory)
    monkeypatch.setattr(run, "_plan", lambda *any: [[first, first], [far, near]])
    library = cast(EmulatedLibrary, None)
    run.generate(tmp_path, library, None, None, Silent(), place=there)
    every = range(SPECIMENS)
    assert ahead == [
        [("0a1b2", 7, True, k) for k in every] + [("0a1b3", 8, False, k) for k in every],
        [("0a1b3", 9, False, k) for k in every],
        [("0a1b2", 7, False, k) for k in range(FEWEST_CHANGES)],
    ]
    assert (tmp_path / "sealed" / "0a1b3.attempt").read_text() == "1"


def test_given_cases_are_not_made(tmp_path):
    with pytest.raises(InputError, match="nothing to make where cases are given"):
        sealed_command(given=tmp_path, judge=False)
