"""Parameters that differ with the moisture of specimens: what a lab file says, and what follows."""

from dataclasses import replace

import numpy as np
import pytest

from calibrate.core.errors import InputError
from calibrate.core.progress import Silent
from calibrate.exporters.source import find
from calibrate.inference.calibration import calibrate as fit
from calibrate.inference.parameters import candidates_of, checked_free, fitting_groups, space
from calibrate.inference.verified import parts
from calibrate.io.lab import load_lab
from calibrate.io.soil import base_soil, soil_at, with_values
from calibrate.labtests.measured import Target
from calibrate.simulation.joint import JointCampaign
from calibrate.simulation.resolution import PRESETS
from calibrate.simulation.session import Session
from calibrate.simulation.specimens import campaign, simulate, soil_json
from calibrate.verbs import fit as fit_verb
from calibrate.verbs.report import report

TINY = replace(PRESETS["quick"], spheres=48, packings=1)
ENERGIES = {"4 %": 4.0, "12 %": 12.0}  # J/m^2
ENERGY = "surface_energy"
NAMES = [f"{ENERGY}@4%", f"{ENERGY}@12%"]
SIZE = 'diameter = "50 mm", height = "60 mm"'
BEGIN = '[soil]\nname = "moist"\n[specimen]\n'


def one_test(name, moisture, own=True, size=SIZE):
    specimen = f"specimen = {{ {size}, moisture = {moisture!r} }}\n" if own else ""
    target = 'targets.depression_depth = { mean = "3 mm", scatter = "0.1 mm", repeats = 4 }\n'
    return f'[[tests]]\ntype = "confined"\nname = "{name}"\n{specimen}{target}'


FIRST = 'diameter = "50 mm"\nheight = "60 mm"\nmoisture = "4 %"\n'
TESTS = one_test("dry", "4 %", own=False) + one_test("wet", "12 %")
ENTRY = f"[parameters.{ENERGY}]\nhigh = 40\n[parameters.{ENERGY}.by_moisture]\n"
VALUES = "".join(f'"{moisture}" = {value}\n' for moisture, value in ENERGIES.items())
TEXT = BEGIN + FIRST + TESTS + ENTRY + VALUES


@pytest.fixture
def read(tmp_path):
    def lab_of(text=TEXT):
        path = tmp_path / "lab.toml"
        path.write_text(text, encoding="utf-8")
        return load_lab(path)

    return lab_of


def test_a_lab_file_gives_a_value_for_each_moisture(read):
    lab = read()
    soil = base_soil(lab)
    assert lab.differing() == {ENERGY: NAMES}
    said = soil_json(soil)
    assert [said[name] for name in NAMES] == [4.0, 12.0] and ENERGY not in said
    for (moisture, value), share in zip(ENERGIES.items(), (0.04, 0.12), strict=True):
        own = soil_at(soil, share)
        assert float(own.surface_energy) == value and not own.further, moisture
    assert soil_at(own, None) is own  # a soil that does not differ


def test_each_value_is_a_parameter_of_its_own(read):
    lab = read()
    assert checked_free([ENERGY, "rolling_friction"], lab) == (*NAMES, "rolling_friction")
    assert checked_free(NAMES[1:], lab) == (NAMES[1],)
    names = candidates_of(lab)
    assert set(NAMES) < set(names) and ENERGY not in names
    every = space(lab, names)
    assert sorted(sum(fitting_groups(names), ())) == list(range(len(names)))
    assert [every.ranges[names.index(name)].high for name in NAMES] == [40.0, 40.0]
    moved = soil_json(every.soil(0.9 * every.start()))
    assert [moved[name] for name in NAMES] == pytest.approx([3.6, 10.8])


def test_values_are_set_from_outside_together_or_alone(read, tmp_path):
    session = Session.open(read(), "quick", tmp_path / "out")
    assert [soil_json(session.soil({ENERGY: 7.0}))[name] for name in NAMES] == [7.0, 7.0]
    alone = soil_json(session.soil({NAMES[1]: "7 J/m^2"}))
    assert [alone[name] for name in NAMES] == [4.0, 7.0]
    with pytest.raises(InputError, match="unknown parameter"):
        session.soil({f"{ENERGY}@8%": 7.0})


REFUSED = [  # text, field, words
    (TEXT.replace('"12 %" =', '"8 %" ='), "tests[1].specimen.moisture", "no value for 12"),
    (TEXT.replace(', moisture = \'12 %\'', ""), "tests[1].specimen.moisture", "has none; give one"),
    (TEXT.replace('moisture = "4 %"\n', ""), "specimen.moisture", "has none; give one of 4%, 12%"),
    (TEXT.replace('"12 %" = 12.0', '"wet" = 12.0'), f"parameters.{ENERGY}.by_moisture", "moisture"),
    (TEXT + '"12.0 %" = 12.0\n', f"parameters.{ENERGY}.by_moisture", "given twice"),
    (TEXT.replace("high = 40", "value = 4"), f"parameters.{ENERGY}.value", "both"),
    (TEXT.replace("high = 40", "high = 10"), f"parameters.{ENERGY}", "low <= value <= high"),
    (TEXT.replace('"12 %" = 12.0', '"12 %" = "12 N"'), f"parameters.{ENERGY}", "J/m^2"),
    (TEXT.replace('"12 %" = 12.0', '"12 %" = 1e6'), f"parameters.{ENERGY}", "usual"),
    (TEXT + f"[named_sets.one]\n{ENERGY} = 5\n", f"named_sets.one.{ENERGY}", "has one value"),
    (
        TEXT + '[parameters.slope_exponent.by_moisture]\n"4 %" = 1\n"12 %" = 1.5\n',
        "parameters.slope_exponent", "cannot differ",
    ),
    (TEXT.replace("'12 %'", "'1200 %'"), "tests[1].specimen.moisture", "usual"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "field", "words"), REFUSED)
def test_what_is_wrong_is_said(read, text, field, words):
    with pytest.raises(InputError) as error:
        read(text)
    assert error.value.field.startswith(field) and words in str(error.value)
    assert len(str(error.value).splitlines()) == 1


def test_where_one_soil_is_needed_the_lab_is_refused(read, tmp_path, calibrate):
    lab = read(TEXT + '[[tests]]\ntype = "unconfined"\n')
    with pytest.raises(InputError, match="differs with moisture, and this takes one soil"):
        lab.pair()
    with pytest.raises(InputError, match="one soil"):
        Session.open(lab, "quick", tmp_path / "out").campaign_of_one(tmp_path)
    status, _, error = calibrate("fit", "lab.toml", "--no-runs")
    assert status == 2 and "differs with moisture, and this takes one soil" in error
    with pytest.raises(InputError, match=f"no fitted test says anything of {NAMES[1]}"):
        parts(read(), ["dry"], ["wet"])


def test_an_export_takes_one_moisture(read, tmp_path):
    read()
    path = tmp_path / "lab.toml"
    found = find(path, {}, 4e-3, 0.12)
    assert found[ENERGY] == 12.0 and "at a moisture of 12%" in found.origin
    with pytest.raises(InputError, match="differs with moisture; give --moisture, one of 4%, 12%"):
        find(path, {}, 4e-3)
    with pytest.raises(InputError, match="no value for 8%"):
        find(path, {}, 4e-3, 0.08)
    read(TEXT.replace(ENTRY + VALUES, ""))
    with pytest.raises(InputError, match="leave out --moisture"):
        find(path, {}, 4e-3, 0.12)


@pytest.mark.slow
def test_each_specimen_is_simulated_with_the_soil_at_its_moisture(read, tmp_path):
    """As in a lab file of its own; a value that moves costs runs of its specimens alone."""
    lab = read()
    work = campaign(lab, TINY, tmp_path / "both", Silent())
    assert isinstance(work, JointCampaign)
    result, _ = simulate(lab, TINY, base_soil(lab), 0, work)
    assert result["parameters"][NAMES[0]] == 4.0 and work.simulated == 2
    for name, energy in (("dry", 4.0), ("wet", 12.0)):
        own = read(BEGIN + FIRST + one_test(name, "", own=False))
        alone = campaign(own, TINY, tmp_path / "both", Silent())
        soil = with_values(base_soil(own), {ENERGY: energy})
        found, _ = simulate(own, TINY, soil, 0, alone)
        depth = found["observables"]["depression_depth_mm"]
        assert result["observables"][f"{name}.depression_depth_mm"] == depth
    free = space(lab, tuple(NAMES))
    work.runs([free.soil([4.0, 15.0])], [0], "wet soil moved")
    assert work.simulated == 3


@pytest.mark.slow
def test_energies_at_both_moistures_come_back(read, tmp_path):
    """From depths that two soils showed, with all else known; results say which is which."""
    lab, preset = read(), replace(TINY, packings=2, fresh=2)
    work = campaign(lab, preset, tmp_path, Silent())
    free = space(lab, tuple(NAMES))
    made = work.runs([free.soil([2.5, 20.0])], [0, 1], "made")[0]
    means = {n: float(np.mean([run.observables[n] for run in made])) for n in lab.targets}
    targets = {name: Target(mean, 0.01 * mean, 4) for name, mean in means.items()}
    measured = replace(lab, targets=targets)
    done = fit(measured, preset, tuple(NAMES), base_soil(lab), 0, work)
    assert done.met
    found = fit_verb.kept(Session(measured, preset, tmp_path, Silent()), done)
    assert set(NAMES) < set(found.parameters) and list(found.free) == NAMES
    assert find(tmp_path, {}, 4e-3, 0.12)[ENERGY] == found.parameters[NAMES[1]]
    assert "surface energy@12%" in report(tmp_path).path.read_text(encoding="utf-8")
    for name, ends, true in zip(
        NAMES, done.result.identifiability.interval, (2.5, 20.0), strict=True
    ):
        assert ends[0] < true < ends[1], name
