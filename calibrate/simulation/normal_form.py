"""A definition's normal form: what it does, without how it is written down or where it stands.

Left out are comments, docstrings, annotations, line numbers, imports, a class's words about
itself (`WORDS`), and the definition's own name.  What a name stands for is a reference, written
as a hole <> whatever its local name is; a name of another package is written in full,
@jax.numpy.sum, and so is one of Python's own.  The text is this file's own, not `ast.dump`'s,
which differs between versions of Python.

An annotation gives no text: the classes that it names are kept apart, as the types of objects
that a definition may be handed.
"""

import ast
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from calibrate.simulation.definitions import (
    DEFINED,
    Definition,
    Module,
    Sources,
    Symbol,
    bound,
    imports,
    is_text,
)

Reference = tuple[tuple[Definition, int], ...]  # definitions, and which of their names it is
Scope = Mapping[str, Symbol | None]  # None: a local name
Scopes = tuple[Scope, ...]

SKIPPED = frozenset({"ctx", "kind", "type_comment", "type_ignores", "lineno", "end_lineno"})
WORDS = ("About",)  # types of class variables that describe and compute nothing: left out
CLASS_BODY: Scope = {}  # binds nothing for the functions within


class Form(NamedTuple):
    """A definition's text, its references in the order of the holes, and types it may be handed."""

    text: str
    references: tuple[Reference, ...]
    types: tuple[Definition, ...]


def normal_form(definition: Definition, sources: Sources) -> Form:
    """The normal form of a definition among these sources."""
    module = sources.module(definition.module)
    assert module is not None
    writer = _Writer(sources, module, definition.statement)
    writer.node(definition.statement, ())
    return Form("".join(writer.parts), tuple(writer.references), tuple(dict.fromkeys(writer.types)))


class _Writer:
    """Writes nodes into `parts`; `scopes` are those around a node, the module's own apart."""

    def __init__(self, sources: Sources, module: Module, top: ast.stmt):
        self._sources, self._module, self._top = sources, module, top
        self.parts: list[str] = []
        self.references: list[Reference] = []
        self.types: list[Definition] = []

    def node(self, node: ast.AST, scopes: Scopes) -> None:
        special = SPECIAL.get(type(node))
        if special is None:
            self._plain(node, scopes)
        else:
            special(self, node, scopes)

    def _plain(self, node: ast.AST, scopes: Scopes, but: Sequence[str] = ()) -> None:
        """Any node: its kind, and each of its fields that is not empty."""
        self.parts.append(f"{type(node).__name__}(")
        for name, value in ast.iter_fields(node):
            if name not in SKIPPED and name not in but:
                self._field(name, value, scopes)
        self.parts.append(")")

    def _field(self, name: str, value, scopes: Scopes) -> None:
        if isinstance(value, list):
            value = [each for each in value if not (is_text(each) or isinstance(each, ast.Pass))]
        if value is None or value == []:
            return
        self.parts.append(f"{name}=")
        for each in value if isinstance(value, list) else [value]:
            if isinstance(each, ast.AST):
                self.node(each, scopes)
            else:
                self.parts.append(repr(each))
            self.parts.append(",")

    # ---- names

    def _constant(self, node: ast.Constant, scopes: Scopes) -> None:
        self.parts.append(repr(node.value))

    def _name(self, node: ast.Name | ast.Attribute, scopes: Scopes) -> None:
        """A name with its attributes, as far as they are known to stand for something."""
        found = self._found(node, scopes)
        if found is None:
            assert isinstance(node, ast.Attribute)
            self.node(node.value, scopes)
            self.parts.append(f".{node.attr}")
            return
        symbol, rest = found
        self._refer(symbol)
        self.parts.extend(f".{attribute}" for attribute in rest)

    def _refer(self, symbol: Symbol) -> None:
        if symbol.definitions:
            found = symbol.definitions
            self.references.append(tuple((one, one.names.index(symbol.name)) for one in found))
            self.parts.append("<>")
        elif symbol.module:
            module = self._sources.module(symbol.module)
            assert module is not None
            self.references.append(tuple((one, 0) for one in module.every()))
            self.parts.append(f"<>.{symbol.text}" if symbol.text else "<>")
        else:
            self.parts.append(symbol.text if symbol.name else f"@{symbol.text}")

    def _found(self, node: ast.expr, scopes: Scopes) -> tuple[Symbol, list[str]] | None:
        """What name.attribute.attribute stands for, and attributes that are left."""
        rest: list[str] = []
        base = node
        while isinstance(base, ast.Attribute):
            rest.insert(0, base.attr)
            base = base.value
        if not isinstance(base, ast.Name):
            return None
        symbol = self._symbol(base, scopes)
        while rest and symbol.module and not symbol.text:
            symbol = self._sources.attribute(symbol, rest.pop(0))
        return symbol, rest

    def _symbol(self, node: ast.Name, scopes: Scopes) -> Symbol:
        local = Symbol(name=node.id, text=node.id)
        if scopes and scopes[-1] is CLASS_BODY and not isinstance(node.ctx, ast.Load):
            return local
        for scope in reversed(scopes):
            if node.id in scope:
                return scope[node.id] or local
        return self._sources.symbol(self._module, node.id)

    def _imported(self, node: ast.Import | ast.ImportFrom, scopes: Scopes) -> None:
        """An import within a definition: what it brings is referred to, used or not."""
        for what in self._imports([node]).values():
            self._refer(self._sources.imported(what))

    def _imports(self, nodes: Sequence[ast.AST]):
        return imports(nodes, self._module.name, self._module.is_package)

    # ---- scopes

    def _scope(self, nodes: Sequence[ast.AST], names: Sequence[str] = ()) -> Scope:
        brought = {name: self._sources.imported(i) for name, i in self._imports(nodes).items()}
        return {**dict.fromkeys(names), **bound(nodes), **brought}

    def _function(self, node, scopes: Scopes) -> None:
        """Decorators and defaults belong to the scope around, the rest to the function's own."""
        body = node.body if isinstance(node.body, list) else [node.body]
        every = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
        every += filter(None, [node.args.vararg, node.args.kwarg])
        self.parts.append(f"{type(node).__name__}({self._own_name(node)}")
        self._field("decorators", getattr(node, "decorator_list", []), scopes)
        self.node(node.args, scopes)
        self._types(getattr(node, "returns", None), scopes)
        own = self._scope(body, [argument.arg for argument in every])
        self._field("body", body, (*scopes, own))
        self.parts.append(")")

    def _argument(self, node: ast.arg, scopes: Scopes) -> None:
        self.parts.append(node.arg)
        self._types(node.annotation, scopes)

    def _class(self, node: ast.ClassDef, scopes: Scopes) -> None:
        self.parts.append(f"ClassDef({self._own_name(node)}")
        self._field("bases", node.bases, scopes)
        self._field("keywords", node.keywords, scopes)
        self._field("decorators", node.decorator_list, scopes)
        self._field("body", node.body, (*scopes, CLASS_BODY))
        self.parts.append(")")

    def _own_name(self, node) -> str:
        named = isinstance(node, DEFINED) and node is not self._top
        return f"{node.name} " if named else ""

    def _comprehension(self, node, scopes: Scopes) -> None:
        """The first iterable belongs to the scope around, as in Python."""
        first = node.generators[0]
        own = self._scope([each.target for each in node.generators])
        self._plain(node, (*scopes, own), but=("generators",))
        self.node(first.iter, scopes)
        self._plain(first, (*scopes, own), but=("iter",))
        self._field("more", node.generators[1:], (*scopes, own))

    # ---- annotations

    def _annotated(self, node: ast.AnnAssign, scopes: Scopes) -> None:
        """Whether something is a field or the class's own matters, its type does not."""
        kind = ast.unparse(node.annotation)
        if any(f"ClassVar[{words}]" in kind for words in WORDS):
            return
        self._types(node.annotation, scopes)
        shared = "ClassVar" in kind
        self.parts.append("ClassVar " if shared else "Field ")
        self._plain(node, scopes, but=("annotation", "simple"))

    def _types(self, node: ast.AST | None, scopes: Scopes) -> None:
        """Keeps what an annotation names."""
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            node = _expression(node.value)
        if node is None:
            return
        if isinstance(node, ast.Name | ast.Attribute):
            found = self._found(node, scopes)
            self.types.extend(found[0].definitions if found else ())
            return
        for child in ast.iter_child_nodes(node):
            self._types(child, scopes)


def _expression(text: str) -> ast.AST | None:
    """An annotation that is a string; None if it is no Python, as a shape."""
    try:
        return ast.parse(text, mode="eval").body
    except SyntaxError:
        return None


SPECIAL = {
    ast.Constant: _Writer._constant,
    ast.Name: _Writer._name,
    ast.Attribute: _Writer._name,
    ast.Import: _Writer._imported,
    ast.ImportFrom: _Writer._imported,
    ast.FunctionDef: _Writer._function,
    ast.AsyncFunctionDef: _Writer._function,
    ast.Lambda: _Writer._function,
    ast.arg: _Writer._argument,
    ast.ClassDef: _Writer._class,
    ast.ListComp: _Writer._comprehension,
    ast.SetComp: _Writer._comprehension,
    ast.DictComp: _Writer._comprehension,
    ast.GeneratorExp: _Writer._comprehension,
    ast.AnnAssign: _Writer._annotated,
}
