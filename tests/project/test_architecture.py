"""The rules that keep packages and studies apart, acyclic and short, read from their source.

Nothing is imported: every file is parsed with `ast`.  A rule is a function from
all modules of a tree to the list of its violations; the second half of this
file shows each rule a tree that breaks it.
"""

import ast
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from tests import ROOT

PACKAGES = ("jdem", "calibrate", "studies", "verification")
ABOVE = {  # what each may not import; `verification` repeats what tests do, and may import these
    "jdem": ("calibrate", "studies", "verification", "tests"),
    "calibrate": ("studies", "verification", "tests"),
    "studies": ("verification", "tests"),
}
UNPACKAGED = ("benchmarks", "reporting")  # nor these, whoever it is
FAMILIES = (
    "jdem.bodies",
    "jdem.boundaries",
    "jdem.laws",
    "jdem.effects",
    "jdem.apparatus",
    "jdem.sensitivity",
)
# Folders (and loose modules) of each package from the ground up: imports run downward only.
ORDER = {
    "jdem": (
        "physics",
        "core",
        "mechanics",
        "laws",
        "materials",
        "bodies",
        "boundaries",
        "engine",
        "packing",
        "observables",
        "apparatus",
        "effects",
        "laboratory",
        "sensitivity",
    ),
    "calibrate": (
        "core",
        "labtests",
        "io",
        "instrument_import",
        "simulation",
        "response",
        "inference",
        "designs",
        "discrepancy",
        "records",
        "view",
        "figures",
        "exporters",
        "reports",
        "verbs",
        "cli",
        "__main__",
    ),
    "studies": (
        "reporting",
        "chen_2023",
        "sealed",
        "open_cases",
        "infill",
        "sound_cases",
        "further_tests",
        "strengths",
        "liggghts",
        "diagnosis",
    ),
    "verification": (
        "reporting",
        "closed_forms",
        "shear_boxes",
        "made_lab",
        "convergence",
        "derivatives",
        "designs",
        "fresh_packings",
        "fuzz",
        "kills",
        "overdamped",
        "posterior",
        "audit",
        "beside",
        "hidden_soils",
        "other_tests",
        "sound_soils",
        "prior",
        "recovery",
        "calibration",
        "examples",
        "reference_beds",
        "resolution",
        "sizes",
        "starts",
        "tangents",
        "whole_curves",
        "scripts",
        "rows",
        "quick",
        "__main__",
    ),
}
SHARED_IN_FAMILY = "base"  # every member may import it
COMPOSES_FAMILY = ("__init__", "composite")  # may import every member
PLOTTERS = (
    "calibrate.figures",
    "calibrate.reports",
    "studies.chen_2023.figures",
    "studies.liggghts.codes",
    "studies.liggghts.export_contact",
    "studies.sealed.figures",
    "verification.examples",
    "verification.resolution",
    "verification.tangents",
    "verification.whole_curves",
)
MAX_FILE_LINES = 400
MAX_BODY_LINES = 60
UNSAFE_MODULES = ("pickle", "cloudpickle", "dill", "marshal", "shelve")
UNSAFE_CALLS = ("eval", "exec")


@dataclass(frozen=True)
class Import:
    """One imported module: its absolute name, the line, and whether import time sees it."""

    target: str
    line: int
    at_module_level: bool


@dataclass(frozen=True)
class Module:
    """One source file; `name` is dotted, and that of the folder for an `__init__.py`."""

    name: str
    path: Path
    lines: int
    tree: ast.Module
    imports: tuple[Import, ...]

    def at(self, line: int, message: str) -> str:
        return f"{self.path}:{line}: {message}"


Rule = Callable[[dict[str, Module]], list[str]]


def is_within(name: str, package: str) -> bool:
    return name == package or name.startswith(package + ".")


# ---------------------------------------------------------------- reading a tree


def module_name(path: Path, root: Path) -> str:
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def nodes_with_level(tree: ast.AST, at_module_level: bool = True) -> Iterator[tuple[ast.AST, bool]]:
    """Every node, and whether it runs when the module is imported (not in a function body)."""
    for node in ast.iter_child_nodes(tree):
        yield node, at_module_level
        is_function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        yield from nodes_with_level(node, at_module_level and not is_function)


def absolute_base(node: ast.ImportFrom, name: str, is_package: bool) -> str:
    """The absolute name of X in `from X import ...`, which may be relative."""
    if node.level == 0:
        return node.module or ""
    parents = name.split(".")
    up = node.level - 1 if is_package else node.level
    kept = parents[: len(parents) - up]
    return ".".join([*kept, *([node.module] if node.module else [])])


def imports_of(tree: ast.Module, name: str, is_package: bool, known: set[str]) -> Iterator[Import]:
    """All imports; `from package import x` means `package.x` where that is a module."""
    for node, top in nodes_with_level(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield Import(alias.name, node.lineno, top)
        elif isinstance(node, ast.ImportFrom):
            base = absolute_base(node, name, is_package)
            for alias in node.names:
                inner = f"{base}.{alias.name}"
                yield Import(inner if inner in known else base, node.lineno, top)


def read_modules(root: Path) -> dict[str, Module]:
    paths = [path for package in PACKAGES for path in sorted((root / package).rglob("*.py"))]
    names = {path: module_name(path, root) for path in paths}
    known = set(names.values())
    modules = {}
    for path, name in names.items():
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text, filename=str(path))
        imports = tuple(imports_of(tree, name, path.name == "__init__.py", known))
        modules[name] = Module(name, path.relative_to(root), text.count("\n"), tree, imports)
    return modules


# ---------------------------------------------------------------- the rules


def packages_are_ordered(modules: dict[str, Module]) -> list[str]:
    """What may import what: see ABOVE; nobody imports a benchmark."""
    return [
        module.at(item.line, f"{package} imports {item.target}")
        for module in modules.values()
        for package in [module.name.split(".")[0]]
        for item in module.imports
        for other in (*ABOVE.get(package, ()), *UNPACKAGED)
        if is_within(item.target, other)
    ]


def member_of(name: str, family: str) -> str:
    """The file or folder directly inside `family` that `name` belongs to."""
    return "__init__" if name == family else name.removeprefix(family + ".").split(".")[0]


def siblings_are_strangers(modules: dict[str, Module]) -> list[str]:
    """A member of a family imports its `base` and nothing else from the family."""
    return [
        module.at(item.line, f"{module.name} imports its sibling {item.target}")
        for family in FAMILIES
        for module in modules.values()
        if is_within(module.name, family)
        and (member := member_of(module.name, family)) not in COMPOSES_FAMILY
        for item in module.imports
        if is_within(item.target, family)
        and member_of(item.target, family) not in (member, SHARED_IN_FAMILY)
    ]


def folder_of(name: str) -> str:
    """The folder or loose module of a package that the module `name` belongs to."""
    return name.split(".")[1] if "." in name else "__init__"


def folders_are_ordered(modules: dict[str, Module]) -> list[str]:
    """Every folder has its place in ORDER, and imports nothing from a folder above it."""
    violations = []
    for module in modules.values():
        package, folder = module.name.split(".")[0], folder_of(module.name)
        order = ORDER[package]
        if folder == "__init__":
            continue
        if folder not in order:
            violations.append(module.at(1, f"{folder} has no place in ORDER"))
            continue
        violations += [
            module.at(item.line, f"{module.name} imports {item.target}, which stands above it")
            for item in module.imports
            if is_within(item.target, package)
            and folder_of(item.target) not in order[: order.index(folder) + 1]
        ]
    return violations


def only_plotters_plot(modules: dict[str, Module]) -> list[str]:
    """Only PLOTTERS import matplotlib."""
    return [
        module.at(item.line, f"{module.name} imports {item.target}")
        for module in modules.values()
        if not any(is_within(module.name, plotter) for plotter in PLOTTERS)
        for item in module.imports
        if is_within(item.target, "matplotlib")
    ]


def no_import_cycles(modules: dict[str, Module]) -> list[str]:
    """Imports at module level, those under TYPE_CHECKING included, form no cycle.

    That importing `a.b` first runs `a/__init__.py` is not counted as an edge.
    """
    graph = {
        name: {i.target for i in module.imports if i.at_module_level and i.target in modules}
        for name, module in modules.items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return ["import cycle: " + " <- ".join(error.args[1])]
    return []


def files_are_short(modules: dict[str, Module]) -> list[str]:
    """No file over 400 lines."""
    return [
        module.at(module.lines, f"file has {module.lines} lines")
        for module in modules.values()
        if module.lines > MAX_FILE_LINES
    ]


def bodies_are_short(modules: dict[str, Module]) -> list[str]:
    """No function body over 60 lines, counted from its first statement to its last."""
    return [
        module.at(node.lineno, f"body of {node.name} has {length} lines")
        for module in modules.values()
        for node in ast.walk(module.tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and (length := (node.body[-1].end_lineno or 0) - node.body[0].lineno + 1) > MAX_BODY_LINES
    ]


def nothing_runs_foreign_code(modules: dict[str, Module]) -> list[str]:
    """No pickle and its kin, no eval, no exec."""
    imports = [
        module.at(item.line, f"imports {item.target}")
        for module in modules.values()
        for item in module.imports
        if item.target.split(".")[0] in UNSAFE_MODULES
    ]
    calls = [
        module.at(node.lineno, f"calls {node.func.id}")
        for module in modules.values()
        for node in ast.walk(module.tree)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id in UNSAFE_CALLS
    ]
    return imports + calls


def files_say_what_they_are(modules: dict[str, Module]) -> list[str]:
    """Every file starts with a docstring."""
    return [
        module.at(1, "no docstring")
        for module in modules.values()
        if ast.get_docstring(module.tree) is None
    ]


RULES: tuple[Rule, ...] = (
    packages_are_ordered,
    folders_are_ordered,
    siblings_are_strangers,
    only_plotters_plot,
    no_import_cycles,
    files_are_short,
    bodies_are_short,
    nothing_runs_foreign_code,
    files_say_what_they_are,
)


@pytest.fixture(scope="module")
def tree() -> dict[str, Module]:
    """This repository's, read once."""
    return read_modules(ROOT)


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_tree_keeps_rule(rule: Rule, tree: dict[str, Module]):
    violations = rule(tree)
    assert not violations, "\n".join(violations)


# ---------------------------------------------------------------- the rules themselves

GOOD_TREE = {
    "jdem/__init__.py": "",
    "jdem/mechanics/contact.py": "import numpy as np\n",
    "jdem/laws/__init__.py": "from jdem.laws import base, eepa\nfrom jdem.laws.coulomb import B\n",
    "jdem/laws/base.py": "from jdem.mechanics import contact\n",
    "jdem/laws/eepa.py": "from jdem.laws.base import A\nfrom ..mechanics import contact\n",
    "jdem/laws/coulomb.py": "from . import base\n",
    "jdem/laws/composite.py": "from jdem.laws import coulomb, eepa\n",
    "jdem/effects/base.py": "from jdem.laws import eepa\n",
    "calibrate/figures/fit.py": "import matplotlib.pyplot as plt\n",
    "calibrate/reports/html.py": "from matplotlib import pyplot\n",
    "calibrate/cli.py": "from jdem import laws\ndef f():\n    from calibrate.core import main\n",
    "calibrate/core/main.py": "import calibrate.core.long\n",
    "calibrate/core/long.py": "x = 1\n" * (MAX_FILE_LINES - 1),
    "calibrate/core/body.py": "def f():\n" + "    x = 1\n" * MAX_BODY_LINES,
    "calibrate/core/shapes.py": "import jax\njax.eval_shape(len, 1)\n",
    "studies/sealed/run.py": "from calibrate.core import main\nfrom studies import reporting\n",
    "studies/reporting.py": "from jdem import laws\n",
    "verification/fuzz.py": "from studies import reporting\nfrom tests.support import malformed\n",
}

BAD_FILES = [
    (folders_are_ordered, "jdem/core/vector.py", "from jdem.laws import eepa\n"),
    (folders_are_ordered, "jdem/misc.py", "x = 1\n"),
    (folders_are_ordered, "calibrate/io/lab.py", "def f():\n    from calibrate import cli\n"),
    (folders_are_ordered, "calibrate/figures/fit.py", "import calibrate.reports.html\n"),
    (packages_are_ordered, "jdem/mechanics/contact.py", "import calibrate.cli\n"),
    (packages_are_ordered, "jdem/mechanics/contact.py", "from calibrate import cli\n"),
    (
        packages_are_ordered,
        "jdem/mechanics/contact.py",
        "def f():\n    import calibrate\n",
    ),
    (packages_are_ordered, "calibrate/core/main.py", "from studies.sealed import run\n"),
    (packages_are_ordered, "jdem/mechanics/contact.py", "def f():\n    import studies\n"),
    (packages_are_ordered, "studies/sealed/run.py", "from benchmarks import reporting\n"),
    (packages_are_ordered, "studies/sealed/run.py", "from tests.support import pieces\n"),
    (packages_are_ordered, "studies/sealed/run.py", "from verification import audit\n"),
    (packages_are_ordered, "calibrate/core/main.py", "from verification import rows\n"),
    (packages_are_ordered, "verification/audit.py", "import reporting\n"),
    (folders_are_ordered, "studies/new.py", "x = 1\n"),
    (folders_are_ordered, "studies/reporting.py", "from studies.sealed import run\n"),
    (siblings_are_strangers, "jdem/laws/eepa.py", "from jdem.laws.coulomb import B\n"),
    (siblings_are_strangers, "jdem/laws/eepa.py", "from jdem.laws import coulomb\n"),
    (siblings_are_strangers, "jdem/laws/eepa.py", "from jdem.laws import SomeLaw\n"),
    (siblings_are_strangers, "jdem/laws/eepa.py", "from . import coulomb\n"),
    (siblings_are_strangers, "jdem/laws/eepa.py", "from .coulomb import B\n"),
    (siblings_are_strangers, "jdem/laws/eepa.py", "def f():\n    import jdem.laws.coulomb\n"),
    (siblings_are_strangers, "jdem/laws/base.py", "from jdem.laws import eepa\n"),
    (siblings_are_strangers, "jdem/effects/suction.py", "from jdem.effects import creep\n"),
    (siblings_are_strangers, "jdem/apparatus/confined.py", "from .unconfined import A\n"),
    (siblings_are_strangers, "jdem/sensitivity/blend.py", "from .pathwise import A\n"),
    (only_plotters_plot, "calibrate/cli.py", "import matplotlib.pyplot as plt\n"),
    (only_plotters_plot, "jdem/mechanics/contact.py", "def f():\n    from matplotlib import cm\n"),
    (no_import_cycles, "jdem/mechanics/contact.py", "from jdem.laws import coulomb\n"),
    (
        no_import_cycles,
        "jdem/mechanics/contact.py",
        "if TYPE_CHECKING:\n    from ..laws.base import A\n",
    ),
    (no_import_cycles, "calibrate/core/main.py", "from . import main\n"),
    (files_are_short, "jdem/mechanics/contact.py", "x = 1\n" * (MAX_FILE_LINES + 1)),
    (
        bodies_are_short,
        "jdem/mechanics/contact.py",
        "def f():\n" + "    x = 1\n" * (MAX_BODY_LINES + 1),
    ),
    (
        bodies_are_short,
        "jdem/mechanics/contact.py",
        "class A:\n    async def f(self):\n" + "        x = 1\n" * (MAX_BODY_LINES + 1),
    ),
    (nothing_runs_foreign_code, "calibrate/core/main.py", "import pickle\n"),
    (nothing_runs_foreign_code, "calibrate/core/main.py", "def f():\n    from dill import load\n"),
    (nothing_runs_foreign_code, "calibrate/core/main.py", "x = eval('1')\n"),
    (nothing_runs_foreign_code, "calibrate/core/main.py", "exec('x = 1')\n"),
    (files_say_what_they_are, "calibrate/core/main.py", None),
]


def write_tree(root: Path, files: dict[str, str]) -> dict[str, Module]:
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text, encoding="utf-8")
    return read_modules(root)


def good_tree() -> dict[str, str]:
    return {name: '"""What it is."""\n' + text for name, text in GOOD_TREE.items()}


def test_empty_tree_passes_every_rule(tmp_path: Path):
    assert [rule(read_modules(tmp_path)) for rule in RULES] == [[]] * len(RULES)


def test_good_tree_passes_every_rule(tmp_path: Path):
    modules = write_tree(tmp_path, good_tree())
    assert len(modules) == len(GOOD_TREE)
    assert [rule(modules) for rule in RULES] == [[]] * len(RULES)


@pytest.mark.parametrize(("broken", "name", "text"), BAD_FILES)
def test_rule_catches_its_violation(broken: Rule, name: str, text: str | None, tmp_path: Path):
    """One bad file in a good tree: its rule complains once, and names that file."""
    bad = "x = 1\n" if text is None else '"""What it is."""\n' + text
    siblings = {
        "jdem/effects/creep.py",
        "jdem/apparatus/unconfined.py",
        "jdem/sensitivity/pathwise.py",
    }
    strangers = {sibling: '"""A sibling."""\n' for sibling in siblings}
    modules = write_tree(tmp_path, good_tree() | strangers | {name: bad})
    violations = broken(modules)
    assert len(violations) == 1
    assert name in violations[0] or module_name(Path(name), Path()) in violations[0]
