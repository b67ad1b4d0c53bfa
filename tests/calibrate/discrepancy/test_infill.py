"""Simulations about a lab's leading explanations, and what references with nothing hidden teach."""

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from calibrate.core.errors import InputError
from calibrate.discrepancy import infill as nearby
from calibrate.discrepancy.comparison.compare import compare
from calibrate.discrepancy.comparison.probability_calibration import ProbabilityCalibration
from calibrate.discrepancy.diagnosis import described, prepared_diagnosis
from calibrate.discrepancy.infill import (
    FIRST_SEED,
    SIZES,
    InfillLocation,
    InfillPlan,
    leading_fits,
    location_of,
    scattered_about,
    with_infill_runs,
)
from calibrate.discrepancy.library.description import EmulatedLibrary, ModelDiscrepancy
from calibrate.discrepancy.library.design import POROSITIES, SPEEDS
from calibrate.discrepancy.library.lab_size import soil_prior_for
from calibrate.discrepancy.model_discrepancy import BaseFitResidual, load, of_references, save
from calibrate.io.lab import load_lab
from tests.support import toy_library

OFFSET = 10.0  # N
LIBRARY = toy_library.library()
DESIGN = LIBRARY.design
WIDE = len(DESIGN.soil_names)


@pytest.fixture(scope="module")
def emulated() -> EmulatedLibrary:
    return EmulatedLibrary.of(LIBRARY)


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    return load_lab(toy_library.write_lab(tmp_path_factory.mktemp("lab"), "toy", OFFSET))


@pytest.fixture
def formulas(monkeypatch):
    monkeypatch.setattr(nearby, "run_points", toy_library.run_points)


def places() -> list[InfillLocation]:
    none = np.zeros(len(DESIGN.base_names))
    return [
        InfillLocation(none, np.zeros(3)),
        InfillLocation(none + 0.1, np.array([0.0, 10.0, 0.0])),
    ]


def test_every_location_is_tried_on_every_packing():
    points = scattered_about(places(), LIBRARY, range(2, 6), seed=0)
    assert points.seeds.tolist() == [FIRST_SEED + j for j in (2, 2, 3, 3, 4, 4, 5, 5)]
    off = points.strengths[:, 1] == 0
    assert off.tolist() == [True, False] * 4
    assert 10 / 3 < points.strengths[~off, 1].min() < points.strengths[~off, 1].max() < 30


def test_a_packing_settles_once_and_sizes_alternate():
    points = scattered_about(places(), LIBRARY, range(4), seed=0)
    porosity, pace, size = WIDE + 1, WIDE + 2, -1
    assert set(points.base[:, pace]) == {SPEEDS[1] / SPEEDS[0]}
    assert set(points.base[:, porosity]) < set(POROSITIES)
    assert set(points.spheres) == {round(factor * DESIGN.spheres) for factor in SIZES}
    assert points.base[:, size] == pytest.approx([DESIGN.sphere_size(n) for n in points.spheres])


def test_soils_scatter_about_their_location():
    points = scattered_about(places(), LIBRARY, range(40), seed=0)
    shifts = (points.base[::2, :WIDE]) / DESIGN.spread()[:WIDE]
    assert shifts.std(axis=0) == pytest.approx(nearby.SOIL_SPREAD, rel=0.2)
    assert np.abs(shifts.mean(axis=0)).max() < 0.1


def test_what_conventions_hold_does_not_scatter():
    points = scattered_about(places(), LIBRARY, range(8), 0, held=("surface_energy",))
    column = DESIGN.soil_names.index("surface_energy")
    assert len(set(points.base[::2, column])) == 1 < len(set(points.base[::2, 1 - column]))


def test_a_strength_beyond_the_library_is_brought_back(emulated, lab):
    _, d, measured = described(lab, emulated, 0)
    which = compare(prepared_diagnosis(d, measured, 0, ProbabilityCalibration(), 60), measured)
    fits = leading_fits(which)
    assert fits[0].chosen == () and {(1,)} <= {fit.chosen for fit in fits}
    strong = replace(fits[1], strengths=np.array([0.0, 1e3, 0.0]))
    assert location_of(
        strong, soil_prior_for(lab, LIBRARY), LIBRARY, d.effect_names
    ).strengths.tolist() == [
        0.0,
        15.0,
        0.0,
    ]


@pytest.mark.slow
def test_infill_runs_lessen_the_emulator_s_error(emulated, lab, formulas, tmp_path):
    """At the hidden strength: nearer to the formula's mean over many packings, and surer."""
    better = with_infill_runs(lab, emulated, 0, InfillPlan(32, tmp_path))
    assert len(better.library.rows.values) > len(LIBRARY.rows.values) + 32
    known = LIBRARY.rows.values
    assert np.array_equal(better.library.rows.values[: len(known)], known)
    point = soil_prior_for(lab, LIBRARY)
    strengths = np.array([0.0, OFFSET, 0.0]) / DESIGN.typical()
    stated = [
        np.linalg.norm(r.at(point).wrong(np.zeros(len(point.offset)), strengths))
        for r in (emulated, better)
    ]
    assert stated[1] < 0.8 * stated[0]


def test_a_lab_of_another_size_is_refused_in_one_sentence(lab):
    other = replace(LIBRARY, cylinder=replace(LIBRARY.cylinder, height=0.07))
    with pytest.raises(InputError, match="leave --simulate out"):
        nearby.simulated_lab(lab, other)


FEATURES, BASE, REFERENCES = 20, 3, 40
RNG = np.random.default_rng(7)
SLOPES = RNG.normal(size=(FEATURES, BASE))
PRIOR = np.ones(BASE)
NOISE = np.diag(RNG.uniform(0.5, 2.0, FEATURES))
SHIFT = 2.0 * RNG.normal(size=FEATURES)
DIRECTION = 3.0 * RNG.normal(size=FEATURES)


def references(along: float) -> list[BaseFitResidual]:
    """Fits of soils with a common shift, a part of random size along a direction, and noise."""
    return [
        BaseFitResidual(
            np.arange(FEATURES),
            SHIFT
            + along * RNG.normal() * DIRECTION
            + SLOPES @ RNG.normal(size=BASE)
            + np.sqrt(np.diag(NOISE)) * RNG.normal(size=FEATURES),
            SLOPES,
            PRIOR,
            NOISE,
        )
        for _ in range(REFERENCES)
    ]


def off_the_base(values: np.ndarray) -> np.ndarray:
    """What no base parameter can do as well."""
    return values - SLOPES @ np.linalg.lstsq(SLOPES, values, rcond=None)[0]


def test_scatter_alone_needs_no_direction():
    found = of_references(references(0.0), FEATURES)
    assert found.directions.shape == (FEATURES, 0)
    error = off_the_base(found.mean) - off_the_base(SHIFT)
    assert np.abs(error).max() < 4 * np.sqrt(NOISE.max() / REFERENCES)


def test_references_may_lack_some_features():
    """Every fourth one lacks its last two; the others tell these."""
    found = [
        BaseFitResidual(
            one.measured[:-2], one.working[:-2], one.slopes[:-2], PRIOR, NOISE[:-2, :-2]
        )
        if number % 4 == 0
        else one
        for number, one in enumerate(references(0.0))
    ]
    error = off_the_base(of_references(found, FEATURES).mean) - off_the_base(SHIFT)
    assert np.abs(error).max() < 4 * np.sqrt(NOISE.max() / (0.75 * REFERENCES))


def test_a_direction_that_repeats_itself_is_found():
    found = of_references(references(1.0), FEATURES)
    assert found.directions.shape[1] == 1
    lead, true = off_the_base(found.directions[:, 0]), off_the_base(DIRECTION)
    assert abs(lead @ true) / np.linalg.norm(lead) / np.linalg.norm(true) > 0.97
    assert np.linalg.norm(lead) == pytest.approx(np.linalg.norm(true), rel=0.4)


def test_a_reference_is_likelier_under_its_own_model_discrepancy():
    one, *others = references(1.0)
    learned = of_references(others, FEATURES)
    nothing = ModelDiscrepancy(np.zeros(FEATURES), np.zeros((FEATURES, 0)))
    assert one.predicted_by(learned) > one.predicted_by(nothing) + 10


#: as much of a library as reading a model discrepancy asks for
OTHER = cast(
    EmulatedLibrary, SimpleNamespace(library=SimpleNamespace(features=tuple(range(FEATURES))))
)


def test_a_model_discrepancy_is_read_back(tmp_path):
    found = of_references(references(1.0), FEATURES)
    save(found, tmp_path / "discrepancy.json", "forty references")
    again = load(tmp_path / "discrepancy.json", OTHER)
    assert (again.mean == found.mean).all() and (again.directions == found.directions).all()


@pytest.mark.parametrize("content", ["no JSON", json.dumps({"mean": [0.0], "directions": [[]]})])
def test_the_discrepancy_of_another_library_is_refused(tmp_path, content):
    (tmp_path / "discrepancy.json").write_text(content)
    with pytest.raises(InputError, match="discrepancy"):
        load(tmp_path / "discrepancy.json", OTHER)
