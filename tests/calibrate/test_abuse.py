"""Abuse: files from anywhere, parameters from the edge of what is allowed, disks that refuse.

Whatever is brought in: one line and exit status 2, or a result; never a traceback, never a
file outside the output folder, and a failed simulation names what failed.
"""

import ast
import errno
import json
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from calibrate.core import kept
from calibrate.core.errors import InputError
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.io.labfile import PARAMETER_RANGES
from calibrate.io.soil import with_values
from calibrate.simulation import session
from calibrate.simulation.resolution import specimen, virtual_lab
from calibrate.simulation.run import _bad_numerics
from jdem.apparatus.pair import SpherePair, drive_overlap, overlap_path
from jdem.core.smooth import Smoothing
from jdem.core.vector import Vector
from jdem.engine.segment import CELL
from jdem.laboratory.virtual_lab import Outcome, VirtualLab
from jdem.materials.conventions import liggghts
from jdem.materials.soil import SoilParameters, particle_law
from tests import ROOT
from tests.support import malformed
from tests.support.formulas import BASE, TINY, tiny_campaign, tiny_lab
from tests.support.toy_library import library
from tests.support.toy_place import Toy

pytestmark = pytest.mark.thorough

# ------------------------------------------------------------------ laws

RADIUS, MOST, POINTS = 2.5e-3, 3e-5, 60
WIDEST = {  # from the smallest to the largest value that anybody may mean
    "restitution": (1e-3, 0.999),
    "static_friction": (0.0, 10.0),
    "rolling_friction": (0.0, 10.0),
    "surface_energy": (0.0, 1e6),
    "plasticity_ratio": (1e-6, 1 - 1e-6),
    "tensile_exponent": (0.5, 5.0),
    "tangential_multiplier": (1e-3, 10.0),
    "shear_modulus": (1e3, 1e11),
    "pull_off_force": (-10.0, 0.0),
}
accepted_soils = st.fixed_dictionaries(
    {name: st.floats(low, high) for name, (low, high) in WIDEST.items()}
)
# To a femtometre: overlaps far below an atom's size underflow in squares and mean nothing.
turning_points = st.lists(
    st.floats(-MOST, MOST).map(lambda overlap: round(overlap, 15)), min_size=4, max_size=4
)


@eqx.filter_jit
def forces_along(soil, turns):
    overlaps = overlap_path(turns, POINTS)
    law = particle_law(soil, 2 * RADIUS, Smoothing())
    return overlaps, drive_overlap(law, SpherePair(RADIUS), overlaps)


@eqx.filter_jit
def slopes_along(soil, turns):
    return eqx.filter_jacfwd(lambda s: forces_along(s, turns)[1])(soil)


@pytest.mark.parametrize("exponent", [1.0, 1.5])
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(values=accepted_soils, turns=turning_points)
@example(values={name: low for name, (low, _) in WIDEST.items()}, turns=[MOST, 0.0, MOST, -MOST])
@example(values={name: high for name, (_, high) in WIDEST.items()}, turns=[MOST, 0.0, MOST, -MOST])
def test_every_accepted_soil_gives_finite_forces_and_slopes(exponent, values, turns):
    """On any path; without overlap no force; never more than virgin loading pushes."""
    assert all(PARAMETER_RANGES[name][0](value) for name, value in values.items())
    soil = SoilParameters(**values, reference_diameter=2 * RADIUS, slope_exponent=exponent)
    overlaps, force = forces_along(soil, jnp.asarray(turns))
    assert np.isfinite(force).all()
    assert (np.asarray(force)[np.asarray(overlaps) < 0] == 0).all()
    slopes = jax.tree.leaves(slopes_along(soil, jnp.asarray(turns)))
    assert all(np.isfinite(slope).all() for slope in slopes)


# ------------------------------------------------------------------ readers


@pytest.mark.parametrize("kind", malformed.KINDS)
def test_accidents_to_files_are_refused_in_one_line(kind, tmp_path):
    counts, _ = malformed.fuzzed(kind, 25, seed=100, strange=tmp_path)
    assert counts["refused"] == 25
    assert not counts["strange"], next(tmp_path.glob("*.txt")).read_text()


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(content=st.one_of(st.binary(max_size=300), st.text(max_size=300).map(str.encode)))
@example(content=b"\xef\xbb\xbf")
@example(content=b'[soil]\nname = "x"\n' * 2)
@example(content=b"a = " + b"[" * 5000)
def test_no_content_of_a_lab_file_or_curve_is_too_strange(tmp_path, content):
    """Any bytes at all."""
    (tmp_path / "lab.toml").write_bytes(content)
    with pytest.raises(InputError):
        load_lab(tmp_path / "lab.toml")
    (tmp_path / "lab.toml").write_bytes(malformed.GOOD["lab.toml"])
    (tmp_path / "confined.csv").write_bytes(content)
    (tmp_path / "unconfined.csv").write_bytes(malformed.GOOD["unconfined.csv"])
    with pytest.raises(InputError):
        load_lab(tmp_path / "lab.toml")


# ------------------------------------------------------------------ the command line


@pytest.fixture
def simulated(calibrate, monkeypatch, tmp_path):
    """Runs a command line in tmp_path/here on formulas; exit status and standard error."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setattr(session, "HERE", Toy(tmp_path / "here" / "notes"))
    return lambda *arguments: calibrate(*arguments)[::2]


EVIL = [
    "../../evil",
    "{elsewhere}/evil",
    "..\\\\evil",
    "a\\u0000b",
    "x" * 900,
    "<script>",
    "$(touch evil)",
]


@pytest.mark.parametrize("name", EVIL)
def test_names_in_a_lab_file_write_nothing_outside_the_output_folder(simulated, tmp_path, name):
    """Of the soil, of its source, and of a set of parameters."""
    name = name.format(elsewhere=tmp_path)
    text = bundled_lab().read_text(encoding="utf-8")
    text = text.replace("wheat after rice, Lishui, Jiangsu", name)
    text = text.replace("named_sets.paper_optimum", f'named_sets."{name}"')
    Path("lab.toml").write_text(text, encoding="utf-8")
    status, _ = simulated("simulate", "lab.toml", "--out", "out", "--json", "j/result.json")
    assert status == 0
    written = {path.relative_to(tmp_path).parts[:2] for path in tmp_path.rglob("*")}
    allowed = {"lab.toml", "notes", "out", "j"}
    assert written == {("here",), *(("here", inside) for inside in allowed)}
    assert json.loads(Path("j/result.json").read_text())["observables"]


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS, errno.EIO])
def test_a_disk_that_refuses_a_result_is_one_line(simulated, monkeypatch, code):
    def refuse(*_, **__):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(Path, "write_text", refuse)
    status, error = simulated("simulate", "--out", "out")
    last = error.splitlines()[-1]
    assert status == 1 and "Traceback" not in error
    assert os.strerror(code) in last and "goes on from here" in last
    assert not list(Path("out").rglob("*.part"))


# ------------------------------------------------------------------ simulations that go wrong


@pytest.mark.slow
def test_a_contact_list_that_is_too_small_is_named(tmp_path):
    """Even the larger ones of the second attempt hold only a tenth of the contacts."""
    lab, cylinder = tiny_lab(), specimen(tiny_lab(), TINY)
    small = replace(virtual_lab(lab, TINY).numerics, pairs_per_sphere=0.2)
    work = tiny_campaign(tmp_path)
    work.lab, work.specimen = virtual_lab(lab, TINY, small), cylinder
    run = work.runs([BASE], [0], "small lists")[0][0]
    assert "a contact list was too small: pairs: have" in run.failure
    assert run.quality["overflow"] == 1.0


@pytest.mark.parametrize("width", [None, 0.02])
def test_spheres_that_outrun_their_lists_may_have_been_pressed_through_a_tool(width):
    """Seen under a cone: a sphere's centre crossed the surface, and it left at 15 m/s."""
    record = SimpleNamespace(
        demand=SimpleNamespace(exceeds=lambda grid: False),
        state=SimpleNamespace(
            motion=SimpleNamespace(position=Vector.from_rows(jnp.zeros((2, 3)))),
            energy=SimpleNamespace(platen=1.0, integration=1e-3, boundaries=np.ones(CELL)),
        ),
        overflow_of=lambda grid: True,
        explain_overflow=lambda grid: "motion between rebuilds (m): have 1, need 2",
    )
    tests = SimpleNamespace(apparatus=(SimpleNamespace(width=width),))
    lab, outcome = SimpleNamespace(grid=None, tests=tests), SimpleNamespace(record=record)
    said = _bad_numerics(cast(VirtualLab, lab), cast(Outcome, outcome))
    assert said.startswith("spheres outran their contact lists: motion between rebuilds")
    assert ("pressed through a tool's surface" in said) == (width is not None)


@pytest.mark.slow
def test_a_time_step_that_is_too_large_is_named(tmp_path):
    """At three times the usual one every number is finite, and wrong."""
    work = tiny_campaign(tmp_path)
    work.lab = virtual_lab(tiny_lab(), TINY, replace(work.lab.numerics, safety=0.9))
    run = work.runs([BASE], [0], "large steps")[0][0]
    assert "the time step is too large" in run.failure
    assert np.isfinite(list(run.observables.values())).all()


@pytest.mark.slow
def test_a_parameter_that_is_no_number_is_named(tmp_path):
    work = tiny_campaign(tmp_path)
    soil = eqx.tree_at(lambda s: s.surface_energy, BASE, jnp.asarray(np.nan))
    healthy = with_values(BASE, {"surface_energy": 12.0})
    (bad,), (good,) = work.runs([soil, healthy], [0], "one of two")
    assert "surface_energy of the soil is not finite" in bad.failure
    assert good.failure == ""


# ------------------------------------------------------------------ nothing that users bring is run

FORBIDDEN_MODULES = {"pickle", "cloudpickle", "dill", "marshal", "shelve", "joblib", "runpy"}
FORBIDDEN_CALLS = {"eval", "exec", "compile", "__import__"}
FORBIDDEN_METHODS = {"system", "popen", "read_pickle", "to_pickle", "eval", "extractall"}
FORBIDDEN_OPTIONS = {"allow_pickle", "shell"}


def offences(source: str) -> Iterator[str]:
    """What in a file could run code, or read pickles, that users bring."""
    for node in ast.walk(ast.parse(source)):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        yield from (name for name in names if name.split(".")[0] in FORBIDDEN_MODULES)
        if not isinstance(node, ast.Call):
            continue
        if isinstance(node.func, ast.Name) and node.func.id in FORBIDDEN_CALLS:
            yield node.func.id
        if isinstance(node.func, ast.Attribute) and node.func.attr in FORBIDDEN_METHODS:
            yield node.func.attr
        for keyword in node.keywords:
            off = isinstance(keyword.value, ast.Constant) and keyword.value.value is False
            if keyword.arg in FORBIDDEN_OPTIONS and not off:
                yield keyword.arg


def test_nothing_that_users_bring_is_unpickled_or_evaluated():
    files = [path for name in ("jdem", "calibrate") for path in (ROOT / name).rglob("*.py")]
    found = [(path, list(offences(path.read_text(encoding="utf-8")))) for path in files]
    assert len(found) > 80
    assert [entry for entry in found if entry[1]] == []


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "from dill import load",
        "eval('1')",
        "os.system('x')",
        "np.load(f, allow_pickle=True)",
        "subprocess.run(c, shell=yes)",
        "pd.eval(x)",
        "__import__(name)",
    ],
)
def test_the_rule_catches(source):
    assert len(list(offences(source))) == 1


def test_the_rule_lets_pass():
    assert not list(offences("np.load(f, allow_pickle=False)\njax.eval_shape(f)\nre.compile(x)"))


# ---------------------------------------------------------------- what is kept between starts


@pytest.fixture
def cache(tmp_path):
    """An empty folder of compiled and kept programs."""
    name = "jax_compilation_cache_dir"
    before = getattr(jax.config, name)
    jax.config.update(name, str(tmp_path))
    yield tmp_path
    jax.config.update(name, before)


def spoil(file: Path) -> None:
    """Another last byte."""
    data = file.read_bytes()
    file.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))


@pytest.mark.parametrize("spoilt", [lambda file: None, spoil, lambda file: file.write_bytes(b"")])
def test_a_program_is_traced_at_the_first_start_and_where_its_file_is_spoilt(cache, spoilt):
    pytest.importorskip(kept.FORMAT)
    traced = []

    def squares(tree, power):
        traced.append(power)
        return tree["x"] ** power, tree["y"]

    given = {"x": np.arange(3.0), "y": np.ones(2)}
    first = kept.kept(squares)(given, 2)
    assert traced == [2] and np.asarray(first[0]).tolist() == [0.0, 1.0, 4.0]
    (file,) = cache.glob("kept-program-*")
    whole = file.read_bytes()
    spoilt(file)
    intact = file.read_bytes() == whole
    again = kept.kept(squares)(given, 2)
    assert traced == ([2] if intact else [2, 2])
    assert kept.kept(squares)(given, 2) and len(traced) == (1 if intact else 2)  # mended
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert np.asarray(kept.kept(squares)(given, 3)[0]).tolist() == [0.0, 1.0, 8.0]
    assert kept.kept(squares)({**given, "x": np.arange(2.0)}, 2)[0].shape == (2,)
    assert len(list(cache.glob("kept-program-*"))) == 3  # one for each power and shape


def test_a_program_with_a_law_is_kept_and_one_with_a_local_function_is_not(cache):
    pytest.importorskip(kept.FORMAT)
    soil, stiffer = SoilParameters(), SoilParameters(shear_modulus=9e6)
    doubled = kept.kept(lambda soil: 2 * soil.shear_modulus)
    assert [float(doubled(each)) for each in (soil, stiffer)] == [1.4e7, 1.8e7]
    assert len(list(cache.glob("kept-program-*"))) == 1
    assert float(doubled(SoilParameters(conventions=liggghts))) == 1.4e7
    assert len(list(cache.glob("kept-program-*"))) == 2  # one for each law
    local = SoilParameters(conventions=lambda parts: liggghts(parts))
    assert float(doubled(local)) == 1.4e7
    assert len(list(cache.glob("kept-program-*"))) == 2


def test_arrays_are_worked_out_again_where_their_file_is_spoilt_or_inputs_differ(cache):
    made = []

    def doubled(of: float) -> np.ndarray:
        return kept.arrays(
            "doubled", [np.array(of)], lambda: made.append(of) or 2 * np.ones(2) * of
        )

    assert doubled(1.0).tolist() == doubled(1.0).tolist() == [2.0, 2.0] and made == [1.0]
    spoil(next(cache.glob("kept-doubled-*")))
    assert doubled(1.0).tolist() == [2.0, 2.0] and made == [1.0, 1.0]
    assert doubled(3.0).tolist() == [6.0, 6.0] and made == [1.0, 1.0, 3.0]
    jax.config.update("jax_compilation_cache_dir", str(cache / "file"))
    (cache / "file").write_text("no folder")
    assert doubled(1.0).tolist() == [2.0, 2.0]  # nothing can be kept there


def test_the_oldest_arrays_go_where_those_of_one_kind_need_too_much_room(cache, monkeypatch):
    monkeypatch.setattr(kept, "ROOM", 2500)
    made = []

    def large(of: float) -> np.ndarray:
        return kept.arrays("large", [np.array(of)], lambda: made.append(of) or np.ones(100) * of)

    for number in range(3):  # of some 960 bytes each
        for file in cache.glob("kept-large-*"):
            os.utime(file, times=2 * (file.stat().st_mtime - 60,))
        large(number)
    assert len(list(cache.glob("kept-large-*"))) == 2
    assert large(2).tolist() == [2.0] * 100 and made == [0, 1, 2]
    assert large(0).tolist() == [0.0] * 100 and made == [0, 1, 2, 0]


def test_weights_of_a_library_that_are_kept_are_those_that_are_worked_out(cache):
    first, kept_ones = (library().emulator(again=True) for _ in range(2))
    alone = library().emulator()
    assert len(list(cache.glob("kept-weights-*"))) == 1
    at = np.zeros(first.x.shape[1]), np.full(first.s.shape[1], 0.1)
    for one in (first, kept_ones):
        for part, known in zip(one.components, alone.components, strict=True):
            assert part.weights == pytest.approx(known.weights, rel=1e-12)
        assert one.variances(*at).tolist() == alone.variances(*at).tolist()
    assert list(cache.glob("kept-factor-*"))
