"""The sequence of designed experiments and its comparison, on a soil of formulas.

What matters to depth there: shear modulus (exponent -0.8), plasticity ratio (0.3), static
friction; to force: surface energy (0.6) and static friction (0.2).
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from calibrate.core.errors import CalibrationError, InputError
from calibrate.core.progress import Silent
from calibrate.designs import designs
from calibrate.designs.comparison import Designed, Enhanced, SlopePair, design, gradient
from calibrate.designs.optimum import target
from calibrate.designs.study import StudySetup, stage_titles, study, surfaces
from calibrate.inference.parameters import FACTORS, space
from calibrate.labtests.measured import Target
from calibrate.reports import study as report
from calibrate.simulation import Run
from calibrate.simulation.resolution import PRESETS, Preset
from calibrate.simulation.session import Session
from calibrate.simulation.specimens import campaign
from tests.support.formulas import BASE, LAB, Formulas, pressed_lightly, specimen

pytestmark = pytest.mark.thorough

TARGETS = {
    "depression_depth_mm": Target(2.5, 0.1, 4),
    "crushing_force_n": Target(185.0, 8.0, 4),
}
NAMES = (*FACTORS, "shear_modulus")


class Rough(Formulas):
    """Every run also misses its formula by a per cent, always the same for the same run."""

    def _run(self, soil, seed):
        run = super()._run(soil, seed)
        numbers = [float(getattr(soil, name)) for name in NAMES]
        rng = np.random.default_rng([seed, *(int(1e6 * n) % 2**31 for n in numbers)])
        depth, force = 1 + 0.01 * rng.normal(size=2)
        factors = {"depression_depth_mm": depth, "crushing_force_n": force}
        scaled = {name: value * factors[name] for name, value in run.observables.items()}
        return replace(run, observables=scaled)


@pytest.fixture(scope="module")
def found() -> Designed:
    return design(replace(LAB, targets=TARGETS), PRESETS["quick"], BASE, 0, Rough())


def test_the_screening_finds_what_matters(found):
    """The two largest contributions to depth and the two to force are the formulas' own."""
    depth, force = (found.study.screens[name].ranked() for name in TARGETS)
    assert [effect.name for effect in depth[:2]] == ["shear_modulus", "static_friction"]
    assert {effect.name for effect in force[:2]} == {"surface_energy", "static_friction"}
    assert all(effect.p < 0.01 for effect in (*depth[:2], *force[:2]))


def test_designs_are_those_of_the_paper(found):
    """12 screening runs with a centre point, 9 + 13 for the surfaces, 7 levels, 3 packings."""
    sizes = [len(experiment.design) for experiment in found.study.experiments]
    assert sizes == [13, 9, 13, 7]
    assert found.study.simulations == 3 * sum(sizes)


def test_the_optimum_meets_both_targets(found):
    """Within the scatter of one repeat on the packings of the designs."""
    for m, wanted in enumerate(TARGETS.values()):
        assert abs(found.study.fitted[:, m].mean() - wanted.mean) < wanted.scatter


def test_surfaces_and_gradients_agree(found):
    """At the surfaces' centres; effects of the screening carry aliased interactions as well."""
    judged = [pair for pair in found.comparison.slopes if pair.matters]
    surfaces = [pair for pair in judged if pair.design != "screening"]
    assert len(surfaces) >= 6
    assert sum(not pair.agree for pair in surfaces) <= 1  # of eight, at 95 %
    for pair in judged:
        if abs(pair.gradient) > 4 * pair.gradient_se:
            assert np.sign(pair.surface) == np.sign(pair.gradient)


def test_the_gradient_fit_costs_less_and_meets_the_targets(found):
    designed, gradient = found.comparison.endings
    assert gradient.simulations < designed.simulations / 2
    for m, wanted in enumerate(TARGETS.values()):
        assert abs(gradient.fitted[:, m].mean() - wanted.mean) < wanted.scatter


def test_a_gradient_saves_points(found):
    """Ten coefficients need ten points alone; with three slopes at the centre seven may do."""
    by_size = {row.points: row for row in found.comparison.enhanced}
    assert all(np.isnan(by_size[size].values_only) for size in (7, 8, 9))
    assert any(np.isfinite(by_size[size].with_gradient) for size in (8, 9))


def test_slopes_disagree_where_they_should():
    pair = SlopePair("force", "surface_energy", "crushing_force_n", 100, 5, 30, 70, 5, 30, True)
    assert not pair.agree
    assert replace(pair, gradient=88.0).agree
    assert Enhanced(5, np.nan, 3.0).points == 5


def test_a_failed_run_ends_the_study_with_its_place():
    work = Formulas(fails=lambda soil: soil.surface_energy > 1.2 * BASE.surface_energy)
    setup = StudySetup(space(LAB, NAMES), work, range(3))
    with pytest.raises(CalibrationError, match=r"screening, point \d+: the bed exploded"):
        study(setup, TARGETS, range(3, 6))


def test_levels_stay_within_the_bounds():
    """Star points too: a factor near its bound gets a narrower range, around the same value."""
    high = float(BASE.plasticity_ratio) * 1.15
    base = replace(BASE, plasticity_ratio=jnp.asarray(high))
    setup = StudySetup(space(LAB, NAMES, base), Formulas(), range(3))
    (factor,) = setup.factors(["plasticity_ratio"], 2.0, {})
    stars = designs.central_composite((factor, *setup.factors(["surface_energy"], 2.0, {})))
    assert stars.natural()[:, 0].max() < 0.85
    assert factor.centre == pytest.approx(high)


def test_a_lab_without_any_target_is_refused():
    with pytest.raises(InputError, match=r"targets.*give one or more of depression_depth_mm"):
        design(replace(LAB, targets={}), PRESETS["quick"], BASE, 0, Formulas())


@pytest.mark.slow
def test_one_target_is_a_goal_of_both_surfaces_and_the_rest_are_responses(tmp_path):
    """The depth, without a target, has effects, surfaces and slopes all the same."""
    lab = replace(LAB, targets={"crushing_force_n": TARGETS["crushing_force_n"]})
    found = design(lab, PRESETS["quick"], BASE, 0, Rough())
    titles = [experiment.title for experiment in found.study.experiments]
    assert titles == ["screening", "force", "force, 3 factors", "refinement"]
    assert set(found.study.screens) == set(TARGETS) and found.study.goals == ("crushing_force_n",)
    assert abs(found.study.fitted[:, 1].mean() - 185.0) < 8.0
    report.write(Session(lab, PRESETS["quick"], tmp_path, Silent()), found)
    page = (tmp_path / report.PAGE).read_text(encoding="utf-8")
    assert "Surface of depression depth" in page and "Force, 3 factors" in page
    assert (tmp_path / "force, 3 factors.csv").exists()
    assert len(list(report.words(found))) == 3


def test_stages_are_called_after_their_goals():
    titles = {
        ("depression_depth_mm", "crushing_force_n"): ("depth", "force"),
        ("settlement_mm", "settlement_mm"): ("settlement", "settlement, 3 factors"),
        ("low.crushing_force_n", "tall.crushing_force_n"): ("force, low", "force, tall"),
    }
    for goals, called in titles.items():
        assert stage_titles(*goals) == called


@pytest.mark.slow
def test_everything_is_written(found, tmp_path):
    """JSON, a page without requests, one run sheet a design with every response in it."""
    session = Session(replace(LAB, targets=TARGETS), PRESETS["quick"], tmp_path, Silent())
    report.write(session, found)
    page = (tmp_path / report.PAGE).read_text(encoding="utf-8")
    assert "http://" not in page.replace("http://www.w3.org", "") and "<script" not in page
    for experiment in found.study.experiments:
        lines = (tmp_path / f"{experiment.title}.csv").read_text().splitlines()
        assert len(lines) == len(experiment.design) + 1
        assert len(lines[1].split(",")) == len(experiment.design.factors) + 2 * 3


@pytest.mark.slow
def test_a_surface_and_the_gradient_agree_on_simulated_beds(tmp_path):
    """48 spheres pressed with 50 N: slopes of depth at the centre of a composite design.

    Two factors, two packings; the modulus matters, and both slopes have its sign and size.
    """
    preset = Preset("tiny", 48, 0.1, 0.2, 2)
    lab = pressed_lightly(LAB)
    work = campaign(lab, preset, tmp_path, Silent())
    setup = StudySetup(space(lab, ("shear_modulus", "static_friction")), work, range(2))
    factors = setup.factors(setup.space.names, 1.5, {})
    composite = designs.central_composite(factors, centre=1)
    goals = {"depression_depth_mm": target(0.2, 1.0, 5.0)}
    stage = surfaces(setup.run("depth", composite, {}), goals)
    slope = stage.whole["depression_depth_mm"].slopes(np.zeros(2))
    found = gradient(setup, setup.soil({}), "gradient")
    surface = slope.values[0] / factors[0].half_range
    reach = 3 * np.hypot(slope.se[0] / factors[0].half_range, float(found.standard_error[0, 0]))
    print(f"dH/dlnG by surface {surface:.3f}, by gradient {float(found.slopes[0, 0]):.3f} mm")
    assert surface < 0
    assert abs(surface - float(found.slopes[0, 0])) < min(reach, 0.3 * abs(surface))


def test_formulas_have_the_interface_of_runs():
    assert isinstance(specimen(BASE, 0), Run)
