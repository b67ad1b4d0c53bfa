"""Lab files that choose a contact law: what they may say, what they are refused, what follows."""

import json
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from calibrate.core.errors import InputError
from calibrate.core.progress import Silent
from calibrate.discrepancy.library.stand_in import why_not
from calibrate.exporters.composite import EXPORTERS
from calibrate.exporters.source import RESULT, find
from calibrate.inference.calibration import calibrate as fit
from calibrate.inference.parameters import (
    candidates,
    checked_free,
    fitting_groups,
    ranges,
    space,
)
from calibrate.io.lab import load_lab
from calibrate.io.soil import base_soil, with_values
from calibrate.labtests.measured import Curve, Target
from calibrate.simulation import run as runs
from calibrate.simulation.campaign import Campaign
from calibrate.simulation.compiled import blank
from calibrate.simulation.resolution import PRESETS, SPARE, Preset, specimen, virtual_lab
from calibrate.simulation.session import Session
from calibrate.simulation.specimens import campaign, simulate, soil_json
from jdem.engine.bed import reach_of
from jdem.materials.catalogue import WHOLE, needed_by, parameters_of
from jdem.materials.contact_laws import BED_LAWS, BONDED_UP_TO, BONDED_WITHIN
from jdem.materials.conventions import DEFAULT

TINY = Preset("tiny", 48, 0.2, 0.4, 1)
GIVEN = {
    "gamma": '"8 J/m^2"',
    "cohesion": '"100 kJ/m^3"',
    "yield_strength": '"5 MPa"',
    "normal_stiffness": '"1e9 N/m^3"',
    "shear_stiffness": '"400 MN/m^3"',
    "tensile_strength": '"200 kPa"',
    "shear_strength": '"150 kPa"',
}
LAB = """[soil]
name = "x"
[specimen]
diameter = "50 mm"
height = "50 mm"
[[tests]]
type = "confined"
force_low = "30 N"
force_high = "120 N"
[tests.targets.depression_depth]
mean = "2 mm"
scatter = "0.1 mm"
repeats = 4
[particles]
"""
every_law = pytest.mark.parametrize("law", WHOLE)


def text_of(law, *lines, particles=""):
    """A lab file with a law, all that it needs, and further lines of [parameters]."""
    needed = [f"{name} = {GIVEN[name]}" for name in needed_by(law)]
    return "\n".join([LAB + f'law = "{law}"', particles, "[parameters]", *needed, *lines])


@pytest.fixture
def lab_of(tmp_path):
    def read(law, *lines, particles=""):
        path = tmp_path / "lab.toml"
        path.write_text(text_of(law, *lines, particles=particles), encoding="utf-8")
        return load_lab(path)

    return read


# ------------------------------------------------------------------ what a lab file says


@every_law
def test_a_lab_file_chooses_its_law(lab_of, law):
    lab = lab_of(law, "static_friction = 0.5")
    soil, names = base_soil(lab), set(parameters_of(law))
    assert lab.particles.conventions == law and soil.conventions is BED_LAWS[law]
    assert set(soil_json(soil)) == names and float(soil.static_friction) == 0.5
    assert "gamma" not in names or soil_json(soil)["gamma"] == 8.0
    assert {"static_friction", *needed_by(law)} <= set(candidates(law)) <= set(ranges(law)) <= names
    assert not {"wall_friction", "platen_friction"} & set(candidates(law))
    every = space(lab, tuple(ranges(law)), soil)
    assert every.start() == pytest.approx([soil_json(soil)[name] for name in ranges(law)])
    moved = soil_json(every.soil(0.9 * every.start()))
    assert [moved[n] for n in ranges(law)] == pytest.approx(0.9 * every.start())
    assert sorted(sum(fitting_groups(every.names), ())) == list(range(len(every.names)))


def test_eepa_is_the_law_of_files_that_say_nothing(lab_of):
    named, silent = lab_of(DEFAULT), lab_of(DEFAULT, particles='conventions = "eepa"')
    assert named.particles == silent.particles and named.particles.conventions == DEFAULT
    liggghts = lab_of(DEFAULT, particles='conventions = "liggghts"')
    assert liggghts.particles.conventions == "liggghts"


REFUSED = [  # particles, lines, field, words
    ('law = "hertz_mindlim"', "", "particles.law", "did you mean 'hertz_mindlin'?"),
    ('law = "liggghts"', "", "particles.law", 'give conventions = "liggghts"'),
    ('law = "jkr"\nconventions = "eepa"', "", "particles.conventions", "has no conventions"),
    ('law = "jkr"', "", "parameters.gamma", "the law 'jkr' needs gamma"),
    ('law = "jkr"', "gamma = { low = 1 }", "parameters.gamma", "the law 'jkr' needs gamma"),
    ('law = "hertz_cohesion"', "", "parameters.cohesion", "needs cohesion"),
    ('law = "hysteretic_cohesion"', "cohesion = 1e5", "parameters.yield_strength", "needs"),
    (
        'law = "hertz_mindlin"', "surface_energy = 3", "parameters.surface_energy",
        "the law 'hertz_mindlin' has no surface_energy",
    ),
    ('law = "hertz_mindlin"', "tensile_exponent = { free = true }", "parameters", "has no tens"),
    ('law = "hertz_mindlin"', "slope_exponent = 1.5", "parameters.slope_exponent", "has no slope"),
    ('law = "hertz_mindlin"', "[named_sets.a]\ngamma = 2", "named_sets.a.gamma", "has no gamma"),
    ('law = "hertz_mindlin"', "restitutoin = 0.5", "parameters", "did you mean 'restitution'?"),
    ('law = "hysteretic_cohesion"', "shear_modulus = 5e6", "parameters", "has no shear_modulus"),
    ("", "gamma = 2", "parameters.gamma", "the law 'eepa' has no gamma"),
    ('conventions = "liggghts"', "gamma = 2", "parameters.gamma", "the law 'eepa' has no gamma"),
    ('law = "jkr"', "gamma = 0", "parameters.gamma", "out of range"),
    (
        'law = "hertz_mindlin"\nreference_diameter = "80 um"', "", "particles.reference_diameter",
        "states nothing at a diameter",
    ),
    ('law = "jkr"', 'gamma = "0.5 N"', "parameters.gamma", "J/m^2"),
    ('law = "jkr"', "gamma = 5e4", "parameters.gamma", "usual"),
    ('law = "parallel_bond"', "", "parameters.normal_stiffness", "needs normal_stiffness"),
    ('law = "parallel_bond"', "cohesion = 1e4", "parameters.cohesion", "has no cohesion"),
    ('law = "parallel_bond"', "moment_share = 2", "parameters.moment_share", "out of range"),
    ('law = "parallel_bond"', 'tensile_strength = "9 GPa"', "parameters", "is 9 MPa meant?"),
    ('law = "parallel_bond"', "normal_stiffness = 1e15", "parameters", "usual"),
]  # fmt: skip


@pytest.mark.parametrize(("particles", "lines", "field", "words"), REFUSED)
def test_what_is_wrong_is_said_in_one_sentence(tmp_path, particles, lines, field, words):
    path = tmp_path / "lab.toml"
    path.write_text(f"{LAB}{particles}\n[parameters]\n{lines}\n", encoding="utf-8")
    with pytest.raises(InputError) as refused:
        load_lab(path)
    said = str(refused.value)
    assert f"field '{field}" in said and words in said and len(said.splitlines()) == 1
    assert str(path) in said


def test_elastic_spheres_may_rebound_fully_and_those_of_eepa_not(lab_of):
    assert float(base_soil(lab_of("hertz_mindlin", "restitution = 1")).restitution) == 1.0
    with pytest.raises(InputError, match="out of range"):
        lab_of(DEFAULT, "restitution = 1")


# ------------------------------------------------------------------ the command line


@every_law
def test_check_lists_the_parameters_of_the_law_alone(calibrate, tmp_path, law):
    (tmp_path / "lab.toml").write_text(text_of(law), encoding="utf-8")
    status, out, error = calibrate("check", "lab.toml")
    assert status == 0, error
    assert f"the law '{law}'" in out and "surface_energy" not in out
    assert all(name in out for name in ranges(law))


@pytest.mark.parametrize("verb", ["simulate", "fit", "audit", "doe"])
def test_changes_are_the_laws_parameters(calibrate, tmp_path, verb):
    (tmp_path / "lab.toml").write_text(text_of("hertz_mindlin"), encoding="utf-8")
    status, _, error = calibrate(verb, "lab.toml", "--set", "surface_energy=3")
    assert status == 2 and len(error.splitlines()) == 1
    assert "the law 'hertz_mindlin' has no surface_energy" in error


def test_only_the_laws_parameters_are_freed(calibrate, tmp_path, lab_of):
    (tmp_path / "lab.toml").write_text(text_of("jkr"), encoding="utf-8")
    for name, words in (("plasticity_ratio", "the law 'jkr' has no"), ("gama", "'gamma'")):
        status, _, error = calibrate("fit", "lab.toml", "--free", name)
        assert status == 2 and words in error and len(error.splitlines()) == 1
    assert checked_free(["gamma", "shear_modulus"], lab_of("jkr")) == ("gamma", "shear_modulus")
    status, _, error = calibrate("fit", "lab.toml", "--conventions", "liggghts")
    assert status == 2 and "law is 'jkr'" in error and len(error.splitlines()) == 1


@pytest.mark.parametrize("verb", ["diagnose", "posterior", "library"])
def test_the_library_of_runs_is_of_eepa(calibrate, tmp_path, verb):
    crushed = '[[tests]]\ntype = "unconfined"\n[tests.targets.crushing_force]\nmean = "50 N"\n'
    curve = (
        '[[tests.curves]]\nfile = "c.csv"\ndisplacement = { column = "mm", unit = "mm" }\n'
        'force = { column = "N", unit = "N" }\n'
    )
    text = text_of("jkr").replace(
        "[particles]", f'{crushed}scatter = "5 N"\nrepeats = 4\n{curve}[particles]', 1
    )
    (tmp_path / "c.csv").write_text("mm,N\n0,0\n1,10\n2,20\n3,40\n4,50\n5,45\n6,30\n")
    (tmp_path / "lab.toml").write_text(text, encoding="utf-8")
    status, _, error = calibrate(verb, "lab.toml")
    assert status == 2 and "'jkr'" in error and "law" in error and "conventions" not in error
    assert len(error.splitlines()) == 1


def test_a_fit_is_told_why_the_library_does_not_explore(lab_of):
    lab = lab_of("hertz_mindlin")
    why = why_not(lab, PRESETS["standard"], None, base_soil(lab))
    assert "the law 'eepa'" in why and "'hertz_mindlin'" in why


# ------------------------------------------------------------------ runs


def test_runs_of_different_laws_have_different_keys(lab_of, tmp_path):
    """Numbers that are the same do not make a run the same."""
    labs = [lab_of(law, "static_friction = 0.5") for law in ("hertz_mindlin", "hertz_cohesion")]
    labs.append(lab_of(DEFAULT, "static_friction = 0.5"))
    keys, beds = set(), set()
    for lab in labs:
        work = campaign(lab, TINY, tmp_path, Silent())
        assert isinstance(work, Campaign)
        soil = base_soil(lab)
        keys.add(work.key(soil, 0))
        keys.add(work.key(replace(soil, further={}), 0))
        beds.add(work._packing_name(0))
    assert len(keys) == 4 and len(beds) == 1  # only hertz_cohesion has a number of its own


def test_lists_reach_as_far_as_the_bounds_of_jkr(lab_of):
    """Up to the stickiest and softest soil that the lab file lets a fit try."""
    assert virtual_lab(lab_of("hertz_cohesion"), TINY).grid.reach == 0.0
    usual = virtual_lab(lab_of("jkr"), TINY).grid
    held = [f"{name} = {{ value = {x}, free = false }}" for name, x in (("shear_modulus", 7e6),)]
    lab = lab_of("jkr", *held)
    narrow = virtual_lab(lab, TINY).grid
    wide = virtual_lab(lab_of("jkr", 'shear_modulus = { low = "0.5 MPa" }'), TINY).grid
    assert 0 < narrow.reach < usual.reach < wide.reach < usual.skin * 4
    filled = specimen(lab, TINY)
    most = with_values(base_soil(lab), {"gamma": 30.0})
    assert narrow.reach > reach_of(most, 2 * filled.mean_radius(), filled.max_radius())


def test_a_run_whose_contacts_may_be_lost_is_a_failed_one(lab_of):
    lab = lab_of("jkr")
    virtual, filled = virtual_lab(lab, TINY), specimen(lab, TINY)
    bed = blank(filled)
    radii = jnp.linspace(0.85, 1.15, filled.count) * filled.mean_radius()
    bed = eqx.tree_at(lambda b: b.spheres.radius, bed, radii)
    assert not runs._lost_contacts(virtual, bed, base_soil(lab))
    said = runs._lost_contacts(virtual, bed, with_values(base_soil(lab), {"gamma": 300.0}))
    assert "pairs were listed up to" in said and "low and high" in said


def test_lists_reach_as_far_as_bonds_hold(lab_of):
    """A fifth of the largest radius at most, and less where lab files bound strength over
    stiffness."""
    lab = lab_of("parallel_bond")
    filled = specimen(lab, TINY)
    widest = SPARE * BONDED_UP_TO * filled.max_radius() / 2
    assert virtual_lab(lab, TINY).grid.reach == pytest.approx(widest, rel=1e-9)
    lines = (
        LAB
        + 'law = "parallel_bond"\n[parameters]\n'
        + "\n".join(
            f"{name} = {{ value = {GIVEN[name]}, free = false }}"
            for name in needed_by("parallel_bond")
        )
    )
    Path(lab.file).write_text(lines, encoding="utf-8")
    stiffness = 1e9 * 5e-3 / (2 * filled.mean_radius())  # stated at 5 mm
    gap = 2e5 / stiffness + BONDED_WITHIN * filled.max_radius() / 2
    reach = virtual_lab(load_lab(lab.file), TINY).grid.reach
    assert reach == pytest.approx(SPARE * gap, rel=1e-6)
    assert reach < widest


@pytest.mark.slow
@every_law
def test_a_tiny_bed_is_simulated(lab_of, tmp_path, law):
    lab = lab_of(law)
    work = campaign(lab, TINY, tmp_path, Silent())
    result, (run,) = simulate(lab, TINY, base_soil(lab), 0, work)
    assert not run.failure and 0.3 < run.observables["depression_depth_mm"] < 20
    assert set(result["parameters"]) == set(parameters_of(law))
    assert run.quality["energy_balance"] < 0.02 and not run.quality["overflow"]
    curve = result["curves"]["confined"]
    assert ("intact_bonds" in curve) == (law == "parallel_bond")
    assert len({len(column) for column in curve.values()}) == 1


@pytest.mark.slow
def test_two_parameters_of_hertz_mindlin_come_back(lab_of, tmp_path):
    """Within their 95 % intervals, of the curves that the law gave with others on the same
    packings.  48 spheres scatter so much that the data leave some of the modulus to the prior."""
    lab, two = lab_of("hertz_mindlin"), ("static_friction", "shear_modulus")
    preset = replace(TINY, packings=2, fresh=2)
    work = campaign(lab, preset, tmp_path, Silent())
    truth = with_values(base_soil(lab), {"static_friction": 0.4, "shear_modulus": 4e6})
    made = work.runs([truth], [0, 1], "made")[0]
    depth = float(np.mean([run.observables["depression_depth_mm"] for run in made]))
    recorded = [run.curves["confined"] for run in made]
    curves = tuple(Curve("confined", c[:, 0], c[:, 1], f"{k}.csv") for k, c in enumerate(recorded))
    target = Target(depth, 0.02 * depth, 4)
    measured = replace(lab, targets={"depression_depth_mm": target}, curves=curves)
    done = fit(measured, preset, two, base_soil(lab), 0, work)
    found = soil_json(done.calibration.space.soil(done.result.best.values))
    assert done.met and set(found) == set(parameters_of("hertz_mindlin"))
    for name, (low, high) in zip(two, done.result.identifiability.interval, strict=True):
        assert low < float(truth.values()[name]) < high
    assert found["shear_modulus"] == pytest.approx(4e6, rel=0.3)  # from 7e6


# ------------------------------------------------------------------ exports


@every_law
@pytest.mark.parametrize("to", EXPORTERS)
def test_exports_know_the_law_or_refuse_it(lab_of, tmp_path, law, to):
    lab_of(law)
    found = find(tmp_path / "lab.toml", {}, 4e-3)
    if (law, to) in {(law, "csv"), (law, "json"), (law, "edem")} or (
        to == "liggghts" and law.startswith("hertz")
    ):
        text = EXPORTERS[to].text(found)
        assert law in text and "surface_energy," not in text and "plasticity" not in text
        return
    with pytest.raises(InputError, match=f"the law '{law}' is not exported to {to}"):
        EXPORTERS[to].text(found)


def test_a_result_of_another_law_is_exported_as_such(calibrate, lab_of, tmp_path):
    lab = lab_of("jkr")
    Session.open(lab, "quick", tmp_path / "fit")
    intervals = {"identifiability": {"interval_95": {"gamma": [4.0, 16.0]}}}
    result = {"law": "jkr", "soil": "x", "parameters": soil_json(base_soil(lab)), **intervals}
    (tmp_path / RESULT).write_text(json.dumps(result), encoding="utf-8")
    status, _, error = calibrate("export", ".", "--to", "edem", "--diameter", "10 mm", "--out", "x")
    assert (status, error) == (0, "")
    rows = (tmp_path / "x").read_text().splitlines()
    assert "JKR soil - soil,Surface Energy,16,J/m^2,8,32" in rows  # twice that at 5 mm
    status, _, error = calibrate("export", ".", "--to", "csv", "--set", "surface_energy=1")
    assert status == 2 and "the law 'jkr' has no surface_energy" in error
    (tmp_path / RESULT).write_text(json.dumps({**result, "law": "hertz"}), encoding="utf-8")
    status, _, error = calibrate("export", ".", "--to", "csv")
    assert status == 2 and "'hertz' is unknown" in error and len(error.splitlines()) == 1
