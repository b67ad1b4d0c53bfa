"""Simulations about a lab's leading explanations, on a bank of formulas."""

from dataclasses import replace

import numpy as np
import pytest
import toy_bank

from calibrate.core.errors import InputError
from calibrate.discrepancy import infill as nearby
from calibrate.discrepancy.comparison.compare import diagnose
from calibrate.discrepancy.diagnosis import Manner, described, ready_to_diagnose
from calibrate.discrepancy.infill import (
    FIRST_SEED,
    MORE,
    Nearby,
    Place,
    about,
    leading_fits,
    place_of,
    refined,
)
from calibrate.discrepancy.library.description import Ready, point_for
from calibrate.io.lab import load_lab

OFFSET = 10.0  # N
BANK = toy_bank.bank()
DESIGN = BANK.design
WIDE = len(DESIGN.soil_names)


@pytest.fixture(scope="module")
def ready() -> Ready:
    return Ready.of(BANK)


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    return load_lab(toy_bank.write_lab(tmp_path_factory.mktemp("lab"), "toy", OFFSET))


@pytest.fixture
def formulas(monkeypatch):
    monkeypatch.setattr(nearby, "run_points", toy_bank.run_points)


def places() -> list[Place]:
    none = np.zeros(len(DESIGN.base_names))
    return [Place(none, np.zeros(3)), Place(none + 0.1, np.array([0.0, 10.0, 0.0]))]


def test_every_place_is_tried_on_every_packing():
    points = about(places(), BANK, range(2, 6), seed=0)
    assert points.seeds.tolist() == [FIRST_SEED + j for j in (2, 2, 3, 3, 4, 4, 5, 5)]
    off = points.strengths[:, 1] == 0
    assert off.tolist() == [True, False] * 4
    assert 10 / 3 < points.strengths[~off, 1].min() < points.strengths[~off, 1].max() < 30


def test_a_packing_settles_once_and_sizes_alternate():
    points = about(places(), BANK, range(4), seed=0)
    preparation, number = WIDE + 1, WIDE + 2
    assert len(set(points.base[:, preparation])) == 1
    assert set(points.spheres) == {DESIGN.spheres, round(MORE * DESIGN.spheres)}
    assert np.exp(points.base[:, number]) * DESIGN.spheres == pytest.approx(points.spheres)


def test_soils_scatter_about_their_place():
    points = about(places(), BANK, range(40), seed=0)
    shifts = (points.base[::2, :WIDE]) / DESIGN.spread()[:WIDE]
    assert shifts.std(axis=0) == pytest.approx(nearby.SOIL_SPREAD, rel=0.2)
    assert np.abs(shifts.mean(axis=0)).max() < 0.1


def test_a_strength_beyond_the_bank_is_brought_back(ready, lab):
    _, d, measured = described(lab, ready, 0)
    which = diagnose(ready_to_diagnose(d, measured, 0, Manner.neutral(), 60), measured)
    fits = leading_fits(which)
    assert fits[0].chosen == () and {(1,)} <= {fit.chosen for fit in fits}
    strong = replace(fits[1], strengths=np.array([0.0, 1e3, 0.0]))
    assert place_of(strong, point_for(lab, BANK), BANK).strengths.tolist() == [0.0, 15.0, 0.0]


def test_what_was_simulated_nearby_is_known_better(ready, lab, formulas, tmp_path):
    """At the hidden strength: nearer to the formula's mean over many packings, and surer."""
    better = refined(lab, ready, 0, Nearby(24, tmp_path))
    assert len(better.bank.values) > len(BANK.values) + 24
    assert np.array_equal(better.bank.values[: len(BANK.values)], BANK.values)
    point = point_for(lab, BANK)
    strengths = np.array([0.0, OFFSET, 0.0]) / DESIGN.typical()
    stated = [
        np.linalg.norm(r.at(point).wrong(np.zeros(len(point.offset)), strengths))
        for r in (ready, better)
    ]
    assert stated[1] < 0.8 * stated[0]


def test_a_lab_of_another_size_is_refused_in_one_sentence(lab):
    other = replace(BANK, cylinder=replace(BANK.cylinder, height=0.07))
    with pytest.raises(InputError, match="leave --simulate out"):
        nearby.simulated_lab(lab, other)
