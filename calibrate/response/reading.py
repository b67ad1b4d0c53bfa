"""How a load cell reads: its errors, a first-order low-pass filter along the platen's path, and the
curve of a soil that is crushed.

    d_shown = d + C F + s (1 - exp(-F/F_s))        compliance C of the frame, seating gap s
    F_shown = (1 + g) R + b + c t                  gain g, offset b, drift c of the load cell
    dR/dx = (F - R)/L      L = v tau               x: the platen's path, v its speed, tau the lag

The filter is exact where F is straight between points: with b = L dF/dx of an interval and t from
its beginning,

    R(x + t) = F(x + t) - b + (R(x) - F(x) + b) exp(-t/L)

Arrays are of one specimen.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from calibrate.labtests.diagnosis.base import Feature
from jdem.core.quantity import Real

STEPS = 13  # of Newton's method, before the last; a reading that only tends to a level needs more
BEYOND = 1.5  # of the last displacement of crushing, up to which a curve goes on
LARGEST = 1e5  # N, mm; beyond it is no soil, as fits may try
CRUSHING, PEAK_FORCE, PEAK_DISPLACEMENT = "crushing", "peak force", "peak displacement"
Features = tuple[Feature, ...]


class MachineErrors(NamedTuple):
    """Compliance (mm/N), seating gap (mm), gain, offset (N), drift (N/s), lag (s), and the force
    (N) by which a gap closes."""

    compliance: Array
    gap: Array
    gain: Array
    offset: Array
    drift: Array
    lag: Array
    closing_force: Real

    def in_forces_of(self, unit: Array) -> "MachineErrors":
        """The same where forces are counted in another unit than newtons."""
        return self._replace(
            compliance=self.compliance * unit, offset=self.offset / unit, drift=self.drift / unit,
            closing_force=self.closing_force / unit,
        )  # fmt: skip

    def travel(self, force: Array) -> Array:
        """What the machine adds to displacements (mm) at forces (k,)."""
        pressed = at_least(force, 0.0)
        return self.compliance * force - self.gap * jnp.expm1(-pressed / self.closing_force)

    def reading(self, shown: Array) -> Array:
        """The load cell's own reading (k,) where the machine shows forces (k,) at once; none where
        it would have to pull."""
        sensitive = jnp.where(self.gain > -1, 1 + self.gain, 1.0)  # else it reads nothing
        return at_least((shown - self.offset) / sensitive, 0.0)


def at_least(values, least) -> Array:
    """The larger of both; where they are equal the second, with its slope."""
    return jnp.where(values > least, values, least)


def between(levels: Array, known: Array, values: Array) -> Array:
    """Values (k,) known at rising points (k,), at levels (q,): straight between the points and
    beyond the last ones."""
    at = jnp.clip((known[:, None] <= levels).sum(axis=0) - 1, 0, len(known) - 2)
    x, y, x_end, y_end = _intervals(at, known, values)
    return y + (levels - x) / (x_end - x) * (y_end - y)


def _intervals(at: Array, *of: Array) -> Array:
    """Values (2 n, q) of n arrays (k,) at the begins of intervals (q,), then at their ends."""
    both = jnp.stack(of)
    return jnp.vstack([both[:, :-1], both[:, 1:]])[:, at]


def by_force(features: Features, kind: str) -> np.ndarray:
    """The features of a kind by rising force."""
    found = [i for i, feature in enumerate(features) if feature.kind == kind]
    return np.array(sorted(found, key=lambda i: features[i].abscissa), int)


def filtered(path: np.ndarray, force: np.ndarray, length: float) -> np.ndarray:
    """Readings (n,) of forces (n,) at any points of a path (n,), from R = F at the first."""
    reading = np.array(force, float)
    steps, rises = np.diff(path), np.diff(force)
    for i, (step, rise) in enumerate(zip(steps, rises, strict=True)):
        if step == 0:
            reading[i + 1] = reading[i]
            continue
        behind = length * rise / step  # how far R lags where F rises evenly
        left = (reading[i] - force[i] + behind) * np.exp(-step / length)
        reading[i + 1] = force[i + 1] - behind + left
    return reading


def reading_at_knots(path: Array, force: Array, length: Array, first: Array | float) -> Array:
    """Readings (k,) of forces (k,) at points of a path (k,), from R = `first`."""
    steps = path[1:] - path[:-1]
    behind = length * (force[1:] - force[:-1]) / steps
    gained = force[1:] - behind + jnp.exp(-steps / length) * (behind - force[:-1])
    since = jnp.maximum(path[:, None] - path, 0.0)  # of what was gained up to a point
    kept = jnp.where(np.tri(len(force), dtype=bool), jnp.exp(-since / length), 0.0)
    return kept @ jnp.hstack([first, gained])


def path_at(
    levels: Array, path: Array, force: Array, reading: Array, length: Array
) -> tuple[Array, Array]:
    """Where on a path (k,) readings (k,), as `reading_at_knots` gives them, reach levels (q,) for
    good, and their slopes dR/dx there, both (q,).  Readings rise at last.

    Newton's method in the interval of each level: R bends one way in it, so from the end on the
    outer side of that bend no step goes too far.  The last step, from a root that is found, carries
    the derivatives (implicit function theorem).
    """
    at = jnp.clip((reading[:, None] < levels).sum(axis=0) - 1, 0, len(path) - 2)
    x, f, r, x_end, f_end, _ = _intervals(at, path, force, reading)
    slope = (f_end - f) / (x_end - x)
    behind = length * slope
    bend = r - f + behind
    of_line = f - behind - levels, slope, bend, length
    known = jax.lax.stop_gradient(of_line)
    far = jax.lax.stop_gradient(jnp.where(bend > 0, x_end - x, 0.0))
    far = jax.lax.fori_loop(0, STEPS, lambda _, far: far - _newton_step(far, *known), far)
    far = jax.lax.stop_gradient(far)
    far = far - _newton_step(far, *of_line)
    return x + far, slope - bend * jnp.exp(-far / length) / length


def _newton_step(far, missing, slope, bend, length) -> Array:
    """Towards the root of missing + slope far + bend exp(-far/length)."""
    fading = bend * jnp.exp(-far / length)
    return (missing + slope * far + fading) / (slope - fading / length)


def crushing_rows(features: Features) -> np.ndarray:
    """The features (c,) that a machine moves as a soil is crushed: by displacement, peak force,
    displacement there; none where the curve has too few."""
    along = [i for i, f in enumerate(features) if f.kind == CRUSHING]
    along.sort(key=lambda i: features[i].abscissa)
    peak = [
        i for kind in (PEAK_FORCE, PEAK_DISPLACEMENT)
        for i, f in enumerate(features) if f.kind == kind
    ]  # fmt: skip
    return np.array([*along, *peak] if len(along) > 1 and len(peak) == 2 else [], int)


def crushing_moved(
    features: Features, speed: Real, values: Array, errors: MachineErrors, slender: Array
) -> Array:
    """What errors add to the features `crushing_rows` (c,), given all (m,) without any, of a
    specimen that is `slender` times as slender as the features' own, pressed at a speed (mm/s).

        touch (F = 0), seating (displacement 0), the features' points, straight on beyond the last

    Displacement counts from where the machine shows the seating force, and time from the first
    touch.  At the peak the force changes by what the machine shows more at its place: a curve that
    is tilted a little is highest nearly where it was (the envelope theorem).
    """
    rows = crushing_rows(features)
    some = (jnp.abs(values[rows]) < LARGEST).all()
    own = jnp.where(some, values[rows], jnp.arange(1.0, len(rows) + 1))
    force, peak, at_peak = own[:-2], own[-2], own[-1]
    levels = slender * np.array([features[i].abscissa for i in rows[:-2]])
    seated = features[rows[0]].zero.force or 0.0
    touch = -levels[0] * seated / at_least(force[0] - seated, seated)
    falls = (force[-1] - force[-2]) / (levels[-1] - levels[-2])
    end = BEYOND * levels[-1]
    way = jnp.hstack([touch, 0.0, levels, end])
    pressed = jnp.hstack([0.0, seated, force, force[-1] + falls * (end - levels[-1])])

    def shown(way, force):
        """More than the force, N."""
        time = (way - touch) / speed
        return errors.gain * force + errors.offset + errors.drift * time

    travel, reading = way + errors.travel(pressed), pressed + shown(way, pressed)
    zero = _seated(travel, reading, seated)
    read = between(levels, travel - zero, reading)
    moved = jnp.hstack([read - force, shown(at_peak, peak), errors.travel(peak) - zero])
    return jnp.where(some, moved, 0.0)


def _seated(travel: Array, reading: Array, seating: float) -> Array:
    """Displacement where the machine first shows the seating force; that of the first point where
    it does from the beginning, or never."""
    at = jnp.argmax(reading >= seating)
    before = jnp.maximum(at - 1, 0)
    (x, x_end), (r, r_end) = ((of[before], of[at]) for of in (travel, reading))
    rise = jnp.where(at > 0, r_end - r, 1.0)
    return jnp.where(at > 0, x + (seating - r) / rise * (x_end - x), x)
