"""What a screening design cannot tell apart: its alias structure.

The least-squares main effects b1 of a design with columns X1 take up a share of every
interaction that is really there (Box and Draper):

    E[b1] = beta1 + A beta2,   A = (X1' X1)^-1 X1' X2

with X2 the columns of two-factor interactions.  In a regular fraction the shares are 0 and
+-1; in a Plackett-Burman design of 12 runs each interaction is spread in thirds.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from calibrate.designs.design import Design

SAME = 1e-9


@dataclass(frozen=True)
class Alias:
    """What the estimate of `effect` takes up besides it: (share, interaction) pairs."""

    effect: str
    others: tuple[tuple[float, str], ...]

    def __str__(self) -> str:
        if not self.others:
            return f"[{self.effect}] = {self.effect}"
        shares = " ".join(_signed(share, name) for share, name in self.others)
        return f"[{self.effect}] = {self.effect} {shares}"


def aliases(design: Design) -> tuple[Alias, ...]:
    """For each factor and dummy the interactions in it; then the groups of like interactions
    that are no main effect's alias.  Computed from the runs away from the centre.
    """
    corner = ~design.centre
    main = np.hstack([design.coded, design.dummies])[corner]
    pairs = list(itertools.combinations(range(len(design.factors)), 2))
    products = [main[:, a] * main[:, b] for a, b in pairs]
    names = [f"{design.names[a]}*{design.names[b]}" for a, b in pairs]
    interactions = np.array(products).reshape(len(pairs), len(main)).T
    base = np.column_stack([np.ones(len(main)), main])
    shares = np.linalg.lstsq(base, interactions)[0][1:]
    columns = design.names + design.dummy_names
    found = [Alias(name, _nonzero(row, names)) for name, row in zip(columns, shares, strict=True)]
    clear = np.flatnonzero(np.all(np.abs(shares) < 1 - SAME, axis=0))
    return tuple(found) + _alike(interactions[:, clear], [names[j] for j in clear])


def alias_table(design: Design) -> str:
    """`aliases` as lines of text."""
    return "\n".join(str(alias) for alias in aliases(design))


def _alike(interactions: np.ndarray, names: list[str]) -> tuple[Alias, ...]:
    """Groups of interactions with the same column up to its sign, each group once."""
    if not names:
        return ()
    gram = interactions.T @ interactions
    norms = np.sqrt(np.diag(gram))
    cosine = gram / np.outer(norms, norms)
    first = np.argmax(np.abs(cosine) > 1 - SAME, axis=0)
    groups = [
        Alias(
            names[leader],
            tuple(
                (float(np.sign(cosine[leader, other])), names[other])
                for other in range(leader + 1, len(names))
                if first[other] == leader
            ),
        )
        for leader in sorted(set(first.tolist()))
    ]
    return tuple(group for group in groups if group.others)


def _nonzero(row: np.ndarray, names: list[str]) -> tuple[tuple[float, str], ...]:
    return tuple((float(s), name) for s, name in zip(row, names, strict=True) if abs(s) > SAME)


def _signed(share: float, name: str) -> str:
    size = "" if abs(abs(share) - 1) < SAME else f"{abs(share):.3g} "
    return f"{'-' if share < 0 else '+'} {size}{name}"
