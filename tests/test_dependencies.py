"""Cache keys change with what numbers depend on, and with nothing else."""

from pathlib import Path

import pytest

import jdem
from calibrate.simulation.dependencies import Sources, places_of, types_in
from jdem.laboratory.virtual_lab import VirtualLab

TOY = {
    "__init__.py": '"""A toy."""\n',
    "laws.py": (
        '"""Laws."""\nfrom toy import numbers\nfrom toy.base import Base\n\n\n'
        "class Law(Base):\n    def force(self, x):\n        return numbers.STIFFNESS * x\n"
    ),
    "base.py": "class Base:\n    def twice(self, x, by=2):\n        return by * half(x)\n\n\n"
    "def half(x):\n    return x / 2\n",
    "numbers.py": "STIFFNESS = 3.0\nUNUSED = 1.0\n",
    "run.py": "from toy.laws import Law as TheLaw\n\n\ndef run(x):\n    return TheLaw().force(x)\n",
}
ROOT = [("toy.run", "run")]


def key(folder: Path, files: dict[str, str]) -> str:
    package = folder / "toy"
    package.mkdir(parents=True)
    for name, text in files.items():
        (package / name).parent.mkdir(exist_ok=True)
        (package / name).write_text(text, encoding="utf-8")
    return Sources.of(package).hash(ROOT)


def changed(name: str, old: str, new: str) -> dict[str, str]:
    assert old in TOY[name]
    return {**TOY, name: TOY[name].replace(old, new)}


def moved() -> dict[str, str]:
    """`numbers` in a folder of its own."""
    files = changed("laws.py", "from toy import numbers", "from toy.deep import numbers")
    return {"deep/__init__.py": "", "deep/numbers.py": files.pop("numbers.py"), **files}


HARMLESS = {
    "a comment": changed("numbers.py", "3.0", "3.0  # N/m"),
    "a docstring": changed("base.py", "def half(x):", 'def half(x):\n    """Half of it."""'),
    "an unused definition": changed("numbers.py", "UNUSED = 1.0", "UNUSED = 2.0"),
    "an unused file": {**TOY, "other.py": "class OtherLaw:\n    pass\n"},
    "an annotation": changed("run.py", "def run(x):", "def run(x: float) -> float:"),
    "a moved file": moved(),
}
TELLING = {
    "a constant": changed("numbers.py", "3.0", "3.1"),
    "a default": changed("base.py", "by=2", "by=3"),
    "a formula": changed("base.py", "x / 2", "x / 2.5"),
    "a method": changed("laws.py", "* x", "* x * x"),
    "another class": changed("run.py", "import Law as TheLaw", "import Base as TheLaw"),
}


@pytest.mark.parametrize("what", HARMLESS)
def test_what_changes_no_number_changes_no_key(what: str, tmp_path: Path):
    assert key(tmp_path / "a", TOY) == key(tmp_path / "b", HARMLESS[what])


@pytest.mark.parametrize("what", TELLING)
def test_what_changes_a_number_changes_the_key(what: str, tmp_path: Path):
    assert key(tmp_path / "a", TOY) != key(tmp_path / "b", TELLING[what])


def test_definitions_may_name_each_other(tmp_path: Path):
    files = {"run.py": "def run(x):\n    return back(x)\n\n\ndef back(x):\n    return run(x - 1)\n"}
    assert key(tmp_path / "a", files) != key(tmp_path / "b", TOY)


ROOTS = places_of([VirtualLab])


def jdem_with(folder: Path, edits: dict[str, tuple[str, str]]) -> Sources:
    """A copy of the simulator with some texts replaced."""
    root = Path(jdem.__file__).parent
    for path in root.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        name = path.relative_to(root).as_posix()
        if name in edits:
            assert edits[name][0] in text
            text = text.replace(*edits[name])
        target = folder / "jdem" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text, encoding="utf-8")
    return Sources.of(folder / "jdem")


def test_of_the_simulator_laws_count_and_unused_effects_do_not(tmp_path: Path):
    now = jdem_with(tmp_path / "now", {}).hash(ROOTS)
    law = {"laws/eepa.py": ("cap = 0.5 * k2 * raised", "cap = 0.6 * k2 * raised")}
    lag = {"effects/lag.py": ("self.strength / time_scale", "2 * self.strength / time_scale")}
    assert jdem_with(tmp_path / "law", law).hash(ROOTS) != now
    assert jdem_with(tmp_path / "lag", lag).hash(ROOTS) == now


def test_the_classes_within_a_laboratory_are_found():
    assert types_in((1.0, {"a": [2]}, "b")) == set()
    assert types_in(Path()) == set()
