"""What a piece of code depends on, hashed: all definitions that can be reached from it.

A definition reaches those that it refers to, and the classes that its annotations name, as it
may be handed their objects; a class is reached whole.  Each is known by its normal form
(`calibrate.simulation.normal_form`) and by what its references are:

    colour_0 = H(text)        colour_k+1 = H(colour_k, colour_k of every reference in order)

until no more definitions can be told apart (Weisfeiler and Leman 1968; cycles do no harm).  The
hash is that of the set of colours.  So moving a definition, renaming it or its module, comments,
docstrings and definitions that are not reached change nothing; a formula, a constant, a default
or another definition in the place of one do.

Seen is what stands in the source: names, not strings given to `getattr`.  A subclass is reached
where it is named, not from its base, so the types of objects that are handed in are roots too.
A statement at module level that binds nothing belongs to every definition of its module and of
modules below.
"""

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from calibrate.simulation.definitions import Definition, Module, Sources
from calibrate.simulation.normal_form import Form, normal_form

Colours = dict[Definition, str]


@dataclass(frozen=True)
class Dependencies:
    """What definitions of some sources depend on."""

    sources: Sources
    _forms: dict[Definition, Form] = field(default_factory=dict, compare=False)

    def hash_of(self, roots: Iterable[tuple[str, str]]) -> str:
        """Hash of all that is reached from roots, each a module and a name in it.

        Raises ValueError for a module that is not among the sources.
        """
        reached = self.reached(roots)
        colours = {one: _hash(self._form(one).text) for one in reached}
        while True:
            finer = {one: self._refined(one, colours) for one in reached}
            if len(set(finer.values())) == len(set(colours.values())):
                return _hash(*sorted(set(finer.values())))
            colours = finer

    def reached(self, roots: Iterable[tuple[str, str]]) -> set[Definition]:
        """All definitions that the roots depend on, themselves included."""
        waiting = [one for root in roots for one in self._root(*root)]
        found: set[Definition] = set()
        while waiting:
            one = waiting.pop()
            if one not in found:
                found.add(one)
                waiting.extend(self._next(one))
        return found

    def _root(self, module: str, name: str) -> tuple[Definition, ...]:
        """The definitions of this name; all of the module where it has no such name."""
        whole = self.sources.module(module)
        if whole is None:
            raise ValueError(f"{module}: no source file of this module was found")
        return whole.definitions.get(name.split(".")[0], whole.every())

    def _next(self, one: Definition) -> Iterator[Definition]:
        form = self._form(one)
        for reference in form.references:
            yield from (target for target, _ in reference)
        for named in form.types:
            yield from self._classes(named)
        for module in self._enclosing(one.module):
            yield from module.loose

    def _classes(self, named: Definition, passed: frozenset[Definition] = frozenset()):
        """The classes that a name in an annotation stands for, through aliases of types."""
        if named in passed or not named.is_alias:
            return [] if named in passed else [named]
        form = self._form(named)
        targets = [target for reference in form.references for target, _ in reference]
        further = [self._classes(each, passed | {named}) for each in (*targets, *form.types)]
        return [each for found in further for each in found]

    def _enclosing(self, name: str) -> Iterator[Module]:
        """The module and the packages around it."""
        parts = name.split(".")
        names = (".".join(parts[: k + 1]) for k in range(len(parts)))
        return filter(None, map(self.sources.module, names))

    def _form(self, one: Definition) -> Form:
        if one not in self._forms:
            self._forms[one] = normal_form(one, self.sources)
        return self._forms[one]

    def _refined(self, one: Definition, colours: Colours) -> str:
        references = self._form(one).references
        return _hash(colours[one], *(_joined(reference, colours) for reference in references))


def _joined(reference, colours: Colours) -> str:
    """The colours of one reference, and which of a definition's names is meant."""
    return "+".join(sorted(f"{colours[target]}.{which}" for target, which in reference))


def _hash(*parts: str) -> str:
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]
