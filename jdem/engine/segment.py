"""The machine's programme: a table of segments, each a movement of boundaries.

    rate_s = rate tanh((force_target - F)/servo_width)     what the servo asks for
    response d(rate)/dt = rate_s - rate                    of the boundary that it drives

A programme is numbers, not code, so one compiled loop serves every apparatus.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jdem.boundaries.base import AbstractBoundary
from jdem.boundaries.composite import FORCE, MOULD, PLATEN, Boundaries, resistances
from jdem.core.kernel import together
from jdem.core.quantity import Real, as_quantity, quantity
from jdem.core.vector import Vector
from jdem.engine.state import BedState, Command

KEEP, REMOVE, LOWER, HOME, FOLLOW = 0, 1, 2, 3, 4
CELL = 3  # boundaries of the testing cell


def _still() -> Array:
    return jnp.zeros(CELL)


def _kept() -> Array:
    return jnp.full(CELL, KEEP)


class Segment(eqx.Module):
    """One movement of the machine; SI units, or a stack of segments along axis 0.

    Boundaries move along their axes at `speed` (m/s), turn about them at `spin` (rad/s) and grow
    at `growth` (m/s), each of shape (boundaries,).  `servo` is the number of the one whose
    `component` (FORCE, TORQUE or PUSH: what resists speed, spin or growth) is brought to
    force_target: that rate is multiplied by tanh((force_target - F)/servo_width), so it arrives
    smoothly; with an infinite target it is constant.  The drive takes `response` (s) to follow its
    servo: dashpots of the bed answer the rate at once, so a drive that followed at once would
    swing from step to step wherever they exceed servo_width/rate.  The segment ends after
    `duration` or when
    |F - force_target| < tolerance.  F is what the load cell reads: it follows the resistance
    with the time constant `lag`; with a lag the segment also ends when F passes the target.
    `placed` says what happens to each boundary first: KEEP, REMOVE, LOWER it onto the nearest
    sphere, bring it HOME to where it was made, or let it FOLLOW the boundary before it, as far from
    its home as that one is.  Lengths are those of the testing cell unless given.
    """

    speed: Array = eqx.field(default_factory=_still, converter=as_quantity)
    spin: Array = eqx.field(default_factory=_still, converter=as_quantity)
    growth: Array = eqx.field(default_factory=_still, converter=as_quantity)
    placed: Array = eqx.field(default_factory=_kept, converter=jnp.asarray)
    servo: Array = eqx.field(default=PLATEN, converter=jnp.asarray)
    component: Array = eqx.field(default=FORCE, converter=jnp.asarray)
    force_target: Real = quantity(jnp.inf)
    servo_width: Real = quantity(1.0)
    response: Real = quantity(0.0)
    tolerance: Real = quantity(0.0)
    damping: Real = quantity(0.0)
    unloaded_damping: Real = quantity(0.0)
    duration: Real = quantity(0.0)
    lag: Real = quantity(0.0)

    @property
    def platen_speed(self) -> Array:
        """Speed (m/s) of the testing cell's platen, downward."""
        return self.speed[..., PLATEN]


def cell_segment(
    *,
    platen_speed: Real = 0.0,
    mould_speed: Real = 0.0,
    platen: Real = KEEP,
    mould: Real = KEEP,
    **given: Real,
) -> Segment:
    """A movement of the testing cell: the platen downward (m/s), under the servo, and the mould's
    opening (m/s); `platen` and `mould` are placed first; all else as in `Segment`."""
    speed = _still().at[PLATEN].set(platen_speed)
    growth = _still().at[MOULD].set(mould_speed)
    placed = _kept().at[PLATEN].set(platen).at[MOULD].set(mould)
    return Segment(speed=speed, growth=growth, placed=placed, **given)


def stack(segments: list[Segment]) -> Segment:
    """Several segments as one programme."""
    return jax.tree.map(
        lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *segments
    )


def row_of(programme: Segment, index) -> Segment:
    """One segment of a programme."""
    return jax.tree.map(lambda leaf: leaf[index], programme)


def command_of(segment: Segment, force: Array, before: Boundaries, time_step: Real) -> Command:
    """What the machine does where it sees `force` (N or N m) and moved as boundaries `before`."""
    unlimited = jnp.isinf(segment.force_target)
    target = jnp.where(unlimited, force, segment.force_target)  # or inf x 0 is a slope: NaN
    share = jnp.where(unlimited, 1.0, jnp.tanh((target - force) / segment.servo_width))
    table = jnp.stack([segment.speed, segment.spin, segment.growth])
    wanted = [
        table[place] * jnp.where(_served(segment, place), share, 1.0)
        for place in np.ndindex(*table.shape)
    ]
    kept = jnp.where(unlimited, 0.0, segment.response / (segment.response + time_step))
    rates = [
        rate + (moved - rate) * jnp.where(_served(segment, place), kept, 0.0)
        for rate, moved, place in zip(wanted, _rates(before), np.ndindex(*table.shape), strict=True)
    ]
    rates = jnp.stack(rates).reshape(table.shape)
    return Command(rates, segment.damping, segment.unloaded_damping)


def _rates(boundaries: Boundaries) -> list[Array]:
    """Speeds, spins and growths, one after the other."""
    each = [boundary.rates for boundary in boundaries]
    return [*(r.speed for r in each), *(r.spin for r in each), *(r.growth for r in each)]


def _served(segment: Segment, place: tuple[int, ...]) -> Array:
    """Whether the servo acts on this component of this boundary."""
    return (segment.component == place[0]) & (segment.servo == place[1])


def read(state: BedState, segment: Segment, time_step: Real) -> BedState:
    """The load cell's reading R after a time step: lag dR/dt = F - R, implicitly."""
    reading = together(_read, state.boundaries, state.loads, state.reading, segment, time_step)
    return eqx.tree_at(lambda s: s.reading, state, reading)


def served(boundaries: Boundaries, loads: Array, segment: Segment) -> Array:
    """What the segment's servo acts upon (N or N m)."""
    table = resistances(boundaries, loads)
    force = table[0, 0]
    for place in np.ndindex(*table.shape):
        force = jnp.where(_served(segment, place), table[place], force)
    return force


def _read(boundaries: Boundaries, loads: Array, before: Array, segment: Segment, time_step: Real):
    force = served(boundaries, loads, segment)
    return force + (before - force) * (segment.lag / (segment.lag + time_step))


def placed(boundaries: Boundaries, segment: Segment, position, radius) -> Boundaries:
    """Boundaries taken away or lowered as the segment begins, and at rest."""
    changed: list[AbstractBoundary] = []
    for boundary, wanted in zip(boundaries, segment.placed, strict=True):
        places = {LOWER: _lowered(boundary, wanted, position, radius), REMOVE: boundary.removed()}
        if (home := boundary.home()) is not None:
            places[HOME] = _at(boundary, home)
            if changed:
                places[FOLLOW] = _at(boundary, home + _way(changed[-1]))
        now = boundary
        for placing, there in places.items():
            chosen = partial(jnp.where, wanted == placing)
            now = jax.tree.map(chosen, there, now)
        changed.append(now.driven(jax.tree.map(jnp.zeros_like, now.rates)))
    return tuple(changed)


def _at(boundary: AbstractBoundary, place: Vector) -> AbstractBoundary:
    return eqx.tree_at(lambda b: b.reference, boundary, place)


def _way(boundary: AbstractBoundary) -> Vector:
    """How far a boundary is from its home (m); no way for one without."""
    home = boundary.home()
    return boundary.reference - (boundary.reference if home is None else home)


def _lowered(boundary: AbstractBoundary, wanted: Array, position, radius) -> AbstractBoundary:
    """The boundary lowered; of many faces it takes long, and is done only where it is wanted."""

    def lowered():
        return boundary.touching(position, radius)

    return jax.lax.cond(wanted == LOWER, lowered, lambda: boundary) if boundary.faces else lowered()


def ended(segment: Segment, readings: list[Array], elapsed: tuple[Array, Array]) -> Array:
    """1 once the force is reached, or after the duration to the nearest interval.

    `readings` (N) are those before, averaged over, and after the interval; `elapsed` (s) is
    the time since the segment began and the length of the interval.
    """
    before, mean, after = (reading - segment.force_target for reading in readings)
    since, interval = elapsed
    reached = jnp.abs(mean) < segment.tolerance
    passed = (segment.lag > 0) & (before * after < 0)  # a late reading does not slow down
    over = since >= segment.duration - 0.5 * interval
    return (reached | passed | over).astype(jnp.int32)
