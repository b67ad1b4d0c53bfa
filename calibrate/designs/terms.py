"""Terms of polynomial models: products of powers of factors, such as A*B or A^2*B.

A term is its tuple of powers, one for each factor.  The intercept belongs to every model and
is no term.  A model is hierarchical if with each term it has all terms that divide it.
"""

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibrate.core.errors import BadValue, shown, suggestion


@dataclass(frozen=True)
class Term:
    """The product of each factor to its power; `powers` has one entry for each factor."""

    powers: tuple[int, ...]

    @property
    def order(self) -> int:
        return sum(self.powers)

    def values(self, X: np.ndarray) -> np.ndarray:
        """The term (n,) at points (n, p)."""
        return np.prod(X ** np.array(self.powers), axis=1)

    def slopes(self, X: np.ndarray) -> np.ndarray:
        """Derivatives (n, p) of the term with respect to each factor at points (n, p)."""
        columns = []
        for factor, power in enumerate(self.powers):
            lowered = list(self.powers)
            lowered[factor] = max(power - 1, 0)
            columns.append(power * Term(tuple(lowered)).values(X))
        return np.column_stack(columns)

    def divides(self, other: "Term") -> bool:
        """Whether `other` contains every factor at least to this term's power."""
        return all(mine <= its for mine, its in zip(self.powers, other.powers, strict=True))

    def label(self, names: Sequence[str]) -> str:
        """The term in the names of its factors, such as "A^2*B"."""
        parts = [
            name if power == 1 else f"{name}^{power}"
            for name, power in zip(names, self.powers, strict=True)
            if power
        ]
        return "*".join(parts) or "1"


Terms = tuple[Term, ...]


def of_order(factors: int, order: int) -> Terms:
    """All terms of exactly that order, pure powers last."""
    found = [
        Term(tuple(chosen.count(factor) for factor in range(factors)))
        for chosen in itertools.combinations_with_replacement(range(factors), order)
    ]
    return tuple(sorted(found, key=lambda term: max(term.powers)))


def linear(factors: int) -> Terms:
    """Main effects of `factors` factors."""
    return of_order(factors, 1)


def quadratic(factors: int) -> Terms:
    """The full second-order model."""
    return linear(factors) + of_order(factors, 2)


def cubic(factors: int) -> Terms:
    """The full third-order model."""
    return quadratic(factors) + of_order(factors, 3)


def parse(text: str, names: Sequence[str]) -> Terms:
    """Terms written as "A + B + A*B + A^2" in the names of the factors; `BadValue` if unknown."""
    terms = tuple(_parse_one(part.strip(), names) for part in text.split("+"))
    if len(set(terms)) < len(terms):
        raise BadValue(f"a term stands twice in {shown(text)}", "write it once", "terms")
    return terms


def _parse_one(text: str, names: Sequence[str]) -> Term:
    powers = dict.fromkeys(names, 0)
    for part in text.replace("**", "^").split("*"):
        name, _, power = (piece.strip() for piece in part.partition("^"))
        if name not in powers:
            raise BadValue(f"no factor {shown(name)}", suggestion(name, names), "terms")
        if power and not re.fullmatch("[1-9]", power):
            raise BadValue(f"the power {shown(power)}", "give a whole number from 1 to 9", "terms")
        powers[name] += int(power or 1)
    return Term(tuple(powers.values()))


def removable(terms: Terms) -> Terms:
    """Terms that no other term contains: leaving one out keeps the model hierarchical."""
    return tuple(
        term for term in terms if not any(term != other and term.divides(other) for other in terms)
    )


def matrix(terms: Terms, X: np.ndarray) -> np.ndarray:
    """The model matrix (n, 1 + terms) at points (n, p): a column of ones, then each term."""
    return np.column_stack([np.ones(len(X)), *(term.values(X) for term in terms)])
