"""The catalogue of parameters: complete, consistent, and what calibration takes from it."""

import numpy as np
import pytest

from jdem.core.parameter import FRACTION, NOT_NEGATIVE, POSITIVE, Accepted
from jdem.materials.catalogue import CATALOGUE, LAWS, catalogue
from jdem.materials.soil import SoilParameters

SOIL = SoilParameters()


def test_every_value_of_a_soil_has_one_entry_and_is_accepted_by_it():
    values = SOIL.values()
    assert set(values) == set(CATALOGUE)
    assert all(CATALOGUE[name].accepted(float(value)) for name, value in values.items())
    assert len({entry.symbol for entry in CATALOGUE.values()}) == len(CATALOGUE)


@pytest.mark.parametrize("law", LAWS)
def test_a_fit_looks_only_where_the_law_accepts(law):
    for entry in catalogue(law).values():
        assert entry.label and entry.symbol and entry.repair
        if entry.search is not None:
            assert entry.accepted(entry.search.low) and entry.accepted(entry.search.high)
            assert 0 < entry.search.low < entry.search.high
            assert entry.search.prior_sd > 0


def test_ends_of_a_range_belong_to_it_or_not():
    assert [POSITIVE(x) for x in (-1.0, 0.0, 1e-9)] == [False, False, True]
    assert [NOT_NEGATIVE(x) for x in (-1e-9, 0.0, 1e9)] == [False, True, True]
    assert [FRACTION(x) for x in (0.0, 0.5, 1.0)] == [False, True, False]
    assert [Accepted(choices=(1.0, 1.5))(x) for x in (1, 1.2, 1.5)] == [True, False, True]
    assert not NOT_NEGATIVE(np.nan)
