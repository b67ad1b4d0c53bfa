"""Fits on a response: derivatives by JAX, closed-form optima, beds that correct it.

The response is a soil of formulas without scatter; the beds that decide scatter about it, and
differ from it by a ratio.
"""

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from calibrate.core.errors import CalibrationError
from calibrate.core.progress import Silent
from calibrate.discrepancy.library.stand_in import served
from calibrate.inference.calibration import calibrate as calibrated
from calibrate.inference.calibration import explore, fit_json
from calibrate.inference.estimate import estimate_json, estimated
from calibrate.inference.evaluation import Calibration
from calibrate.inference.fit import AsGoodAsChance
from calibrate.inference.on_response import (
    BEYOND,
    FeaturesOfBeds,
    Residual,
    slopes_of,
    solved,
)
from calibrate.inference.parameters import space
from calibrate.inference.problem import Problem, pose
from calibrate.io.choices import ParameterChoice
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.io.soil import with_values
from calibrate.labtests.diagnosis.curves import TARGETS, TESTS, feature_values
from calibrate.labtests.features import (
    SEATING,
    DisplacementOnLoading,
    DisplacementOnUnloading,
    ForceAtDisplacement,
    ScalarTarget,
)
from calibrate.labtests.measured import Curve
from calibrate.labtests.reading import Zero
from calibrate.response.beds import Beds
from calibrate.simulation.resolution import PRESETS
from tests.support.formulas import (
    BASE,
    LAB,
    NAMES,
    FormulaBeds,
    Formulas,
    on_response,
    specimen,
)
from tests.support.formulas import response_campaign as campaign
from tests.support.toy_library import library

TARGETS_ONLY = (ScalarTarget(TARGETS[0], "mm", ""), ScalarTarget(TARGETS[1], "N", ""))
RISE = DisplacementOnLoading("displacement at 300 N", "mm", "confined", 300.0, Zero(100.0))
SEEDS = range(4)


def case(work, features=TARGETS_ONLY, truth=(1.5, 0.6), names=NAMES, measured=None):
    """Numbers that the response shows of the true soil, known to one per cent."""
    known = space(LAB, names, BASE)
    reading = FeaturesOfBeds(FormulaBeds(), BASE, names, features)
    if measured is None:
        measured = np.asarray(reading(known.start() * np.asarray(truth)))
    problem = Problem(features, measured, (0.01 * measured) ** 2, np.zeros(len(measured), int))
    return Calibration(problem, known, work, SEEDS, np.zeros((len(measured),) * 2), 8)


def known_to(share, calibration):
    """The same with measured numbers that are known to a share of their values."""
    variance = (share * calibration.problem.measured) ** 2
    return replace(calibration, problem=replace(calibration.problem, target_variance=variance))


# ------------------------------------------------------------------ derivatives


@pytest.mark.parametrize("features", [TARGETS_ONLY, (*TARGETS_ONLY, RISE)], ids=["two", "curve"])
def test_the_solver_s_jacobian_is_that_of_the_residual_by_jax(features):
    """As Optimistix takes it, against differences of the residual itself."""
    residual = Residual.of(FormulaBeds(), case(campaign(), features))
    y = jnp.array([0.3, -0.7])
    found, step = jax.jacfwd(residual)(y), 1e-5
    for column, way in enumerate(np.eye(2)):
        apart = np.asarray(residual(y + step * way) - residual(y - step * way))
        assert found[:, column] == pytest.approx(apart / (2 * step), rel=1e-6, abs=1e-6)


def test_the_residual_is_that_of_the_calibration():
    calibration = case(campaign(), (*TARGETS_ONLY, RISE))
    residual, y = Residual.of(FormulaBeds(), calibration), jnp.array([0.3, -0.7])
    values = calibration.space.from_unbounded(y)
    features = np.asarray(residual.features(values))
    assert np.asarray(residual(y)) == pytest.approx(calibration.residual(values, features))
    assert calibration.evaluate(values, "").residual == pytest.approx(np.asarray(residual(y)))


def test_slopes_are_those_of_the_formulas():
    known = space(LAB, NAMES, BASE)
    features = FeaturesOfBeds.of(FormulaBeds(), case(campaign()).problem, known)
    found = slopes_of(features, known.start())
    depth = 6.0 * (1 - 0.5**0.7)
    assert found[0] == pytest.approx([-0.8 * depth, 0.0])
    force = 200 * -np.expm1(-12.0)
    assert found[1] == pytest.approx([0.3 * 200 * 12 * np.exp(-12.0), 0.6 * force])


def test_slopes_for_an_audit_come_with_errors_and_not_beyond_the_runs():
    known = space(LAB, (*NAMES, "static_friction"), BASE)

    def read(observables, curves):
        return jnp.stack([observables[name] for name in TARGETS])

    found = on_response().sensitivity(known, read)
    beds = FeaturesOfBeds.of(FormulaBeds(), case(campaign()).problem, known)
    assert np.asarray(found.slopes) == pytest.approx(slopes_of(beds, known.start()))
    full = -np.expm1(-12.0)  # of the strength, F is as much
    assert np.asarray(found.standard_error) == pytest.approx(
        np.array([[0, 0, 0], [0, 4 * full, 0]])
    )
    far = on_response(beyond=lambda soil: ("surface_energy",)).sensitivity(known, read)
    assert np.isnan(far.slopes).all() and np.isnan(far.standard_error).all()


# ------------------------------------------------------------------ the best point


def test_it_ends_at_the_soil_that_the_response_shows():
    calibration = case(campaign())
    truth = calibration.space.start() * [1.5, 0.6]
    tight = replace(
        calibration,
        problem=replace(
            calibration.problem, target_variance=1e-10 * calibration.problem.measured**2
        ),
    )
    found = solved(campaign(), tight)
    assert found.best.values == pytest.approx(truth, rel=1e-4)
    assert found.best.cost < 2.0  # of the prior alone
    assert [row["status"] for row in found.history] == ["better", "better"]
    assert found.history[0]["parameters"] == dict(zip(NAMES, tight.space.start(), strict=True))


def test_a_prior_holds_what_the_data_hardly_see():
    """Residuals are linear in ln p here, so the best point is that of a linear regression."""
    calibration = case(campaign(), TARGETS_ONLY[:1], names=("shear_modulus",), truth=(1.5,))
    loose = replace(
        calibration,
        problem=replace(
            calibration.problem, target_variance=0.64 * calibration.problem.measured**2
        ),
    )
    found = solved(campaign(), loose)
    away = np.log(found.best.values / loose.space.start())[0]
    assert 0.1 < away < np.log(1.5) - 0.05
    slope = 0.8 * loose.problem.measured[0] / np.sqrt(loose.covariance[0, 0])
    gradient = -slope * found.best.residual[0] * np.exp(-0.8 * (away - np.log(1.5))) * -1
    assert gradient == pytest.approx(-found.best.residual[1] / loose.space.prior_sd()[0], abs=0.02)


def test_it_stays_within_the_bounds():
    strong = case(campaign(), measured=np.array([2.3, 1e6]))
    found = solved(campaign(), strong)
    low, high = strong.space.bounds().T
    assert np.all(found.best.values > low) and np.all(found.best.values <= high)
    assert found.best.values[1] > 0.9 * high[1]


# ------------------------------------------------------------------ in the place of smaller beds


@dataclass
class Larger(Formulas):
    """The beds that decide: 3 % deeper and 6 % weaker than the response."""

    def _run(self, soil, seed):
        run = super()._run(soil, seed)
        ratio = dict(zip(TARGETS, (1.03, 0.94), strict=True))
        values = {name: ratio[name] * value for name, value in run.observables.items()}
        return replace(run, observables=values)


def test_a_fit_takes_no_run_for_slopes_and_few_to_meet_its_targets():
    work, asked = Larger(), []
    runs = work.runs
    work.runs = lambda soils, seeds, what: asked.append(what) or runs(soils, seeds, what)
    done = calibrated(LAB, PRESETS["standard"], NAMES, BASE, 0, work, on_response())
    assert done.met
    fitted = {what for what in asked if what.startswith("evaluation")}
    assert 1 <= len(fitted) <= 3
    assert not [what for what in asked if "slopes" in what and "best point" not in what]
    content = fit_json(done)
    assert content["resolutions"]["explored_with"] == "the library of runs"
    ratio = content["resolutions"]["ratio"]
    assert ratio["depression_depth_mm"]["end"] == pytest.approx(1.03, rel=0.05)
    assert ratio["crushing_force_n"]["end"] == pytest.approx(0.94, rel=0.08)
    assert content["history"][0]["parameters"]["shear_modulus"] == float(BASE.shear_modulus)


@pytest.mark.slow
def test_curves_are_met_as_well_as_chance_allows_and_no_better():
    """Records of three other packings: what is left of them is luck, which no evaluation chases."""
    soil = with_values(BASE, {"shear_modulus": 8e6})
    records = [specimen(soil, seed).curves["confined"].T for seed in (77, 78, 79)]
    curves = tuple(Curve("confined", *record, "a record.csv") for record in records)
    lab = replace(LAB, targets={}, curves=curves)
    done = calibrated(lab, PRESETS["standard"], NAMES, BASE, 0, Formulas(), on_response())
    assert "as well as their scatter allows" in done.result.stopped
    assert done.result.history[-1]["status"] == "better"  # it ends with the first that does
    residual = done.result.best.residual[: len(done.setup.problem.measured)]
    assert residual @ residual <= len(residual)


@pytest.mark.parametrize(
    ("change", "ends"),
    [({}, True), ({"size": 1.1}, False), ({"explored": False}, False), ({"targets": 4}, False),
     ({"targets": 1}, True), ({"off": 9.0}, False), ({"off": 9.0, "targets": 1}, False)],
)  # fmt: skip
def test_only_curves_that_a_response_explored_end_there(change, ends):
    """Whitened residuals of one size; the first number may be off by so many deviations."""
    size, explored, targets, off = (
        {"size": 0.9, "explored": True, "targets": 0, "off": 0.0, **change}.values()
    )  # fmt: skip
    features = [
        SimpleNamespace(name=f"force at {k} mm", test="unconfined", is_target=k < targets)
        for k in range(4)
    ]
    problem = SimpleNamespace(measured=np.full(4, 20.0), features=features)
    best = SimpleNamespace(
        residual=np.full(6, size), failures=(), features=np.array([[20.0 + off, 20, 20, 20]])
    )
    calibration = SimpleNamespace(
        problem=problem,
        covariance=np.eye(4),
        coarse=SimpleNamespace(near=True) if explored else None,
    )
    seen: Any = SimpleNamespace(at=best, best=best, calibration=calibration)
    assert bool(AsGoodAsChance()(seen)) == ends
    assert AsGoodAsChance()(SimpleNamespace(**{**vars(seen), "best": None})) == ""


def test_it_chooses_what_to_free_without_a_run():
    work = Formulas()
    done = calibrated(LAB, PRESETS["standard"], None, BASE, 0, work, on_response())
    assert set(done.screening["free"]) == {"shear_modulus", "surface_energy"}
    assert done.met


def test_scatter_is_that_of_the_response_s_packings():
    work = Formulas()
    explorer = on_response(spread=(0.03, 0.0, 0.05, 0.0))
    problem = case(work).problem
    found, packings = explorer.scatter(problem, BASE, None, work)
    assert (work.simulated, packings) == (0, 40)
    assert np.sqrt(np.diag(found)) == pytest.approx([0.03, 0.05], rel=0.3)


def test_beyond_the_runs_it_leads_nowhere():
    """Every run of it fails there, and so does a fit on it: smaller beds have to explore."""
    explorer = on_response(beyond=lambda soil: ("surface_energy",))
    (run,) = explorer.campaign.runs([BASE], [0], "")[0]
    assert run.failure == "surface_energy beyond the library's runs"
    found = solved(explorer.campaign, case(explorer.campaign))
    assert found.best.failures
    with pytest.raises(CalibrationError, match="beyond the library's runs"):
        calibrated(LAB, PRESETS["standard"], NAMES, BASE, 0, Formulas(), explorer)


def test_an_estimate_takes_no_run_and_is_as_unsure_as_the_response():
    """One per cent of each of its values; depth is one of them, and force nearly so."""
    work, explorer = Formulas(), on_response()
    explored = explore(LAB, PRESETS["standard"], NAMES, BASE, 0, work, explorer)
    found = estimated(explored, explorer)
    content = estimate_json(found)
    assert work.simulated == 0 and content["simulated"] is False and content["met"]
    depth, force = content["features"].values()
    assert force["library_sd"] == pytest.approx(0.01 * force["simulated"], rel=1e-3)
    assert depth["known"] and force["known"]
    assert 0.01 < depth["library_sd"] / depth["simulated"] < 0.02  # of D, and of the exponent
    sure = replace(explorer, errors=lambda soil: np.zeros((1, 4)))
    narrower = estimated(explored, sure).identifiability
    assert np.all(found.identifiability.sd_log > narrower.sd_log)
    low, high = content["identifiability"]["interval_95"]["shear_modulus"]
    assert low < content["parameters"]["shear_modulus"] < high


def test_there_is_no_estimate_beyond_the_runs():
    explorer = on_response(beyond=lambda soil: ("surface_energy",))
    explored = explore(LAB, PRESETS["standard"], NAMES, BASE, 0, Formulas(), explorer)
    with pytest.raises(CalibrationError, match=r"surface_energy beyond .* leave out --no-runs"):
        estimated(explored, explorer)


# ------------------------------------------------------------------ beds of a library


def test_curves_of_beds_give_back_the_features_that_they_are_made_of():
    """Of a smooth press and crush, read at the library's displacements and forces."""
    features = library().features
    force = np.concatenate([np.linspace(0, 400, 801), np.linspace(400, 0, 801)[1:]])
    up = 6.0 * (force[:801] / 400) ** 0.7
    down = 6.0 - 2.0 * (1 - force[800:] / 400)
    travel = np.linspace(0, 12, 1201)
    curves = {
        TESTS[0]: (np.append(up, down[1:]), force),
        TESTS[1]: (travel, 200 * travel / 4 * np.exp(1 - travel / 4)),
    }
    values = feature_values(features, curves, dict(zip(TARGETS, (2.3, 200.0), strict=True)))
    beds = Beds(None, None, None, None, None, None, (), features, TESTS)
    observables, shown = beds.shown(jnp.asarray(values))
    assert {k: float(v) for k, v in observables.items()} == {TARGETS[0]: 2.3, TARGETS[1]: 200.0}
    again = feature_values(features, {t: tuple(np.asarray(c).T) for t, c in shown.items()})
    known = np.isfinite(again) & np.isfinite(values)
    of_curves = np.array([f.test == TESTS[0] for f in features]) & known
    assert of_curves.sum() > 20
    assert again[of_curves] == pytest.approx(values[of_curves], abs=0.06)


def crushed_beds(values):
    """Beds of the usual features, and curves of a press and of these forces (N) of crushing."""
    features = library().features
    numbers = {"largest force": 400.0, "travel at the top": 0.01, "peak force": 190.0,
               "peak displacement": 3.5}  # fmt: skip
    pressed = {"loading": lambda f: 0.01 * f.abscissa, "unloading": lambda f: 3 + f.abscissa / 400}
    found = [
        numbers[f.kind] if f.kind in numbers
        else pressed[f.kind](f) if f.kind in pressed
        else values(f.abscissa) if f.kind == "crushing" else 1.0
        for f in features
    ]  # fmt: skip
    beds = Beds(None, None, None, None, None, None, (), features, TESTS)
    return beds, beds.shown(jnp.asarray(found))[1]


def test_displacements_of_a_crushed_specimen_count_from_where_it_carries_little():
    """A line of 60 N/mm through the library's zero, at which it carries some newtons already."""
    seat = next(f.zero.force for f in library().features if f.kind == "crushing")
    _, curves = crushed_beds(lambda at: seat + 60.0 * at)
    for zero in (SEATING, seat, 20.0):
        found = ForceAtDisplacement("", "N", TESTS[1], 0.5, Zero(zero), 0.0).read({}, curves)
        assert float(found) == pytest.approx(zero + 30.0, rel=1e-9)


def test_what_lies_beyond_the_ends_of_curves_is_known_as_such():
    beds, curves = crushed_beds(lambda at: 100.0)
    end = float(curves[TESTS[1]][-1, 0])
    features = (
        ForceAtDisplacement("", "N", TESTS[1], 0.8 * end),
        ForceAtDisplacement("", "N", TESTS[1], 1.2 * end),
        DisplacementOnLoading("", "mm", TESTS[0], 300.0),
        DisplacementOnLoading("", "mm", TESTS[0], 500.0),
        DisplacementOnUnloading("", "mm", TESTS[0], 100.0),
        DisplacementOnUnloading("", "mm", TESTS[0], 0.1),
    )
    shown = {test: np.asarray(curve) for test, curve in curves.items()}
    other = beds.continued(shown)
    moved = [f.read({}, shown) != pytest.approx(f.read({}, other), rel=BEYOND) for f in features]
    assert moved == [False, True, False, True, False, True]


# ------------------------------------------------------------------ the bundled library


@dataclass(frozen=True)
class Nowhere:
    """A campaign that simulates nothing."""

    folder: Path = Path()
    progress: Silent = field(default_factory=Silent)
    apparatus: tuple = ()


def standing_in(spheres=2000):
    found, why = served(LAB, replace(PRESETS["standard"], spheres=spheres), None, BASE, Nowhere())
    assert why == ""
    return found


@pytest.mark.slow
def test_the_bundled_library_shows_what_beds_of_2000_spheres_show():
    """Means over four packings, that `calibrate fit --preset standard` simulated on its way: H
    scatters by 1.3 % and F by 7 % from packing to packing."""
    found, problem = standing_in(), pose(LAB)
    simulated = {
        (4.587541722e6, 17.158, 0.651698498132): (3.33033, 208.147),
        (4.538852234e6, 17.158, 0.648473173255): (3.35896, 205.973),
        (4.5227e6, 11.08, 0.7): (3.366, 209.8),
    }
    for values, (depth, force) in simulated.items():
        names = ("shear_modulus", "surface_energy", "plasticity_ratio")
        soil = with_values(BASE, dict(zip(names, values, strict=True)))
        shown = found.features(problem, soil, [0], "")[0]
        assert shown[0] == pytest.approx(depth, rel=0.01)
        assert shown[1] == pytest.approx(force, rel=0.06)


@pytest.mark.slow
def test_slopes_of_the_bundled_library_are_those_of_the_audit_s_reference():
    """Regressions over +-20 % on eight packings of 1000 spheres (verification/results/audit.md).
    Force with the plasticity ratio is not among them: it bends where adhesion is capped, and the
    library has 430 N for the reference's 320.  Both errors tell how far they may be apart."""
    reference = {
        "shear_modulus": (-1.95, -110), "rolling_friction": (-0.110, 137),
        "tangential_multiplier": (-0.278, -26), "surface_energy": (None, 148),
        "static_friction": (None, 30),
    }  # fmt: skip
    known = space(LAB, tuple(reference), BASE)
    slopes = standing_in(1000).slopes(pose(LAB), known, known.start())
    for (depth, force), found in zip(reference.values(), slopes.T, strict=True):
        assert depth is None or found[0] == pytest.approx(depth, rel=0.15)
        assert found[1] == pytest.approx(force, rel=0.25)
    errors = {"shear_modulus": (0.02, 9), "rolling_friction": (0.011, 16),
              "tangential_multiplier": (0.011, 5), "surface_energy": (None, 14),
              "static_friction": (None, 6)}  # fmt: skip

    def read(observables, curves):
        return jnp.stack([observables[name] for name in TARGETS])

    audited = standing_in(1000).sensitivity(known, read)
    for column, name in enumerate(reference):
        for row, (true, error) in enumerate(zip(reference[name], errors[name], strict=True)):
            stated = float(audited.standard_error[row, column])
            apart = 0.0 if true is None else float(audited.slopes[row, column]) - true
            assert abs(apart) < 3 * np.hypot(stated, error or 0.0)


@pytest.mark.slow
def test_the_bundled_library_shows_what_a_soft_machine_and_a_rough_platen_do():
    """Where nothing acts, both ways to the features agree.  A frame of 1e-6 m/N gives way by
    0.001 mm for each newton between the forces that the depression is counted from and to."""
    found, problem = standing_in(), pose(LAB)
    under = found.under(["load_frame_compliance", "platen_friction"])
    typical = np.array([each.typical for each in found.acting if each.name in (
        "load_frame_compliance", "platen_friction")])  # fmt: skip
    features = FeaturesOfBeds.of(found.campaign.beds, problem, space(LAB, (), BASE), under)
    still = FeaturesOfBeds.of(found.campaign.beds, problem, space(LAB, (), BASE))
    assert features(jnp.zeros(2)) == pytest.approx(np.asarray(still(jnp.zeros(0))), rel=1e-9)
    soft = np.asarray(features(jnp.array([1e-6, 0.0]) / typical) - still(jnp.zeros(0)))
    test = LAB.pair().compression
    assert soft[0] == pytest.approx(1e-3 * (test.force_high - test.force_low), rel=1e-3)  # mm
    assert abs(soft[1]) < 2.0  # N
    rough = np.asarray(features(jnp.array([0.0, 0.4]) / typical) - still(jnp.zeros(0)))
    assert abs(rough[0]) < 0.1 and rough[1] > 5.0
    own, theirs = (found.error_rows(problem, BASE, *at)[1] for at in (
        (), (under, np.array([0.0, 1.0]))))  # fmt: skip
    assert np.all((theirs**2).sum(axis=0) > 0.5 * (own**2).sum(axis=0))


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"preset": "quick"}, "coarse beds that fall"),
        ({"free": ["wall_friction"]}, "no run of the library varies wall_friction"),
        ({"lab": "trumao_oedometer"}, "of type oedometer"),
        ({"base": {"wall_friction": 0.6}}, "has this value of wall_friction"),
        ({"base": {"reference_diameter": 1e-3}}, "has this value of reference_diameter"),
        ({"stated": "wall_friction"}, "no run of the library varies wall_friction"),
        ({"porosity": 0.3}, "beyond the library's beds"),
    ],
)
def test_where_the_library_does_not_serve_it_says_why(change, why):
    lab = load_lab(bundled_lab(change["lab"])) if "lab" in change else LAB
    if "stated" in change:
        choice = ParameterChoice(0.1, None, None, None, True)
        lab = replace(lab, parameters={**lab.parameters, change["stated"]: choice})
    if "porosity" in change:
        lab = replace(lab, particles=replace(lab.particles, porosity=change["porosity"]))
    preset = PRESETS[change.get("preset", "standard")]
    base = with_values(BASE, change.get("base", {}))
    found, said = served(lab, preset, change.get("free"), base, Nowhere())
    assert found is None and why in said


# ------------------------------------------------------------------ the command


def test_no_runs_is_refused_where_the_library_does_not_serve(calibrate, tmp_path):
    status, _, error = calibrate("fit", "--no-runs", "--free", "wall_friction")
    assert status == 2 and error.count("\n") == 1
    assert "no run of the library varies wall_friction" in error and "--no-runs" in error
    assert not list(tmp_path.rglob("estimate.json"))


def test_simulations_alone_and_none_at_once_are_refused(calibrate):
    status, _, error = calibrate("fit", "--no-runs", "--runs-alone")
    assert status == 2 and "give one of them" in error


@pytest.mark.slow
def test_no_runs_answers_without_a_simulation(calibrate, tmp_path):
    status, out, error = calibrate("fit", "--no-runs", "--out", "o")
    assert (status, error) == (0, "") or "error" not in error
    assert "NOT SIMULATED" in out and "estimate.json is in o" in out
    content = json.loads((tmp_path / "o/estimate.json").read_text())
    assert content["simulated"] is False and content["preset"] == "standard"
    assert content["free"] == ["shear_modulus", "surface_energy"] and content["met"]
    assert not list((tmp_path / "o").rglob("*.npz"))
