"""Posteriors on a response of formulas: density, sampler, what runs add, the file, resumption."""

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import calibrate.verbs.posterior as posterior_verb
from calibrate.core.errors import CalibrationError, InputError
from calibrate.core.progress import Silent
from calibrate.inference import draws as files
from calibrate.inference.draws import described, inference_data, read_draws, write_draws
from calibrate.inference.parameters import RANGES, Acting
from calibrate.inference.posterior import Question, Shown, within_reach
from calibrate.inference.sampling import (
    FURTHER,
    Plan,
    Sampled,
    further_points,
    mixing,
    sample,
    sampled,
    starts,
    values_of,
)
from calibrate.io.choices import ParameterChoice
from calibrate.io.lab import bundled_lab
from calibrate.simulation.specimens import Seeds
from calibrate.verbs.export import export
from tests import ROOT
from tests.support.formulas import BASE, LAB, NAMES, Formulas, on_response

SEEDS = Seeds.of(0, 4, 4)
PLAN = Plan(chains=4, warm_up=100, draws=400, most=1200, chunk=50)
SHORT = replace(PLAN, draws=100, most=100)  # compiled as the other
MEASURED = {"depression_depth_mm": 1.7, "crushing_force_n": 160.0}


def lab(**choices):
    """Targets of a soil that is stiffer and weaker than the start, known to some per cent."""
    targets = {
        name: replace(target, mean=MEASURED[name], scatter=0.06 * MEASURED[name], repeats=4)
        for name, target in LAB.targets.items()
    }
    return replace(LAB, targets=targets, parameters={**LAB.parameters, **choices})


def question(**choices):
    return Question.of(lab(**choices), BASE, on_response(), Formulas(), SEEDS)


@pytest.fixture(scope="module")
def asked():
    return question()


@pytest.fixture(scope="module")
def density(asked):
    return asked.density(asked.own_error(), [])


def at(asked, *shifts):
    """y of a soil whose ln p are shifted from the start."""
    return jnp.asarray(asked.space.to_unbounded(asked.space.start() * np.exp(shifts)))


# ------------------------------------------------------------------ the density


def test_the_density_s_gradient_is_jax_s_and_that_of_differences(asked, density):
    y = at(asked, 0.3, -0.2)
    found, step = eqx.filter_jit(jax.grad(lambda d, y: d(y), 1))(density, y), 1e-5
    for column, way in enumerate(np.eye(2)):
        apart = density(y + step * way) - density(y - step * way)
        assert found[column] == pytest.approx(float(apart) / (2 * step), rel=1e-6)


def test_the_density_is_that_of_normals_in_ln_p(asked, density):
    """One per cent of each of the response's values is its own error: depth is one of them."""
    y = at(asked, 0.3, -0.2)
    values = asked.space.start() * np.exp([0.3, -0.2])
    mean, own = density.shown(jnp.asarray(values))
    expected = asked.response.features(asked.problem, asked.space.soil(values), [0], "")[0]
    assert np.asarray(mean) == pytest.approx(expected)
    deviation = asked.response.error(asked.problem, asked.space.soil(values))
    assert np.sqrt(np.diag(own)) == pytest.approx(deviation, rel=0.03)
    total = asked.problem.target_variance + np.diag(own)
    known = norm.logpdf(asked.problem.measured, expected, np.sqrt(total)).sum()
    known += norm.logpdf([0.3, -0.2], 0, asked.space.prior_sd()).sum()
    known += np.log(asked.space.log_slope(np.asarray(y))).sum()
    constant = np.log(2 * np.pi) * 2 + np.log(asked.space.prior_sd()).sum()
    assert float(density(y)) == pytest.approx(known + constant, abs=1e-4)


def test_bounds_end_where_the_response_does(asked):
    start = asked.space.start()
    assert asked.space.bounds() == pytest.approx(np.outer(start, np.exp([-1, 1])))
    of_fits = [RANGES[name] for name in NAMES]
    ends = np.log([[each.low, each.high] for each in of_fits] / start[:, None])
    assert [each.prior_sd for each in of_fits] == [1.0, 1.0]
    assert asked.share == pytest.approx((2 * norm.cdf(1) - 1) / np.diff(norm.cdf(ends))[:, 0])


def test_what_the_lab_holds_is_held():
    held = ParameterChoice(None, None, None, None, False)
    assert question(surface_energy=held).space.names == ("shear_modulus",)


def test_no_mass_inside_the_bounds_is_one_sentence(asked):
    far = 10 * asked.space.start()[0]
    (first, second), reach = asked.space.ranges, asked.response.reach
    narrow = replace(asked.space, ranges=(replace(first, low=far, high=2 * far), second))
    with pytest.raises(CalibrationError, match="no mass inside the bounds: shear_modulus"):
        within_reach(narrow, reach)


# ------------------------------------------------------------------ strengths of effects


class Stronger(eqx.Module):
    """In the place of `UnderEffects`: a typical strength adds a tenth to forces."""

    def __call__(self, beds, soil, strengths):
        return beds.values(soil) * (1 + jnp.array([0.0, 0.0, 0.1, 0.1]) * strengths[0])


GAIN = Acting("load_cell_gain", 0.03, "1", -2.0, 3.0)


@pytest.fixture(scope="module")
def with_effect():
    """The question with the strength of an effect that the data see in the force alone."""
    response = replace(on_response(), acting=(GAIN,), under=lambda names: Stronger())
    return Question.of(lab(), BASE, response, Formulas(), SEEDS, (GAIN,))


def test_a_strength_is_normal_beforehand_and_moves_what_is_shown(asked, density, with_effect):
    of_both = with_effect.density(with_effect.own_error(), [])
    y, share = at(asked, 0.3, -0.2), 0.8  # of the way from -2 to 3 typical strengths
    values = np.asarray(of_both.values(jnp.append(y, np.log(share / (1 - share)))))
    assert values == pytest.approx(np.append(density.values(y), 2.0))
    for strength, force in ((0.0, 1.0), (2.0, 1.2), (-1.5, 0.85)):
        alone, both = density.shown(values[:2])[0], of_both.shown(jnp.append(values[:2], strength))
        assert np.asarray(both[0] / alone) == pytest.approx([1.0, force], rel=1e-4)
    narrow = replace(of_both, covariance=1e12 * of_both.covariance)  # the data say nothing
    heights = [float(narrow(jnp.append(y, np.log((s + 2) / (3 - s))))) for s in (0.5, 2.0)]
    slopes = [np.log((s + 2) * (3 - s)) for s in (0.5, 2.0)]
    expected = norm.logpdf(2.0) - norm.logpdf(0.5) + slopes[1] - slopes[0]
    assert heights[1] - heights[0] == pytest.approx(expected, abs=1e-3)


@pytest.mark.slow
def test_what_an_effect_may_have_done_is_left_open(asked, with_effect, tmp_path):
    """The force no longer tells of the soil alone: the parameter behind it is less sure, and the
    strength as open as before."""
    said = []
    for each in (asked, with_effect):
        found = sampled(each, [], None, {}, 0, tmp_path, Silent(), SHORT)
        tree = inference_data(each, found, 0, {})
        said.append(described(each, found, tree, []))
    alone, both = said
    assert "effects" not in alone
    row = both["effects"]["load_cell_gain"]
    assert row["unit"] == "1" and -0.06 <= row["low"] < row["median"] < row["high"] <= 0.09
    assert row["width"] == pytest.approx(1.0, abs=0.25)
    width = [each["parameters"]["surface_energy"]["width"] for each in said]
    assert width[1] > 1.1 * width[0]
    write_draws(tree, tmp_path)
    with pytest.raises(InputError, match=r"strengths of effects \(load_cell_gain\)"):
        read_draws(tmp_path)


@pytest.mark.slow
def test_runs_are_asked_for_without_effects(with_effect, tmp_path):
    work = Formulas()
    wide = replace(with_effect, response=replace(with_effect.response, errors=lambda soil: (
        10 * with_effect.response.errors(soil))))  # fmt: skip
    found = sampled(wide, [], work, {}, 0, tmp_path, Silent(), SHORT)
    assert 0 < found.added <= FURTHER
    assert all(len(each.values) == len(NAMES) for each in found.shown)


@pytest.mark.parametrize(
    ("names", "said"), [(["load_cell_gian"], "load_cell_gain"), (["load_cell_gain"] * 2, "twice")]
)
def test_effects_that_are_not_known_are_refused(with_effect, names, said):
    with pytest.raises(InputError, match=said):
        posterior_verb.asked_for(names, with_effect.response)
    assert posterior_verb.asked_for(["load_cell_gain"], with_effect.response) == (GAIN,)


# ------------------------------------------------------------------ what runs add


def shown_at(asked, shifts, packings, ratio):
    """Runs that give a ratio of what the response shows."""
    values = asked.space.start() * np.exp(shifts)
    features = asked.response.features(asked.problem, asked.space.soil(values), [0], "")
    return Shown(values, packings, np.tile(ratio * features[0], (len(packings), 1)))


def test_many_runs_correct_the_response_where_they_are_and_not_far_off(asked):
    error = asked.own_error()
    many = shown_at(asked, [0.1, 0.1], tuple(range(4000)), np.array([1.01, 0.99]))
    density = asked.density(error, [many])
    plain, (near, own) = asked.density(error, []), density.shown(jnp.asarray(many.values))
    before, unsure = plain.shown(jnp.asarray(many.values))
    assert np.asarray(near / before) == pytest.approx([1.01, 0.99], abs=2e-3)
    assert np.all(np.diag(own) < 0.05 * np.diag(unsure))
    far = jnp.asarray(asked.space.bounds()[:, 0])
    rate = np.asarray(density.shown(far)[0] / plain.shown(far)[0])
    assert np.all(np.abs(rate - 1) < 0.004)


def test_one_packing_corrects_by_the_part_that_is_not_its_own_luck(asked):
    """The mean is the ratio times e^2/(e^2 + scatter^2), and so much of the variance goes."""
    error = asked.own_error()
    one = shown_at(asked, [0.0, 0.0], (0,), np.exp([0.02, 0.02]))
    values = jnp.asarray(one.values)
    plain, found = (asked.density(error, runs).shown(values) for runs in ([], [one]))
    own = np.diag(plain[1]) / np.asarray(plain[0]) ** 2
    part = own / (own + np.diag(asked.scatter))
    assert np.log(np.asarray(found[0] / plain[0])) == pytest.approx(0.02 * part, rel=1e-3)
    left = np.diag(found[1]) / np.asarray(found[0]) ** 2
    assert left == pytest.approx(own * (1 - part), rel=1e-3)


def test_points_that_share_packings_share_their_luck(asked):
    error = asked.own_error()
    first = shown_at(asked, [0.0, 0.0], (0, 1), np.ones(2))
    again, other = (shown_at(asked, [0.01, 0.0], p, np.ones(2)) for p in ((0, 1), (2, 3)))
    variance = [
        np.diag(asked.density(error, [first, second]).shown(jnp.asarray(first.values))[1])
        for second in (again, other)
    ]
    assert np.all(variance[0] > variance[1])


def test_runs_are_asked_for_where_they_narrow_and_only_as_many_as_it_takes(asked):
    error = asked.own_error()
    values = np.exp(asked.prior.rvs((400, 2), np.random.default_rng(0)))
    sure = replace(asked, problem=replace(asked.problem, target_variance=1e-6 * MEASURES**2))
    points = further_points(sure, error, [], values, 3)
    assert 1 <= len(points) <= 3
    assert len({packings for _, packings in points}) == min(len(points), 2)  # they take turns
    loose = replace(asked, problem=replace(asked.problem, target_variance=MEASURES**2))
    assert further_points(loose, error, [], values, 3) == []


@pytest.mark.slow
def test_runs_that_were_asked_for_are_made_and_draws_are_taken_again(asked, tmp_path):
    """Depth measured to a thousandth: runs at the posterior narrow what the response leaves."""
    sure = replace(asked, problem=replace(asked.problem, target_variance=1e-6 * MEASURES**2))
    work, plan = Formulas(), replace(SHORT, draws=50, most=50)
    found = sampled(sure, [], work, {}, 0, tmp_path, Silent(), plan)
    assert 1 <= found.added <= FURTHER and len(found.shown) == found.added
    assert work.simulated == found.added * len(SEEDS.fitted)
    at = jnp.asarray(found.shown[0].values)
    before = asked.density(asked.own_error(), []).shown(at)[1]
    assert np.all(np.diag(found.density.shown(at)[1]) < np.diag(before))
    none = sampled(sure, [], None, {}, 0, tmp_path, Silent(), plan)
    assert none.added == 0


def test_numbers_that_no_soil_explains_together_are_said_to_be_so(asked, tmp_path):
    """Depth and force of a soil of the response, and a depth eight deviations off with a force that
    asks for the contrary."""
    for measured, contradicts in ((MEASURES, False), (MEASURES * [3.0, 3.0], True)):
        problem = replace(asked.problem, measured=measured, target_variance=(0.01 * measured) ** 2)
        narrow = tuple(replace(r, prior_sd=0.05) for r in asked.space.ranges)
        strict = replace(asked, problem=problem, space=replace(asked.space, ranges=narrow))
        strict = asked if not contradicts else strict
        found = sampled(strict, [], None, {}, 0, tmp_path, Silent(), SHORT)
        said = described(strict, found, inference_data(strict, found, 0, {}), [])
        assert (said["chance"] < 0.01) == contradicts
        assert any("all measured numbers together" in w for w in said["warnings"]) == contradicts


def test_a_number_beyond_the_response_s_curves_has_no_say(asked, tmp_path):
    unknown = np.array([False, True])
    deaf = replace(asked, problem=asked.problem.without(unknown), unknown=unknown)
    off = replace(deaf.problem, measured=deaf.problem.measured * [1.0, 1.5])
    logs = []
    for each in (deaf, replace(deaf, problem=off)):
        found = sampled(each, [], None, {}, 0, tmp_path, Silent(), SHORT)
        logs.append(np.log(values_of(found.density, found.draws.y)).mean(axis=(0, 1)))
        said = described(each, found, inference_data(each, found, 0, {}), [])
        assert any("without a say: crushing_force_n" in sentence for sentence in said["warnings"])
    assert logs[0] == pytest.approx(logs[1], abs=0.1)


MEASURES = np.array([*MEASURED.values()])


# ------------------------------------------------------------------ draws


@pytest.fixture(scope="module")
def drawn(asked, density, tmp_path_factory):
    folder = tmp_path_factory.mktemp("draws")
    found = sample(density, asked.best(), {}, 0, folder, Silent(), PLAN)
    return Sampled(density, found, (), 0)


def test_draws_are_those_of_brute_force(asked, density, drawn):
    """Means, deviations and correlation of ln p beside a grid of the density."""
    (centre, covariance), step = asked.best(), np.linspace(-6, 6, 241)
    sides = centre[:, None] + np.sqrt(np.diag(covariance))[:, None] * step
    grid = jnp.asarray(np.stack(np.meshgrid(*sides, indexing="ij"), -1).reshape(-1, 2))
    logs = np.log(np.asarray(density.values(grid)))
    weight = np.exp(np.asarray(jax.lax.map(density, grid, batch_size=4096)))
    weight /= weight.sum()
    mean = weight @ logs
    spread = np.sqrt(weight @ (logs - mean) ** 2)
    found = np.log(values_of(density, drawn.draws.y)).reshape(-1, 2)
    assert np.all(np.abs(found.mean(axis=0) - mean) < 0.1 * spread)
    assert found.std(axis=0) == pytest.approx(spread, rel=0.08)
    for row in range(2):
        order = np.argsort(logs[:, row])
        ends = np.interp([0.05, 0.95], np.cumsum(weight[order]), logs[order, row])
        inside = np.mean((found[:, row] > ends[0]) & (found[:, row] < ends[1]))
        assert inside == pytest.approx(0.9, abs=0.03)


def test_chains_mix_and_say_so_by_arviz(drawn):
    rhat, ess = mixing(drawn.draws.y)
    assert np.all(rhat < 1.01) and np.all(ess > 400)
    apart = drawn.draws.y + np.arange(4)[:, None, None]  # four chains in four places
    assert np.all(mixing(apart)[0] > 1.2)


def test_the_file_gives_back_soils_and_groups_of_arviz(asked, drawn, tmp_path):
    tree = inference_data(asked, drawn, 0, {"preset": "standard"})
    write_draws(tree, tmp_path)
    found = read_draws(tmp_path)
    groups = {
        "posterior",
        "prior",
        "posterior_predictive",
        "observed_data",
        "sample_stats",
        "curves",
    }
    assert set(found.tree.children) == groups and found.names == NAMES
    values = values_of(drawn.density, drawn.draws.y).reshape(-1, 2)
    assert found.values == pytest.approx(values)
    soil = found.soil(7)
    assert [float(getattr(soil, n)) for n in NAMES] == pytest.approx(values[7])
    assert float(soil.rolling_friction) == float(BASE.rolling_friction)
    said = described(asked, drawn, tree, [])
    row = said["parameters"]["shear_modulus"]
    assert row["low"] < row["median"] < row["high"] and row["rhat"] < 1.01 < row["ess"]
    assert said["features"]["depression_depth_mm"]["met"] and said["divergences"] == 0


def test_soils_along_what_is_open_are_exported_a_file_each(asked, drawn, tmp_path):
    write_draws(inference_data(asked, drawn, 0, {"spheres": 2000}), tmp_path)
    export(tmp_path, to="json", diameter="4 mm", draws=3, out=tmp_path / "out")
    written = [json.loads(path.read_text()) for path in sorted((tmp_path / "out").iterdir())]
    logs = np.log([[s["parameters"][n]["value"] for n in NAMES] for s in written])
    every = np.log(values_of(drawn.density, drawn.draws.y)).reshape(-1, 2)
    turns = np.diff(logs, axis=0) @ np.linalg.svd(every - every.mean(axis=0))[2][0]
    assert len(written) == 3 and abs(np.sign(turns).sum()) == 2  # one way all along
    assert np.abs(turns).min() > 0.5 * every.std(axis=0).max()


def test_draws_of_another_physics_version_are_refused(asked, drawn, tmp_path, monkeypatch):
    write_draws(inference_data(asked, drawn, 0, {}), tmp_path)
    monkeypatch.setattr(files, "PHYSICS", files.PHYSICS + 1)
    with pytest.raises(InputError, match="draws of another physics version"):
        read_draws(tmp_path)


def test_a_file_that_is_none_is_one_sentence(tmp_path):
    with pytest.raises(InputError, match="there is no such file"):
        read_draws(tmp_path)
    (tmp_path / files.FILE).write_bytes(b"nothing")
    with pytest.raises(InputError, match="not draws of a posterior"):
        read_draws(tmp_path)


def test_chains_that_do_not_mix_are_named(asked, drawn):
    apart = drawn.draws._replace(y=drawn.draws.y + np.arange(4)[:, None, None] * [1.0, 0.0],
                                 diverging=np.ones_like(drawn.draws.diverging))  # fmt: skip
    found = replace(drawn, draws=apart)
    said = described(asked, found, inference_data(asked, found, 0, {}), [])["warnings"]
    assert any("the chains have not mixed: shear_modulus" in sentence for sentence in said)
    assert any("trajectories diverged" in sentence for sentence in said)


def test_what_no_soil_shows_is_said(asked, density, tmp_path):
    """A force twice as large as any soil of the response has."""
    far = replace(asked, problem=replace(asked.problem, measured=MEASURES * [1, 5.0]))
    found = sampled(far, [], None, {}, 0, tmp_path, Silent(), PLAN)
    said = described(far, found, inference_data(far, found, 0, {}), [])["warnings"]
    assert any("crushing_force_n is 800" in sentence for sentence in said)
    assert any("draws of surface_energy gather" in sentence for sentence in said)
    assert any("shear_modulus" in sentence and "left out" in sentence for sentence in said)


# ------------------------------------------------------------------ resumption


def test_a_sampler_that_goes_on_draws_the_same(asked, density, tmp_path):
    def drawn(folder):
        return sample(density, asked.best(), {}, 3, folder, Silent(), SHORT)

    whole = drawn(tmp_path / "a")
    kept = sorted((tmp_path / "a/draws").iterdir())
    assert len(kept) == 4
    for count in range(4):
        for path in sorted((tmp_path / "a/draws").iterdir())[count:]:
            path.unlink()
        again = drawn(tmp_path / "a")
        assert all(np.array_equal(a, b) for a, b in zip(whole, again, strict=True))
    kept[2].write_bytes(kept[2].read_bytes()[:1000])  # damaged
    again = drawn(tmp_path / "a")
    assert np.array_equal(whole.y, again.y)


def test_other_data_or_seeds_draw_anew(asked, density, tmp_path):
    start = asked.best()
    for number, (content, seed) in enumerate([({}, 0), ({"a": 1}, 0), ({}, 1)]):
        sample(density, start, content, seed, tmp_path, Silent(), SHORT)
        assert len(list((tmp_path / "draws").iterdir())) == 4 * (number + 1)


def test_draws_of_another_lab_are_not_taken_in_the_same_folder(asked, density, tmp_path):
    """Numbers that were measured otherwise, or a wider prior: nothing but the density differs."""
    start = asked.best()
    other = eqx.tree_at(lambda d: d.measured, density, 1.01 * density.measured)
    wider = eqx.tree_at(lambda d: d.prior_sd, density, 2.0 * density.prior_sd)
    for number, each in enumerate([density, other, wider, density]):
        sample(each, start, {}, 0, tmp_path, Silent(), SHORT)
        assert len(list((tmp_path / "draws").iterdir())) == 4 * min(number + 1, 3)


def test_chains_begin_on_the_top_that_holds_the_mass():
    """Another lies thirty nats below, and about that one the best fit was found."""

    def density(y):
        high = -0.5 * jnp.sum(((y - 2.0) / 0.5) ** 2)
        low = -30.0 - 0.5 * jnp.sum((y + 2.0) ** 2)
        return jnp.logaddexp(high, low)

    about = jnp.full(3, -2.0), 0.01 * jnp.eye(3)
    found = np.asarray(starts(density, about, 8, seed=4))
    assert np.all(np.abs(found - 2.0) < 0.5)
    assert len(np.unique(found, axis=0)) == 8
    assert np.array_equal(found, np.asarray(starts(density, about, 8, seed=4)))


KILLED = """
import sys
from pathlib import Path
from calibrate.core import runtime
runtime.configure()
from calibrate.core.progress import Silent
from calibrate.inference.sampling import sample
from tests.calibrate.inference.test_posterior import SHORT, question
asked = question()
density = asked.density(asked.own_error(), [])
print("ready", flush=True)
sample(density, asked.best(), {}, 5, Path(sys.argv[1]), Silent(), SHORT)
"""


@pytest.mark.slow
def test_a_sampler_that_is_killed_at_any_moment_leaves_the_same_draws(tmp_path):
    """Each start is killed soon after its first new chunk; the last one ends."""

    def started():
        return subprocess.Popen(
            [sys.executable, "-c", KILLED, str(tmp_path / "killed")], cwd=ROOT,
            stdout=subprocess.PIPE, text=True,
        )  # fmt: skip

    for moment in (0.0, 0.3, 0.6):
        process = started()
        assert process.stdout is not None and process.stdout.readline() == "ready\n"
        chunks = len(kept(tmp_path / "killed"))
        while process.poll() is None and len(kept(tmp_path / "killed")) == chunks:
            time.sleep(0.02)
        time.sleep(moment * 0.1)
        process.send_signal(signal.SIGKILL)
        process.communicate()
    assert started().wait() == 0
    whole = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / "whole")], cwd=ROOT)
    assert whole.returncode == 0
    both = [kept(tmp_path / name) for name in ("killed", "whole")]
    assert [path.name for path in both[0]] == [path.name for path in both[1]]
    for one, other in zip(*both, strict=True):
        with np.load(one) as a, np.load(other) as b:
            assert all(np.array_equal(a[name], b[name]) for name in a.files)


def kept(folder):
    """Chunks that are whole; a kill may leave a part of one, under a name of its own."""
    found = sorted((folder / "draws").glob("*.npz")) if folder.exists() else []
    return [path for path in found if ".part" not in path.name]


# ------------------------------------------------------------------ the command


def test_a_lab_that_the_library_does_not_serve_is_one_sentence(calibrate):
    status, _, error = calibrate("posterior", bundled_lab("trumao_oedometer"), "--no-runs")
    assert status == 2 and "the library of runs does not serve this laboratory" in error
    status, _, error = calibrate("posterior", "--preset", "quick")
    assert status == 2 and "coarse beds" in error


@pytest.mark.slow
def test_the_command_writes_draws_words_and_a_picture(calibrate, tmp_path, monkeypatch):
    monkeypatch.setattr(posterior_verb, "sampled", partial(sampled, plan=SHORT))
    status, out, _ = calibrate("posterior", "--no-runs", "--out", "o")
    assert status == 0 and "posterior.png are in o" in out
    assert "fixed by the data" in out and "left open by the data" in out
    found = json.loads((tmp_path / "o/posterior.json").read_text())
    low, high = (found["parameters"]["shear_modulus"][key] for key in ("low", "high"))
    assert 3.9e6 < low < 4.5e6 < high < 5.2e6
    assert found["simulations"] == 0 and found["physics"] == files.PHYSICS
    assert found["parameters"]["surface_energy"]["width"] > 0.6  # left open
    draws = read_draws(tmp_path / "o")
    logs = np.log(draws.values)
    names = draws.names.index("surface_energy"), draws.names.index("plasticity_ratio")
    assert np.corrcoef(logs[:, names].T)[0, 1] < -0.15
    assert (tmp_path / "o/posterior.png").stat().st_size > 10_000
