"""What simulations said: features, their slopes, and the scatter between packings.

    f(delta, e) = mean + B delta + G e            delta = ln p - ln p0,  e in typical strengths

B (m, p) are slopes per ln p with a normal prior on delta; G (m, k) are slopes of the effects
per typical strength, at strength 0.  Whoever fills this runs the simulator; an emulator of
values and slopes may stand behind it for what is not linear.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from calibrate.labtests.diagnosis.base import Feature

FEWEST_SPECIMENS = 8  # simulated, of which a description tells the scatter


@dataclass(frozen=True)
class EffectCandidate:
    """A candidate: whether its strength can only be positive, the strength that is typical (in
    `unit`), its kind (`jdem.effects.base.KINDS`), how many typical strengths simulations reach."""

    name: str
    one_sided: bool
    typical: float
    unit: str = ""
    kind: str = "soil"
    reach: float = 3.0


class Emulator(Protocol):
    """Values (m,), slopes (m, p) and effects' slopes (m, k, per typical strength) at a point;
    `wrong`: directions (m, q) in which these values may be wrong, one standard deviation each."""

    def __call__(
        self, delta: np.ndarray, strengths: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]: ...

    def wrong(self, delta: np.ndarray, strengths: np.ndarray) -> np.ndarray: ...


@dataclass(frozen=True, eq=False)
class Linearised:
    """A linear description of the simulator in the space of features.

    mean (m,) over `mean_specimens` packings; base_slopes (m, p) per ln p with prior_sd (p,) and
    standard errors base_errors (m, p); effect_slopes (m, k) per typical strength;
    packing_residuals (n, m): features of n simulated specimens minus their mean; extra (m, m):
    covariance of a specimen by what packings do not contain (density, moisture), sensor (m, m) by
    instruments; wrong (m, q): directions in which the description may be wrong, one standard
    deviation each.  rows (m,): which of the emulator's features it describes; on: a mask of which
    of its effects are candidates, the others being at strength 0; None: all of them.
    """

    features: tuple[Feature, ...]
    mean: np.ndarray
    base_names: tuple[str, ...]
    base_slopes: np.ndarray
    prior_sd: np.ndarray
    effects: tuple[EffectCandidate, ...]
    effect_slopes: np.ndarray
    packing_residuals: np.ndarray
    mean_specimens: int
    base_errors: np.ndarray
    extra: np.ndarray
    sensor: np.ndarray
    wrong: np.ndarray
    emulator: Emulator | None = field(default=None)
    rows: np.ndarray | None = None
    on: np.ndarray | None = None

    def __post_init__(self):
        m, p, k = len(self.features), len(self.base_names), len(self.effects)
        shapes = {
            "mean": (m,), "base_slopes": (m, p), "prior_sd": (p,), "effect_slopes": (m, k),
            "base_errors": (m, p), "extra": (m, m), "sensor": (m, m),
            "wrong": (m, *self.wrong.shape[1:2]),
        }  # fmt: skip
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} has shape {getattr(self, name).shape}, not {shape}")
        residuals, few = self.packing_residuals.shape, FEWEST_SPECIMENS
        if residuals[1:] != (m,) or residuals[0] < few:
            raise ValueError(f"packing_residuals must have at least {few} rows of {m} features")

    @property
    def own_error(self) -> np.ndarray:
        """Covariance (m, m) of what the description itself is wrong by, beside its slopes."""
        return self.wrong @ self.wrong.T

    @property
    def effect_names(self) -> tuple[str, ...]:
        return tuple(effect.name for effect in self.effects)

    @property
    def one_sided(self) -> np.ndarray:
        """Which effects can only have positive strength, shape (k,)."""
        return np.array([effect.one_sided for effect in self.effects], bool)

    def at(self, delta: np.ndarray, strengths: np.ndarray):
        """Values (m,), slopes (m, p) and effects' slopes (m, k) at a point."""
        if self.emulator is not None:
            values, base, effects = self.emulator(delta, self._every(strengths))
            effects = effects if self.on is None else effects[:, self.on]
            return tuple(map(self._mine, (values, base, effects)))
        values = self.mean + self.base_slopes @ delta + self.effect_slopes @ strengths
        return values, self.base_slopes, self.effect_slopes

    def wrong_at(self, delta: np.ndarray, strengths: np.ndarray) -> np.ndarray:
        """Directions (m, q) in which the values at a point may be wrong."""
        if self.emulator is None:
            return self.wrong
        return self._mine(self.emulator.wrong(delta, self._every(strengths)))

    def _mine(self, found: np.ndarray) -> np.ndarray:
        return found if self.rows is None else found[self.rows]

    def _every(self, strengths: np.ndarray) -> np.ndarray:
        """Strengths of all the emulator's effects."""
        if self.on is None:
            return strengths
        every = np.zeros(len(self.on))
        every[self.on] = strengths
        return every

    def without_effects(self, names: Sequence[str]) -> "Linearised":
        """The same without some candidates."""
        keep = np.array([effect.name not in names for effect in self.effects], bool)
        on = keep
        if self.on is not None:
            on = self.on.copy()
            on[self.on] = keep
        return replace(
            self, on=on, effect_slopes=self.effect_slopes[:, keep],
            effects=tuple(e for e, kept in zip(self.effects, keep, strict=True) if kept),
        )  # fmt: skip

    def only_features(self, index: np.ndarray) -> "Linearised":
        """The same for a subset of the features."""
        block = np.ix_(index, index)
        return replace(
            self,
            features=tuple(self.features[i] for i in index),
            mean=self.mean[index],
            base_slopes=self.base_slopes[index],
            effect_slopes=self.effect_slopes[index],
            packing_residuals=self.packing_residuals[:, index],
            base_errors=self.base_errors[index],
            extra=self.extra[block],
            sensor=self.sensor[block],
            wrong=self.wrong[index],
            rows=np.asarray(index) if self.rows is None else self.rows[index],
        )
