"""Commands that are made from signatures: what is typed, what is given, what help loads."""

import importlib
import inspect
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
from calibrate.verbs import VERBS, command, options

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
