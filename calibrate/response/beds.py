"""What beds of one size would show of a soil, at once: features, observables and curves.

    soil -> base coordinates of the beds -> emulator -> features -> observables and curves

Values are means over packings.  Curves go straight through the features that are known of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from calibrate.labtests.diagnosis.base import TARGET, Feature
from calibrate.labtests.diagnosis.curves import TESTS
from calibrate.response.process import SoilResponse
from jdem.materials.soil import SoilParameters

FAR = 1.0  # mm, on which a curve goes on that is not known


class Beds(eqx.Module):
    """Features (m,) of a soil, and the observables and curves that they make up.

    centre (q,): ln p of the parameters `names` where base coordinates are zero; settings: the base
    coordinates of the beds; spread (p,) scales both; none (k,): strengths of effects, all zero;
    units (m,) take features from the library's size to the lab's; called: the lab's names of the
    confined and of the unconfined test.
    """

    soil: SoilResponse
    centre: Array
    settings: Array
    spread: Array
    none: Array
    units: Array
    names: tuple[str, ...] = eqx.field(static=True)
    features: tuple[Feature, ...] = eqx.field(static=True)
    called: tuple[str, str] = eqx.field(static=True)

    @property
    def observables(self) -> tuple[str, ...]:
        """Names of observables that are among the features."""
        return tuple(f.name for f in self.features if f.kind == TARGET)

    def logs(self, soil: SoilParameters) -> Array:
        """ln p over the centre (q,)."""
        logs = jnp.log(jnp.stack([jnp.asarray(getattr(soil, name)) for name in self.names]))
        return logs - self.centre

    def scaled(self, soil: SoilParameters) -> Array:
        """The scaled point (p,) of a soil."""
        return jnp.concatenate([self.logs(soil), self.settings]) / self.spread

    def holding(self) -> "Beds":
        """The same, of which only the soil varies, at an eighth of the cost; as it is where an
        effect is always at work."""
        if len(self.soil.always):
            return self
        count = len(self.names)
        soil = self.soil.holding(self.settings / self.spread[count:])
        return replace(self, soil=soil, settings=jnp.zeros(0), spread=self.spread[:count])

    def values(self, soil: SoilParameters) -> Array:
        """Features (m,) of a soil, in mm and N."""
        return self.units * self.soil(self.scaled(soil), self.none)

    def shown(self, values: Array) -> tuple[Mapping[str, Array], Mapping[str, Array]]:
        """Observables by name, and curves (points, 2) by test in mm and N, of features (m,)."""
        observables = {f.name: values[i] for i, f in enumerate(self.features) if f.kind == TARGET}
        pressed, crushed = self.called
        return observables, {pressed: self._pressed(values), crushed: self._crushed(values)}

    def continued(self, curves: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The same curves with a course of their own beyond what is known of them: a larger force
        at the top of the confined test, no force after the end of both."""
        pressed, crushed = (curves[test] for test in self.called)
        top = int(pressed[:, 1].argmax())
        spike = pressed[[top, top]] * [[1.0, 2.0], [1.0, 1.0]] + [[FAR, 0.0], [0.0, 0.0]]
        pressed = np.concatenate([pressed[: top + 1], spike, pressed[top + 1 :]])
        ends = ([pressed[-1, 0] - FAR, 0.0], [crushed[-1, 0] + FAR, 0.0])
        more = zip(self.called, (pressed, crushed), ends, strict=True)
        return {test: np.vstack([curve, end]) for test, curve, end in more}

    def _pressed(self, values: Array) -> Array:
        """To the largest force and back.  It begins at no force, where the straight line through
        the first two features leads."""
        (up, loads), (down, fewer) = self._of(TESTS[0], "loading"), self._of(TESTS[0], "unloading")
        ((top,), _), ((turn,), _) = (
            self._of(TESTS[0], kind) for kind in ("largest force", "travel at the top")
        )
        way = values[up]
        first = way[0] - (way[1] - way[0]) * loads[0] / (loads[1] - loads[0])
        travel = jnp.concatenate([first[None], way, (way[-1] + values[turn])[None], values[down]])
        force = jnp.concatenate([jnp.zeros(1), loads, values[top][None], fewer])
        return jnp.column_stack([travel - first, force])

    def _crushed(self, values: Array) -> Array:
        """From no force over the peak to the last displacement of a feature.

        Displacements of features count from a force, so the curve begins before, where the straight
        line through that zero and the first feature leads; it has a row at the zero.
        """
        rows, places = self._of(TESTS[1], "crushing")
        ((peak,), _), ((at,), _) = (
            self._of(TESTS[1], kind) for kind in ("peak force", "peak displacement")
        )
        seat = self.features[rows[0]].zero.force
        assert seat  # N
        before = places[0] * seat / jnp.maximum(values[rows[0]] - seat, seat)
        ends, none = jnp.concatenate([places, values[at][None]]), jnp.zeros(1)
        travel = jnp.concatenate([none, before[None], before + ends])
        force = jnp.concatenate([none, jnp.array([seat]), values[rows], values[peak][None]])
        return jnp.column_stack([travel, force])[jnp.argsort(travel)]

    def _of(self, test: str, kind: str) -> tuple[np.ndarray, np.ndarray]:
        """The numbers of all features of one kind, in the order of recording, and the forces (N)
        or displacements (mm) that they are read at."""
        return _in_order(self.features, test, kind)


def _in_order(features: Sequence[Feature], test: str, kind: str) -> tuple[np.ndarray, np.ndarray]:
    mine = [(f.abscissa, i) for i, f in enumerate(features) if (f.test, f.kind) == (test, kind)]
    mine.sort(reverse=kind == "unloading")
    return np.array([i for _, i in mine]), np.array([at for at, _ in mine])
