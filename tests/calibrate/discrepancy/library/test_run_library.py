"""The library: its design, its emulator on formulas, its file, and what a lab becomes in it."""

import csv
import pickle
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
import xarray as xr

from calibrate.core.errors import CalibrationError, InputError
from calibrate.discrepancy.library import run_library, simulate, store
from calibrate.discrepancy.library.cross_validation import (
    BLOCK,
    FOLDS,
    EmulatorErrors,
    Repeats,
    Split,
    by_effects,
    cross_validate,
    dropped_split,
    fold_of,
)
from calibrate.discrepancy.library.description import EmulatedLibrary
from calibrate.discrepancy.library.design import (
    ACTIVE,
    AGAIN,
    ALONE,
    FIRST_REFINED,
    FURTHEST,
    LIMITS,
    OF,
    POROSITIES,
    REFINED,
    REFINED_AGAIN,
    REFINED_SHARE,
    SETTINGS,
    SPECIMENS,
    SPEEDS,
    TURN,
    WEAKEST,
    Design,
)
from calibrate.discrepancy.library.emulator import (
    FeatureEmulator,
    fit_emulator,
    leading,
    spread,
)
from calibrate.discrepancy.library.kernel import PACE, Blocks
from calibrate.discrepancy.library.lab_size import soil_prior_for
from calibrate.discrepancy.library.run_library import Cylinder, Rows, RunLibrary
from calibrate.discrepancy.library.simulate import lacks_refined
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.response.process import covariance
from jdem.physics import PHYSICS
from tests.support import toy_library
from tests.support.formulas import LAB

jax.config.update("jax_enable_x64", True)

RNG = np.random.default_rng(3)
ROWS, EACH, P, K = 132, 6, 4, 2
PACKING = np.repeat(np.arange(ROWS // EACH), EACH)
X, S = RNG.normal(size=(ROWS, P)), RNG.uniform(-1, 1, size=(ROWS, K))
S[RNG.random(S.shape) < 0.5] = 0.0
SCALE = np.array([20.0, 20.0, 0.2])
PACKING_SD = 0.15


def formula(x: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Two forces (N) and a depth (mm) that a soil might have, shapes (..., 3)."""
    force = 200 * np.exp(0.4 * x[..., 0] + 0.2 * x[..., 1] + 0.5 * s[..., 0])
    toe = 60 * np.exp(0.3 * x[..., 1] + 0.1 * x[..., 2] ** 2)
    depth = 3 * np.exp(-0.4 * x[..., 0]) + 0.4 * s[..., 1]
    return np.stack([force, toe, depth], axis=-1)


@pytest.fixture(scope="module")
def emulator() -> FeatureEmulator:
    """Fitted to the formula with packings that scatter by 15 %."""
    scatter = np.exp(PACKING_SD * RNG.normal(size=(ROWS // EACH, 1)))[PACKING]
    return fit_emulator(X, S, PACKING, formula(X, S) * scatter, SCALE)


def test_a_library_without_simulations_is_refused_in_a_sentence():
    with pytest.raises(CalibrationError, match="give more --packings"):
        spread(np.zeros(0, int), 100)


def test_an_emulator_that_was_used_goes_to_another_process(emulator):
    """With the points that it keeps left behind, and the same answers."""
    x, s = X[3], S[3]
    known = emulator.variances(x, s)
    other = pickle.loads(pickle.dumps(emulator))
    assert np.array_equal(other.variances(x, s), known)
    assert emulator.variances(x, s) is known  # still kept here


def test_design_is_within_its_limits_and_a_beginning_is_a_smaller_design():
    small, large = Design(packings=8), Design(packings=16)
    fewer, every = small.rows(), large.rows()
    beginning = len(fewer.base)
    for name, part in vars(fewer).items():
        assert np.array_equal(part, getattr(every, name)[:beginning])
        assert np.array_equal(getattr(large.rows(8), name), getattr(every, name)[beginning:])
    low, high = np.array(list(LIMITS.values())).T
    assert (every.strengths >= low).all() and (every.strengths <= high).all()
    wide = len(large.soil_names)
    assert np.abs(every.base[:, :wide] / large.spread()[:wide]).max() <= FURTHEST + 1e-9


def alone(design: Design) -> np.ndarray:
    """Which packings show one effect at a time."""
    return np.isin(np.arange(design.packings) % OF, ALONE)


def test_effects_are_at_work_together_where_rows_differ_in_everything():
    design = Design(packings=200, slow_in=0)
    points = design.rows()
    base, strengths = (
        part.reshape(200, design.rows_each, -1) for part in (points.base, points.strengths)
    )
    mixed = ~alone(design)
    assert (strengths[mixed] != 0).mean() == pytest.approx(ACTIVE, abs=0.02)
    assert not (base[mixed] == base[mixed, :1]).all(axis=(1, 2)).any()


def test_slow_rows_repeat_the_soils_and_effects_of_fast_ones_on_the_same_packing():
    design = Design(packings=2 * TURN, slow_in=2)
    points = design.rows()
    base, strengths, packing = points.base, points.strengths, points.packing
    pace = base[:, design.base_names.index("pace")]
    slow = pace < 1
    assert set(pace) == {1.0, SPEEDS[1] / SPEEDS[0]}
    assert set(packing[slow]) == set(range(TURN)) and len(set(packing)) == 2 * TURN
    rest = np.delete(base, design.base_names.index("pace"), axis=1)
    twice = (packing < TURN) & ~slow
    assert np.array_equal(rest[slow], rest[twice])
    assert np.array_equal(strengths[slow], strengths[twice])


def test_every_size_of_spheres_meets_every_porosity():
    design = Design(packings=48, slow_in=0)
    points = design.rows()
    of_packing, spheres = points.base[:: design.rows_each], points.spheres[:: design.rows_each]
    settings = dict(zip(SETTINGS, of_packing[:, -len(SETTINGS) :].T, strict=True))
    porosity, size = settings["porosity"], settings["sphere_size"]
    pairs = set(zip(spheres, porosity.tolist(), strict=True))
    assert pairs == {(n, p) for n in (500, 1000, 2500) for p in POROSITIES}
    assert (1 + size) ** -3 * 1000 == pytest.approx(spheres)
    assert np.median(settings["smoothing"]) < -0.5 and settings["smoothing"].max() > 0


def test_some_packings_show_each_effect_by_itself_on_one_soil():
    design = Design(packings=65, slow_in=0)
    points = design.rows()
    base, strengths = (
        part.reshape(design.packings, design.rows_each, -1)[alone(design)]
        for part in (points.base, points.strengths)
    )
    assert (base == base[:, :1]).all()
    assert not strengths[:, 0].any()
    single = strengths[:, 1:]
    assert ((single != 0).sum(axis=2) == 1).all()
    assert (single != 0).sum(axis=(0, 1)).tolist() == [10] * len(LIMITS)
    low, high = np.array(list(LIMITS.values())).T
    assert (single >= low).all() and (single <= high).all()
    reach = np.where(single < 0, low, np.where(single > 0, high, 1.0))
    assert (single / reach)[single != 0].min() >= WEAKEST
    assert ((single < 0).any(axis=(0, 1)) == (low < 0)).all()


def test_emulator_predicts_new_points_within_packing_scatter(emulator):
    """The mean over 22 packings is known to 15 %/sqrt(22) = 3 %; the rest is interpolation."""
    x, s = 0.7 * RNG.normal(size=(40, P)), RNG.uniform(-0.5, 0.5, size=(40, K))
    predicted = np.array([emulator(a, b)[0] for a, b in zip(x, s, strict=True)])
    mean = formula(x, s) * np.exp(PACKING_SD**2 / 2)
    assert np.sqrt(np.mean((predicted / mean - 1) ** 2, axis=0)).max() < 0.09


def test_slopes_are_derivatives_of_values(emulator):
    x, s, step = np.array([0.3, -0.5, 0.2, 0.1]), np.array([0.2, 0.1]), 1e-3
    _, base, effects = emulator(x, s)
    for i in range(P):
        ahead, back = (emulator(x + sign * step * np.eye(P)[i], s)[0] for sign in (1, -1))
        assert base[:, i] == pytest.approx((ahead - back) / (2 * step), rel=1e-4, abs=1e-6)
    for k in range(K):
        ahead, back = (emulator(x, s + sign * step * np.eye(K)[k])[0] for sign in (1, -1))
        assert effects[:, k] == pytest.approx((ahead - back) / (2 * step), rel=1e-4, abs=1e-6)


def test_errors_of_slopes_are_those_of_differences_of_values(emulator):
    """The difference of a process at two near points has the variance that their covariance says;
    slopes are known less surely far from the runs."""
    x, s, step = np.array([0.3, -0.5, 0.2, 0.1]), np.array([0.2, 0.1]), 5e-3
    found = emulator.slope_variances(x, s)
    assert np.all(emulator.slope_variances(4 * np.ones(P), s) > found)
    for number, component in enumerate(emulator.components):
        ends = x[None] + step * np.vstack([np.eye(P), -np.eye(P)])
        at = ends, np.repeat(s[None], len(ends), axis=0)
        own = np.asarray(covariance(component.kernel, *at, *at))
        known = np.asarray(covariance(component.kernel, *at, emulator.x, emulator.s))
        white = np.linalg.solve(emulator.factors[number], (known[:P] - known[P:]).T)
        before = np.diag(own)[:P] + np.diag(own)[P:] - 2 * np.diag(own[:P, P:])
        apart = (before - (white**2).sum(axis=0)) / (2 * step) ** 2
        assert found[number] == pytest.approx(apart, rel=1e-3)


def test_slopes_agree_with_the_formula_though_packings_scatter(emulator):
    _, base, effects = emulator(np.zeros(P), np.zeros(K))
    assert base[0, 0] == pytest.approx(0.4 * 200, rel=0.15)
    assert effects[0, 0] == pytest.approx(0.5 * 200, rel=0.15)
    assert effects[2, 1] == pytest.approx(0.4, rel=0.2)


def test_soil_blocks_show_an_effect_that_scatter_between_soils_hides():
    """Specimens scatter by 30 % from soil to soil of one packing, by 1 % between soil blocks."""
    rng, packings = np.random.default_rng(6), 40
    packing = np.repeat(np.arange(packings), EACH)
    x = np.repeat(rng.normal(size=(packings, P)), EACH, axis=0)
    mixed = packing < packings // 2
    x[mixed] = rng.normal(size=(mixed.sum(), P))
    s = np.where(np.arange(len(x)) % EACH == 0, 0.0, rng.uniform(0.3, 1, len(x)))[:, None]
    own = rng.normal(size=len(x))
    first = np.arange(len(x)) // EACH * EACH
    scatter = np.exp(0.3 * np.where(mixed, own, own[first]) + 0.01 * rng.normal(size=len(x)))
    force = 200 * np.exp(0.4 * x[:, 0] + 0.5 * s[:, 0]) * scatter
    estimated = fit_emulator(x, s, packing, force[:, None], SCALE[:1])
    kernel = estimated.components[0].kernel
    assert np.exp(kernel.soil_block - kernel.rest) > 3
    both = np.hypot(np.exp(kernel.soil_block), np.exp(kernel.rest))
    blind = kernel._replace(soil_block=np.log(1e-3), rest=np.log(both))
    untold = fit_emulator(x, s, packing, force[:, None], SCALE[:1], [blind])
    here, none = np.zeros(P), np.zeros(1)
    slopes = [each(here, none)[2][0, 0] / each(here, none)[0][0] for each in (estimated, untold)]
    errors = np.abs(np.array(slopes) - 0.5)
    assert errors[0] < 0.05 and errors[0] < 0.2 * errors[1]


def test_scatter_that_depends_on_the_soil_is_learned():
    """From 5 to 37 % over four deviations of the first coordinate: ln scatter goes with 0.5 x."""
    rng, packings = np.random.default_rng(8), 60
    packing = np.repeat(np.arange(packings), EACH)
    x, s = rng.normal(size=(packings * EACH, P)), np.zeros((packings * EACH, 1))
    loud = 0.136 * np.exp(0.5 * x[:, 0])
    force = 200 * np.exp(0.2 * x[:, 1] + loud * rng.normal(size=packings)[packing])
    estimated = fit_emulator(x, s, packing, force[:, None], SCALE[:1])
    slopes = estimated.components[0].kernel.scattering
    assert slopes == pytest.approx(np.eye(P)[0] * 0.5, abs=0.15)
    at = np.eye(P)[0]
    ratio = estimated.larger(2 * at) / estimated.larger(-2 * at)
    assert ratio == pytest.approx(np.exp([2.0]), rel=0.4)
    assert estimated.residuals.std() == pytest.approx(0.136, rel=0.25)  # as at the centre


def test_slow_packings_lie_in_every_fold():
    """Whole blocks of packings in turn; slow ones are TURN of every 4 TURN packings."""
    packing = np.arange(160)
    folds, slow = fold_of(packing), packing // TURN % Design().slow_in == 0
    assert (folds[::BLOCK].repeat(BLOCK) == folds).all()
    assert np.bincount(folds).tolist() == [40] * FOLDS
    assert np.bincount(folds[slow], minlength=FOLDS).min() >= 8


def test_rows_of_one_soil_may_differ_in_pace():
    x = np.array([[1.0, 2.0, 1.0, 0.0, 0.5]] * 3)
    x[1, PACE], x[2, 0] = 0.3, 1.1
    blocks = Blocks.of(x, np.array([0, 0, 0]))
    assert blocks.soil_block.tolist() == [[1, 1, 0], [1, 1, 0], [0, 0, 1]]


def test_a_file_without_soil_blocks_has_none(tmp_path: Path):
    path = tmp_path / "library.nc"
    store.save(toy_library.library(), path)
    with xr.open_dataset(path, engine="h5netcdf") as stored:
        older = stored.load().drop_vars("kernel_twin")
    older.to_netcdf(path, engine="h5netcdf")
    assert all(kernel.soil_block == store.NOTHING for kernel in store.load(path).kernels)


def test_a_file_whose_soils_do_not_bend_effects_is_read(tmp_path: Path):
    path = tmp_path / "library.nc"
    library = toy_library.library()
    store.save(library, path)
    with xr.open_dataset(path, engine="h5netcdf") as stored:
        older = stored.load().drop_vars(["kernel_local", "kernel_local_length"])
    older.to_netcdf(path, engine="h5netcdf")
    for kernel, now in zip(store.load(path).kernels, library.kernels, strict=True):
        assert (kernel.local == store.NOTHING).all() and kernel.local.shape == now.local.shape
        assert kernel.local_length.shape == now.local_length.shape


def test_a_file_whose_scatter_depends_on_size_alone_is_read(tmp_path: Path):
    path = tmp_path / "library.nc"
    library = toy_library.library()
    store.save(library, path)
    with xr.open_dataset(path, engine="h5netcdf") as stored:
        older = stored.load().drop_vars("kernel_scattering")
    older["kernel_coarse"] = (("component", "one"), np.full((len(library.kernels), 1), 0.4))
    older.to_netcdf(path, engine="h5netcdf")
    for kernel in store.load(path).kernels:
        assert kernel.scattering[-1] == 0.4 and not kernel.scattering[:-1].any()


def test_emulator_is_less_certain_far_away(emulator):
    none = np.zeros(K)
    nothing = EmulatorErrors.nothing(len(emulator.components), len(SCALE))
    near, far = (nothing.of_values(emulator, np.full(P, at), none) for at in (0.0, 6.0))
    assert ((far**2).sum(axis=1) > 3 * (near**2).sum(axis=1)).all()


def test_components_carry_back_to_the_features():
    warped = np.arcsinh(formula(X, S) / SCALE)
    basis = leading(warped, X, S)
    back = basis.mean + basis.components(warped) @ basis.carried.T
    assert np.allclose(back, warped)
    assert np.allclose(basis.components(warped).std(axis=0), 1.0)


def test_components_hold_what_hardly_scatters():
    """Nine features scatter by 1, a tenth varies by 0.1 with the soil and hardly scatters."""
    rng = np.random.default_rng(8)
    x, s = rng.normal(size=(300, 2)), np.zeros((300, 1))
    warped = rng.normal(size=(300, 10))
    warped[:, :9] += np.outer(x[:, 0], np.ones(9))
    warped[:, 9] = 0.1 * x[:, 1] + 1e-3 * rng.normal(size=300)
    basis = leading(warped, x, s, count=2)
    back = basis.mean + basis.components(warped) @ basis.carried.T
    assert np.std(warped[:, 9] - back[:, 9]) < 0.02


def validated(emulator: FeatureEmulator, **changes) -> EmulatorErrors:
    """On other specimens of the same soils; with other hyperparameters."""
    scatter = np.exp(PACKING_SD * np.random.default_rng(5).normal(size=(ROWS // EACH, 1)))[PACKING]
    components = tuple(
        replace(each, kernel=each.kernel._replace(**changes)) for each in emulator.components
    )
    changed = replace(emulator, components=components)
    return cross_validate(changed, PACKING, formula(X, S) * scatter)


def test_cross_validation_shows_scatter_that_an_emulator_lacks(emulator):
    honest = validated(emulator)
    sure = validated(emulator, packing=np.log(0.01))  # forgets that packings differ
    most = int(np.argmax([component.kernel.packing for component in emulator.components]))
    assert 1 / 3 < honest.scatter[most] < 3.0  # 22 packings in one sample and 22 in the other
    assert sure.scatter[most] > 3 * honest.scatter[most]


def test_errors_that_an_emulator_states_are_never_narrowed(emulator):
    assert (validated(emulator).widening >= 1.0).all()


MISSED, SCATTERED = 0.10, 0.05  # of ln force: by soils beside a smooth function, by specimens


@pytest.fixture(scope="module")
def split_errors() -> tuple[FeatureEmulator, EmulatorErrors, EmulatorErrors]:
    """Errors of an emulator of two forces, with and without repeats of 40 soils on four packings:
    each soil differs from the smooth function, and each specimen from its soil, by as much in
    either force."""
    rng, n, soils, specimens = np.random.default_rng(14), 200, 40, 4
    x, s, packing = rng.normal(size=(n, P)), np.zeros((n, 1)), np.arange(n)
    scale = np.full(2, 20.0)

    def forces(x: np.ndarray) -> np.ndarray:
        smooth = np.stack([0.4 * x[:, 0] + 0.2 * x[:, 1], 0.3 * x[:, 1] + 0.2 * x[:, 2]], axis=1)
        return np.log(200) + smooth

    def scattered(sd: float, *shape: int) -> np.ndarray:
        return sd * rng.normal(size=(*shape, 2))

    values = np.exp(forces(x) + scattered(MISSED, n) + scattered(SCATTERED, n))
    emulator = fit_emulator(x, s, packing, values, scale)
    again = rng.normal(size=(soils, P))
    soil = (forces(again) + scattered(MISSED, soils))[:, None]
    repeats = Repeats(again, list(np.exp(soil + scattered(SCATTERED, soils, specimens))))
    known = emulator, packing, values
    return emulator, cross_validate(*known, repeats), cross_validate(*known)


def test_repeats_tell_scatter_of_specimens_from_what_is_missed(split_errors):
    """Rows scatter by both; 120 differences of repeats know their variance to 13 %."""
    emulator, errors, without = split_errors
    whole = MISSED**2 + SCATTERED**2
    assert emulator.residuals.var(axis=0) == pytest.approx(whole, rel=0.25)
    assert errors.scatter == pytest.approx(SCATTERED**2 / whole, rel=0.4)
    assert errors.misfit == pytest.approx(MISSED**2 / whole, rel=0.6)
    assert not without.misfit.any() and without.scatter == pytest.approx(1.0, rel=0.3)


def test_what_is_missed_counts_for_values_and_scatter_for_specimens(split_errors):
    emulator, errors, without = split_errors
    here, none = np.zeros(P), np.zeros(1)
    of_values, stated = (
        np.linalg.norm(e.of_values(emulator, here, none), axis=1) for e in (errors, without)
    )
    assert of_values == pytest.approx(MISSED, rel=0.35)
    assert (stated < 0.5 * of_values).all()
    specimens = errors.specimens(emulator, emulator.residuals, here)
    assert specimens.std(axis=0) == pytest.approx(SCATTERED, rel=0.35)


def test_what_no_component_holds_is_split_too():
    """Six features of which one component is kept; each misses something of each soil beside what
    specimens scatter by."""
    rng, n, soils, m = np.random.default_rng(15), 300, 60, 6
    scale = np.full(m, 20.0)

    def features(x: np.ndarray, *more: int) -> np.ndarray:
        """In ln, with what is missed."""
        plain = np.log(200) + 0.4 * x[:, :1] + MISSED * rng.normal(size=(len(x), m))
        every = plain.reshape(len(x), *[1] * len(more), m)
        return np.exp(every + SCATTERED * rng.normal(size=(len(x), *more, m)))

    x, s = rng.normal(size=(n, P)), np.zeros((n, 1))
    values = features(x)
    basis = leading(np.arcsinh(values / scale), x, s, count=1)
    emulator = fit_emulator(x, s, np.arange(n), values, scale, basis=basis)
    again = rng.normal(size=(soils, P))
    split = dropped_split(emulator, Repeats(again, list(features(again, 4))))
    whole = MISSED**2 + SCATTERED**2
    assert split.scatter == pytest.approx(SCATTERED**2 / whole, rel=0.25)
    assert split.misfit == pytest.approx(MISSED**2 / whole, rel=0.25)


def test_effects_are_sampled_again_on_packings_of_one_soil():
    design = Design(refined=24)
    points = design.refined_rows()
    base, strengths, packing = points.base, points.strengths, points.packing
    each = 1 + len(REFINED)
    assert np.array_equal(packing, np.repeat(np.arange(24), each) + FIRST_REFINED)
    of_packing = base.reshape(24, each, -1)
    assert (of_packing == of_packing[:, :1]).all()  # one soil and setting
    at_work = strengths.reshape(24, each, -1) != 0
    names = [[design.effect_names[k] for k in np.flatnonzero(row)] for row in at_work[0]]
    assert names == [[], *([name] for name in REFINED)]
    assert (at_work == at_work[0]).all()
    largest = np.array([max(map(abs, pair)) for pair in design.limits.values()])
    share = np.abs(strengths / largest)[strengths != 0]
    low, high = REFINED_SHARE
    assert low <= share.min() < low + 0.1 and high - 0.1 < share.max() <= high
    density = strengths[:, design.effect_names.index("specimen_density")]
    assert density.min() < 0 < density.max()
    assert len(set(base[:, list(design.base_names).index("pace")])) == 2
    fewer = replace(design, refined=8).refined_rows().base
    assert np.array_equal(fewer, base[: len(fewer)])


def test_later_packings_sample_other_effects_again():
    design = Design(refined=AGAIN + 16)
    every, later = design.refined_rows(), design.refined_rows(AGAIN)
    for name, part in vars(later).items():
        assert np.array_equal(part, getattr(every, name)[-len(part) :])
    strengths, each = later.strengths, 1 + len(REFINED_AGAIN)
    at_work = strengths.reshape(16, each, -1) != 0
    names = [[design.effect_names[k] for k in np.flatnonzero(row)] for row in at_work[0]]
    assert names == [[], *([name] for name in REFINED_AGAIN)]
    assert (at_work == at_work[0]).all()
    density = strengths[:, design.effect_names.index("specimen_density")].reshape(16, each).sum(1)
    sizes = np.array(later.spheres)[::each]
    for size in set(sizes):  # of one size some are denser and some looser
        assert len(set(np.sign(density[sizes == size]))) == 2


def test_effects_that_are_sampled_again_join_a_library():
    library = toy_library.library()
    design = replace(library.design, refined=2)
    runs = toy_library.run_points(design, design.refined_rows())
    assert lacks_refined(design, library)
    grown = library.refined(design, runs)
    assert 0 < len(grown.rows.values) - len(library.rows.values) <= len(runs)
    assert grown.design.refined == 2 and not lacks_refined(design, grown)
    assert grown.rows.packing.max() == FIRST_REFINED + 1
    more = replace(design, refined=3)
    larger = grown.refined(more, toy_library.run_points(more, more.refined_rows(2)))
    assert np.array_equal(larger.rows.base[: len(grown.rows.base)], grown.rows.base)
    assert set(larger.rows.packing[len(grown.rows.base) :]) == {FIRST_REFINED + 2}


def test_errors_that_an_effect_makes_along_one_direction_are_found():
    """Of two effects the second errs along a direction, ten deviations long at full strength; a
    likelihood with heavy tails finds nine tenths of what is normal."""
    rng, m = np.random.default_rng(11), 12
    root = rng.normal(size=(m, m))
    s = np.zeros((300, 2))
    s[100:160, 0], s[160:220, 1] = rng.uniform(0.2, 1, 60), rng.uniform(-1, 1, 60)
    line = 10 * root[:, 0]
    errors = rng.normal(size=(300, m)) @ root.T + s[:, [1]] * rng.normal(size=(300, 1)) * line
    directions, effect = by_effects(errors, s)
    assert set(effect.tolist()) == {1}
    found, *by_chance = np.linalg.solve(root, directions).T
    assert 7 < abs(found[0]) < 12
    assert np.abs(found[1:]).max() < 0.2 * abs(found[0])
    assert all(np.linalg.norm(other) < 3 for other in by_chance)


def test_one_soil_that_is_far_off_does_not_widen_the_errors_of_all():
    """One of sixty rows with an effect misses by two hundred deviations."""
    rng, m = np.random.default_rng(13), 12
    s = np.zeros((300, 1))
    s[200:260, 0] = rng.uniform(0.3, 1, 60)
    errors = rng.normal(size=(300, m))
    errors[200:260] += 6 * s[200:260] * rng.normal(size=(60, 1)) * np.eye(m)[0]
    longest = np.linalg.norm(by_effects(errors, s)[0], axis=0).max()
    errors[230] += 200 * np.eye(m)[1]
    far_off = np.linalg.norm(by_effects(errors, s)[0], axis=0).max()
    assert 2 < longest < 6 and far_off < 1.3 * longest


def test_errors_without_a_direction_have_hardly_any():
    rng = np.random.default_rng(12)
    s = np.zeros((200, 1))
    s[120:] = 0.5
    directions, _ = by_effects(rng.normal(size=(200, 12)), s)
    assert directions.shape[1] <= 1  # one in twenty by chance


def test_emulator_errors_survive_their_file(tmp_path):
    """Earlier files know nothing of effects; their widening counts all the same."""
    library = toy_library.library()
    m, ones = len(library.features), np.ones(len(library.kernels))
    known = EmulatorErrors(
        1.5 * ones, ones, 0.5 * ones, Split(0.5, 0.25), RNG.normal(size=(m, 2)), np.array([0, 1])
    )
    path = tmp_path / "library.nc"
    store.save(replace(library, emulator_errors=known), path)
    again = store.load(path).emulator_errors
    assert again is not None and (again.directions == known.directions).all()
    assert (again.misfit == known.misfit).all() and again.dropped == known.dropped
    with xr.open_dataset(path, engine="h5netcdf") as stored:
        older = stored.load().drop_vars(["missed_directions", "missed_effect", "misfit", "dropped"])
    older.to_netcdf(path, engine="h5netcdf")
    again = store.load(path).emulator_errors
    assert again is not None and again.directions.shape == (m, 0)
    assert (again.widening == known.widening).all()
    assert not again.misfit.any() and again.dropped == Split()


def toy_repeats() -> run_library.Rows:
    """Repeats of the toy library's design, by formula; the first run of the second soil failed."""
    points = toy_library.DESIGN.repeats()
    soils = points.base[:, :2]
    runs = [toy_library.run(soil, np.zeros(3), 500 + i) for i, soil in enumerate(soils)]
    runs = [*runs[:SPECIMENS], None, *runs[SPECIMENS + 1 :]]
    return Rows.of(Cylinder.of(LAB), points, runs)


def test_repeats_survive_their_file_and_growth(tmp_path):
    rows, path = toy_repeats(), tmp_path / "library.nc"
    store.save(replace(toy_library.library(), repeats=rows), path)
    library = store.load(path)
    assert library.repeats is not None
    assert np.allclose(library.repeats.values, rows.values, rtol=1e-6)
    assert np.allclose(library.repeats.base, rows.base, rtol=1e-6, atol=1e-7)
    assert library.repeats.packing.tolist() == rows.packing.tolist()
    larger = replace(toy_library.DESIGN, packings=toy_library.PACKINGS + 2)
    grown = library.grown(larger, [None] * (2 * toy_library.ROWS))
    assert grown.repeats is library.repeats


@pytest.mark.slow
def test_a_fitted_library_knows_scatter_from_repeats():
    """A soil with a failed run has three specimens."""
    rows = toy_repeats()
    assert np.bincount(rows.packing).tolist() == [4, 3, *[4] * (toy_library.DESIGN.repeated - 2)]
    alone = replace(toy_library.library(), kernels=()).fitted().emulator_errors
    fitted = replace(toy_library.library(), kernels=(), repeats=rows).fitted().emulator_errors
    assert alone is not None and fitted is not None
    assert not alone.misfit.any() and alone.dropped == Split()
    assert fitted.misfit.any() and fitted.dropped != Split()


def test_the_bundled_library_is_whole():
    """It predicts its repeats, which set its errors and nothing else, as well as it says."""
    library = store.load(store.bundled_library())
    emulated = EmulatedLibrary.of(library)
    errors, none = emulated.emulator_errors, np.zeros(len(library.design.limits))
    assert library.repeats is not None and len(library.repeats.values) == 96
    assert errors.misfit.any() and errors.dropped.misfit > 0
    squares = []
    for soil in range(library.design.repeated):
        of_soil = library.repeats.packing == soil
        x = (library.repeats.base[of_soil] / library.design.spread())[0]
        mean = np.arcsinh(library.repeats.values[of_soil] / library.scale()).mean(axis=0)
        missed = mean - emulated.emulator.warped(x, none)
        scatter = errors.specimens(emulated.emulator, emulated.emulator.without_effects, x)
        stated = (errors.of_values(emulated.emulator, x, none) ** 2).sum(axis=1)
        squares.append(missed**2 / (stated + scatter.var(axis=0) / 4))
    assert 0.7 < np.median(np.mean(squares, axis=0)) < 1.4
    assert 0.6 < np.mean(squares) < 1.6


def test_specimens_of_one_class_of_porosity_share_a_program(tmp_path):
    """Lists have room for the largest spheres of the class."""
    simulator = simulate.Simulator(LAB, tmp_path)
    first, second, denser = (
        simulator._campaign(500, loose, 1.0, True) for loose in (0.005, 0.013, -0.01)
    )
    assert first.lab.grid == second.lab.grid and first.lab.capacity == second.lab.capacity
    assert first.lab.numerics.sample_time == second.lab.numerics.sample_time
    assert first.specimen.porosity != second.specimen.porosity
    assert denser.lab.grid != first.lab.grid
    for each in (first, second, denser):
        grid = each.lab.grid
        assert grid.cell >= 2 * each.specimen.max_radius() + grid.skin + grid.reach


def test_repeats_are_simulated_on_their_packings():
    design = Design()
    points = design.repeats()
    assert not points.strengths.any()
    assert len(set(points.seeds)) == len(points.base)
    assert points.seeds.min() > 1000 * design.seed + design.rows().packing.max()
    sizes = [design.sphere_size(spheres) for spheres in points.spheres]
    assert sizes == points.base[:, design.base_names.index("sphere_size")].tolist()


def test_repeats_are_soils_of_several_specimens():
    design = Design()
    points = design.repeats()
    of_soil = points.base.reshape(design.repeated, SPECIMENS, -1)
    assert (of_soil == of_soil[:, :1]).all()
    assert np.bincount(points.packing).tolist() == [SPECIMENS] * design.repeated
    assert len(np.unique(of_soil[:, 0, 0])) == design.repeated
    pace = of_soil[:, 0, design.base_names.index("pace")]
    assert np.mean(pace < 1) == pytest.approx(1 / design.slow_in)
    size = of_soil[:, 0, design.base_names.index("sphere_size")]
    assert len(np.unique(size)) == 3


def test_specimens_have_components_of_the_size_that_is_known(emulator):
    factors = np.array([4.0, 1.0, 0.25])
    known = replace(EmulatorErrors.nothing(3, len(SCALE)), scatter=factors)
    scattered = known.specimens(emulator, emulator.residuals, np.zeros(P))
    parts = [
        emulator.basis.components(emulator.basis.mean + residuals).var(axis=0)
        for residuals in (emulator.residuals, scattered)
    ]
    assert parts[1] / parts[0] == pytest.approx(factors)


def small_library() -> RunLibrary:
    """Rows of a design with made-up features."""
    design = replace(Design(), packings=8)
    points = design.rows()
    features = Cylinder(0.05, 0.1, 200.0, 400.0).features()
    values = RNG.uniform(1, 2, size=(len(points.base), len(features)))
    curve = (np.linspace(0, 1, 5), np.linspace(0, 400, 5))
    return RunLibrary(
        design, Cylinder(0.05, 0.1, 200.0, 400.0), PHYSICS,
        Rows(points.base, points.strengths, points.packing, values),
        {"confined": curve, "unconfined": curve},
    )  # fmt: skip


def test_the_pace_of_a_lab_is_that_of_its_test_in_the_mould():
    """8 mm/s unless it says otherwise, over the library's fast 160 mm/s."""
    lab, library = load_lab(bundled_lab()), small_library()
    place = library.design.base_names.index("pace")
    faster = lab.tests[0].model_copy(update={"pressed_at": 0.05})
    for tests, pace in ((lab.tests, 0.05), ((faster, *lab.tests[1:]), 0.3125)):
        prior = soil_prior_for(replace(lab, tests=tests), library)
        assert prior.offset[place] == pytest.approx(pace)
        assert len(prior.offset) == len(prior.prior_sd) == len(library.design.base_names)


def test_a_library_without_the_pace_of_its_runs_is_refused(tmp_path: Path):
    path = tmp_path / "library.nc"
    store.save(small_library(), path)
    with xr.open_dataset(path, engine="h5netcdf") as stored:
        older = stored.load().drop_sel(coordinate="pace")
    older.to_netcdf(path, engine="h5netcdf")
    with pytest.raises(InputError, match="do not state pace"):
        store.load(path)


def test_a_library_survives_its_file(tmp_path: Path):
    library, path = small_library(), tmp_path / "library.nc"
    store.save(library, path)
    again = store.load(path)
    assert again.design == library.design and again.cylinder == library.cylinder
    assert np.allclose(again.rows.values, library.rows.values, rtol=1e-6)
    assert np.allclose(again.reference["confined"], library.reference["confined"])


def test_a_library_grows_to_the_one_that_a_larger_design_gives():
    """By the runs of further packings, one of which failed; kernels are to be fitted anew."""
    larger = replace(toy_library.DESIGN, packings=toy_library.PACKINGS + 2)
    runs = toy_library.runs(larger)
    whole = run_library.collect(larger, LAB, runs, toy_library.run(np.zeros(2), np.zeros(3), 900))
    later = [None, *runs[toy_library.PACKINGS * toy_library.ROWS + 1 :]]
    grown = toy_library.library().grown(larger, later)
    first = toy_library.PACKINGS * toy_library.ROWS
    keep = np.delete(np.arange(len(whole.rows.values)), first)
    assert len(whole.rows.values) == len(runs)
    assert not grown.kernels and grown.emulator_errors is None
    for part in ("base", "strengths", "packing", "values"):
        np.testing.assert_array_equal(getattr(grown.rows, part), getattr(whole.rows, part)[keep])


def test_a_library_grows_only_by_more_of_the_same():
    smaller = toy_library.library()
    simulate.check_extends(replace(smaller.design, packings=20), LAB, smaller, "library.nc")
    with pytest.raises(InputError, match="14 packings already"):
        simulate.check_extends(smaller.design, LAB, smaller, "library.nc")
    other = replace(smaller.design, packings=20, spheres=200)
    with pytest.raises(InputError, match="another centre, cylinder or number of spheres"):
        simulate.check_extends(other, LAB, smaller, "library.nc")
    fixed = replace(smaller, design=replace(smaller.design, refined=2))
    fewer = replace(fixed.design, packings=20, refined=1)
    with pytest.raises(InputError, match="2 packings of --refined, and fewer"):
        simulate.check_extends(fewer, LAB, fixed, "library.nc")
    simulate.check_extends(replace(fixed.design, refined=4), LAB, fixed, "library.nc")


@pytest.mark.parametrize("field", ["rate", "pressed_at"])
def test_a_test_faster_than_any_run_is_refused_by_its_field(field):
    library, lab = toy_library.library(), load_lab(bundled_lab())
    fast = lab.tests[0].model_copy(update={field: 0.2})
    with pytest.raises(InputError, match=f"'confined.{field}': 200 mm/s is faster than any run"):
        soil_prior_for(replace(lab, tests=(fast, *lab.tests[1:])), library)


def test_further_rows_move_what_they_are_about_and_make_it_surer():
    """Forty rows at one point, on packings of their own, twice as strong as the library knows."""
    emulated = EmulatedLibrary.of(toy_library.library())
    library, count = emulated.library, 40
    base, strengths = np.zeros((count, len(library.design.base_names))), np.zeros((count, 3))
    scatter = np.random.default_rng(0).normal(1, 0.05, size=(count, 1))
    here, none = np.zeros(base.shape[1]), np.zeros(3)
    values = 2 * emulated.emulator(here, none)[0] * scatter
    rows = run_library.Rows(base, strengths, np.arange(count), values)
    better = emulated.joined(rows, library)
    ratio = better.emulator(here, none)[0] / emulated.emulator(here, none)[0]
    assert np.median(ratio) == pytest.approx(2.0, rel=0.15)
    errors = [
        np.linalg.norm(r.emulator_errors.of_values(r.emulator, here, none))
        for r in (emulated, better)
    ]
    assert errors[1] < 0.7 * errors[0]
    assert len(better.specimens(here)) == len(emulated.specimens(here)) + count


@pytest.mark.parametrize("content", [b"", b"no library", b"\x89HDF\r\n\x1a\n"])
def test_another_file_is_refused_in_one_sentence(tmp_path: Path, content: bytes):
    path = tmp_path / "library.nc"
    path.write_bytes(content)
    with pytest.raises(InputError, match="no library of runs"):
        store.load(path)


def test_the_trumao_soils_targets_follow_from_its_data():
    lab = load_lab(bundled_lab("trumao"))
    folder = Path(lab.file).parent / "trumao_2021"
    area = np.pi * lab.specimen.diameter**2 / 4
    limits = np.log([force / area / 1e3 for force in lab.pair().compression.guides()])
    rows = list(csv.DictReader((folder / "oedometer.csv").open()))
    depths = []
    for sample in dict.fromkeys(row["sample"] for row in rows):
        mine = [row for row in rows if row["sample"] == sample][:7]  # loading, to 1200 kPa
        stress, ratio = (np.array([float(row[key]) for row in mine]) for key in ("stress", "e"))
        between = np.interp(limits, np.log(stress), ratio)
        depths.append(1e3 * lab.specimen.height * (between[0] - between[1]) / (1 + ratio[0]))
    strengths = [float(row["su"]) for row in csv.DictReader((folder / "UCT.csv").open())]
    forces = 2e3 * area * np.array(strengths)
    for name, values in (("depression_depth_mm", depths), ("crushing_force_n", forces)):
        target = lab.targets[name]
        assert target.mean == pytest.approx(np.mean(values), rel=1e-3)
        assert target.scatter == pytest.approx(np.std(values, ddof=1), rel=2e-3)
        assert target.repeats == len(values)
