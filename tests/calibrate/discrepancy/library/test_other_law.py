"""What other conventions of the contact law change, learned beside a library of runs."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibrate.cli import main
from calibrate.core.errors import InputError
from calibrate.core.progress import Silent
from calibrate.discrepancy.library import other_law, store
from calibrate.discrepancy.library.description import EmulatedLibrary
from calibrate.discrepancy.library.design import SHAPE_COLUMNS, Design
from calibrate.discrepancy.library.lab_size import HELD_SD, soil_prior_for
from calibrate.discrepancy.library.run_library import Cylinder, Rows, RunLibrary, features_of
from calibrate.io.lab import bundled_lab, load_lab
from studies.sealed.labels import EffectChange
from tests.support import toy_library
from tests.support.formulas import LAB

LAW = "liggghts"
PACKINGS = 10


def under_law(rows: Rows, library: RunLibrary) -> Rows:
    """Crushing a third stronger, and the more so the stiffer the soil; the mould as it is."""
    stronger = 1.3 * np.exp(0.15 * rows.base[:, :1])
    crushing = np.array([f.test == "unconfined" and f.unit == "N" for f in library.features])
    return replace(rows, values=np.where(crushing, stronger * rows.values, rows.values))


@pytest.fixture(scope="module")
def library() -> RunLibrary:
    """The toy library with rows of another law beside its own."""
    own = toy_library.library()
    points = own.design.plain_rows(PACKINGS, other_law.EACH)
    each = zip(points.base, points.packing, strict=True)
    runs = [toy_library.run(x[:2], np.zeros(3), 300 + j) for x, j in each]
    rows = under_law(Rows.of(own.cylinder, points, runs), own)
    return replace(own, other_laws={LAW: other_law.fitted(rows, own)})


@pytest.fixture(scope="module")
def emulated(library) -> EmulatedLibrary:
    return EmulatedLibrary.of(library)


def expected(soil: np.ndarray, library: RunLibrary, law: bool, gain: float = 0.0) -> np.ndarray:
    """Mean features (m,) of specimens of other packings."""
    strengths = np.array([gain, 0.0, 0.0])
    runs = [toy_library.run(soil, strengths, 800 + j) for j in range(40)]
    base = np.zeros((len(runs), len(library.design.base_names)))
    base[:, :2] = soil
    values = features_of(library.cylinder, base[:, SHAPE_COLUMNS], runs)
    every = Rows(base, np.tile(strengths, (len(runs), 1)), base[:, 0], values)
    return (under_law(every, library) if law else every).values.mean(axis=0)


@pytest.mark.parametrize("soil", [(0.0, 0.0), (0.3, -0.4), (-0.4, 0.3)])
def test_a_lab_is_told_what_its_own_conventions_change(emulated, soil):
    """The other law makes crushing 22 to 36 % stronger, and the mould stays as it is."""
    x, none = np.zeros(len(emulated.library.design.base_names)), np.zeros(3)
    x[:2] = np.array(soil) / emulated.library.design.spread()[:2]
    under = emulated.for_lab(LAB.following(LAW))
    found = under.emulator(x, none)[0] / emulated.emulator(x, none)[0]
    true = expected(np.array(soil), emulated.library, True)
    true = true / expected(np.array(soil), emulated.library, False)
    changed = true > 1.01
    assert changed.sum() > 10 and true[changed].min() > 1.2
    assert np.median(np.abs(found[changed] / true[changed] - 1)) < 0.05
    assert np.median(np.abs(found[~changed] - 1)) < 0.03


def test_effects_act_under_other_conventions_too(emulated):
    x, s = np.zeros(len(emulated.library.design.base_names)), np.array([0.5, 0.0, 0.0])
    under = emulated.for_lab(LAB.following(LAW))
    found = under.emulator(x, s)[0] / under.emulator(x, 0 * s)[0]
    own = emulated.emulator(x, s)[0] / emulated.emulator(x, 0 * s)[0]
    assert np.median(np.abs(found / own - 1)) < 0.03 < np.median(np.abs(own - 1))


def test_slopes_are_derivatives_under_other_conventions(emulated):
    emulator, rng = emulated.for_lab(LAB.following(LAW)).emulator, np.random.default_rng(5)
    x, s = 0.3 * rng.normal(size=emulator.x.shape[1]), 0.3 * rng.normal(size=3)
    step = 1e-6
    _, base, effects = emulator(x, s)
    for i in range(2):
        to = step * np.eye(len(x))[i]
        by_hand = (emulator(x + to, s)[0] - emulator(x - to, s)[0]) / (2 * step)
        np.testing.assert_allclose(base[:, i], by_hand, rtol=1e-4, atol=1e-6)
    assert effects.shape[1] == 3
    by_hand = (emulator(x, s + step * np.eye(3)[0])[0] - emulator(x, s)[0]) / step
    np.testing.assert_allclose(effects[:, 0], by_hand, rtol=1e-3, atol=1e-3)


def test_the_librarys_own_labs_hear_nothing_of_other_conventions(emulated):
    assert emulated.for_lab(LAB).emulator is emulated.emulator


def test_a_diagnosis_makes_the_emulator_of_conventions_once(emulated):
    lab = LAB.following(LAW)
    assert emulated.for_lab(lab).emulator is emulated.for_lab(lab).emulator
    again = emulated.for_lab(lab)
    assert again.for_lab(lab).emulator is again.emulator


def test_conventions_that_no_run_follows_are_refused(emulated):
    with pytest.raises(InputError, match=r"no run of the library follows .* 'liggghts_history'"):
        emulated.for_lab(LAB.following("liggghts_history"))


def test_rows_beside_a_library_survive_its_file(library, tmp_path: Path):
    store.save(toy_library.library(), tmp_path / "toy.nc")
    assert not store.load(tmp_path / "toy.nc").other_laws
    file = store.of_law(tmp_path / "toy.nc", LAW)
    store.save_law(library.other_laws[LAW], store.load(tmp_path / "toy.nc"), file)
    assert file.name == "toy.liggghts.nc"
    again, own = store.load(tmp_path / "toy.nc").other_laws[LAW], library.other_laws[LAW]
    np.testing.assert_allclose(again.rows.values, own.rows.values, rtol=1e-6)
    np.testing.assert_allclose(again.columns, own.columns)
    np.testing.assert_allclose(again.widening, own.widening)
    rows = toy_library.library().rows
    grown = replace(toy_library.library(), rows=replace(rows, values=1.01 * rows.values))
    store.save(grown, tmp_path / "toy.nc")
    with pytest.raises(InputError, match="beside another library, or an earlier state"):
        store.load(tmp_path / "toy.nc")


def test_a_label_tells_by_which_law_an_effect_is_seen(emulated):
    """Another code's label, whose soil is the centre's: crushing forces are those of its law."""
    label = {"hidden": [{"name": "load_cell_gain", "strength": 0.1}], "soil": {}}
    seen = [
        EffectChange.of(label | more, emulated, None).visible.description.mean
        for more in ({}, {"conventions": LAW})
    ]
    assert np.max(seen[1] / seen[0]) > 1.2


def test_held_parameters_stay_where_conventions_hold_them():
    """The prior of a lab, and the rows that are simulated."""
    lab = load_lab(bundled_lab()).following(LAW)
    design = replace(Design(), centre=other_law.centre_of(LAW, Design()))
    tensile = design.soil_names.index("tensile_exponent")
    assert design.centre["tensile_exponent"] == 1.0 and design.centre["rolling_friction"] == 0.3
    prior = soil_prior_for(lab, bare_library(design))
    assert prior.offset[tensile] == 0.0 and prior.prior_sd[tensile] == HELD_SD


def bare_library(design: Design) -> RunLibrary:
    """One row of a full design, of which only points are read."""
    lab, wide = load_lab(bundled_lab()), len(design.base_names)
    none = np.zeros((1, len(design.limits)))
    rows = Rows(np.zeros((1, wide)), none, np.zeros(1, int), np.zeros((1, 53)))
    return RunLibrary(design, Cylinder.of(lab), 1, rows, reference={})


def test_rows_are_simulated_under_the_conventions(monkeypatch, tmp_path: Path):
    asked = []

    def run_points(design, points, simulator, progress):
        asked.append((design, points, simulator))
        return [None] * len(points.base)

    monkeypatch.setattr(other_law, "run_points", run_points)
    other_law.simulate(LAW, Design(), load_lab(bundled_lab()), tmp_path, Silent(), packings=3)
    design, points, simulator = asked[0]
    assert simulator.lab.particles.conventions == LAW and not points.strengths.any()
    assert not points.base[:, design.soil_names.index("tensile_exponent")].any()
    assert points.base[:, design.soil_names.index("shear_modulus")].std() > 0.1
    assert len(set(points.seeds)) == 3 and len(points.base) == 3 * other_law.EACH
    pace = points.base[:, design.base_names.index("pace")]
    assert sorted(set(pace)) == pytest.approx([0.28125, 1.0])


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ([], "no library to lay them beside"),
        (["--onto", "FILE"], "every library follows 'eepa'"),
    ],
)
def test_a_wrong_request_for_conventions_is_refused_in_one_sentence(
    tmp_path, given, says, monkeypatch, capsys
):
    file = toy_library.write_library(tmp_path / "toy.nc")
    options = [str(file) if part == "FILE" else part for part in given]
    law = "eepa" if given else LAW
    monkeypatch.setattr(sys, "argv", ["calibrate", "library", "--conventions", law, *options])
    with pytest.raises(SystemExit):
        main()
    assert says in " ".join(capsys.readouterr().err.split())
