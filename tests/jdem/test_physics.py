"""The version of the physics: numbers of small runs that it stands for, and what is named by it.

Each law is led along a path of one contact.  Seven spheres go through both tests with an oedometer
between them, and through both with each effect.  Four spheres settle and six grow into a bed.
These runs are so short that round-off does not grow in them, which is tested as well: another
processor finds the same to twelve digits, while a change of 1e-6 in a constant is seen.

    python -m tests.jdem.test_physics     writes tests/data/physics.json anew (two minutes)

It keeps what has not changed, adds what is new, and refuses numbers that changed under a version.
"""

import argparse
import importlib
import inspect
import json
import pkgutil
import sys
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import replace
from functools import cache, partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jdem
import tests.conftest  # noqa: F401  double precision, where this file runs as a script
from calibrate.core.files import write_text
from calibrate.records.base import Origin, record
from calibrate.simulation import keys
from calibrate.simulation.session import made_by
from jdem import laws, physics
from jdem.apparatus.confined import ConfinedCompression
from jdem.apparatus.pair import SpherePair, overlap_path
from jdem.apparatus.platen_on_base import PlatenOnBase
from jdem.apparatus.protocol import Protocol, Step
from jdem.apparatus.unconfined import UnconfinedCompression
from jdem.bodies.spheres import Spheres
from jdem.core.smooth import Smoothing
from jdem.core.vector import Vector
from jdem.effects import capillary, cementation
from jdem.effects.composite import EFFECTS, with_strengths
from jdem.engine import step
from jdem.engine.bed import Numerics
from jdem.engine.loop import run as run_loop
from jdem.laboratory.bare_machine import BareMachine
from jdem.laboratory.virtual_lab import Outcome, TestSequence, VirtualLab
from jdem.laws import bond, eepa, friction, hertz_mindlin, hysteretic, jkr, liggghts
from jdem.laws.base import (
    AbstractContactLaw,
    AbstractNormalLaw,
    AbstractRollingLaw,
    AbstractTangentialLaw,
)
from jdem.materials.catalogue import LAWS
from jdem.materials.contact_laws import CONTACT_LAWS, Stated
from jdem.materials.conventions import CONVENTIONS
from jdem.materials.soil import SoilParameters, particle_law
from jdem.observables import Curve, ForceLeft, LargestDisplacement
from jdem.packing import growth, settling
from jdem.packing.specimen import Packing, Specimen
from jdem.sensitivity.overdamped import Overdamped
from tests import DATA
from tests.support.toy_place import SPECIMEN, soils, toy_campaign

pytestmark = pytest.mark.thorough

KEPT = DATA / "physics.json"
TOLERANCE = 1e-9  # of the largest number of its kind in a run
CHANGED = "numbers changed: raise the version, or find the fault"
# Without optimisation programs compile in a third of the time.
CHEAP = {"compiler_options": {"xla_backend_optimization_level": 0}}

Numbers = dict[str, list[float]]  # of one run, by what they are
Found = dict[str, Numbers]

# ------------------------------------------------------------------ one contact

RADIUS, MOST = 2.5e-3, 3e-5
PAIR = SpherePair(RADIUS)
PATH = overlap_path(jnp.asarray([MOST, 0.3 * MOST, 1.2 * MOST, 0.1 * MOST, -0.01 * MOST]), 40)
# Parameters of a law that others do not have.
FURTHER = {"hysteretic": {"yield_strength": 8e6, "cohesion": 2e4, "damping_factor": 0.3}}


def soil_of(law: str, conventions: str, exponent: float = 1.0) -> SoilParameters:
    return SoilParameters(
        slope_exponent=exponent,
        law=LAWS[law].law,
        conventions=CONVENTIONS[conventions],
        further={name: jnp.asarray(value) for name, value in FURTHER.get(law, {}).items()},
        reference_diameter=2 * RADIUS,
    )


SOILS = {
    **{f"{law}, eepa": soil_of(law, "eepa") for law in LAWS},
    **{f"eepa, {name}": soil_of("eepa", name) for name in CONVENTIONS},
    "eepa, slope exponent 1.5": replace(soil_of("eepa", "eepa", 1.5), pull_off_force=-1e-3),
}


# Laws that no soil has, with what they take; the bond breaks on the path.
STATED: dict[str, dict[str, float]] = {
    "hertz_mindlin": {"restitution": 0.5, "rolling_friction": 0.1},
    "hertz_cohesion": {"cohesion": 2e4, "restitution": 0.5},
    "jkr": {"gamma": 2.0, "restitution": 0.5},
    "parallel_bond": dict(zip((e.name for e in bond.PARAMETERS),
                              (1e9, 4e8, 900.0, 4e4, 0.8, 0.3, 0.9), strict=True)),
}  # fmt: skip
FRICTION = 0.676


def law_of(case: str) -> AbstractContactLaw:
    """A law of SOILS or of STATED."""
    if case in SOILS:
        return particle_law(SOILS[case], jnp.asarray(2 * RADIUS), Smoothing())
    values = {"static_friction": FRICTION, **STATED[case]}
    numbers = {name: jnp.asarray(value) for name, value in values.items()}
    stated = Stated(jnp.asarray(18.2e6), jnp.asarray(0.3), numbers, {}, Smoothing())
    return CONTACT_LAWS[case].law(stated)


def contact_numbers(case: str) -> Numbers:
    """All that a law returns along a path on which the contact slips and rolls."""
    law, friction = law_of(case), jnp.asarray(FRICTION)

    def advance(history, overlap):
        contact = PAIR.contact(overlap, 1e-3 * jnp.ones_like(overlap), 1e-5)
        turned = (Vector(0 * overlap, 4e-3 * overlap / MOST, 0 * overlap), friction)
        contact = eqx.tree_at(lambda c: (c.slip, c.friction), contact, turned)
        spin = Vector(0.1 * overlap / MOST, 0.2 + 0 * overlap, 0 * overlap)
        contact = eqx.tree_at(lambda c: c.spin, contact, spin)
        force, history = law.force(contact, history)
        return history, (force, force.traction())

    def driven():
        return jax.lax.scan(advance, law.memory((), PATH.dtype), PATH)[1]

    leaves = jax.tree_util.tree_leaves_with_path(jax.jit(driven, **CHEAP)())
    rows = {jax.tree_util.keystr(place): np.asarray(leaf) for place, leaf in leaves}
    return {name: row[::8].tolist() for name, row in rows.items() if np.any(row)}


def contacts() -> Found:
    return {f"contact: {name}": contact_numbers(name) for name in (*SOILS, *STATED)}


# ------------------------------------------------------------------ both tests, oedometer, effects

SMALL = Specimen(diameter=0.018, height=0.026, count=7, spread=0.05)
NUMERICS = Numerics(sample_time=2e-4)
CONFINED = ConfinedCompression(simulated_rate=0.05, force_low=10.0, force_high=20.0, stroke=4e-3)
UNCONFINED = UnconfinedCompression(stroke=1.47e-3, rest=4.3e-3, opening=1.1e-4)
OEDOMETER = Protocol(
    (
        Step("force", "load", 10.0),
        Step("hold", "hold", 60.0),
        Step("force", "unload", 3.0),
        Step("force", "reload", 15.0),
        Step("keep", "creep", 60.0),
    ),
    gauges=(ForceLeft(held=1), LargestDisplacement()),
    name="oedometer",
    stroke=4e-3,
)
SHARES = {"acquisition_lag": 0.5}  # of the largest typical strength, where round-off grows at it


def packing(shift: float = 0.0) -> Packing:
    """Three spheres on three, and one on top, in a mould of three across; `shift` is relative."""
    mean = 4e-3
    radius = mean * np.array([1.0, 0.97, 1.03, 0.99, 1.02, 0.98, 1.01])
    ring, rise = 2 * mean / np.sqrt(3), 2.02 * mean * np.sqrt(2 / 3)
    angle = np.arange(6) * 2 * np.pi / 3 + np.repeat([0.0, np.pi / 3], 3)
    height = 1.01 * mean + rise * np.repeat([0.0, 1.0, 2.0], [3, 3, 1])
    flat = [[*ring * np.cos(angle), 0.02 * mean], [*ring * np.sin(angle), 0.03 * mean]]
    centres = np.column_stack([*flat, height])
    number = np.arange(centres.size).reshape(centres.shape)
    centres = centres + 0.002 * mean * np.cos(number**2)
    centres = centres * (1 + shift * np.sin(number + 1))
    spheres = Spheres(jnp.asarray(radius), jnp.asarray(2650 * 4 / 3 * np.pi * radius**3))
    position = Vector.from_rows(jnp.asarray(centres))
    return Packing(position, spheres, height[-1] + 1.1 * mean, ring + 1.03 * mean)


def curve_numbers(curve: Curve) -> list[float]:
    """Number of rows, work (J), largest force (N)."""
    valid = np.asarray(curve.valid) > 0
    travel, force = np.asarray(curve.displacement)[valid], np.asarray(curve.force)[valid]
    return [float(valid.sum()), float(np.trapezoid(force, travel)), float(force.max())]


def outcome_numbers(outcome: Outcome) -> Numbers:
    assert not outcome.failed
    state = outcome.record.state
    every = jax.tree.leaves(state.energy)
    readings = {
        f"{test} {name}": [float(value)]
        for test, found in outcome.observables.items()
        for name, value in found.items()
    }
    curves = {
        f"{test} {name}": [value]
        for test, curve in outcome.curves.items()
        for name, value in zip(("rows", "work", "force"), curve_numbers(curve), strict=True)
    }
    energy = np.concatenate([np.ravel(leaf) for leaf in every]).tolist()
    centres = np.ravel(state.motion.position.stack()).tolist()
    return {**readings, **curves, "time": [float(state.time)], "energy": energy, "centres": centres}


class Laboratory:
    """The small bed's runs, each program compiled when it is first asked for."""

    def __init__(self):
        self._run = eqx.filter_jit(lambda *given: VirtualLab.run(*given), **CHEAP)
        self._plain = _lab((CONFINED, OEDOMETER, UNCONFINED))
        self._altered = _lab((CONFINED, UNCONFINED), [effect(0.0) for effect in EFFECTS.values()])

    def tests(self, shift: float = 0.0) -> Found:
        outcome = self._run(self._plain, packing(shift), SoilParameters())
        return {"confined, oedometer, unconfined": outcome_numbers(outcome)}

    def effects(self, shift: float = 0.0, names=tuple(EFFECTS)) -> Found:
        return {f"effect: {name}": self._effect(name, shift) for name in names}

    def _effect(self, name: str, shift: float) -> Numbers:
        strength = SHARES.get(name, 1.0) * EFFECTS[name].about.typical[-1]
        given = [strength if each == name else 0.0 for each in EFFECTS]
        effects = with_strengths(self._altered.effects, given)
        lab = eqx.tree_at(lambda lab: lab.effects, self._altered, effects)
        return outcome_numbers(self._run(lab, packing(shift), SoilParameters()))


def _lab(apparatus, effects=()) -> VirtualLab:
    return VirtualLab.of(SMALL, TestSequence(tuple(apparatus)), NUMERICS, effects)


def bare() -> Found:
    """The machine without soil, with all its errors."""
    names = ("load_frame_compliance", "load_cell_gain", "load_cell_drift", "acquisition_lag")
    errors = tuple(EFFECTS[name](EFFECTS[name].about.typical[-1]) for name in names)
    found = BareMachine(TestSequence((PlatenOnBase(),)), errors).run()["machine"]
    observed = {name: [float(value)] for name, value in found.observables.items()}
    return {"machine without soil": {**observed, "curve": curve_numbers(found.curve)}}


# ------------------------------------------------------------------ beds

SETTLED = Specimen(diameter=0.02, height=0.02, count=4, spread=0.05)
GROWN = Specimen(diameter=0.02, height=0.02, count=6, spread=0.05, porosity=0.5)
SEED = 1


@contextmanager
def cheaply_compiled():
    """Both preparations with one program that is compiled without optimisation."""
    found = settling._program, growth._program
    advance = eqx.filter_jit(lambda *given: run_loop(*given), **CHEAP)
    settling._program = growth._program = lambda: advance
    try:
        yield
    finally:
        settling._program, growth._program = found


def rougher(soil: SoilParameters, shift: float) -> SoilParameters:
    return replace(soil, static_friction=soil.static_friction * (1 + shift))


def beds(shift: float = 0.0) -> Found:
    """A settled and a grown bed; `shift` is of the friction."""
    with cheaply_compiled():
        ways = {
            "settled bed": settling.settled(SETTLED, SEED, rougher(settling.neutral_soil(), shift)),
            "grown bed": growth.grown(GROWN, SEED, rougher(growth.holding_soil(), shift)),
        }
    return {
        name: {
            "centres": np.ravel(bed.position.stack()).tolist(),
            "masses": np.asarray(bed.spheres.mass).tolist(),
            "height": [float(bed.height)],
        }
        for name, bed in ways.items()
    }


# ------------------------------------------------------------------ slopes


def slopes() -> Found:
    """The depression depth and its slopes by JAX, in the first test alone."""
    strategy, soil, bed = Overdamped(), SoilParameters(), packing()
    lab = strategy.laboratory(_lab((CONFINED,)))

    def simulated(lab: VirtualLab, shift: jax.Array) -> Outcome:
        return lab.run(bed, replace(soil, shear_modulus=soil.shear_modulus * jnp.exp(shift[0])))

    def read(outcome: Outcome) -> jax.Array:
        return outcome.observables["confined"]["depression_depth"][None]

    differentiated = eqx.filter_jit(strategy.traced, **CHEAP)
    found = differentiated(lab, simulated, read, jnp.zeros(1))
    return {"slope": {"depth": found.values.tolist(), "slope": np.ravel(found.slopes).tolist()}}


# ------------------------------------------------------------------ what is kept

laboratory = cache(Laboratory)
MAKERS: dict[str, tuple[str, Callable[[], Found]]] = {  # the version that numbers are of
    "contacts": ("PHYSICS", contacts),
    "tests": ("PHYSICS", lambda: laboratory().tests()),
    "effects": ("PHYSICS", lambda: laboratory().effects()),
    "machine": ("PHYSICS", bare),
    "beds": ("PREPARATION", beds),
    "slopes": ("DERIVATIVES", slopes),
}


def difference(found: Numbers, kept: Numbers) -> float:
    """The largest, over the largest number of its kind; infinite where kinds differ."""
    if {k: len(v) for k, v in found.items()} != {k: len(v) for k, v in kept.items()}:
        return np.inf
    pairs = [(np.array(found[name]), np.array(kept[name])) for name in kept]
    return max(float(np.max(np.abs(a - b)) / (np.max(np.abs(b)) or 1.0)) for a, b in pairs)


def changed(found: Found, kept: Found) -> list[str]:
    """The runs whose numbers are not those that are kept; they have to be kept."""
    return [name for name in found if difference(found[name], kept.get(name, {})) > TOLERANCE]


@cache
def stored() -> dict:
    return json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.exists() else {}


def kept(version: str) -> Found:
    return stored().get(version, {}).get("runs", {})


def written(version: str, found: Found) -> dict:
    """What is to be kept of a version; exits where numbers changed under it."""
    number, before = getattr(physics, version), kept(version)
    different = changed({name: run for name, run in found.items() if name in before}, before)
    if different and stored()[version]["version"] == number:
        sys.exit(f"{CHANGED} ({version} is {number}: {', '.join(different)})")
    same = {name: before[name] for name in found if name in before and name not in different}
    return {"version": number, "runs": {**found, **same}}


def write() -> None:
    """Writes all numbers."""
    content = {}
    for version in ("PHYSICS", "PREPARATION", "DERIVATIVES"):
        makers = [make for belongs, make in MAKERS.values() if belongs == version]
        found = {name: run for make in makers for name, run in make().items()}
        content[version] = written(version, found)
    if raised(content, "PREPARATION") and not raised(content, "PHYSICS"):
        sys.exit("PREPARATION was raised: raise PHYSICS as well")
    write_text(KEPT, as_lines(content))


def raised(content: dict, version: str) -> bool:
    before = stored().get(version, content[version])
    return content[version]["version"] > before["version"]


def as_lines(content: dict) -> str:
    """JSON with a run in a line."""
    parts = []
    for version, part in content.items():
        runs = ",\n".join(f"{json.dumps(k)}: {json.dumps(v)}" for k, v in part["runs"].items())
        parts.append(f'"{version}": {{"version": {part["version"]}, "runs": {{\n{runs}\n}}}}')
    return "{" + ",\n".join(parts) + "}\n"


# ------------------------------------------------------------------ numbers


SLOW_ONES = {"beds", "slopes"}
every_maker = pytest.mark.parametrize(
    "what",
    [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW_ONES)) for name in MAKERS],
)


@every_maker
def test_numbers_are_those_of_the_version(what):
    version, make = MAKERS[what]
    different = changed(make(), kept(version))
    assert not different, f"{CHANGED} ({version}: {', '.join(different)})"


def test_what_is_kept_is_of_the_present_versions():
    numbers = {name: part["version"] for name, part in stored().items()}
    present = {name: getattr(physics, name) for name in numbers}
    assert numbers == present, "a version was raised: run `python -m tests.jdem.test_physics`"


def test_every_law_and_every_effect_has_its_numbers():
    used = [law_of(name) for name in (*SOILS, *STATED)]
    assert {one.__name__ for one in laws_of_the_package()} <= set(keys.classes(*used))
    assert set(kept("PHYSICS")) >= {f"effect: {name}" for name in EFFECTS}


def laws_of_the_package() -> list[type]:
    names = [each.name for each in pkgutil.iter_modules(laws.__path__, "jdem.laws.")]
    parts = (AbstractContactLaw, AbstractNormalLaw, AbstractRollingLaw, AbstractTangentialLaw)
    every = [one for name in names for one in vars(importlib.import_module(name)).values()]
    return [
        one
        for one in every
        if isinstance(one, type) and issubclass(one, parts) and not inspect.isabstract(one)
    ]


@pytest.mark.slow
def test_round_off_does_not_grow_in_the_tests():
    """All spheres are moved by 1e-15 of their place; every number stays within 1e-10."""
    moved, runs = laboratory().tests(1e-15) | laboratory().effects(1e-15), kept("PHYSICS")
    assert max(difference(moved[name], runs[name]) for name in moved) < TOLERANCE / 10


@pytest.mark.slow
def test_round_off_does_not_grow_in_beds():
    moved, runs = beds(1e-15), kept("PREPARATION")
    assert max(difference(moved[name], runs[name]) for name in moved) < TOLERANCE / 10


# ------------------------------------------------------------------ a change is seen

MORE = 1 + 1e-6


def by_more(method, than=None):
    """The method with results that are larger by 1e-6; with the number of an argument to which
    they are compared, with a larger difference from it."""

    def mutated(self, *given):
        found = method(self, *given)
        before = found if than is None else given[than]
        share = MORE if than is None else None

        def more(new, old):
            if not (eqx.is_inexact_array(new) or isinstance(new, float)):
                return new
            return new * share if share else jnp.where(new == old, new, new + 1e-6 * (new - old))

        return jax.tree.map(more, found, before)

    return mutated


LAWS_CHANGED = [
    (eepa.EEPA, "loading_stiffness", "eepa, eepa"),
    (eepa.EEPA, "_tension", "eepa, eepa"),
    (eepa.EEPA, "_pull_off", "eepa, slope exponent 1.5"),
    (hysteretic.HystereticSpring, "unloading_stiffness", "hysteretic, eepa"),
    (friction.CoulombSpring, "force", "eepa, eepa"),
    (friction.ConstantTorque, "limit", "eepa, eepa"),
    (liggghts.LudingSpring, "force", "eepa, liggghts"),
    (liggghts.RollingSpring, "moment", "eepa, liggghts_history"),
    (liggghts.WholeLoad, "force", "eepa, liggghts"),
    (hertz_mindlin.Hertz, "force", "hertz_mindlin"),
    (hertz_mindlin.LinearCohesion, "force", "hertz_cohesion"),
    (hertz_mindlin.MindlinSpring, "force", "hertz_mindlin"),
    (jkr.JKRStiffness, "tear_off_radius", "jkr"),
    (jkr.JKR, "_dashpot", "jkr"),
    (bond.ParallelBond, "_push", "parallel_bond"),
    (bond.ParallelBond, "_moment", "parallel_bond"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("law", "method", "case"), LAWS_CHANGED)
def test_a_small_change_of_a_law_is_seen(law, method, case, monkeypatch):
    monkeypatch.setattr(law, method, by_more(law.__dict__[method]))
    found = {f"contact: {case}": contact_numbers(case)}
    assert changed(found, kept("PHYSICS")) == list(found)


HOOKS = {"force_error": None, "servo_error": None, "travel_error": None}  # 0 without an effect
HOOKS |= {"soil": 0, "packing": 0, "programme": 0}  # what it was without an effect


@pytest.mark.slow
def test_a_small_change_of_each_effect_is_seen(monkeypatch):
    """All at once, as one program serves them all; at strength 0 each changes nothing."""
    for effect in EFFECTS.values():
        for hook in set(HOOKS) & set(vars(effect)):
            mutated = by_more(vars(effect)[hook], HOOKS[hook])
            monkeypatch.setattr(effect, hook, mutated)
    for module, constant in ((capillary, "DECAY"), (cementation, "STRAIN")):
        monkeypatch.setattr(module, constant, getattr(module, constant) * MORE)
    found = Laboratory().effects()
    assert changed(found, kept("PHYSICS")) == list(found)


@pytest.mark.slow
def test_a_small_change_of_the_time_step_s_physics_is_seen(monkeypatch):
    monkeypatch.setattr(step, "LOADED", step.LOADED * MORE)
    assert changed(Laboratory().tests(), kept("PHYSICS"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "constant", "bed"),
    [(settling, "SOFT", "settled bed"), (growth, "SPARSE", "grown bed")],
)
def test_a_small_change_of_how_beds_are_made_is_seen(module, constant, bed, monkeypatch):
    monkeypatch.setattr(module, constant, getattr(module, constant) * MORE)
    assert changed(beds(), kept("PREPARATION")) == [bed]


def test_numbers_that_changed_are_not_written_under_the_same_version(monkeypatch):
    before = kept("PREPARATION")
    other = {name: {**run, "height": [1.0]} for name, run in before.items()}
    with pytest.raises(SystemExit, match=f"^{CHANGED}"):
        written("PREPARATION", other)
    assert written("PREPARATION", before)["runs"] == before
    monkeypatch.setattr(physics, "PREPARATION", physics.PREPARATION + 1)
    assert written("PREPARATION", other) == {"version": physics.PREPARATION, "runs": other}


# ------------------------------------------------------------------ results


def test_results_name_the_physics():
    assert jdem.PHYSICS == physics.PHYSICS == made_by()["physics"]


def test_results_from_before_the_versions_are_read():
    from studies import reporting  # not there where this file runs as a script

    made = {"command": "calibrate fit", "soil": "s", "preset": "quick", "versions": {}}
    assert record(Origin, {**made, "engine": "0123"}).physics == 0
    assert record(Origin, {**made, "physics": 3}).physics == 3
    files = ({"physics": 3}, {"engine": reporting.FIRST}, {"engine": "0123"})
    assert [reporting.physics_of(one) for one in files] == ["3", "1", "before 1, engine 0123"]


# ------------------------------------------------------------------ names of beds and runs


def test_classes_inside_a_laboratory_count():
    def lab(*effects, tests=(CONFINED,)):
        return VirtualLab.of(SPECIMEN, TestSequence(tests), Numerics(), effects)

    effects = [EFFECTS[name](0.0) for name in ("cementation", "rate_dependence")]
    labs = [lab(*chosen) for chosen in ([], effects[:1], effects[1:], effects)]
    found = [tuple(keys.classes(one)) for one in (*labs, lab(tests=(CONFINED, UNCONFINED)))]
    assert len(set(found)) == 5
    soils_of = [soil_of("eepa", "eepa"), soil_of("hysteretic", "eepa"), soil_of("eepa", "liggghts")]
    assert len({tuple(keys.classes(one)) for one in soils_of}) == 3


def test_objects_of_all_kinds_are_looked_into():
    def names(root):
        return {name.split()[0].split(".")[-1] for name in keys.classes(root)}

    assert names({"a": [Laboratory, (1.0, "b")]}) == {"Laboratory"}
    assert names(partial(names, SPECIMEN)) >= {"Specimen"}
    assert names(np.sin) == {"sin"}
    assert names((None, 1, np.ones(3))) == set()


def test_keys_of_runs_differ_by_soil_and_packing(tmp_path):
    work = toy_campaign(tmp_path)
    assert len({work.key(soil, seed) for soil in soils(2) for seed in (0, 1)}) == 4


def test_versions_name_runs_and_beds(tmp_path, monkeypatch):
    """A new physics simulates anew and keeps beds; a new preparation makes both anew."""
    work, (soil,) = toy_campaign(tmp_path), soils(1)

    def names():
        return work.key(soil, 0), work._packing_name(0)

    (run, bed) = names()
    monkeypatch.setattr(keys, "PHYSICS", physics.PHYSICS + 1)
    (later_run, same_bed) = names()
    assert later_run != run and same_bed == bed
    monkeypatch.setattr(keys, "PREPARATION", physics.PREPARATION + 1)
    assert len({run, later_run, names()[0]}) == 3 and names()[1] != bed


def test_a_class_of_one_s_own_counts_with_the_text_of_its_file(tmp_path, monkeypatch):
    file = tmp_path / "my_effect.py"
    file.write_text("class Mine:\n    strength = 1.0\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    mine = importlib.import_module("my_effect").Mine
    before = keys.classes(mine)
    file.write_text("class Mine:\n    strength = 2.0\n", encoding="utf-8")
    assert keys.classes(mine) != before
    assert keys.classes(UnconfinedCompression) == ["UnconfinedCompression"]
    typed = type("Typed", (), {"__module__": "__notebook__"})
    assert keys.classes(typed) == ["__notebook__.Typed "]


if __name__ == "__main__":
    plain = argparse.RawDescriptionHelpFormatter
    argparse.ArgumentParser(description=__doc__, formatter_class=plain).parse_args()
    write()
