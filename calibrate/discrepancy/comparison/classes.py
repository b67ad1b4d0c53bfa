"""Which effects this data cannot tell apart: classes of alike projected signatures.

Two effects with signal-to-noise s and confusability c are told apart with 80 % power when
s sqrt(1 - c^2) >= 2.8 (a two-sided test at 5 %: 1.96 + 0.84).  Classes are made at a stated
signal-to-noise, by complete linkage: any two members of a class are alike.  Effects that are
one-sided both are alike only with equal sign.
"""

from dataclasses import dataclass

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

JOINED = " / "  # between effects of one class, in its label
TOGETHER = " + "  # between effects at work at once
SEPARABLE = 2.8  # signal-to-noise between two hypotheses for 80 % power
REFERENCE_SNR = 6.0  # at which classes are made
INVISIBLE = 0.02  # visibility below which calibration absorbs an effect


@dataclass(frozen=True)
class Classes:
    """Effects by class, and those that the base parameters mimic."""

    names: tuple[str, ...]
    members: tuple[tuple[str, ...], ...]
    absorbed: tuple[str, ...]

    def of(self, name: str) -> tuple[str, ...]:
        """The class that an effect belongs to."""
        return next(group for group in self.members if name in group)

    def label(self, name: str) -> str:
        """A class's label: its members, joined; other words (none, unknown) stay."""
        return JOINED.join(self.of(name)) if name in self.names else name

    def alike(self) -> list[list[str]]:
        """Classes of more than one effect."""
        return [list(group) for group in self.members if len(group) > 1]


def classes(
    names: tuple[str, ...],
    confusability: np.ndarray,
    one_sided: np.ndarray,
    visibility: np.ndarray,
) -> Classes:
    """Classes at the reference signal-to-noise."""
    apart = separation(confusability, one_sided)
    groups: list[tuple[str, ...]] = [tuple(names)] if len(names) == 1 else []
    if len(names) > 1:
        np.fill_diagonal(apart, 0.0)
        tree = linkage(squareform(apart, checks=False), method="complete")
        number = fcluster(tree, SEPARABLE / REFERENCE_SNR, criterion="distance")
        order = list(dict.fromkeys(number))
        groups = [
            tuple(n for n, c in zip(names, number, strict=True) if c == group) for group in order
        ]
    absorbed = tuple(n for n, v in zip(names, visibility, strict=True) if v < INVISIBLE)
    return Classes(tuple(names), tuple(groups), absorbed)


def separation(confusability: np.ndarray, one_sided: np.ndarray) -> np.ndarray:
    """sqrt(1 - c^2) (k, k); 1 where opposite signs tell one-sided effects apart."""
    both = np.outer(one_sided, one_sided)
    cosine = np.where(both, np.maximum(confusability, 0.0), np.abs(confusability))
    return np.sqrt(np.maximum(1 - cosine**2, 0.0))
