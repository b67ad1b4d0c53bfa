"""Single values as the user writes them: quantities with units, and parameters in their range.
The catalogue of parameters: complete, consistent, and what calibration takes from it.

Whatever the text, a quantity is a finite number or a `BadValue` with a repair.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibrate.core.errors import BadValue, InputError, suggestion
from calibrate.core.units import FORCE, LENGTH, quantity, unit_factor
from calibrate.io.labfile import PARAMETER_RANGES, PARAMETER_UNITS, check_parameter
from jdem.core.parameter import FRACTION, NOT_NEGATIVE, POSITIVE, Accepted
from jdem.materials.catalogue import CATALOGUE, LAWS, catalogue
from jdem.materials.soil import SoilParameters


def test_parameters_take_numbers_and_quantities():
    assert check_parameter("shear_modulus", "12 MPa", "cli", "--set") == pytest.approx(12e6)
    assert check_parameter("shear_modulus", "12e6", "cli", "--set") == 12e6
    assert check_parameter("surface_energy", 17, "cli", "--set") == 17.0
    assert check_parameter("plasticity_ratio", "35.8 %", "cli", "--set") == pytest.approx(0.358)
    assert check_parameter("pull_off_force", "-1 mN", "cli", "--set") == pytest.approx(-1e-3)


OUT_OF_RANGE = {
    "restitution": (0, 1), "static_friction": (-0.1,), "rolling_friction": (-0.1,),
    "surface_energy": (-1,), "plasticity_ratio": (0, 1, "1"), "tensile_exponent": (0.4, 5.1),
    "tangential_multiplier": (0,), "shear_modulus": (0, "-1 Pa"), "pull_off_force": (1e-3,),
    "slope_exponent": (1.2,), "wall_friction": (-1,), "platen_friction": (-1,),
}  # fmt: skip


@pytest.mark.parametrize("name", PARAMETER_UNITS)
def test_every_parameter_has_a_range(name):
    for value in (*OUT_OF_RANGE[name], float("nan"), float("inf"), True, None, "abc", 10**400):
        with pytest.raises(
            InputError, match=f"^cli: field '--set': .*; {PARAMETER_RANGES[name][1][:6]}"
        ):
            check_parameter(name, value, "cli", "--set")


def test_suggestion_names_the_nearest_or_all():
    assert suggestion("heigth", ["height", "width"]) == "did you mean 'height'?"
    assert suggestion("zzz", ["height", "width"]) == "known names: height, width"


def test_units_are_converted():
    assert unit_factor("kN", FORCE) == pytest.approx(1000)
    assert quantity(" +5.0e1mm ", LENGTH) == pytest.approx(0.05)


@given(st.text(max_size=20) | st.text("0123456789 .-+eE^*/()mNskgPa%µ²·", max_size=20))
def test_no_text_breaks_a_quantity(text):
    for read in (quantity, unit_factor):
        try:
            assert np.isfinite(read(text, LENGTH))
        except BadValue as bad:
            assert bad.repair


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
