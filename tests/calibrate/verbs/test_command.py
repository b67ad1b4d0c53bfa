"""Commands made from signatures: what is typed, given, loaded for help; and `calibrate check`."""

import importlib
import inspect
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
import typer

import calibrate as package
from calibrate import figures
from calibrate.core.errors import CalibrationError, InputError
from calibrate.discrepancy.library import cross_validation
from calibrate.figures import misfit
from calibrate.figures.fit import contact_figure
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.verbs import VERBS, command, options
from calibrate.verbs.check import check

FOLDER = Path(command.__file__).parent
SHARED = {"__init__", "base", "command", "options"}
HEAVY = ("jax", "numpy", "pandas", "matplotlib", "scipy")


def test_every_file_of_a_verb_is_in_the_table_and_says_what_it_does():
    assert {path.stem for path in FOLDER.glob("*.py")} - SHARED == set(VERBS)
    assert all(command.summary(name).endswith((".", "`.")) for name in VERBS)


def shown(name: str, only_help: bool) -> list[tuple]:
    """What the options of a verb are."""
    told = (
        "name",
        "opts",
        "secondary_opts",
        "help",
        "metavar",
        "required",
        "default",
        "min",
        "max",
    )
    parameters = command.command_of(name, only_help).params
    return [tuple(getattr(each, what, None) for what in told) for each in parameters]


@pytest.mark.parametrize("name", VERBS)
def test_a_signature_alone_has_the_options_of_the_verb(name, monkeypatch):
    """With stand-ins for what the verb computes with, as `--help` reads it, and with all of it."""
    whole = shown(name, only_help=False)
    monkeypatch.delitem(sys.modules, f"calibrate.verbs.{name}")
    assert shown(name, only_help=True) == whole
    assert f"calibrate.verbs.{name}" not in sys.modules


def test_help_loads_nothing_heavy():
    """Help of all verbs in one process: half a second; with JAX and the rest five."""
    program = f"""
import sys
from calibrate import cli
for words in [["--help"], *([verb, "--help"] for verb in cli.VERBS)]:
    cli.run(cli.app, "calibrate", words)
print("heavy:", *({HEAVY} & sys.modules.keys()))
""".replace(str(HEAVY), str(set(HEAVY)))
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert said.returncode == 0, said.stderr
    assert said.stdout.count("Usage: ") == len(VERBS) + 1
    assert said.stdout.splitlines()[-1] == "heavy:"


def test_a_signature_in_python_has_nothing_of_the_command_line():
    for name in ("fit", "contact", "convert", "next_test"):
        said = str(inspect.signature(getattr(package, name)))
        assert "typer" not in said and "Typed" not in said, said
    assert "strategies: str | collections.abc.Sequence[str] = ('fit',)" in str(
        inspect.signature(package.audit)
    )


def test_a_picture_takes_one_line(monkeypatch, calibrate, tmp_path):
    """It is written, named on the terminal, and drawn in a notebook; others are refused."""
    twice = lambda overlap, force: contact_figure(2 * overlap, force)  # noqa: E731
    monkeypatch.setattr(misfit, "twice", twice, raising=False)
    monkeypatch.setitem(figures.FIGURES["contact"], "twice", "misfit:twice")
    status, out, error = calibrate("contact", "--path-um", "9,1", "--out", "o")
    assert (status, error) == (0, "")
    assert out.splitlines()[-1] == "contact.json, contact.png and twice.png are in o"
    assert (tmp_path / "o" / "twice.png").stat().st_size > 1000
    found = package.contact([9, 1], out=tmp_path)
    widest = [found.plot(name).axes[0].lines[0].get_xdata().max() for name in (None, "twice")]
    assert widest == pytest.approx([9.0, 18.0])
    with pytest.raises(InputError, match='give "contact" or "twice"'):
        found.plot("thrice")


@pytest.mark.parametrize("name", figures.FIGURES)
def test_a_new_picture_of_any_verb_is_drawn_and_written(name, monkeypatch, tmp_path):
    """From what the verb's result has as `drawn`; where that has nothing for it, it is left out."""
    assert all(map(callable, figures.functions(name).values()))
    [kind] = [
        kind
        for kind in vars(importlib.import_module(f"calibrate.verbs.{name}")).values()
        if isinstance(kind, type) and vars(kind).get("verb") == name
    ]
    monkeypatch.setattr(kind, "drawn", ("a", "b"))
    drawing = lambda *drawn: plt.figure(label=" ".join(drawn))  # noqa: E731
    monkeypatch.setattr(misfit, "new", drawing, raising=False)
    monkeypatch.setattr(misfit, "none", lambda *_: None, raising=False)
    monkeypatch.setitem(figures.FIGURES, name, {"none": "misfit:none", "new": "misfit:new"})
    found = object.__new__(kind)
    object.__setattr__(found, "folder", tmp_path)
    assert found.plot().get_label() == found.plot("new").get_label() == "a b"
    with pytest.raises(CalibrationError, match='the picture "none" would show'):
        found.plot("none")
    found.save_figures()
    [written] = (path for path in tmp_path.rglob("*") if path.is_file())
    assert written == tmp_path / found.pictures.format("new")
    assert not found.files or written.relative_to(tmp_path).parts[0] in found.written()


# ------------------------------------------------------------------ from what is typed to arguments


def given(*words: str) -> dict:
    """The arguments that a function gets of what is typed."""
    program, found = typer.Typer(), {}

    def kept(
        first: options.LabFile = None,
        *,
        values: options.Changes = None,
        further: options.FurtherLabs = ("nothing",),
        seed: options.Seed = 3,
    ) -> None:
        found.update(first=first, values=values, further=further, seed=seed)

    program.command()(command.typed(kept))
    program(list(words), standalone_mode=False)
    return found


def test_the_smallest_library_has_two_blocks_of_packings():
    """The emulator is judged on one that it was fitted without."""
    [packings] = (p for p in command.command_of("library").params if p.name == "packings")
    assert packings.min == 2 * cross_validation.BLOCK


def test_what_is_not_typed_keeps_the_default_of_the_function():
    assert given() == {"first": None, "values": None, "further": ("nothing",), "seed": 3}


def test_what_is_typed_is_read():
    found = given("a.toml", "--set", "a = 1 ", "--set=b=2 m", "--further", "c", "--seed", "0")
    assert found["first"] == Path("a.toml") and found["values"] == {"a": "1", "b": "2 m"}
    assert found["further"] == [Path("c")] and found["seed"] == 0


def test_what_is_typed_wrongly_is_refused():
    with pytest.raises(InputError, match="no '='"):
        given("--set", "a")
    with pytest.raises(typer.exceptions.TyperException, match="equal to 0"):
        given("--seed", "-1")


GOOD = bundled_lab().read_text()


def test_it_says_what_a_fit_compares(calibrate, tmp_path):
    status, out, error = calibrate("check", "--json", "check.json")
    assert (status, error) == (0, "")
    assert "confined: a specimen 50 mm wide, 100 mm high, 0 curves, 1 target" in out
    assert "crushing force (N)" in out and "2 numbers fix as many parameters at most" in out
    assert "names no effect, since the lab file has no curves" in out
    found = json.loads((tmp_path / "check.json").read_text())
    assert found["numbers"] == {
        "depression_depth_mm": {"measured": 3.36, "repeats": 4},
        "crushing_force_n": {"measured": 206.0, "repeats": 4},
    }
    assert [path.name for path in tmp_path.iterdir()] == ["check.json"]


def test_numbers_of_curves_are_means_over_them():
    found = check(bundled_lab("trumao_curves"))
    rows = found.content["numbers"]
    assert {row["repeats"] for name, row in rows.items() if "displacement" in name} == {3}
    assert rows["displacement at 392.7 N, loading"]["measured"] == pytest.approx(1.688, abs=5e-4)
    assert len(found.warnings) == 1 and "begins at a load of 49.09 N" in found.warnings[0]
    assert found.content["diagnosis"] == "takes it"


def test_what_the_lab_file_frees_and_holds(tmp_path):
    path = tmp_path / "lab.toml"
    marks = "[parameters.shear_modulus]\nvalue = '7 MPa'\nfree = true\n"
    held = "[parameters.restitution]\nvalue = 0.3\nfree = false\n"
    kept = [line for line in GOOD.splitlines() if not line.startswith(("shear_modulus", "restit"))]
    path.write_text("\n".join(kept) + "\n" + marks + held)
    found = check(load_lab(path))
    assert found.content["free"] == ["shear_modulus"] and found.content["held"] == ["restitution"]
    assert found.content["parameters"]["restitution"] == 0.3
    assert "a fit frees shear_modulus" in repr(found)


def test_a_test_that_prepares_is_not_in_vain_and_one_that_ends_unmeasured_is(tmp_path):
    source = bundled_lab("trumao_oedometer")
    assert not [w for w in check(source).warnings if "in vain" in w]
    shutil.copytree(source.parent, tmp_path / "soils")
    path = tmp_path / "soils" / source.name
    path.write_text(path.read_text() + '\n[[tests]]\ntype = "unconfined"\nname = "again"\n')
    assert [w for w in check(path).warnings if "in vain" in w] == [
        "again has neither a target nor a curve: a fit simulates it in vain"
    ]
    assert check(path).content["diagnosis"].startswith("refuses it: a library of runs holds")


def test_a_start_beyond_its_bounds_is_refused_before_anything_is_simulated(calibrate, tmp_path):
    path = tmp_path / "lab.toml"
    path.write_text(re.sub("(?m)^rolling_friction.*", "rolling_friction = 0.05", GOOD))
    (said,) = [warning for warning in check(path).warnings if "refuses" in warning]
    assert "parameters.rolling_friction" in said and "0.05 is not between the bounds" in said
    for verb in ("fit", "doe"):
        status, out, error = calibrate(verb, "lab.toml", "--preset", "quick")
        assert (status, out) == (2, "") and error.endswith("give its low and high\n")
        assert "packings" not in error and "compiled" not in error


@pytest.mark.parametrize("text", ["", "[soil\nname", GOOD.replace('"100 mm"', '"-100 mm"')])
def test_a_wrong_lab_file_is_refused(calibrate, tmp_path, text):
    (tmp_path / "lab.toml").write_text(text)
    status, out, error = calibrate("check", "lab.toml")
    assert (status, out, error.count("\n")) == (2, "", 1) and "lab.toml" in error
