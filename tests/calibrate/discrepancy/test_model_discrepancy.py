"""What references with nothing hidden teach: a shift, and directions that repeat themselves."""

import json
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from calibrate.core.errors import InputError
from calibrate.discrepancy.library.description import EmulatedLibrary, ModelDiscrepancy
from calibrate.discrepancy.model_discrepancy import BaseFitResidual, load, of_references, save

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
