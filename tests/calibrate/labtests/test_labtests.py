"""Tests in a lab file: any list of them, with protocols, stress, strain, points, other specimens.

Numbers are small enough to be done by hand; whatever is wrong is one line that names the field.
"""

import re
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calibrate.core.errors import InputError
from calibrate.figures.style import pretty
from calibrate.inference.problem import pose
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.labtests.base import Pace, Shown
from calibrate.labtests.composite import label
from calibrate.labtests.confined import ConfinedTest
from calibrate.labtests.features import cyclic_course, path_features, turning_rows
from calibrate.labtests.measured import Curve, Cylinder
from calibrate.labtests.protocol import StepTable, program
from calibrate.labtests.reading import Zero
from calibrate.labtests.unconfined import FAILURE_STRAIN, SECANT_MODULUS, WORK, UnconfinedTest
from calibrate.simulation.resolution import PRESETS, virtual_lab
from calibrate.simulation.specimens import doubts
from jdem.observables import Curve as RunCurve
from tests.support.formulas import two_tests

AREA = np.pi / 4 * 0.05**2  # m2, of the specimen below
HEAD = """[soil]
name = "x"
[specimen]
diameter = "5 cm"
height = "100 mm"
"""
TESTS = """
[[tests]]
type = "confined"
name = "second cycle"
protocol = [
  { step = "approach" },
  { step = "load", to = "200 kPa", rate = "1 %/min" },
  { step = "hold", for = "60 s", keep = "force" },
  { step = "unload", to = "0 N" },
  { step = "reload", to = "500 N", rate = "8 mm/s" },
]
[tests.targets]
depression_depth = { mean = "3 %", scatter = "0.2 mm", repeats = 4 }
[[tests.curves]]
file = "points.csv"
stress = { column = "stress (kPa)", unit = "kPa" }
strain = { column = "strain (%)", unit = "%" }
delimiter = ";"
decimal = ","
points = true

[[tests]]
type = "unconfined"
specimen = { diameter = "50 mm", height = "80 mm" }
[tests.targets.crushing_force_n]
file = "strength.csv"
column = "su"
unit = "kPa"
times = 2.0
where = { state = "u" }
"""
POINTS = "strain (%);stress (kPa)\n0,0;10\n1,0;50\n2,5;100\n2,0;25\n3,0;150\n"
STRENGTHS = "su,state\n20,u\n30,u\n99,r\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a lab file of two tests, a curve and strengths."""
    (tmp_path / "lab.toml").write_text(HEAD + TESTS)
    (tmp_path / "points.csv").write_text(POINTS)
    (tmp_path / "strength.csv").write_text(STRENGTHS)
    return tmp_path


def refusal(folder: Path, text: str) -> InputError:
    """How a lab file is refused: in one line, with a field and a repair."""
    (folder / "lab.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_lab(folder / "lab.toml")
    assert len(str(caught.value).splitlines()) == 1
    assert caught.value.repair
    return caught.value


# ---- good files -----------------------------------------------------------------------------


def test_stress_strain_and_repeats_become_newtons_and_millimetres(folder):
    lab = load_lab(folder / "lab.toml")
    (curve,) = lab.curves
    np.testing.assert_allclose(curve.displacement_mm, [0, 1, 2.5, 2, 3])
    np.testing.assert_allclose(curve.force_n, 1e3 * AREA * np.array([10, 50, 100, 25, 150]))
    depth, force = (lab.targets[n] for n in ("depression_depth_mm", "crushing_force_n"))
    assert (depth.mean, depth.scatter, depth.repeats) == pytest.approx((3.0, 0.2, 4))
    assert force.mean == pytest.approx(2e3 * AREA * 25) and force.repeats == 2
    assert force.scatter == pytest.approx(2e3 * AREA * np.std([20, 30], ddof=1))


def test_tests_go_on_with_a_specimen_or_take_their_own(folder):
    lab = load_lab(folder / "lab.toml")
    first, second = lab.specimens()
    assert [test.called for test in first.tests] == ["second cycle"]
    assert (first.cylinder.height, second.cylinder.height) == pytest.approx((0.1, 0.08))
    assert lab.cylinder_of("unconfined") == second.cylinder
    text = (HEAD + TESTS).replace('specimen = { diameter = "50 mm", height = "80 mm" }\n', "")
    (folder / "lab.toml").write_text(text)
    (both,) = load_lab(folder / "lab.toml").specimens()
    assert [test.called for test in both.tests] == ["second cycle", "unconfined"]


def test_the_machine_takes_the_steps_of_the_protocol(folder):
    lab = virtual_lab(load_lab(folder / "lab.toml"), PRESETS["quick"])
    (test,) = lab.tests.apparatus
    assert test.names == ("approach", "load", "hold", "unload", "reload")
    targets = np.asarray(lab.tests.programme().force_target)
    np.testing.assert_allclose(targets[[1, 2, 3, 4]], [2e5 * AREA, 2e5 * AREA, 0, 500])
    assert float(test.nominal_rate) == pytest.approx(0.1 * 0.01 / 60)
    assert test.observables == ("depression_depth",)


def test_displacements_of_a_protocol_count_from_the_first_touch():
    steps = [
        StepTable.model_validate(step)
        for step in (
            {"step": "load", "to": "2 %"},
            {"step": "unload", "to": "1 mm"},
            {"step": "reload", "to": "3 mm"},
        )
    ]
    made = program(steps, Cylinder(0.05, 0.1))
    assert [float(step.value) for step in made] == pytest.approx([2e-3, -1e-3, 2e-3])


def test_old_files_have_both_tests_and_the_same_data_as_a_list(tmp_path):
    (tmp_path / "c.csv").write_text(
        "mm,N\n" + "\n".join(f"{x},{100 * x}" for x in np.linspace(0, 4.5, 10))
    )
    columns = (
        'file = "c.csv"\ndisplacement = { column = "mm", unit = "mm" }\n'
        'force = { column = "N", unit = "N" }\n'
    )
    target = 'mean = "200 N"\nscatter = "10 N"\nrepeats = 3\n'
    old = f'[confined]\nrate = "4 mm/s"\n[targets.crushing_force]\n{target}'
    old += '[[curves]]\ntest = "confined"\n'
    new = '[[tests]]\ntype = "confined"\nrate = "4 mm/s"\n[[tests.curves]]\n' + columns
    new += f'[[tests]]\ntype = "unconfined"\n[tests.targets.crushing_force]\n{target}'
    (tmp_path / "old.toml").write_text(HEAD + old + columns)
    (tmp_path / "new.toml").write_text(HEAD + new)
    labs = [load_lab(tmp_path / name) for name in ("old.toml", "new.toml")]
    problems = [pose(lab) for lab in labs]
    assert problems[0].features == problems[1].features
    np.testing.assert_array_equal(problems[0].measured, problems[1].measured)
    programmes = [virtual_lab(lab, PRESETS["quick"]).tests.programme() for lab in labs]
    assert str(programmes[0]) == str(programmes[1])


# ---- features along a protocol --------------------------------------------------------------

LOOP = np.array([0, 25, 50, 100, 50, 20, 60, 120, 200.0])
WAY = np.array([0, 1, 2, 4, 3.5, 3, 3.6, 4.5, 6.0])


def test_turns_are_found_and_small_dips_are_not():
    assert turning_rows(LOOP) == [0, 3, 5, 8]
    assert turning_rows(np.array([0, 50, 48, 100, 200.0])) == [0, 4]


def test_load_steps_are_read_on_the_branch_where_they_were_measured():
    """50 N is passed twice: at 2 mm going up, at 3.5 mm coming down; all count from 0 N."""
    features = path_features("t", [Curve("t", WAY, LOOP, "c.csv", points=True)])
    values = [feature.of({}, {"t": np.stack([WAY, LOOP], axis=1)}) for feature in features]
    np.testing.assert_allclose(values, WAY[1:])
    assert len({feature.name for feature in features}) == len(features)
    dense = np.linspace(0, 8, 801)
    curve = np.stack([np.interp(dense, np.arange(9), WAY), np.interp(dense, np.arange(9), LOOP)], 1)
    np.testing.assert_allclose([f.of({}, {"t": curve}) for f in features], WAY[1:], atol=1e-9)


def test_a_curve_that_does_not_come_that_far_has_no_such_number():
    features = path_features("t", [Curve("t", WAY, LOOP, "c.csv", points=True)])
    short = np.stack([WAY[:5], LOOP[:5]], axis=1)
    values = np.array([feature.of({}, {"t": short}) for feature in features])
    assert np.all(np.isfinite(values[:4])) and np.all(np.isnan(values[4:]))


# ---- bad files ------------------------------------------------------------------------------

BAD = {
    "unknown type": ('type = "confined"', 'type = "triaxal"', "tests[0].type", "known names"),
    "near type": ('type = "confined"', 'type = "confind"', "tests[0].type", "'confined'?"),
    "no type": ('type = "confined"\n', "", "tests[0].type", "add type"),
    "two names": ('type = "unconfined"', 'type = "unconfined"\nname = "second cycle"',
                  "tests[1].name", "give each its own name"),
    "strange name": ('name = "second cycle"', 'name = "a/b"', "tests[0].name", "letters, digits"),
    "no end": (', to = "500 N"', "", "tests[0].protocol[4].to", 'add to = "400 N"'),
    "no time": (', for = "60 s"', "", "tests[0].protocol[2].for", 'add for = "10 s"'),
    "wrong unit": ('to = "500 N"', 'to = "500 s"', "tests[0].protocol[4].to", "200 kPa"),
    "wrong rate": ('rate = "8 mm/s"', 'rate = "8 N"', "tests[0].protocol[4].rate", "8 mm/s"),
    "no size": ('diameter = "5 cm"\n', "", "specimen.diameter", "add diameter"),
    "unknown step": ('step = "hold"', 'step = "wait"', "tests[0].protocol[2].step", "'hold'"),
    "rest in mould": ('step = "hold", for = "60 s", keep = "force"', 'step = "rest", for = "1 s"',
                      "tests[0].protocol[2].step", "remove_mould"),
    "displacement after force": ('to = "500 N"', 'to = "5 mm"', "tests[0].protocol[4].to",
                                 "go to a force"),
    "all strain": ('to = "500 N"', 'to = "120 %"', "tests[0].protocol[4].to", "90 %"),
    "both axes": ("points = true", 'displacement = { column = "x", unit = "mm" }',
                  "tests[0].curves[0].displacement", "void_ratio"),
    "no axis": ('strain = { column = "strain (%)", unit = "%" }\n', "",
                "tests[0].curves[0].displacement", "displacement ="),
    "unknown observable": ("depression_depth =", "depth =", "tests[0].targets.depth",
                           "depression_depth_mm"),
    "strain as force": ('mean = "3 %"', 'mean = "3 N"', "tests[0].targets.depression_depth.mean",
                        "length"),
    "no such row": ('state = "u"', 'state = "q"', "state", "correct where"),
    "one decimal sign": ('decimal = ","', 'decimal = "."', "strain (%)", "decimal point"),
    "top table too": ("[[tests]]", "[confined]\n[[tests]]", "confined",
                      "put it into one of [[tests]]"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_tests_are_named_with_their_repair(folder, name):
    old, new, field, words = BAD[name]
    assert old in HEAD + TESTS
    error = refusal(folder, (HEAD + TESTS).replace(old, new, 1))
    assert error.field == field
    assert words in str(error)


def test_points_that_are_none_are_refused(folder):
    (folder / "points.csv").write_text("strain (%);stress (kPa)\n")
    assert "0 points" in str(refusal(folder, HEAD + TESTS))


def test_tests_without_anything_measured_are_refused(folder):
    listed = str(refusal(folder, HEAD + '[[tests]]\ntype = "confined"\n'))
    assert "nothing measured" in listed and "[tests.targets.depression_depth]" in listed


# ---- the tests of a library of runs -----------------------------------------------------------

PAIR = '[[tests]]\ntype = "confined"\n[tests.targets]\n'
PAIR += 'depression_depth = { mean = "3 mm", scatter = "0.2 mm", repeats = 4 }\n'
PAIR += '[[tests]]\ntype = "unconfined"\n'
UNFIT = {
    "another type": ("unconfined", "relaxation", "tests[1]", "'relaxation', number 2, is of type"),
    "one less": ('[[tests]]\ntype = "unconfined"\n', "", "tests", "no test here is unconfined"),
    "a name": ('"unconfined"\n', '"unconfined"\nname = "b"\n', "tests[1]", "'b': leave out name"),
    "a protocol": ('"unconfined"\n', '"unconfined"\nprotocol = [{ step = "load", to = "9 N" }]\n',
                   "tests[1]", "a protocol of its own"),
    "a specimen": ('"unconfined"\n',
                   '"unconfined"\nspecimen = { diameter = "5 cm", height = "8 cm" }\n',
                   "tests[1]", "a specimen of its own"),
}  # fmt: skip


def test_a_library_of_runs_takes_a_machine_beside_its_pair(folder):
    machine = '[[tests]]\ntype = "machine"\n'
    (folder / "lab.toml").write_text(HEAD + machine + PAIR)
    assert load_lab(folder / "lab.toml").pair().compression.force_high == 400.0


def test_further_tests_may_come_after_the_pair(folder):
    more = '[[tests]]\ntype = "relaxation"\n[[tests]]\ntype = "confined"\nname = "slow"\n'
    (folder / "lab.toml").write_text(HEAD + PAIR + more)
    assert load_lab(folder / "lab.toml").pair().crushing.called == "unconfined"


@pytest.mark.parametrize("name", UNFIT)
def test_what_a_library_does_not_hold_is_named_with_file_and_test(folder, name):
    old, new, field, words = UNFIT[name]
    (folder / "lab.toml").write_text(HEAD + PAIR.replace(old, new, 1))
    with pytest.raises(InputError, match="a library of runs holds confined and then") as caught:
        load_lab(folder / "lab.toml").pair()
    assert (caught.value.file, caught.value.field) == (str(folder / "lab.toml"), field)
    assert words in str(caught.value) and "begins with these two" in caught.value.repair
    assert len(str(caught.value).splitlines()) == 1


def test_an_oedometer_is_told_how_to_be_compared():
    with pytest.raises(InputError, match="oedometer") as caught:
        load_lab(bundled_lab("trumao_oedometer")).pair()
    assert "trumao_curves" in caught.value.repair
    assert load_lab(bundled_lab("trumao_curves")).pair().compression.force_high == 785.4


PIECES = st.one_of(
    st.text(max_size=6),
    st.sampled_from(["nan", "-1 N", "[", "]]", "{}", "= ", "\n", "1e999 kPa", "[[tests]]", "0 %"]),
    st.sampled_from(re.findall(r"\S+", TESTS)),
)
EDITS = st.lists(
    st.tuples(st.integers(0, len(HEAD + TESTS)), st.integers(0, 12), PIECES),
    min_size=1,
    max_size=4,
)


@settings(
    max_examples=500, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(EDITS)
def test_mutations_of_tests_load_or_are_refused_in_one_line(folder, edits):
    text = HEAD + TESTS
    for start, length, piece in edits:
        text = text[:start] + piece + text[start + length :]
    (folder / "lab.toml").write_bytes(text.encode("utf-8", "surrogatepass"))
    try:
        lab = load_lab(folder / "lab.toml")
        assert type(lab) is Lab
        pose(lab)
    except InputError as error:
        assert len(str(error).splitlines()) == 1


# ------------------------------------------------------------------ is there a crushing force?


def crushing(shape):
    """A simulated curve (points, 2) to 15 mm: `shape` of the share of the travel, times 100 N."""
    share = np.linspace(0, 1, 301)
    return np.stack([15 * share, 100 * shape(share)], axis=1)


RISES = {  # shape of the curve, whether there is no crushing force
    "straight": (lambda s: s, True),
    "stiffens": (lambda s: s**2, True),
    "softens but rises": (lambda s: 1 - np.exp(-3 * s), True),
    "rises after a dip": (lambda s: s + 0.2 * np.sin(9 * s), True),
    "breaks": (lambda s: 4 * s * (1 - s), False),
    "breaks late": (lambda s: np.where(s < 0.9, s, 0.9 - 2 * (s - 0.9)), False),
    "flows": (lambda s: np.minimum(5 * s, 1), False),
    "breaks, then creeps up": (lambda s: np.exp(-(((s - 0.3) / 0.1) ** 2)) + 0.3 * s, False),
    "nothing": (lambda s: 0 * s, False),
}


def shown(curve):
    """On a specimen of the usual size."""
    return Shown(Cylinder(0.05, 0.1, None), curve, {})


@pytest.mark.parametrize("name", RISES)
def test_a_force_that_rises_to_the_end_is_no_crushing_force(name):
    shape, rises = RISES[name]
    test = UnconfinedTest()
    (force,) = test.observables
    assert bool(test.doubt(force, shown(crushing(shape)))) == rises
    assert not ConfinedTest().doubt(ConfinedTest().observables[0], shown(crushing(shape)))


@pytest.mark.parametrize(("points", "noise"), [(60, 0.0), (400, 0.0), (400, 3.0), (3000, 3.0)])
def test_failure_strain_of_a_parabola(points, noise):
    """F = 200 N (1 - (u/6 mm - 1)^2), with its peak at 6 mm, on a specimen of 80 mm: displacement
    counts from 2 N.  Noise of 3 N on the flat top moves the strain by less than 0.05 %."""
    way = np.linspace(0.0, 12.0, points)
    load = 200 * (1 - (way / 6 - 1) ** 2)
    load += noise * np.random.default_rng(0).standard_normal(points)
    feature = FAILURE_STRAIN.feature(Cylinder(0.05, 0.08))
    exact = 100 * 6 * np.sqrt(1 - 2 / 200) / 80
    assert feature.zero == Zero(2.0)
    assert feature.of_curve(way, load) == pytest.approx(exact, abs=5e-2 if noise else 1e-3)
    gauge, curve = FAILURE_STRAIN.gauge(Cylinder(0.05, 0.08)), (1e-3 * way, load, np.ones(points))
    in_run = eqx.filter_jit(gauge.of)(RunCurve(*map(jnp.asarray, curve)), jnp.zeros(points))
    assert 100 * float(in_run) == pytest.approx(feature.of_curve(way, load), rel=1e-9)


@pytest.mark.parametrize(
    ("observable", "exact"),
    [
        # half of 200 N on 1963 mm2, over the way from 2 N to 100 N on 80 mm
        (SECANT_MODULUS, 1e-3 * 100 / AREA * 80 / (6 * (np.sqrt(0.99) - np.sqrt(0.5)))),
        (WORK, 1e-3 * 200 * 6 * 2 / 3),
    ],
    ids=lambda given: getattr(given, "name", ""),
)
def test_modulus_and_work_of_a_parabola(observable, exact):
    """The same curve: two thirds of 200 N over 6 mm, and the chord to half of 200 N."""
    way = np.linspace(0.0, 12.0, 2001)
    load = 200 * (1 - (way / 6 - 1) ** 2)
    feature, size = observable.feature(Cylinder(0.05, 0.08)), Cylinder(0.05, 0.08)
    assert feature.of_curve(way, load) == pytest.approx(exact, rel=1e-5)
    in_run = eqx.filter_jit(observable.gauge(size).of)(
        RunCurve(*map(jnp.asarray, (1e-3 * way, load, np.ones_like(way)))), jnp.zeros(2001)
    )
    assert observable.scale * float(in_run) == pytest.approx(exact, rel=1e-5)
    assert observable.name.endswith(f"_{observable.unit.lower()}")


def test_failure_strain_is_given_where_a_target_asks_for_it():
    size, pace = Cylinder(0.05, 0.1), Pace(0.05, 0.05, 1e-3)
    target = {"mean": "6 %", "scatter": "0.5 %", "repeats": 3}
    asking = UnconfinedTest.model_validate({"targets": {"failure_strain": target}})
    assert UnconfinedTest().machine(size, pace).observables == ("crushing_force",)
    machine = asking.machine(size, pace)
    assert machine.observables == ("crushing_force", "failure_strain")
    assert machine.at_rate(2.0).observables == machine.sampled(3).observables == machine.observables
    assert [o.name for o in asking.given] == ["crushing_force_n", "failure_strain_percent"]
    assert label("failure_strain_percent") == "failure strain (%)"
    assert pretty("failure_strain_percent") == "failure strain"


def test_a_specimen_that_does_not_fail_has_no_failure_strain():
    rising = np.stack([np.linspace(0, 10, 200), np.linspace(0, 100, 200)], axis=1)
    said = UnconfinedTest().doubt(FAILURE_STRAIN, shown(rising))
    assert "there is no failure strain" in said and "\n" not in said


def test_a_doubt_is_said_with_what_to_do(tmp_path):
    flat = UnconfinedTest().doubt(UnconfinedTest().observables[0], shown(crushing(lambda s: s)))
    assert "still rises at the end of the travel, 15 mm" in flat
    assert "no crushing force" in flat and "slender" in flat


def test_a_doubt_counts_packings_that_did_not_fail():
    rising, broken = crushing(RISES["straight"][0]), crushing(RISES["breaks"][0])
    lab = load_lab(bundled_lab())
    runs = [
        two_tests(3.0, 90.0, rising, curve, {}, failure)
        for curve, failure in ((rising, ""), (rising, ""), (broken, ""), (broken, "x"))
    ]
    assert set(doubts(lab, runs)) == {"crushing_force_n"}
    assert doubts(lab, runs)["crushing_force_n"].endswith("(2 of 3 packings)")
    assert doubts(lab, [runs[0], runs[2]]) == {}
    assert doubts(lab, [runs[3]]) == {}


# ------------------------------------------------------------------ a record of several loadings


def cycles(forces, stiffness=100.0, noise=0.0):
    """Displacement (mm) and force (N) of a soil that yields, through these turns of the force."""
    course, ways, way = [0.0], [0.0], 0.0
    for target in forces:
        for force in np.linspace(course[-1], target, 60)[1:]:
            fresh = force > max(course)
            way += (force - course[-1]) / (stiffness / 10 if fresh else stiffness)
            course.append(float(force))
            ways.append(way)
    rng = np.random.default_rng(3)
    return np.array(ways), np.array(course) + noise * rng.standard_normal(len(course))


COURSES = {
    "two cycles": (400, 20, 400, 0),
    "growing": (100, 10, 200, 20, 400),
    "at one level": (300, 50, 300, 50, 300, 50),
    "small cycle": (400, 250, 400),
    "ends loaded": (200, 0, 400),
}


@pytest.mark.parametrize("name", COURSES)
@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_the_turns_of_a_cyclic_record_are_found(name, noise):
    found = cyclic_course(*cycles(COURSES[name], noise=noise))
    assert len(found) == len(COURSES[name])
    np.testing.assert_allclose(found, COURSES[name], atol=4 * noise + 1e-9)


@pytest.mark.parametrize(
    "curve",
    [
        cycles((400,)),
        cycles((400, 0)),
        (np.linspace(0, 9, 90), 100 * np.sin(np.linspace(0, 3, 90))),
        (np.linspace(0, 9, 90), 100 + 50 * np.sin(np.linspace(0, 20, 90))),  # breaks and recovers
        (np.array([0.0, 1, 2, 2, 2, 2]), np.array([0.0, 200, 400, 390, 350, 300])),  # a hold
    ],
)
def test_one_loading_has_no_cycles(curve):
    assert cyclic_course(*curve) == ()


def test_cycles_below_zero_press_nothing():
    way, force = cycles(COURSES[next(iter(COURSES))], noise=0.0)
    assert cyclic_course(way, force) and cyclic_course(way, force - 2 * force.max()) == ()


def test_a_cyclic_curve_is_refused_with_the_protocol_that_it_followed(folder):
    """The line of the refusal, put into the lab file, makes it readable by a fit."""
    way, force = cycles((400, 20, 400, 0))
    rows = "".join(f"{w!r},{f!r}\n" for w, f in zip(way.tolist(), force.tolist(), strict=True))
    (folder / "cycles.csv").write_text(f"way,force\n{rows}")
    test = '\n[[tests]]\ntype = "confined"\nPROTOCOL\n[[tests.curves]]\nfile = "cycles.csv"\n'
    test += 'displacement = { column = "way", unit = "mm" }\n'
    test += 'force = { column = "force", unit = "N" }\n'
    path = folder / "lab.toml"
    path.write_text(HEAD + test.replace("PROTOCOL", ""))
    with pytest.raises(InputError, match="loaded 2 times") as caught:
        pose(load_lab(path))
    line = caught.value.repair.removeprefix("give the test ")
    assert line.startswith('protocol = [{ step = "load", to = "400 N" }, { step = "unload"')
    path.write_text(HEAD + test.replace("PROTOCOL", line))
    lab = load_lab(path)
    assert [step.step for step in lab.tests[0].protocol] == ["load", "unload", "reload", "unload"]
    features = pose(lab).features
    assert len([f for f in features if "reload" in f.name or "loading 2" in f.name]) >= 4
