"""A lab's own size and shape beside the library's: proportions, units, what is refused.

That specimens of 38 and 70 mm really behave in proportion is for
`python -m studies.sealed --shapes`, whose laboratory simulates them as they are.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from calibrate.core.errors import InputError
from calibrate.discrepancy.diagnosis import described, diagnosed
from calibrate.discrepancy.library import store
from calibrate.discrepancy.library.description import EmulatedLibrary
from calibrate.discrepancy.library.design import (
    FIRST_SHAPED,
    HEIGHTS,
    SETTINGS,
    SHAPE,
    SHAPE_COLUMNS,
    STRESSES,
    Design,
)
from calibrate.discrepancy.library.lab_size import LabSize, soil_prior_for
from calibrate.discrepancy.library.run_library import Cylinder, features_of
from calibrate.discrepancy.library.simulate import shaped
from calibrate.io.lab import Lab, bundled_lab, load_lab
from studies.sealed.plan import SpecimenSize
from tests.support import toy_library

OFFSET = 10.0  # N, at the library's size
LARGER = 1.4  # times, a lab's specimen


def of_size(lab: Lab, diameter: float, height: float, force_high: float) -> Lab:
    """A lab with specimens of another size, and its curves in proportion."""
    longer, wider = height / lab.specimen.height, (diameter / lab.specimen.diameter) ** 2
    curves = tuple(
        replace(c, displacement_mm=longer * c.displacement_mm, force_n=wider * c.force_n)
        for c in lab.curves
    )
    sized = SpecimenSize(diameter, height, force_high).lab()
    faster = {"rate": longer, "pressed_at": 1.0}  # as long a test; what dashpots carry stays
    tests = tuple(
        after.model_copy(
            update={n: f * v for n, f in faster.items() if (v := getattr(before, n, None))}
        )
        for after, before in zip(sized.tests, lab.tests, strict=True)
    )
    return replace(lab, specimen=sized.specimen, tests=tests, curves=curves)


@pytest.fixture(scope="module")
def emulated() -> EmulatedLibrary:
    return EmulatedLibrary.of(toy_library.library())


@pytest.fixture(scope="module")
def lab(tmp_path_factory) -> Lab:
    path = toy_library.write_lab(tmp_path_factory.mktemp("lab"), "0a1b2", OFFSET)
    return load_lab(path)


# ---------------------------------------------------------------- proportion


@pytest.mark.slow
def test_a_lab_of_the_same_shape_gets_the_same_answer_in_its_own_units(emulated, lab):
    """Lengths times 1.4, forces times 1.96: so is the offset of the load cell."""
    other = of_size(lab, 0.05 * LARGER, 0.1 * LARGER, 400.0 * LARGER**2)
    here, there = (diagnosed(one, emulated) for one in (lab, other))
    assert there.comparison.verdict == here.comparison.verdict == "load_cell_offset"
    strength = [
        next(e["strength"] for e in one.as_json()["which"]["effects"] if e["unit"] == "N")
        for one in (here, there)
    ]
    assert strength[0] == pytest.approx(OFFSET, rel=0.3)
    assert strength[1] == pytest.approx(LARGER**2 * strength[0], rel=0.1)
    assert "displacement at 20 N, loading" in [f.name for f in here.measured.features]
    assert "displacement at 39.2 N, loading" in [f.name for f in there.measured.features]


def test_slopes_in_a_lab_s_own_size_are_derivatives_of_its_values(emulated, lab):
    other = of_size(lab, 0.05 * LARGER, 0.1 * LARGER, 400.0 * LARGER**2)
    d = described(other, emulated, 0)[1]
    at, strength = np.full(len(d.prior_sd), 0.02), np.full(len(d.effects), 0.1)
    values, base, effects = d.at(at, strength)
    step = 1e-5
    for column, slopes in ((0, base), (1, base)):
        moved = at + step * (np.arange(len(at)) == column)
        found = (d.at(moved, strength)[0] - values) / step
        assert found == pytest.approx(slopes[:, column], rel=1e-3, abs=1e-2)
    moved = strength + step * (np.arange(len(strength)) == 1)
    found = (d.at(at, moved)[0] - values) / step
    assert found == pytest.approx(effects[:, 1], rel=1e-3, abs=1e-2)


@pytest.mark.parametrize("strength", [0.0, 0.1])
def test_a_description_of_fewer_effects_and_features_says_the_same_of_them(emulated, lab, strength):
    d = described(lab, emulated, 0)[1]
    at, strengths = np.full(len(d.prior_sd), 0.02), np.full(len(d.effects), strength)
    strengths[0], some = 0.0, np.arange(0, len(d.features), 7)
    fewer = d.without_effects([d.effect_names[0]]).only_features(some)
    values, base, effects = fewer.at(at, strengths[1:])
    every = d.at(at, strengths)
    assert values == pytest.approx(every[0][some]) and base == pytest.approx(every[1][some])
    assert effects == pytest.approx(every[2][some, 1:])
    least = fewer.without_effects([d.effect_names[1]])
    strengths[1] = 0.0
    assert least.at(at, strengths[2:])[0] == pytest.approx(d.at(at, strengths)[0][some])
    wrong = d.wrong_at(at, strengths)[some]
    assert least.wrong_at(at, strengths[2:]) == pytest.approx(wrong)


def test_strengths_are_converted_by_their_units():
    """Twice as wide and high: lengths double, forces are fourfold.  Both platens move as fast as
    the library's, so times double."""
    lab, library = SpecimenSize(0.1, 0.2, 1600.0).lab(), toy_library.library()
    names = ("seating_gap", "load_cell_offset", "load_frame_compliance", "acquisition_lag",
             "load_cell_drift", "cementation", "wall_friction", "load_cell_gain")  # fmt: skip
    found = LabSize.of(lab, library).of_effects(names)
    assert found == pytest.approx([2.0, 4.0, 0.5, 2.0, 2.0, 1.0, 1.0, 1.0])


# ---------------------------------------------------------------- shape


def test_a_lab_s_shape_is_known_to_its_fit(emulated):
    """130 mm by 50 mm at 300 kPa, by a library that reaches so far."""
    library = emulated.library
    base = library.rows.base.copy()
    base[:2, SHAPE_COLUMNS] = np.log([[0.5, 0.25], [1.5, 2.5]])
    lab = SpecimenSize(0.05, 0.13, 300e3 * np.pi / 4 * 0.05**2).lab()
    prior = soil_prior_for(lab, replace(library, rows=replace(library.rows, base=base)))
    stress = 300e3 / (400.0 / (np.pi / 4 * 0.05**2))
    assert prior.offset[SHAPE_COLUMNS] == pytest.approx(np.log([1.3, stress]))
    assert (prior.prior_sd[SHAPE_COLUMNS] < 0.02).all()


@pytest.mark.parametrize(
    ("size", "field"),
    [
        (SpecimenSize(0.05, 0.2), "'specimen': height over diameter is 4,"),
        (SpecimenSize(0.05, 0.1, 800.0), "'confined.force_high': the largest stress in kPa is 407"),
    ],
)
def test_a_shape_that_no_run_has_is_refused_in_one_sentence(emulated, size, field):
    with pytest.raises(InputError, match=field):
        emulated.for_lab(size.lab())


def test_further_packings_have_every_height_and_many_stresses():
    design = Design(shaped=72)
    points = design.shaped_rows()
    base, strengths, packing = points.base, points.strengths, points.packing
    assert len(base) == len(strengths) == len(packing) == 72 * design.rows_each
    assert sorted(set(packing)) == list(range(FIRST_SHAPED, FIRST_SHAPED + 72))
    columns = dict(zip(SETTINGS, base[:, -len(SETTINGS) :].T, strict=True))
    assert sorted(set(np.exp(columns["slenderness"]).round(6))) == sorted(HEIGHTS)
    low, high = np.log(STRESSES)
    assert columns["stress"].min() < low + 0.1 and columns["stress"].max() > high - 0.1
    assert np.mean(columns["pace"] < 1) == pytest.approx(1 / 3)
    met = {tuple(row) for row in np.column_stack([columns[n] for n in ("slenderness", "porosity")])}
    assert len(met) == len(HEIGHTS) * 3
    fewer = replace(design, shaped=24).shaped_rows().base
    assert np.array_equal(fewer, base[: len(fewer)])


def test_a_shaped_lab_keeps_its_diameter():
    lab = shaped(load_lab(bundled_lab()), float(np.log(1.25)), float(np.log(2.0)))
    found = Cylinder.of(lab)
    assert (found.diameter, found.height) == pytest.approx((0.05, 0.125))
    assert (found.force_low, found.force_high) == pytest.approx((400.0, 800.0))
    assert found.shape_over(Cylinder.of(load_lab(bundled_lab()))) == pytest.approx(
        np.log([1.25, 2.0])
    )


def test_rows_of_other_shapes_join_a_library():
    """Features are read at the displacements and forces of each row's own shape."""
    library = toy_library.library()
    design = replace(library.design, shaped=2)
    points = design.shaped_rows()
    runs = toy_library.run_points(design, points)
    grown = library.with_shapes(design, runs)
    new = len(grown.rows.values) - len(library.rows.values)
    values = features_of(library.cylinder, points.base[:, SHAPE_COLUMNS], runs)
    whole = np.isfinite(values).all(axis=1)
    assert 0 < new == whole.sum() and grown.design.shaped == 2
    assert np.array_equal(grown.rows.values[-new:], values[whole])
    assert np.array_equal(grown.rows.packing[-new:], points.packing[whole])


def test_a_file_of_one_shape_is_read_as_such(tmp_path: Path):
    """As files were before there were shapes: the emulator does not look at them."""
    library, path = toy_library.library(), tmp_path / "library.nc"
    store.save(library, path)
    with xr.open_dataset(path, engine="h5netcdf") as stored:
        older = stored.load().drop_sel(coordinate=list(SHAPE))
    keep = [i for i in range(library.rows.base.shape[1]) if i - library.rows.base.shape[1] not in
            SHAPE_COLUMNS]  # fmt: skip
    for name in ("kernel_linear", "kernel_length", "kernel_scattering"):
        older[name] = (("component", f"{name}_older"), older[name].values[:, keep])
    older.to_netcdf(path, engine="h5netcdf")
    again = store.load(path)
    assert again.design.base_names == library.design.base_names
    assert not again.rows.base[:, SHAPE_COLUMNS].any()
    emulator = EmulatedLibrary.of(again).emulator
    here, there = np.zeros((2, again.rows.base.shape[1]))
    there[SHAPE_COLUMNS] = 0.5
    none = np.zeros(3)
    assert emulator(there, none)[0] == pytest.approx(emulator(here, none)[0], rel=0.01)
