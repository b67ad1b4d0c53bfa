"""What `import calibrate` and `import jdem` offer: one path each, arguments explained."""

import doctest
import inspect
import re
import shutil
import subprocess
import sys

import pytest

import calibrate
import jdem
from calibrate.io.lab import bundled_lab
from tests import ROOT
from tests.support import toy_library
from tests.support.formulas import in_place_of_spheres

PACKAGES = {"calibrate": calibrate, "jdem": jdem}
PUBLIC = [(package, name) for package in PACKAGES for name in sorted(PACKAGES[package].__all__)]
FUNCTIONS = [
    (package, name)
    for package, name in PUBLIC
    if inspect.isfunction(inspect.unwrap(getattr(PACKAGES[package], name)))
]
RESULTS = [name for _, name in PUBLIC if name.endswith("Result")]


def dotted(case) -> str:
    return ".".join(case)


def of(case):
    package, name = case
    return getattr(PACKAGES[package], name)


def test_a_user_meets_few_names():
    assert 20 <= len(calibrate.__all__) <= 32
    assert 40 <= len(jdem.__all__) <= 50
    assert set(calibrate.__all__) <= set(dir(calibrate)) and set(jdem.__all__) <= set(dir(jdem))


@pytest.mark.parametrize("case", PUBLIC, ids=dotted)
def test_a_name_is_there_and_says_what_it_is(case):
    if case == ("jdem", "PHYSICS"):  # a number, told in its file
        assert isinstance(of(case), int)
        return
    assert inspect.getdoc(of(case)), "no docstring"
    assert not of(case).__name__.startswith("_") and of(case).__name__ == case[1]


def test_no_name_of_one_package_means_another_thing_in_a_folder_of_it():
    """A folder and a function of one name: whoever imports the folder would lose the function."""
    for package, name in PUBLIC:
        assert not (ROOT / package / name).exists() and not (ROOT / package / f"{name}.py").exists()


@pytest.mark.parametrize("case", FUNCTIONS, ids=dotted)
def test_a_function_explains_its_arguments(case):
    function = inspect.unwrap(of(case))
    doc = inspect.getdoc(function) or ""
    parameters = inspect.signature(function).parameters
    assert "Returns:\n" in doc and "Example:\n" in doc
    section = doc.partition("Args:\n")[2].partition("Returns:")[0]
    explained = re.findall(r"^    (\w+): ", section, re.MULTILINE)
    assert explained == list(parameters)


@pytest.mark.parametrize("case", [f for f in FUNCTIONS if f[0] == "calibrate"], ids=dotted)
def test_options_are_given_by_keyword(case):
    parameters = list(inspect.signature(inspect.unwrap(of(case))).parameters.values())
    assert all(p.kind is p.KEYWORD_ONLY for p in parameters[1:])
    assert all(p.default is not p.empty for p in parameters[1:] if p.name != "to")


@pytest.mark.parametrize("name", RESULTS)
def test_a_result_has_attributes_json_text_and_a_picture(name):
    kind = getattr(calibrate, name)
    assert "Attributes:" in (kind.__doc__ or "")
    for method in ("to_json", "__repr__", "_repr_html_"):
        assert callable(getattr(kind, method))
    assert callable(getattr(kind, "plot", None)) or name == "ReportResult"
    for attribute, value in vars(kind).items():
        if isinstance(value, property) and not attribute.startswith("_"):
            assert value.__doc__, attribute


def test_importing_loads_nothing_heavy():
    program = "import calibrate, jdem, sys; print('jax' in sys.modules, 'numpy' in sys.modules)"
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert said.stdout.split() == ["False", "False"], said.stderr


# ------------------------------------------------------------------ examples run


def examples(case) -> str:
    """The code of a function's example, without what it shows."""
    found = doctest.DocTestParser().get_examples(inspect.getdoc(inspect.unwrap(of(case))) or "")
    return "".join(example.source for example in found)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a lab file, an export and a fit, and formulas in place of spheres."""
    place = tmp_path_factory.mktemp("examples")
    for name in ("my_soil.toml", "other_test.toml"):
        shutil.copy(bundled_lab(), place / name)
    with pytest.MonkeyPatch.context() as patch:
        in_place_of_spheres(patch)
        toy_library.write_library(place / "library.nc")
        patch.setattr("calibrate.verbs.diagnose.bundled_library", lambda: place / "library.nc")
        patch.chdir(place)
        rows = [f"{0.02 * k},{0.9 * k}" for k in range(200)]
        (place / "export.csv").write_text("Displacement (mm),Force (N)\n" + "\n".join(rows))
        calibrate.fit(out="results/fit")
        yield place


@pytest.mark.slow
@pytest.mark.parametrize("case", [f for f in FUNCTIONS if f[0] == "calibrate"], ids=dotted)
def test_the_example_of_a_verb_runs(case, folder):
    code = examples(case)
    assert f"calibrate.{case[1]}(" in code
    exec(compile(code, dotted(case), "exec"), {"calibrate": calibrate})


@pytest.mark.parametrize("name", ["overlap_path", "drive_overlap", "particle_law"])
def test_the_example_of_a_contact_runs(name):
    exec(compile(examples(("jdem", name)), name, "exec"), {"jdem": jdem})


def code_of(package) -> str:
    """The example in a package's docstring: all lines that are indented."""
    lines = (package.__doc__ or "").split("\n")
    return "\n".join(line[4:] for line in lines if line.startswith("    ") or not line)


@pytest.mark.slow
def test_both_tests_run_in_eight_lines():
    """The example of `jdem`, then those of `prepare` and `simulate`."""
    code, names = code_of(jdem), {"jdem": jdem}
    assert len([line for line in code.split("\n") if line]) <= 8
    for each in (code, examples(("jdem", "prepare")), examples(("jdem", "simulate"))):
        exec(compile(each, "jdem", "exec"), names)
    assert 1e-4 < names["found"].observables["confined"]["depression_depth"] < 1e-2


@pytest.mark.slow
def test_a_fit_takes_five_lines(folder):
    code = code_of(calibrate)
    assert len([line for line in code.split("\n") if line]) <= 5
    exec(compile(code, "calibrate", "exec"), {})


# ------------------------------------------------------------------ results


@pytest.fixture(scope="module")
def loop(tmp_path_factory):
    return calibrate.contact([20, 2, 32, -28], out=tmp_path_factory.mktemp("contact"))


def test_a_result_is_shown_in_a_notebook_as_on_the_terminal(loop):
    assert repr(loop).startswith("largest force ")
    assert repr(loop) in loop._repr_html_()


def test_a_result_is_drawn_once(loop):
    from matplotlib import pyplot

    assert loop.plot().axes and not pyplot.get_fignums()


def test_a_result_becomes_json(loop, tmp_path):
    text = loop.to_json(tmp_path / "loop.json")
    assert (
        (tmp_path / "loop.json").read_text() == text == (loop.folder / "contact.json").read_text()
    )


WRONG = {
    "preset": lambda out: calibrate.fit(preset="x", out=out),
    "values.surfce_energy": lambda out: calibrate.fit(values={"surfce_energy": 1}, out=out),
    "values.surface_energy": lambda out: calibrate.simulate(
        values={"surface_energy": "1 kg"}, out=out
    ),
    "values.slope_exponent": lambda out: calibrate.simulate(
        values={"slope_exponent": 1.5}, conventions="liggghts", out=out
    ),
    "free": lambda out: calibrate.fit(free=["density"], out=out),
    "strategies": lambda out: calibrate.audit(strategies=["hope"], out=out),
    "path_um": lambda out: calibrate.contact([9000], out=out),
    "seed": lambda out: calibrate.fit(seed=-1, out=out),
    "packings": lambda out: calibrate.audit(packings=1, out=out),
    "spheres": lambda out: calibrate.audit(spheres=30.5, out=out),
    "simulate": lambda out: calibrate.diagnose(bundled_lab(), simulate=-3, out=out),
    "batch": lambda out: calibrate.doe(batch=1, out=out),
    "to": lambda out: calibrate.export(bundled_lab(), to="abaqus", out=out / "x"),
    "force_unit": lambda out: calibrate.convert("x.csv", force_unit="mm", out=out),
    "exports": lambda out: calibrate.convert(out=out),
}


@pytest.mark.parametrize("argument", WRONG)
def test_a_wrong_argument_is_called_by_its_name(argument, tmp_path):
    with pytest.raises(calibrate.InputError) as caught:
        WRONG[argument](tmp_path)
    assert caught.value.field == argument and caught.value.file == "arguments"
    assert "--" not in str(caught.value)


def test_names_may_stand_in_one_text(tmp_path):
    with pytest.raises(calibrate.InputError, match="'density' cannot be fitted"):
        calibrate.fit(free="shear_modulus, density", out=tmp_path)
    with pytest.raises(calibrate.InputError, match="no list of numbers"):
        calibrate.contact("a,b", out=tmp_path)


def test_what_would_be_rounded_to_single_precision_is_refused():
    program = "import jdem; jdem.prepare(jdem.Specimen(count=60), seed=0)"
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert "ValueError: JAX is in single precision" in said.stderr
