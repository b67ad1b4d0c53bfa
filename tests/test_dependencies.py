"""Hashes of source change with what numbers depend on, and with nothing else.

On little packages of a few lines; tests/test_keys.py does the same with `jdem`.
"""

import shutil
from pathlib import Path
from textwrap import dedent

import pytest

from calibrate.simulation.definitions import Sources
from calibrate.simulation.dependencies import Dependencies

PACKAGE = {
    "__init__": '"""A little package."""',
    "laws": '''
        """Laws."""
        import numpy as np
        from toy.core import rounding
        from toy.core.rounding import width as smooth_width

        class Base:
            """The contract."""
            slope = 2.0

            def bound(self, x):
                return self.slope * np.abs(x)

        class Spring(Base):
            def force(self, x, stiffness=3.0):
                """k x"""
                return stiffness * x + rounding.step(x) + smooth_width

        class Other(Base):
            pass
        ''',
    "core.__init__": "",
    "core.rounding": """
        width = 0.5
        LOW, HIGH = 1.0, 2.0

        def step(x):
            return even(x) if x > width else LOW

        def even(x):
            return step(x - 1)  # round and round

        def unused(x):
            return HIGH
        """,
    "engine": """
        from .laws import Spring, Base
        from toy import state

        def run(law: Base, bed: "state.Bed", names=[step for step in (1, 2)]):
            return law.force(bed.height())

        def plain():
            return run(Spring(), state.Bed())
        """,
    "state": """
        class Bed:
            def height(self):
                return 7.0
        """,
}


def written(folder: Path, package: dict[str, str]) -> Path:
    """The package's files below `folder`; module names are keys."""
    shutil.rmtree(folder / "toy", ignore_errors=True)
    for name, text in package.items():
        path = (folder / "toy").joinpath(*name.split(".")).with_suffix(".py")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(dedent(text), encoding="utf-8")
    return folder / "toy"


def dependencies_in(folder: Path, package: dict[str, str]) -> Dependencies:
    return Dependencies(Sources({"toy": written(folder, package)}))


def edited(module: str, old: str, new: str, package=None) -> dict[str, str]:
    """The package with one passage replaced."""
    package = PACKAGE if package is None else package
    assert old in package[module]
    return {**package, module: package[module].replace(old, new)}


@pytest.fixture
def hashed(tmp_path):
    """Hash of a package's roots; without roots that of its function `plain`."""

    def find(package, roots=(("toy.engine", "plain"),)):
        return dependencies_in(tmp_path, package).hash_of(roots)

    return find


RUN = (("toy.engine", "run"), ("toy.laws", "Spring"))  # with a spring in the objects given

CHANGES = [
    ("a formula", "core.rounding", "x - 1", "x - 2"),
    ("a constant", "core.rounding", "width = 0.5", "width = 0.6"),
    ("one of two constants", "core.rounding", "LOW, HIGH = 1.0", "LOW, HIGH = 1.5"),
    ("another constant of two", "core.rounding", "else LOW", "else HIGH"),
    ("the kind of a number", "core.rounding", "LOW, HIGH = 1.0", "LOW, HIGH = 1"),
    ("a default argument", "laws", "stiffness=3.0", "stiffness=4.0"),
    ("a method of the base class", "laws", "self.slope *", "self.slope +"),
    ("a field of the base class", "laws", "slope = 2.0", "slope = 2.5"),
    ("another base class", "laws", "class Spring(Base)", "class Spring(Other)"),
    ("a function of another package", "laws", "np.abs", "np.sign"),
    ("another package of that name", "laws", "import numpy as np", "import jax.numpy as np"),
    ("a method of an argument's type", "state", "7.0", "8.0"),
    ("a default in a comprehension", "engine", "(1, 2)", "(1, 3)"),
]


@pytest.mark.parametrize("roots", [RUN, (("toy.engine", "plain"),)])
@pytest.mark.parametrize(
    ("module", "old", "new"), [c[1:] for c in CHANGES], ids=[c[0] for c in CHANGES]
)
def test_what_numbers_depend_on_changes_the_hash(module, old, new, roots, hashed):
    assert hashed(edited(module, old, new), roots) != hashed(PACKAGE, roots)


SAME = [
    ("a comment", "core.rounding", "round and round", "and round"),
    ("a docstring", "laws", "k x", "the spring's force, N"),
    ("a docstring taken away", "laws", '"""k x"""', ""),
    ("a docstring of a module", "laws", '"""Laws."""', '"""Springs and others."""'),
    ("an annotation", "engine", "law: Base", "law"),
    ("a definition that is not used", "core.rounding", "return HIGH", "return LOW"),
    ("a sibling class", "laws", "class Other(Base):", "class Other:"),
    ("lines", "core.rounding", "return even(x) if", "return even(\n                x) if"),
    ("the name of an import", "laws", "smooth_width", "wide"),
    ("a definition's own name", "core.rounding", "even", "rounded"),
]


@pytest.mark.parametrize(("module", "old", "new"), [c[1:] for c in SAME], ids=[c[0] for c in SAME])
def test_how_it_is_written_does_not_change_the_hash(module, old, new, hashed):
    assert hashed(edited(module, old, new)) == hashed(PACKAGE)


def test_a_constant_in_the_place_of_a_like_one_of_the_same_name_changes_the_hash(hashed):
    """Names do not count, so that what stands behind them must."""
    two = {**PACKAGE, "first": "WIDTH = 0.5", "second": "WIDTH = 0.7"}
    head = "from toy import first, second\n\ndef f():\n    return second.WIDTH, "
    once = hashed({**two, "use": head + "first.WIDTH + 1"}, [("toy.use", "f")])
    again = hashed({**two, "use": head + "second.WIDTH + first.WIDTH * 0 + 1"}, [("toy.use", "f")])
    assert once != again
    swapped = head.replace("second.WIDTH", "first.WIDTH") + "second.WIDTH + 1"
    assert once != hashed({**two, "use": swapped}, [("toy.use", "f")])


def test_a_moved_definition_and_a_renamed_module_do_not_change_the_hash(hashed):
    moved = edited("core.rounding", "width = 0.5", "from toy.core.widths import width")
    moved = edited("laws", "from toy.core.rounding import", "from toy.core.widths import", moved)
    moved["core.widths"] = "width = 0.5"
    assert hashed(moved) == hashed(PACKAGE)
    assert hashed({**moved, "core.widths": "width = 0.6"}) != hashed(PACKAGE)
    renamed = {**moved, "core.smooth": moved["core.rounding"]}
    del renamed["core.rounding"]
    renamed = edited("laws", "import rounding", "import smooth as rounding", renamed)
    assert hashed(renamed) == hashed(PACKAGE)


def test_a_package_may_pass_on_what_its_modules_define(hashed):
    passed = {**PACKAGE, "core.__init__": "from toy.core.rounding import width, step"}
    passed = edited("laws", "from toy.core.rounding import", "from toy.core import", passed)
    assert hashed(passed) == hashed(PACKAGE)


@pytest.mark.parametrize(
    ("head", "use"),
    [
        ("from toy.core import rounding", "rounding.step(1)"),
        ("from toy.core import rounding as r", "r.step(1)"),
        ("from toy.core.rounding import step as s", "s(1)"),
        ("import toy.core.rounding", "toy.core.rounding.step(1)"),
        ("import toy.core.rounding as r", "r.step(1)"),
        ("from .core.rounding import step", "step(1)"),
    ],
)
def test_however_it_is_imported_the_hash_is_one(head, use, hashed):
    plain = "from toy.core.rounding import step\n\ndef f():\n    return step(1)"
    expected = hashed({**PACKAGE, "use": plain}, [("toy.use", "f")])
    roots = [("toy.use", "f")]
    package = {**PACKAGE, "use": f"{head}\n\ndef f():\n    return {use}"}
    assert hashed(package, roots) == expected
    assert hashed(edited("core.rounding", "0.5", "0.6", package), roots) != expected


def test_an_import_within_a_function_is_followed(hashed):
    inside = "def f():\n    from toy.core.rounding import step\n    return step(1)"
    package, roots = {**PACKAGE, "use": inside}, [("toy.use", "f")]
    assert hashed(edited("core.rounding", "0.5", "0.6", package), roots) != hashed(package, roots)


def test_a_module_that_is_handed_on_counts_whole(hashed):
    whole = "from toy.core import rounding\n\ndef f(name):\n    return getattr(rounding, name)"
    package, roots = {**PACKAGE, "use": whole}, [("toy.use", "f")]
    changed = edited("core.rounding", "return HIGH", "return LOW", package)
    assert hashed(changed, roots) != hashed(package, roots)


def test_local_names_are_not_taken_for_definitions(hashed):
    """Arguments, loops and comprehensions hide what the module calls by that name."""
    text = """
        def f(step):
            return [width + step for width in range(3)], lambda even: even
        def width():
            return 1
        def step():
            return 2
        def even():
            return 3
        """
    package, roots = {**PACKAGE, "use": text}, [("toy.use", "f")]
    changed = package
    for old, new in (("return 1", "return 4"), ("return 2", "return 5"), ("return 3", "return 6")):
        changed = edited("use", old, new, changed)
    assert hashed(changed, roots) == hashed(package, roots)


def test_a_method_does_not_hide_the_function_of_its_name(hashed):
    text = """
        def run():
            return 1

        class A:
            def run(self):
                return run()
        """
    package, roots = {**PACKAGE, "use": text}, [("toy.use", "A")]
    assert hashed(edited("use", "return 1", "return 2", package), roots) != hashed(package, roots)


def test_a_field_that_becomes_the_class_s_own_changes_the_hash(hashed):
    text = """
        from typing import ClassVar

        class A:
            width: float = 1.0
            height: float = 2.0
        """
    package, roots = {**PACKAGE, "use": text}, [("toy.use", "A")]
    assert hashed(edited("use", "height: float", "height: int", package), roots) == hashed(
        package, roots
    )
    shared = edited("use", "height: float", "height: ClassVar[float]", package)
    assert hashed(shared, roots) != hashed(package, roots)


def test_an_alias_of_types_leads_to_its_classes(hashed):
    text = """
        from toy.state import Bed
        from toy.laws import Other
        Either = Bed | Other

        def f(bed: Either):
            return bed.height()
        """
    package, roots = {**PACKAGE, "use": text}, [("toy.use", "f")]
    assert hashed(edited("state", "7.0", "8.0", package), roots) != hashed(package, roots)
    other = edited("use", "Bed | Other", "Other | Bed", package)
    assert hashed(other, roots) == hashed(package, roots)


def test_a_setting_at_module_level_counts_for_its_module_and_those_below(hashed):
    for module in ("laws", "__init__", "core.__init__"):
        package = {**PACKAGE, module: dedent(PACKAGE[module]) + "\nprint('set')\n"}
        assert hashed(package) != hashed(PACKAGE), module
    package = {**PACKAGE, "unused": "print('set')"}
    assert hashed(package) == hashed(PACKAGE)


def test_a_new_file_changes_nothing(hashed):
    assert hashed({**PACKAGE, "effects": "from toy import laws\nX = laws.Other"}) == hashed(PACKAGE)


def test_only_what_is_reached_is_parsed(hashed):
    assert hashed({**PACKAGE, "broken": "def def"}) == hashed(PACKAGE)


def test_imports_of_everything_are_refused(hashed):
    with pytest.raises(ValueError, match="line 1: name what is imported"):
        hashed({**PACKAGE, "use": "from toy.laws import *\nX = 1"}, [("toy.use", "X")])


def test_a_root_without_source_is_refused(hashed):
    with pytest.raises(ValueError, match="elsewhere: no source"):
        hashed(PACKAGE, [("elsewhere", "f")])
