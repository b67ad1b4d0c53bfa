"""Whose conventions a contact law follows: laws, LIGGGHTS' own curves, lab files, exports.

The committed curves (tests/data/export_contact/liggghts_conventions.csv) are those of LIGGGHTS 3.8
for a contact that is held at an overlap and slid, then rolled (`studies.liggghts.codes`).
"""

import json
from dataclasses import replace
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from calibrate.core.errors import InputError
from calibrate.exporters import liggghts
from calibrate.exporters.source import RESULT, find
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.io.soil import base_soil
from jdem.apparatus.pair import SpherePair
from jdem.core.quantity import cast
from jdem.core.smooth import Smoothing
from jdem.core.vector import Vector
from jdem.materials.conventions import CONVENTIONS, DEFAULT
from jdem.materials.soil import SoilParameters, particle_law
from tests import DATA
from tests.support.hand_made_beds import SHARP, advanced, bed_of, spheres_of, state_of
from tests.support.law_cases import MOST, PAIR, SLIP, contact_at, law_of, path_through_every_kink

pytestmark = pytest.mark.usefixtures("cheaply_compiled")

CURVES = DATA / "export_contact" / "liggghts_conventions.csv"
FIT = DATA / "fit_result"
LIGGGHTS = [name for name in CONVENTIONS if name != DEFAULT]
HELD = 0.05  # overlap of the committed curves, radii
SLOW = 1e-7  # m/s, rad/s
GRAVITY = 9.81

every_convention = pytest.mark.parametrize("name", CONVENTIONS)
those_of_liggghts = pytest.mark.parametrize("name", LIGGGHTS)
every_smoothing = pytest.mark.parametrize(
    "smoothing", [Smoothing.sharp(), Smoothing()], ids=["sharp", "default"]
)


def soil_of(name, **values):
    """The bundled soil's start in these conventions."""
    given = {"tensile_exponent": 1.0, **values}
    return SoilParameters(**given, conventions=CONVENTIONS[name])


# ------------------------------------------------------------------ the law


@eqx.filter_jit
def rows_along(soil, smoothing, overlaps, spin=3.0, slip=SLIP):
    """Normal force, load, spring's traction and moment along a path with steady slip and spin."""
    law = law_of(soil, smoothing)

    def advance(history, overlap):
        contact = contact_at(overlap, slip, soil.static_friction)
        turning = Vector(0.0 * overlap, spin + 0.0 * overlap, 0.0 * overlap)
        contact = eqx.tree_at(lambda c: c.spin, contact, cast(turning, overlap.dtype))
        force, history = law.force(contact, history)
        moment = 0.0 * overlap if force.moment is None else force.moment.y
        normal = force.normal
        parts = [normal.total(), normal.frictional_load, force.tangential.y, moment]
        return history, jnp.stack([*parts, force.rolling_limit])

    return jax.lax.scan(advance, law.memory((), overlaps.dtype), overlaps)[1]


@cache
def path():
    return path_through_every_kink(SoilParameters(reference_diameter=2 * 2.5e-3))


@every_convention
@every_smoothing
def test_no_force_without_overlap(name, smoothing):
    apart = jnp.asarray([1e-5, MOST, 0.5 * MOST, 0.0, *-np.geomspace(1e-12, 1.0, 20)])
    rows = np.asarray(rows_along(soil_of(name), smoothing, apart))
    assert np.all(rows[1, :3] != 0) and not rows[3:].any()


@pytest.mark.slow
@every_convention
@every_smoothing
def test_values_and_gradients_are_finite_through_every_kink(name, smoothing):
    soil = soil_of(name)
    by_soil, by_overlap = jax.jacfwd(lambda s, d: rows_along(s, smoothing, d), (0, 1))(soil, path())
    for leaf in jax.tree.leaves((rows_along(soil, smoothing, path()), by_soil, by_overlap)):
        assert np.isfinite(leaf).all()
    assert np.any(by_soil.rolling_friction) and np.any(by_soil.static_friction)


@those_of_liggghts
def test_sliding_and_rolling_have_their_limits(name):
    """|M| <= mu_r N R*; the spring's traction likewise."""
    soil = soil_of(name)
    rows = np.asarray(rows_along(soil, SHARP, path(), 30.0, 100 * SLIP))
    load = rows[:, 1]
    lever = float(PAIR.effective_radius())
    assert np.all(np.abs(rows[:, 3]) <= float(soil.rolling_friction) * load * lever * (1 + 1e-12))
    assert np.isclose(np.abs(rows[:, 3]), float(soil.rolling_friction) * load * lever).any()
    limit = float(soil.static_friction) * load
    assert np.all(np.abs(rows[:, 2]) <= limit * (1 + 1e-12))
    assert np.isclose(np.abs(rows[:, 2]), limit)[load > 0].any() and not rows[:, 4].any()


@those_of_liggghts
def test_a_roll_below_the_limit_costs_nothing(name):
    """To and fro at a fixed overlap: the moment comes back to nothing."""
    law, held = law_of(soil_of(name), SHARP), jnp.asarray(MOST)

    def advance(history, spin):
        contact = contact_at(held)
        contact = eqx.tree_at(lambda c: c.spin, contact, Vector(0.0 * held, 0.0 * held, spin))
        force, history = law.force(contact, history)
        return history, force.moment.z

    there = np.full(50, 1e-3)
    moment = jax.lax.scan(advance, law.memory((), float), np.concatenate([there, -there]))[1]
    assert np.abs(moment).max() > 0
    assert abs(float(moment[-1])) < 1e-12 * float(np.abs(moment).max())


@those_of_liggghts
def test_float32_agrees_with_float64(name):
    soil, overlaps = soil_of(name), jnp.linspace(1e-3, 1.0, 300) * MOST
    wide = np.asarray(rows_along(soil, Smoothing(), overlaps))
    narrow = np.asarray(rows_along(*cast((soil, Smoothing(), overlaps), jnp.float32)))
    largest = np.abs(wide).max(axis=0)
    used = largest > 0
    error = np.abs(narrow - wide).max(axis=0)[used] / largest[used]
    assert (error < 300 * np.finfo(np.float32).eps).all(), error


def test_these_conventions_are_for_slope_exponent_1():
    with pytest.raises(ValueError, match="slope_exponent"):
        law_of(soil_of("liggghts", slope_exponent=1.5))


@those_of_liggghts
def test_a_sphere_that_rolls_on_the_base_slows_down_by_the_torque(name):
    """Rolling without slip against mu_r m g r: dv/dt = -5/7 mu_r g."""
    soil = SoilParameters(
        conventions=CONVENTIONS[name], rolling_friction=0.05, platen_friction=0.8,
        shear_modulus=1e6, restitution=0.2, surface_energy=0.0, plasticity_ratio=1e-6,
    )  # fmt: skip
    bed = bed_of(spheres_of(1), soil, skin=400.0)
    radius, speed = float(bed.spheres.radius[0]), 0.1
    state = state_of(bed, [[0.0, 0.0, radius]], [[speed, 0.0, 0.0]], [[0.0, speed / radius, 0.0]])
    steps = int(0.1 / float(bed.time_step))
    velocity = np.asarray(advanced(bed, state, steps)[1][0].velocity.x[:, 0])
    early, late = steps // 2, steps - 1
    rate = (velocity[late] - velocity[early]) / ((late - early) * float(bed.time_step))
    assert velocity[late] > 0.03  # it still rolls
    assert rate == pytest.approx(-5 / 7 * 0.05 * GRAVITY, rel=0.01)


def test_strong_tangential_dashpots_shorten_the_time_step():
    """All of the normal dashpot (`history`) for 0.3 of it (`tan_luding`); hardly any: alike."""
    radius, mass = PAIR.effective_radius(), PAIR.effective_mass()

    def step(name, restitution):
        law = law_of(soil_of(name, restitution=restitution))
        return float(law.longest_step(mass, radius))

    assert step("liggghts_history", 0.05) < 0.7 * step("liggghts", 0.05)
    assert step("liggghts_history", 0.999) > 0.95 * step("liggghts", 0.999)


# ------------------------------------------------------------------ what LIGGGHTS makes of it


@cache
def exported(name):
    """The bundled soil's start, for spheres of the quick preset."""
    return replace(find(bundled_lab(), {"tensile_exponent": 1.0}, None), conventions=name)


@those_of_liggghts
def test_a_held_contact_slides_and_rolls_as_in_liggghts(name):
    """LIGGGHTS renews the adhesive share while it loads only now and then, hence 1 %."""
    rows = np.genfromtxt(CURVES, delimiter=",", names=True, dtype=None, encoding="utf-8")
    rows = rows[rows["conventions"] == name]
    traction, torque = held_contact(exported(name), rows["slip_m"], rows["turn_rad"])
    for ours, theirs in ((traction, rows["traction_n"]), (torque, rows["torque_nm"])):
        assert np.abs(ours - theirs).max() < 0.01 * np.abs(theirs).max()


def held_contact(found, slips, turns):
    """Our traction (N) at slips (m) and torque (N m) at rotations (rad), kinks sharp."""
    names = SoilParameters.__dataclass_fields__
    values = {n: found[n] for n in names if n in found.values and n != "slope_exponent"}
    soil = SoilParameters(**values, conventions=CONVENTIONS[found.conventions])
    law = particle_law(soil, jnp.asarray(found.diameter), SHARP)
    pair, held = SpherePair(jnp.asarray(found.diameter / 2)), HELD * found.diameter / 2
    zero, slow = jnp.asarray(0.0), jnp.asarray(SLOW)
    still = Vector(zero, zero, zero)

    def moved(slip, spin, friction, moments, of):
        def advance(carry, moment):
            history, before = carry
            contact = pair.contact(jnp.asarray(held), zero, (moment - before) / SLOW)
            contact = eqx.tree_at(
                lambda c: (c.slip, c.spin, c.friction), contact, (slip, spin, friction)
            )
            force, history = law.force(contact, history)
            return (history, moment), of(force)

        start = (law.memory((), float), zero)
        return np.asarray(jax.lax.scan(advance, start, jnp.asarray(moments))[1])

    friction = jnp.asarray(found["static_friction"])
    sideways = Vector(zero, slow, zero)
    traction = moved(sideways, still, friction, slips, lambda f: -f.traction().y)
    turning = Vector(zero, zero, slow)
    return traction, moved(still, turning, zero, turns, lambda f: -f.moment.z)


# ------------------------------------------------------------------ lab files and commands


def lab_file(tmp_path, extra, old="[particles]"):
    text = bundled_lab().read_text(encoding="utf-8")
    path = tmp_path / "lab.toml"
    path.write_text(text.replace(old, extra, 1), encoding="utf-8")
    return path


def test_a_lab_follows_the_conventions_that_it_is_told():
    lab = load_lab(bundled_lab())
    assert base_soil(lab).conventions is CONVENTIONS[DEFAULT]
    told = lab.following("liggghts")
    soil = base_soil(told)
    assert soil.conventions is CONVENTIONS["liggghts"] and float(soil.tensile_exponent) == 1.0
    assert told.parameters["tensile_exponent"].free is False
    assert all(values["tensile_exponent"] == 1.0 for values in told.named_sets.values())
    with pytest.raises(InputError, match="no conventions"):
        lab.following("ligghts")


def test_a_lab_file_that_contradicts_its_conventions_is_refused(calibrate, tmp_path):
    path = lab_file(tmp_path, '[particles]\nconventions = "liggghts"')
    status, _, error = calibrate("simulate", path)  # the bundled soil states another exponent
    assert status == 2 and "tensile_exponent" in error and len(error.splitlines()) == 1
    path = lab_file(tmp_path, '[particles]\nconventions = "esys"')
    status, _, error = calibrate("simulate", path)
    assert status == 2 and "particles.conventions" in error and len(error.splitlines()) == 1


@pytest.mark.parametrize("change", ["tensile_exponent=2", "slope_exponent=1.5"])
@pytest.mark.parametrize("verb", ["simulate", "fit"])
def test_a_change_that_contradicts_them_is_refused(calibrate, verb, change):
    status, _, error = calibrate(verb, "--conventions", "liggghts", "--set", change)
    assert status == 2 and change.split("=")[0] in error and len(error.splitlines()) == 1


def test_a_held_parameter_cannot_be_freed(calibrate):
    options = ["--conventions", "liggghts", "--free", "tensile_exponent"]
    status, _, error = calibrate("fit", *options)
    assert status == 2 and "tensile_exponent" in error and len(error.splitlines()) == 1


@pytest.mark.slow
def test_simulate_says_whose_conventions_it_followed(calibrate, tmp_path):
    options = ["--preset", "quick", "--conventions", "liggghts", "--out", "out"]
    status, _, error = calibrate("simulate", *options)
    assert status == 0, error
    result = json.loads((tmp_path / "out" / RESULT).read_text())
    assert result["conventions"] == "liggghts" and not result["quality"]["overflow"]
    assert result["observables"]["crushing_force_n"] > 50


# ------------------------------------------------------------------ exports


def properties(text):
    """The first number of each property of an exported section, by its name."""
    lines = [line.split() for line in text.splitlines() if line.startswith("fix soil_")]
    return {w[4]: float(w[7 if w[5] == "peratomtypepair" else 6]) for w in lines}


def test_liggghts_conventions_are_exported_one_to_one():
    found = exported("liggghts")
    text, given = liggghts.text(found), properties(liggghts.text(found))
    assert given["coefficientRollingFriction"] == pytest.approx(found["rolling_friction"])
    assert given["coeffFrictionStiffness"] == pytest.approx(found["tangential_multiplier"])
    assert liggghts.model(found) == liggghts.LUDING and liggghts.LUDING in text
    other = exported("liggghts_history")
    assert liggghts.model(other) == liggghts.HISTORY
    ours = properties(liggghts.text(exported(DEFAULT)))
    assert ours["coefficientRollingFriction"] == pytest.approx(2 * found["rolling_friction"])


@every_convention
def test_every_export_keeps_the_memory_of_liggghts(name):
    """Sorting spheres turns the sign of edinburgh's memory: it is switched off, and said."""
    lines = liggghts.text(exported(name)).splitlines()
    assert lines.index(liggghts.KEPT) < next(
        k for k, line in enumerate(lines) if line.startswith("pair_style")
    )
    assert any("memory" in line for line in lines if line.startswith("#"))


def test_an_exponent_that_tan_luding_does_not_know_is_not_exported(calibrate, tmp_path):
    result = json.loads((FIT / RESULT).read_text())
    result["conventions"] = "liggghts"
    (tmp_path / RESULT).write_text(json.dumps(result))
    where = (".", "--to", "liggghts", "--diameter", "4 mm")
    status, _, error = calibrate("export", *where, "--set", "tensile_exponent=2")
    assert status == 2 and "tensile_exponent" in error and len(error.splitlines()) == 1
    status, _, error = calibrate("export", *where, "--set", "tensile_exponent=1", "--out", "x")
    assert (status, error) == (0, "") and liggghts.LUDING in (tmp_path / "x").read_text()
    for wrong in ("nobody's", ["liggghts"]):
        (tmp_path / RESULT).write_text(json.dumps({**result, "conventions": wrong}))
        status, _, error = calibrate("export", *where)
        assert status == 2 and "conventions" in error and len(error.splitlines()) == 1


def test_other_programs_are_told_whose_conventions_these_were(calibrate, tmp_path):
    result = json.loads((FIT / RESULT).read_text()) | {"conventions": "liggghts"}
    (tmp_path / RESULT).write_text(json.dumps(result))
    status, out, _ = calibrate("export", ".", "--to", "edem", "--diameter", "4 mm", "--out", "x")
    assert status == 0 and "conventions liggghts" in out
    assert "conventions liggghts" in (tmp_path / "x").read_text()
