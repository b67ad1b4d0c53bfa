"""What a number depends on in a program's source: the definitions that are reached from its roots.

    key = hash of { definition : reached by name from the roots }

A definition is one statement at the level of a module: a function, a class, an assignment.  It
reaches what it names, followed through imports; a class is reached whole.  Docstrings, comments,
file names, and definitions that nothing reaches are left out, so a moved file, a comment or
another law beside the used one changes no key, and a changed formula or default does.
"""

import ast
import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

Place = tuple[str, str]  # module and name
WORDS_ONLY = ("About",)  # types of class variables that describe and compute nothing


@dataclass(frozen=True, eq=False)
class Module:
    """A parsed file: statements by the names that they bind, and what its imports bring."""

    statements: dict[str, list[ast.stmt]]
    imports: dict[str, Place]


@dataclass(frozen=True, eq=False)
class Sources:
    """All modules of one package, by dotted name."""

    modules: dict[str, Module]
    _dumps: dict[Place, str] = field(default_factory=dict)
    _hashes: dict[frozenset[Place], str] = field(default_factory=dict)

    @staticmethod
    def of(root: Path) -> "Sources":
        """The package in the folder `root`."""
        return Sources({name: _parsed(path, name) for name, path in _files(root)})

    def hash(self, roots: Iterable[Place]) -> str:
        """Of all definitions that the roots reach; found once for the same roots."""
        key = frozenset(roots)
        if key not in self._hashes:
            texts = sorted({self._dump(place) for place in self._reached(key)})
            self._hashes[key] = hashlib.sha256("\n".join(texts).encode()).hexdigest()[:16]
        return self._hashes[key]

    def reached(self, roots: Iterable[Place]) -> set[Place]:
        """Module and name of all definitions that the roots reach."""
        return self._reached(roots)

    def _reached(self, roots: Iterable[Place]) -> set[Place]:
        found: set[Place] = set()
        waiting = [place for root in roots if (place := self._resolved(*root))]
        while waiting:
            place = waiting.pop()
            if place not in found:
                found.add(place)
                waiting += self._named_in(place)
        return found

    def _named_in(self, place: Place) -> list[Place]:
        """The definitions that a definition names."""
        module, name = place
        names = (
            used for node in self.modules[module].statements[name] for used in _names(_bare(node))
        )
        return [found for used in names if (found := self._followed(module, used))]

    def _followed(self, module: str, dotted: str) -> Place | None:
        """The definition that a dotted name stands for in a module, if it is one of ours."""
        first, *rest = dotted.split(".")
        if first in self.modules[module].statements:
            return module, first
        source, name = self.modules[module].imports.get(first, ("", ""))
        inner = f"{source}.{name}".strip(".")
        if inner in self.modules:  # a module was imported: its attribute is meant
            return self._resolved(inner, rest[0]) if rest else None
        return self._resolved(source, name)

    def _resolved(self, module: str, name: str) -> Place | None:
        """Where a name of a module is defined, through what the module itself imports."""
        if module not in self.modules:
            return None
        if name in self.modules[module].statements:
            return module, name
        if name in self.modules[module].imports:
            return self._resolved(*self.modules[module].imports[name])
        return None

    def _dump(self, place: Place) -> str:
        if place not in self._dumps:
            module, name = place
            nodes = self.modules[module].statements[name]
            self._dumps[place] = "\n".join(ast.dump(_bare(node)) for node in nodes)
        return self._dumps[place]


def types_in(tree: Any) -> set[type]:
    """The classes of all objects of our making in a tree of modules, tuples and dictionaries."""
    if is_dataclass(tree) and not isinstance(tree, type):
        inside = [types_in(getattr(tree, f.name, None)) for f in fields(tree)]
        return {type(tree)}.union(*inside)
    if isinstance(tree, dict):
        return set().union(*[types_in(value) for value in tree.values()])
    if isinstance(tree, list | tuple):
        return set().union(*[types_in(value) for value in tree])
    return set()


def places_of(classes: Iterable[type]) -> list[Place]:
    """Where classes are defined."""
    return [(each.__module__, each.__qualname__.split(".")[0]) for each in classes]


def _files(root: Path) -> Iterator[tuple[str, Path]]:
    for path in sorted(root.rglob("*.py")):
        parts = (root.name, *path.relative_to(root).with_suffix("").parts)
        yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path


def _parsed(path: Path, name: str) -> Module:
    tree = ast.parse(path.read_bytes(), str(path))
    statements: dict[str, list[ast.stmt]] = {}
    imports: dict[str, Place] = {}
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in tree.body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            imports.update(_imported(node, package))
        else:
            for bound in _bound(node):
                statements.setdefault(bound, []).append(node)
    return Module(statements, imports)


def _imported(node: ast.Import | ast.ImportFrom, package: str) -> dict[str, Place]:
    if isinstance(node, ast.Import):
        return {alias.asname or alias.name.split(".")[0]: ("", alias.name) for alias in node.names}
    source = node.module or ""
    if node.level:
        parts = package.split(".")
        source = ".".join([*parts[: len(parts) - node.level + 1], *filter(None, [node.module])])
    return {alias.asname or alias.name: (source, alias.name) for alias in node.names}


def _bound(node: ast.stmt) -> list[str]:
    """Names that a statement at module level binds."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return [node.name]
    return [
        each.id
        for each in ast.walk(node)
        if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)
    ]


def _names(node: ast.AST) -> Iterator[str]:
    """Names that a statement uses, `a.b` for attributes of a name."""
    for each in ast.walk(node):
        if isinstance(each, ast.Attribute) and isinstance(each.value, ast.Name):
            yield f"{each.value.id}.{each.attr}"
        elif isinstance(each, ast.Name):
            yield each.id


class _Bare(ast.NodeTransformer):
    """Drops docstrings, annotations of functions, and class variables that are only words."""

    def _body(self, node: Any) -> Any:
        self.generic_visit(node)
        first = node.body[0]
        if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
            node.body = node.body[1:]
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> Any:
        node.returns = None
        return self._body(node)

    def visit_ClassDef(self, node: ast.ClassDef) -> Any:
        return self._body(node)

    def visit_arg(self, node: ast.arg) -> Any:
        node.annotation = None
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> Any:
        words = ast.unparse(node.annotation)
        return None if any(f"ClassVar[{kind}]" in words for kind in WORDS_ONLY) else node


def _bare(node: ast.stmt) -> ast.stmt:
    """The statement without what changes no number; made once, in place."""
    if not getattr(node, "is_bare", False):
        node = _Bare().visit(node)
        node.is_bare = True  # type: ignore[attr-defined]
    return node
