"""The command line: what goes in, what comes out, and one line for every mistake.

`calibrate.cli.main` runs in this process with its arguments patched in, which is what
the console script does; one test starts the real process.
"""

import json
import os
import subprocess
import sys
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path

import jax
import numpy as np
import pytest

from calibrate.io.lab import bundled_lab
from calibrate.simulation import resolution, session
from tests import DATA
from tests.support import pieces

REFERENCE = np.load(DATA / "contact_curves.npz")
CASE = json.loads(str(REFERENCE["eepa"]))["curves"]["c1_paper_opt"]
VERBS = ("simulate", "fit", "contact", "audit", "doe")


@pytest.fixture
def calibrate(command_line):
    """Runs a command line in tmp_path; JAX's settings are put back afterwards."""
    settings = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = {name: getattr(jax.config, name) for name in settings}
    yield command_line
    for name, value in before.items():
        jax.config.update(name, value)


def contact_arguments(**changes):
    """The reference case as a user would type it; turning points are a cumulative sum."""
    path = ",".join(f"{1e6 * point:.9g}" for point in np.cumsum(CASE["path"]))
    values = {
        "slope_exponent": CASE["n"],
        "tensile_exponent": CASE["x"],
        "plasticity_ratio": CASE["lam"],
        "surface_energy": CASE["gam"],
        **changes,
    }
    options = [part for k, v in values.items() for part in ("--set", f"{k}={v}")]
    size = ["--radius-mm", 1e3 * CASE["R"], "--young-mpa", 1e-6 * CASE["E"]]
    return ["contact", *options, *size, "--poisson", CASE["nu"], f"--path-um={path}"]


# ------------------------------------------------------------------ contact


def test_contact_draws_the_reference_curve(calibrate, tmp_path):
    """Every leg within 1e-3 of the largest force: 500 points a leg of at most 60 um are
    0.12 um apart, and linear interpolation of the adhesive branch (x = 2, largest second
    derivative 2 f_min/d_min^2) errs by a hundredth of that."""
    status, _, error = calibrate(*contact_arguments(), "--json", "out.json")
    assert (status, error) == (0, "")
    result = json.loads((tmp_path / "out.json").read_text())
    assert set(result) == {"overlap_m", "normal_force_n"}
    reference = REFERENCE["eepa/c1_paper_opt"]
    scale = np.abs(reference[:, 3]).max()
    overlap, force = (np.array([0.0, *result[key]]) for key in result)
    for leg in range(4):
        rows, ours = reference[reference[:, 0] == leg], slice(500 * leg, 500 * leg + 501)
        order = np.argsort(overlap[ours])
        drawn = np.interp(rows[:, 2], overlap[ours][order], force[ours][order])
        assert np.abs(drawn - rows[:, 3]).max() < 1e-3 * scale, leg


def test_contact_takes_units_and_keeps_its_files(calibrate, tmp_path):
    calibrate(*contact_arguments(), "--json", "plain.json")
    with_unit = contact_arguments(surface_energy=f"{1e3 * CASE['gam']} mJ/m^2")
    status, out, _ = calibrate(*with_unit, "--json", "deep/unit.json", "--out", "here")
    assert status == 0
    assert "largest force" in out
    plain, unit = (json.loads((tmp_path / n).read_text()) for n in ("plain.json", "deep/unit.json"))
    np.testing.assert_allclose(plain["normal_force_n"], unit["normal_force_n"], rtol=1e-12)
    assert (tmp_path / "here" / "contact.png").stat().st_size > 1000
    assert json.loads((tmp_path / "here" / "contact.json").read_text()) == unit


def test_rounding_of_the_law_is_optional(calibrate, tmp_path):
    calibrate(*contact_arguments(), "--json", "sharp.json")
    calibrate(*contact_arguments(), "--smooth", "--json", "smooth.json")
    sharp, smooth = (
        np.array(json.loads((tmp_path / f"{name}.json").read_text())["normal_force_n"])
        for name in ("sharp", "smooth")
    )
    # As in test_reference_curves: the roundings stay within two per cent.
    assert 0 < np.abs(sharp - smooth).max() < 0.02 * np.abs(sharp).max()


def test_contact_follows_a_path_by_any_law(calibrate, tmp_path):
    """On a wall: Hertz along the normal, and friction's limit along the path."""
    (tmp_path / "p.csv").write_text("x_um,z_um,wy\n0,1,0\n0,-10,0\n90,-10,0\n")
    law = ["--law", "hertz_mindlin", "--set", "static_friction=0.5", "--wall"]
    status, out, _ = calibrate("contact", *law, "--path", "p.csv", "--out", "o")
    assert status == 0 and out.endswith("contact.json, contact.csv and contact.png are in o\n")
    load = 4 / 3 * 5e6 / (2 * (1 - 0.09)) * 2.5e-3**0.5 * 1e-5**1.5
    found = json.loads((tmp_path / "o" / "contact.json").read_text())
    assert found["normal_force_n"] == pytest.approx([0, load, load])
    assert found["tangential_force_n"] == pytest.approx([0, 0, -load / 2])
    table = np.genfromtxt(tmp_path / "o" / "contact.csv", delimiter=",", names=True)
    assert table["tx_nm"].max() == 0 < table["ty_nm"][2] == pytest.approx(2.49e-3 * load / 2)


# ------------------------------------------------------------------ wrong input

GOOD = bundled_lab().read_text()
CURVE = """
[[curves]]
test = "confined"
file = "c.csv"
displacement = { column = "x", unit = "mm" }
force = { column = "f", unit = "N" }
"""
ROWS = ["x,f", "0,0", "1,100", "2,200", "3,300", "4,400"]

LABS = {
    "unknown field": (GOOD.replace("[confined]", "[confined]\nspeed = 3"), "speed"),
    "unknown section": (GOOD + "\n[extra]\na = 1\n", "extra"),
    "wrong unit": (GOOD.replace('"8 mm/s"', '"8 mm"'), "confined.rate"),
    "no unit": (GOOD.replace('"8 mm/s"', '"8"'), "confined.rate"),
    "negative stiffness": (GOOD.replace('"7 MPa"', '"-7 MPa"'), "shear_modulus"),
    "plasticity ratio 1": (
        GOOD.replace("plasticity_ratio = 0.7", "plasticity_ratio = 1"),
        "plasticity_ratio",
    ),
    "unknown parameter": (GOOD.replace("restitution = 0.322", "bounce = 0.3", 1), "bounce"),
    "negative height": (GOOD.replace('"100 mm"', '"-100 mm"'), "specimen.height"),
    "no TOML": ("[soil\nname", "TOML"),
    "empty": ("", "soil"),
}
CURVES = {
    "empty curve": ("", "c.csv"),
    "header only": ("x,f\n", "c.csv"),
    "NaN in a curve": ("\n".join([*ROWS, "5,nan", "6,600"]), "c.csv"),
    "a word in a curve": ("\n".join([*ROWS, "5,five", "6,600"]), "c.csv"),
    "missing column": ("\n".join([*ROWS, "5,500"]).replace("f", "g"), "c.csv"),
    "curve that stops short": ("\n".join([*ROWS[:-1], "4,301", "5,302", "6,303"]), "c.csv"),
}
OPTIONS = {
    "--set without '='": (["--set", "restitution"], "--set restitution"),
    "--set of an unknown name": (["--set", "bounce=1"], "bounce"),
    "--set without a number": (["--set", "restitution=often"], "restitution"),
    "--set out of range": (["--set", "plasticity_ratio=1"], "plasticity_ratio"),
    "--set not finite": (["--set", "surface_energy=nan"], "surface_energy"),
    "--set with a wrong unit": (["--set", "shear_modulus=3 N"], "shear_modulus"),
    "unknown --preset": (["--preset", "rapid"], "--preset"),
    "unknown option": (["--colour", "red"], "--colour"),
    "negative --seed": (["--seed", "-1"], "--seed"),
    "--seed that is no number": (["--seed", "x"], "--seed"),
    "missing lab file": (["nowhere.toml"], "nowhere.toml"),
    "folder as lab file": (["."], "folder"),
}
FREE = {
    "unknown --free": (["--free", "colour"], "colour"),
    "empty --free": (["--free", ","], "--free"),
    "--free twice": (["--free", "restitution,restitution"], "--free"),
}
JKR = ["--path-um", "9", "--law", "jkr"]
PATHS = {
    "words": (["--path-um", "deep"], "--path-um"),
    "nothing": (["--path-um", ""], "--path-um"),
    "not finite": (["--path-um", "10,nan"], "--path-um"),
    "missing": ([], "--path-um"),
    "negative radius": (["--path-um", "9", "--radius-mm", "-1"], "--radius-mm"),
    "no modulus": (["--path-um", "9", "--young-mpa", "0"], "--young-mpa"),
    "incompressible": (["--path-um", "9", "--poisson", "0.5"], "--poisson"),
    "both paths": (["--path-um", "9", "--path", "p.csv"], "--path-um"),
    "no such file": (["--path", "q.csv"], "q.csv"),
    "a column lacks": (["--path", "lacks.csv"], "x_um"),
    "too deep": (["--path", "p.csv", "--radius-mm", "0.004"], "not below the radius"),
    "unknown law": (["--path-um", "9", "--law", "jkl"], "did you mean 'jkr'?"),
    "no parameters": (JKR, "needs gamma and static_friction"),
    "no parameter of it": ([*JKR, "--set", "gama=1"], "did you mean 'gamma'?"),
    "no such memory": ([*JKR, "--set", "memory=forces"], "did you mean 'force'?"),
    "held": ([*JKR[:3], "liggghts", "--set", "tensile_exponent=2"], "tensile_exponent"),
}


def refused(answer, words):
    """Status 2, one line on standard error that names the culprit, and nothing else."""
    status, _, error = answer
    assert status == 2, answer
    assert error.count("\n") == 1 and error.endswith("\n"), error
    assert "Traceback" not in error
    assert words in error


@pytest.mark.parametrize("verb", ["simulate", "fit", "audit", "doe"])
@pytest.mark.parametrize("case", LABS)
def test_a_wrong_lab_file_is_refused(calibrate, tmp_path, verb, case):
    text, words = LABS[case]
    (tmp_path / "lab.toml").write_text(text)
    refused(calibrate(verb, "lab.toml"), words)
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize("case", CURVES)
def test_a_wrong_curve_is_refused(calibrate, tmp_path, case):
    text, words = CURVES[case]
    (tmp_path / "lab.toml").write_text(GOOD + CURVE)
    (tmp_path / "c.csv").write_text(text)
    refused(calibrate("fit", "lab.toml"), words)


def test_a_missing_curve_is_refused(calibrate, tmp_path):
    (tmp_path / "lab.toml").write_text(GOOD + CURVE)
    refused(calibrate("simulate", "lab.toml"), "c.csv")


@pytest.mark.parametrize("verb", ["simulate", "fit", "audit", "doe"])
@pytest.mark.parametrize("case", OPTIONS)
def test_a_wrong_option_is_refused(calibrate, verb, case):
    options, words = OPTIONS[case]
    refused(calibrate(verb, *options), words)


@pytest.mark.parametrize("case", FREE)
def test_wrong_free_parameters_are_refused(calibrate, case):
    options, words = FREE[case]
    refused(calibrate("fit", *options), words)


def test_an_unknown_strategy_is_refused(calibrate):
    refused(calibrate("audit", "--strategy", "pathwize"), "pathwise")


@pytest.mark.parametrize("case", PATHS)
def test_a_wrong_contact_is_refused(calibrate, tmp_path, case):
    options, words = PATHS[case]
    (tmp_path / "p.csv").write_text("z_um,x_um\n0,0\n-10,0\n")
    (tmp_path / "lacks.csv").write_text("z_um\n0\n")
    refused(calibrate("contact", *options), words)


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("place", ["file", "file/below", "/proc/nowhere"])
def test_a_folder_that_cannot_be_written_is_refused(calibrate, tmp_path, verb, place):
    (tmp_path / "file").write_text("in the way")
    path = ["--path-um", "5"] if verb == "contact" else []
    refused(calibrate(verb, *path, "--out", place), "--out")


@pytest.mark.parametrize("place", ["file/x.json", "/proc/x.json", "folder"])
def test_json_that_cannot_be_written_is_refused(calibrate, tmp_path, place):
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "folder").mkdir()
    refused(calibrate("contact", "--path-um", "5", "--json", place), "--json")


def test_an_unknown_verb_is_refused(calibrate):
    refused(calibrate("calibrat"), "calibrat")


def test_an_interrupted_command_says_how_to_go_on(calibrate, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("calibrate.simulation.specimens.simulate", interrupted)
    status, _, error = calibrate("simulate")
    assert (status, error.count("\n")) == (1, 1)
    assert "goes on from here" in error


# ------------------------------------------------------------------ help, and the real process


@pytest.mark.parametrize("verb", VERBS)
def test_help_lists_the_options_of_the_contract(calibrate, verb):
    status, out, error = calibrate(verb, "--help")
    assert (status, error) == (0, "")
    simulates = ("--seed", "--preset") if verb != "contact" else ("--path-um", "--radius-mm")
    for option in ("--json", "--out", "--set", *simulates):
        assert option in out


def test_help_names_the_verbs(calibrate):
    status, out, _ = calibrate("--help")
    assert status == 0
    assert all(verb in out for verb in VERBS)


@pytest.mark.parametrize(
    ("program", "wrong"),
    [([sys.executable, "-m", "calibrate"], ["contact", "--path-um", "x"]), (["calibrate"], ["x"])],
)
def test_the_process_has_the_exit_status(tmp_path, program, wrong):
    folder = Path(sys.executable).parent
    environment = {**os.environ, "PATH": f"{folder}{os.pathsep}{os.environ['PATH']}"}
    for arguments, status in ((wrong, 2), (["contact", "--help"], 0)):
        done = subprocess.run(
            [*program, *arguments], cwd=tmp_path, env=environment, capture_output=True, text=True
        )
        assert done.returncode == status, done.stderr
        assert "Traceback" not in done.stderr
    assert done.stdout


# ------------------------------------------------------------------ nothing that could be believed


@dataclass
class Failing(pieces.FormulaPlace):
    """Formulas whose runs fail on the packings of these seeds."""

    seeds: tuple[int, ...]

    def simulate(self, lab, specimen, packing, soil):
        run = super().simulate(lab, specimen, packing, soil)
        fails = round(float(packing.height)) - 1 in self.seeds
        return replace(run, failure="the platen did not reach 400 N") if fails else run


@pytest.fixture
def failing(monkeypatch):
    """Lets a laboratory's runs fail on packings."""

    def on(*seeds):
        monkeypatch.setattr(session, "HERE", Failing(seeds))
        monkeypatch.setitem(resolution.PRESETS, "quick", pieces.TINY)

    return on


def test_where_all_packings_failed_there_are_no_observables(calibrate, tmp_path, failing):
    failing(*range(20))
    status, out, error = calibrate("simulate", "--out", "o", "--json", "r.json")
    assert status == 1
    assert "all 2 packings failed" in error and "did not reach 400 N" in error
    assert "depression depth" not in out and "crushing force" not in out
    result = json.loads((tmp_path / "r.json").read_text())
    assert set(result["observables"].values()) == {None}
    assert len(result["failures"]) == 2
    assert result == json.loads((tmp_path / "o" / "result.json").read_text())


def test_a_mean_is_that_of_the_packings_that_did_not_fail(calibrate, tmp_path, failing):
    failing(1)
    assert calibrate("simulate", "--json", "r.json")[0] == 0
    result = json.loads((tmp_path / "r.json").read_text())
    sound = next(packing for packing in result["packings"] if not packing["failure"])
    assert len(result["packings"]) == 2 and len(result["failures"]) == 1
    for name, mean in result["observables"].items():
        assert mean == sound[name]


@pytest.mark.parametrize(
    "verb",
    [
        ["fit", "--free", "shear_modulus"],
        ["doe"],
        pytest.param(["audit", "--packings", "2"], marks=pytest.mark.slow),
    ],
)
def test_every_verb_ends_with_1_where_all_packings_failed(calibrate, failing, verb):
    failing(*range(1000))
    status, out, error = calibrate(*verb)
    reason = "every probe failed" if verb[0] == "audit" else "did not reach 400 N"
    assert status == 1 and reason in error and "mm" not in out, (out, error)


# ------------------------------------------------------------------ small things


def test_the_version_is_said(calibrate):
    status, out, error = calibrate("--version")
    assert (status, error) == (0, "")
    python = ".".join(map(str, sys.version_info[:3]))
    assert out.split(",")[1:] == [f" JAX {jax.__version__}", f" Python {python}\n"]
    assert out.startswith(f"calibrate {metadata.version('differentiable-soil')},")


@pytest.mark.parametrize(
    ("path", "radius", "status"),
    [
        ("20,2600,10", "2.5", 2),
        ("2500", "2.5", 2),
        ("2400,2", "2.5", 0),
        ("600", "0.5", 2),
        ("30,-6000", "2.5", 0),
        ("30", "0.02", 2),
    ],
)
def test_overlaps_stay_below_the_radius(calibrate, path, radius, status):
    found, _, error = calibrate("contact", f"--path-um={path}", "--radius-mm", radius)
    assert found == status
    if status:
        deepest = max(map(float, path.split(",")))
        assert f"'--path-um': an overlap of {deepest:g} um is not below the radius" in error
