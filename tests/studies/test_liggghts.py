"""The cases that another code computed: files, seal, recipe, measuring chain, referee.

Nothing here needs LIGGGHTS but the last test, which is skipped without it.
"""

import json
import math
import shutil
import tarfile
import tomllib
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from calibrate.core.errors import InputError
from calibrate.io.lab import load_lab
from studies.liggghts import instrument, labfiles, referee
from studies.liggghts.cases import plan
from studies.liggghts.effects import BY_NAME, LIBRARY, OUTSIDE, Setup
from studies.liggghts.physics import BASE_LAW, Physics, layer_factors, materials, trapped_air_force
from studies.liggghts.soil import MEAN_DIAMETER, PLATEN, TYPES, Soil, draw_soil
from studies.liggghts.specimen import Run, run
from studies.sealed.labels import normalised
from studies.sealed.seal import digest, open_seal, write_seal

pytestmark = pytest.mark.thorough

ARCHIVE = Path(referee.__file__).parents[1] / "results" / "withheld_liggghts.tar.xz"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """The newest sealed set, unpacked."""
    place = tmp_path_factory.mktemp("liggghts")
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(place, filter="data")
    return place


@pytest.fixture(scope="module")
def cases(folder) -> list[Path]:
    return sorted(path.parent for path in folder.glob("cases/*/lab.toml"))


# ---------------------------------------------------------------- the files


def test_every_case_reads_as_a_lab_file(cases):
    assert len(cases) == 44
    for case in cases:
        lab = load_lab(case / "lab.toml")
        assert Counter(curve.test for curve in lab.curves) == {"confined": 3, "unconfined": 3}
        assert all(len(curve.force_n) == instrument.READINGS for curve in lab.curves)
        for curve in lab.curves:
            if curve.test == "confined":
                assert 330 < curve.force_n.max() < 460
                assert curve.displacement_mm.argmax() < len(curve.force_n) - 5  # it turns back
            else:
                assert np.ptp(curve.displacement_mm) > 8


def test_a_case_is_written_as_the_committed_ones_were(tmp_path, cases):
    """Name, densities and height are the specimens' own; all else stands in every lab file."""
    row = np.zeros(instrument.READINGS)
    record = instrument.Record(row, row, row)
    specimens = [labfiles.Specimen(300.0, height, record, record) for height in (90.0, 91.0, 92.0)]
    labfiles.write_case("0a1b2c3d", specimens, tmp_path)
    written, committed = (
        tomllib.loads((case / "lab.toml").read_text()) for case in (tmp_path, cases[0])
    )
    soil, cylinder = written.pop("soil"), written.pop("specimen")
    assert soil["name"] == "soil 0a1b2c3d" and cylinder.pop("height") == "91.0 mm"
    committed.pop("soil")
    committed["specimen"].pop("height")
    assert cylinder == committed.pop("specimen")
    assert written["particles"]["conventions"] == "liggghts"
    assert written == committed


def test_runs_of_three_specimens_become_a_case(tmp_path):
    """Straight curves: 400 N at 8 mm are 1 mm for each 50 N; crushing ends at 200 N."""
    way = np.linspace(0, 8e-3, 2001)
    up, down = np.column_stack([way, 5e4 * way]), np.column_stack([way, 5e4 * way])[::-1]
    crushing = np.column_stack([way, 200 * np.minimum(way / 4e-3, 1)])
    one = Run(True, 0.09, 0.18, np.concatenate([up, down]), crushing, {})
    assert one.depth_mm() == pytest.approx(1e3 * (396 - 200) / 5e4, rel=1e-6)
    assert one.crushing_n() == pytest.approx(200, rel=1e-9)
    random = np.random.default_rng(0)
    specimens = [labfiles.measured(one, instrument.Instrument(), random) for _ in range(3)]
    labfiles.write_case("0a1b2c3d", specimens, tmp_path)
    lab = load_lab(tmp_path / "lab.toml")
    assert lab.particles.conventions == "liggghts"
    largest = {c.test: c.force_n.max() for c in lab.curves}
    assert largest["confined"] == pytest.approx(400, abs=15)
    assert largest["unconfined"] == pytest.approx(200, abs=3)


def test_all_cases_look_alike_from_outside(cases):
    def outside(case: Path) -> tuple:
        names = tuple(sorted(path.name for path in case.iterdir()))
        rows = tuple(len((case / name).read_text().splitlines()) for name in names)
        return names, rows, (case / "confined_1.csv").read_text().splitlines()[0]

    assert len({outside(case) for case in cases}) == 1


def test_labels_match_the_published_hashes(folder, cases):
    assert sorted(open_seal(folder)) == [case.name for case in cases]


def metadata(case: Path) -> np.ndarray:
    """What can be known of a case without its curves."""
    lab = load_lab(case / "lab.toml")
    density = lab.density_kg_m3
    return np.array([np.mean(density), np.ptp(density), lab.specimen.height, int(case.name, 16)])


def neighbour_accuracy(features: np.ndarray, labels: np.ndarray) -> float:
    """Balanced accuracy of the three nearest other cases' vote."""
    scaled = (features - features.mean(0)) / features.std(0)
    distance = np.linalg.norm(scaled[:, None] - scaled[None], axis=-1)
    np.fill_diagonal(distance, np.inf)
    votes = labels[np.argsort(distance, axis=1)[:, :3]].mean(1) > 0.5
    return float(np.mean([np.mean(votes[labels == kind] == kind) for kind in (0, 1)]))


def test_metadata_do_not_tell_whether_something_is_hidden(folder, cases):
    labels = open_seal(folder)
    hidden = np.array([len(labels[case.name]["effects"]) > 0 for case in cases]).astype(int)
    features = np.array([metadata(case) for case in cases])
    seen = neighbour_accuracy(features, hidden)
    random = np.random.default_rng(0)
    chance = [neighbour_accuracy(features, random.permutation(hidden)) for _ in range(400)]
    assert np.mean(np.array(chance) >= seen) > 0.01


# ---------------------------------------------------------------- the recipe


@pytest.mark.parametrize("factor", [3.0, -3.0])
def test_friction_on_platens_is_told_as_it_is_realised(factor):
    label = {"kind": "library", "effects": [
        {"name": "platen_friction", "strength": factor, "unit": "1"}
    ]}  # fmt: skip
    (told,) = normalised(label)["hidden"]
    realised = BY_NAME["platen_friction"].realise(Setup(Soil()), factor).soil.platen_friction
    assert told["strength"] == pytest.approx(realised - Soil().platen_friction)


def test_a_plan_follows_from_its_seed_and_is_mixed_from_the_start():
    first, again, other = plan(67, 5), plan(67, 5), plan(67, 6)
    assert first == again
    assert not {case.name for case in first} & {case.name for case in other}
    kinds = Counter(case.kind for case in first)
    assert kinds["none"] >= 15
    names = Counter(case.hidden[0].name for case in first if case.kind in ("library", "outside"))
    assert set(names) == set(BY_NAME) and min(names.values()) >= 3
    start = Counter(case.kind for case in first[:34])
    assert abs(start["none"] - kinds["none"] / 2) <= 2


def test_strengths_cover_their_thirds_and_both_signs():
    random = np.random.default_rng(0)
    for effect in (*LIBRARY, *OUTSIDE):
        drawn = np.array([[effect.draw(random, third) for third in range(3)] for _ in range(30)])
        size = np.abs(drawn)
        assert size.min() >= effect.weak and size.max() <= effect.strong
        assert (size[:, :-1].max(0) <= size[:, 1:].min(0)).all()
        assert (drawn.min() < 0) == effect.signed


def test_a_strong_plan_takes_single_effects_from_the_upper_third():
    single = [case.hidden[0] for case in plan(67, 5, thirds=(2,)) if len(case.hidden) == 1]
    ranges = [(BY_NAME[h.name], abs(h.strength)) for h in single]
    assert len(single) > 40
    assert all(size >= e.weak * (e.strong / e.weak) ** (2 / 3) for e, size in ranges)


def test_every_effect_changes_the_set_up():
    for effect in BY_NAME.values():
        assert effect.realise(Setup(Soil()), effect.strong) != Setup(Soil())


def test_soils_stay_within_their_limits_and_differ():
    random = np.random.default_rng(1)
    moduli = [draw_soil(random).shear_modulus for _ in range(50)]
    assert 5.5e6 <= min(moduli) < max(moduli) <= 13e6


def test_a_label_cannot_be_guessed_from_its_hash(tmp_path):
    case = plan(20, 1)[0]
    label = case.label(0)
    assert digest(label) != digest({**label, "nonce": "0" * 32})
    write_seal([label], tmp_path)
    assert open_seal(tmp_path) == {case.name: label}
    sealed = tmp_path / "sealed" / "labels.json"
    sealed.write_text(sealed.read_text().replace('"attempt":0', '"attempt":1'))
    with pytest.raises(InputError, match="do not match"):
        open_seal(tmp_path)


# ---------------------------------------------------------------- LIGGGHTS' input


def property_values(text: str, name: str) -> np.ndarray:
    """The numbers of one property line, after its kind (and its count, for pairs)."""
    words = next(line.split() for line in text.splitlines() if f" {name} " in line)
    return np.array(words[7 if words[5] == "peratomtypepair" else 6 :], float)


def test_parameters_keep_their_meaning_in_the_other_code():
    text = materials(Soil(), Physics())
    moduli = property_values(text, "youngsModulus")
    assert moduli[:-1] == pytest.approx(2 * 8.5e6 * 1.3)  # the last is crushed spheres
    energy = property_values(text, "surfaceEnergy").reshape(TYPES, TYPES)
    assert energy[0, 0] == pytest.approx(17 * MEAN_DIAMETER / 80e-6, rel=1e-5)
    assert not energy[PLATEN - 1].any() and (energy == energy.T).all()
    ratio = property_values(text, "UnloadingStiffness")
    assert 1 - 1 / ratio == pytest.approx(0.7, rel=1e-5)


def test_soft_platens_touch_nothing_but_platens():
    hard, soft = (materials(Soil(), Physics(platen_modulus=e)) for e in (None, 5e6))
    changed = property_values(hard, "youngsModulus") != property_values(soft, "youngsModulus")
    assert changed.nonzero()[0].tolist() == [PLATEN - 1]


def test_a_gradient_keeps_the_mean():
    factors = layer_factors(Physics(gradient=0.4))[[0, 3, 4, 5, 6]]
    assert factors.mean() == pytest.approx(1) and np.ptp(factors) == pytest.approx(0.8)


def test_trapped_air_follows_boyle():
    whole = Physics(trapped_air=1.0)
    travel = 0.5 * 0.11 * 0.1  # half of the pore air's volume, in a specimen of 0.1 m
    force = trapped_air_force(whole, np.array([0.0, travel]), 0.1)
    assert force == pytest.approx([0.0, 101325 * math.pi * 0.025**2])


# ---------------------------------------------------------------- the measuring chain


QUIET = {"noise_force": 0.0, "noise_displacement": 0.0}


def ramp() -> tuple[np.ndarray, np.ndarray]:
    """Up to 4 mm and 400 N and back, as a straight line."""
    way = np.concatenate([np.linspace(0, 4e-3, 2001), np.linspace(4e-3, 0, 2001)[1:]])
    return way, 1e5 * way


def read(**chain: float) -> instrument.Record:
    quiet = instrument.Instrument(**{**QUIET, **chain})
    way, force = ramp()
    return instrument.record(way, force, 8e-3, quiet, 0.0, np.random.default_rng(0))


def test_a_perfect_chain_reads_the_curve():
    seen = read()
    assert len(seen.force) == instrument.READINGS
    turn = int(np.argmax(seen.force))
    assert np.delete(seen.force, [turn, turn + 1]) == pytest.approx(
        np.delete(100 * seen.displacement, [turn, turn + 1]), abs=0.2
    )


def test_gain_offset_and_drift_act_on_the_force():
    plain, seen = read(), read(gain=0.1, offset=5.0, drift=3600.0)
    expected = 1.1 * plain.force + 5.0 + plain.time
    assert seen.force == pytest.approx(expected, abs=0.2)


def test_a_lag_delays_a_ramp_by_its_time_constant():
    plain, seen = read(), read(lag=0.02)
    rising = slice(30, 50)  # long after the start: y = rate (t - lag)
    assert plain.force[rising] - seen.force[rising] == pytest.approx(800 * 0.02, abs=0.5)


def test_a_loose_seat_adds_its_travel_and_stays_closed():
    random = np.random.default_rng(3)
    _, force = ramp()
    travel = instrument.seat_travel(force, 1e-3, random)
    assert travel[0] == 0 and travel[-1] == 0
    assert travel.max() == pytest.approx(travel[2000]) == pytest.approx(travel[3000])


# ---------------------------------------------------------------- the referee


def test_a_contact_force_above_its_strength_crushes_a_sphere_for_good(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    strength = referee.strength_of(4, 20.0, 9)
    look = f"ITEM: ENTRIES\n4 7 0 0 {strength * 1.01}\n"
    Path("look.txt").write_text(look)
    assert "set atom 4 type 8" in referee.verdict_on_spheres(20.0, 9)
    assert "set atom 4 " not in referee.verdict_on_spheres(20.0, 9)


def test_a_stretched_bond_breaks_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    stretch = 1.5e-4
    Path("bonds.txt").write_text("1 1 2 0.008\n2 2 3 0.008\n")
    rows = [(1, 0.0), (2, 0.008), (3, 0.016 + 1.01 * stretch)]
    Path("look.txt").write_text("ITEM: ATOMS\n" + "".join(f"{i} {x} 0 0\n" for i, x in rows))
    assert referee.verdict_on_bonds(stretch) == "delete_bonds all bond 2 remove\n"
    assert Path("bonds.txt").read_text() == "1 1 2 0.008\n"


# ---------------------------------------------------------------- the other code


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("liggghts"), reason="LIGGGHTS is not installed")
def test_a_specimen_stands_and_is_crushed(tmp_path):
    outcome = run(Soil(), Physics(), instrument.Instrument(), 1, tmp_path / "run")
    assert outcome.stands, json.dumps(outcome.facts)
    assert outcome.confined[:, 1].max() == pytest.approx(400, abs=10)
    assert 100 < outcome.unconfined[:, 1].max() < 500
    assert BASE_LAW in (tmp_path / "run" / "materials.in").read_text()
