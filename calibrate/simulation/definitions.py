"""Python sources as definitions: what a module binds at its level, and what a name stands for.

A definition is one statement at module level (function, class, assignment) with the names that
it binds.  A name is followed through imports to the definition that it stands for; names of
other packages, and Python's own, stay text.  Nothing is imported or run; a file is parsed when
it is first asked for.
"""

import ast
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

SCOPES = (
    ast.FunctionDef,
    ast.AsyncFunctionDef,
    ast.ClassDef,
    ast.Lambda,
    ast.ListComp,
    ast.SetComp,
    ast.DictComp,
    ast.GeneratorExp,
)
DEFINED = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
ASIDE = ("TYPE_CHECKING", "typing.TYPE_CHECKING", "__name__ == '__main__'")  # blocks left out


@dataclass(frozen=True, eq=False)
class Definition:
    """A statement at module level; `names` are those that it binds."""

    module: str
    names: tuple[str, ...]
    statement: ast.stmt

    @property
    def is_alias(self) -> bool:
        """Whether it is neither a function nor a class: a constant, or an alias of types."""
        return not isinstance(self.statement, DEFINED)


class Symbol(NamedTuple):
    """What a name stands for: definitions, or else a `module`, or else `text`.

    More than one definition where a module binds the name several times.
    """

    name: str = ""
    definitions: tuple[Definition, ...] = ()
    module: str = ""
    text: str = ""


class Imported(NamedTuple):
    """`from module import name`; without a name the module itself."""

    module: str
    name: str = ""


@dataclass(frozen=True, eq=False)
class Module:
    """A parsed file.  `loose` are statements that bind nothing: settings, registrations."""

    name: str
    is_package: bool
    definitions: Mapping[str, tuple[Definition, ...]]
    loose: tuple[Definition, ...]
    imports: Mapping[str, Imported]

    def every(self) -> tuple[Definition, ...]:
        """All definitions."""
        return tuple(dict.fromkeys(one for each in self.definitions.values() for one in each))


@dataclass(frozen=True)
class Sources:
    """The files of some packages: each top-level name with its folder, or its only file."""

    places: Mapping[str, Path]
    _parsed: dict[str, Module | None] = field(default_factory=dict, compare=False)

    def module(self, name: str) -> Module | None:
        """The module of this dotted name; None if it is none of these packages'."""
        if name not in self._parsed:
            path = self._path(name)
            self._parsed[name] = None if path is None else _parsed(name, path)
        return self._parsed[name]

    def symbol(self, module: Module, name: str) -> Symbol:
        """What `name` stands for at the level of a module."""
        if name in module.definitions:
            return Symbol(name, module.definitions[name])
        if name in module.imports:
            return self.imported(module.imports[name])
        return Symbol(text=name)

    def imported(self, what: Imported) -> Symbol:
        """What an import brings."""
        if self.module(what.module) is None:
            return Symbol(text=".".join(filter(None, what)))
        whole = Symbol(module=what.module)
        return self.attribute(whole, what.name) if what.name else whole

    def attribute(self, whole: Symbol, name: str) -> Symbol:
        """What `module.name` stands for; what cannot be found may come from all of the module."""
        module = self.module(whole.module)
        assert module is not None
        found = self.symbol(module, name)
        inside = f"{whole.module}.{name}"
        if not found.text or name in module.imports:
            return found
        return Symbol(module=inside) if self.module(inside) else whole._replace(text=name)

    def _path(self, name: str) -> Path | None:
        top, *rest = name.split(".")
        place = self.places.get(top)
        if place is None or (rest and place.is_file()):
            return None
        below = place.joinpath(*rest)
        tries = (below, below / "__init__.py", below.with_suffix(".py"))
        return next((path for path in tries if path.is_file()), None)


def within(nodes: Iterable[ast.AST]) -> Iterator[ast.AST]:
    """All nodes of one scope, the outsides of scopes within it included."""
    for node in nodes:
        yield node
        if not isinstance(node, SCOPES):
            yield from within(ast.iter_child_nodes(node))


def bound(nodes: Iterable[ast.AST]) -> dict[str, None]:
    """Names that nodes of one scope bind, imports apart, in their order."""
    names, elsewhere = {}, set()
    for node in within(nodes):
        if isinstance(node, ast.Global | ast.Nonlocal):
            elsewhere.update(node.names)
        elif isinstance(node, ast.Name) and not isinstance(node.ctx, ast.Load):
            names[node.id] = None
        elif isinstance(node, (*DEFINED, ast.ExceptHandler, ast.MatchAs, ast.MatchStar)):
            names[node.name] = None
        elif isinstance(node, ast.MatchMapping):
            names[node.rest] = None
    return {name: None for name in names if name and name not in elsewhere}


def imports(nodes: Iterable[ast.AST], module: str, is_package: bool) -> dict[str, Imported]:
    """What nodes of one scope import, by local name."""
    found = {}
    for node in within(nodes):
        if isinstance(node, ast.Import):
            for alias in node.names:
                whole = alias.name if alias.asname else alias.name.split(".")[0]
                found[alias.asname or whole] = Imported(whole)
        elif isinstance(node, ast.ImportFrom):
            source = _absolute(node, module, is_package)
            for alias in node.names:
                if alias.name == "*":
                    raise ValueError(f"{module}: line {node.lineno}: name what is imported, not *")
                found[alias.asname or alias.name] = Imported(source, alias.name)
    return found


def _absolute(node: ast.ImportFrom, module: str, is_package: bool) -> str:
    if not node.level:
        return node.module or ""
    parts = module.split(".")
    up = node.level - 1 if is_package else node.level
    return ".".join([*parts[: len(parts) - up], *filter(None, [node.module])])


def _parsed(name: str, path: Path) -> Module:
    is_package = path.name == "__init__.py"
    body = ast.parse(path.read_bytes(), str(path)).body
    definitions: dict[str, tuple[Definition, ...]] = {}
    loose = []
    for statement in body:
        one = Definition(name, tuple(bound([statement])), statement)
        for each in one.names:
            definitions[each] = (*definitions.get(each, ()), one)
        if not one.names and _acts(statement):
            loose.append(one)
    return Module(name, is_package, definitions, tuple(loose), imports(body, name, is_package))


def _acts(statement: ast.stmt) -> bool:
    """Whether a statement that binds nothing may change something when it runs."""
    if isinstance(statement, ast.If):
        return ast.unparse(statement.test) not in ASIDE
    return not (isinstance(statement, ast.Import | ast.ImportFrom | ast.Pass) or is_text(statement))


def is_text(node: ast.AST) -> bool:
    """Whether a statement is a docstring, or a string that stands there like one."""
    value = node.value if isinstance(node, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)
