"""The contract of an apparatus: it states what the machine does, and reads what was recorded.

An apparatus knows rates, forces and durations.  It does not know how a bed is advanced
(`jdem.engine`) nor what soil is in it.  Several of them make a sequence on one specimen: each
goes on with the specimen as the one before left it.

A test may bring tools along beside the testing cell.  It numbers boundaries for itself: 0 to 2 are
the cell's base, platen and mould, its own tools come after.  A sequence of tests puts the tools of
all of them behind the cell (`numbered`); while one test runs, the tools of the others are away.

    channel = sum over boundaries of direction . (force on it, torque on it, or place of its point)
"""

import abc
from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.boundaries.base import DOWN, AbstractBoundary, Axis
from jdem.boundaries.composite import PLATEN
from jdem.core.quantity import Real, quantity
from jdem.engine.loop import Sample
from jdem.engine.segment import CELL, KEEP, REMOVE, Segment
from jdem.engine.state import Bed, BedState
from jdem.observables import AbstractGauge, Curve

RESPONSE = 5e-4  # s, of the drive to its servo: some 13 time steps at quick, 50 at fine
FORCE, TORQUE, PLACE = "force", "torque", "place"
KINDS = (FORCE, TORQUE, PLACE)


class Damping(eqx.Module):
    """Background damping (1/s) while the machine loads, and while a specimen comes to rest.

    unloaded is added for spheres that carry next to no load (`jdem.engine.step`): enough to stop
    their rattling, while the loaded skeleton keeps its low damping and with it its strength.
    """

    loading: Real = quantity(200.0)
    resting: Real = quantity(500.0)
    unloaded: Real = quantity(4000.0)


class Movement(eqx.Module):
    """One movement of the machine: a segment of its programme, and what it means in the test.

    time_scale is nominal over simulated time: what passes in the laboratory.  `testing`: the
    test runs, and its time counts; `free`: the specimen stands without a mould; `resting`: it
    comes to rest.
    """

    name: str = eqx.field(static=True)
    segment: Segment
    time_scale: Real = quantity(1.0)
    testing: bool = eqx.field(static=True, default=True)
    free: bool = eqx.field(static=True, default=False)
    resting: bool = eqx.field(static=True, default=False)


class Readings(eqx.Module):
    """What is recorded; arrays (samples,): travel (m, downward, from anywhere), force (N), the
    test's further channels by name (SI), and the simulated time (s) where it is known; `window` as
    in `Curve`."""

    travel: Array
    force: Array
    window: float = eqx.field(static=True, default=0.0)
    channels: dict[str, Array] = eqx.field(default_factory=dict)
    time: Array | None = None


class Reading(eqx.Module):
    """What one test gives: its curve, its observables by name (SI), whether the machine came as far
    as it was to, and further channels beside the curve, by name (SI), at its rows."""

    curve: Curve
    observables: dict[str, Array]
    complete: Array
    channels: dict[str, Array] = eqx.field(default_factory=dict)


class Tool(eqx.Module):
    """A boundary of one test, at its home; `surface` says whose friction it has, area (m2) how much
    of it may touch soil."""

    name: str = eqx.field(static=True)
    boundary: AbstractBoundary
    area: float = eqx.field(static=True)
    surface: str = eqx.field(static=True, default="platen")


class Channel(eqx.Module):
    """One recorded quantity of a test: a force (N), a torque (N m) or a place (m), summed over some
    of its boundaries along a direction; forces and torques are those on the boundary."""

    name: str = eqx.field(static=True)
    kind: str = eqx.field(static=True)
    boundaries: tuple[int, ...] = eqx.field(static=True, default=(PLATEN,))
    direction: Axis = eqx.field(static=True, default=DOWN)

    def __check_init__(self):
        if self.kind not in KINDS:
            raise ValueError(f"no channel '{self.kind}'; give one of {', '.join(KINDS)}")

    @property
    def unit(self) -> str:
        return {FORCE: "N", TORQUE: "N m", PLACE: "m"}[self.kind]

    def read(self, samples: Sample, ahead: int) -> Array:
        """Shape (samples,), where the tools of `ahead` boundaries stand before the test's own."""
        columns = {FORCE: samples.loads[..., :3], TORQUE: samples.loads[..., 3:6]}
        table = columns.get(self.kind, samples.reference)
        chosen = [number if number < CELL else number + ahead for number in self.boundaries]
        summed = sum(table[..., number, :] for number in chosen)
        return summed @ jnp.asarray(self.direction, table.dtype)


class AbstractApparatus(eqx.Module):
    """One test, run on the specimen as the previous one left it.

    `name` is unique in a sequence; simulated_rate and nominal_rate (m/s) are the platen's, in
    the simulation and in the laboratory; stroke (m) is the farthest that a movement goes.
    """

    name: eqx.AbstractVar[str]
    simulated_rate: eqx.AbstractVar[Real]
    nominal_rate: eqx.AbstractVar[Real]
    stroke: eqx.AbstractVar[Real]

    @abc.abstractmethod
    def movements(self) -> list[Movement]:
        """The machine's movements in order."""

    @abc.abstractmethod
    def read(self, readings: Readings, movement: Array) -> Reading:
        """Curve and observables; `movement` (samples,) is the number of the test's movement under
        way, negative or too large where another test runs."""

    @property
    @abc.abstractmethod
    def observables(self) -> tuple[str, ...]:
        """Names of the observables that `read` gives."""

    def at_end(self, bed: Bed, state: BedState) -> dict[str, Array]:
        """Further observables, SI, of where all spheres are after the test: none, unless said so.

        A test that has some is the last one of its sequence.
        """
        return {}

    @property
    def tools(self) -> tuple[Tool, ...]:
        """Boundaries that the test brings along beside the cell's; `movements` has their rates
        after the cell's."""
        return ()

    @property
    def spreads(self) -> float:
        """How many times as wide as its mould the soil may lie in the end; 1 unless said so."""
        return 1.0

    @property
    def travel(self) -> Channel:
        """The channel that is the curve's displacement."""
        return Channel("travel", PLACE)

    @property
    def force(self) -> Channel | None:
        """The channel that is the curve's force; None: what the servo's load cell reads."""
        return None

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Further channels that are recorded."""
        return ()

    @property
    def names(self) -> tuple[str, ...]:
        """What each movement is called."""
        return tuple(movement.name for movement in self.movements())

    @property
    def required_force(self) -> Real | None:
        """Force (N) that the test has to reach, None if it has none."""
        return None

    @property
    def reference_force(self) -> Real | None:
        """Force (N) at which the inertial number of loading is stated, None if there is none."""
        return None

    @property
    def width(self) -> float:
        """Of the tool, m; 0 where there is none, or where it is not known."""
        return 0.0

    @property
    def no_number(self) -> str:
        """Why an observable may be no number."""
        return "the test took an unforeseen course"

    def sheared(self, observables: dict[str, Array], diameter: Real) -> tuple[Real, Real] | None:
        """Shear rate (1/s) and pressure (Pa) of soil of this mean diameter (m) where a tool moves
        it, of which the inertial number is made; None where none is stated."""
        return None

    @abc.abstractmethod
    def at_rate(self, factor: float) -> "AbstractApparatus":
        """The same test simulated `factor` times as fast."""

    def sampled(self, ratio: float) -> "AbstractApparatus":
        """The same test where samples are `ratio` times as dense."""
        return self


class Gauged(AbstractApparatus):
    """A test whose whole curve is read by further gauges; their numbers stand beside its own."""

    name: str = eqx.field(static=True)
    simulated_rate: Real
    nominal_rate: Real
    stroke: Real
    test: AbstractApparatus
    gauges: tuple[AbstractGauge, ...]

    @staticmethod
    def of(test: AbstractApparatus, gauges: tuple[AbstractGauge, ...]) -> "Gauged":
        rates = (test.simulated_rate, test.nominal_rate)
        return Gauged(test.name, *rates, test.stroke, test, gauges)

    def movements(self) -> list[Movement]:
        return self.test.movements()

    def read(self, readings: Readings, movement: Array) -> Reading:
        found = self.test.read(readings, movement)
        more = {gauge.name: gauge.of(found.curve, movement) for gauge in self.gauges}
        return replace(found, observables={**found.observables, **more})

    @property
    def observables(self) -> tuple[str, ...]:
        return (*self.test.observables, *(gauge.name for gauge in self.gauges))

    def at_end(self, bed: Bed, state: BedState) -> dict[str, Array]:
        return self.test.at_end(bed, state)

    @property
    def tools(self) -> tuple[Tool, ...]:
        return self.test.tools

    @property
    def spreads(self) -> float:
        return self.test.spreads

    @property
    def travel(self) -> Channel:
        return self.test.travel

    @property
    def force(self) -> Channel | None:
        return self.test.force

    @property
    def channels(self) -> tuple[Channel, ...]:
        return self.test.channels

    @property
    def required_force(self) -> Real | None:
        return self.test.required_force

    @property
    def reference_force(self) -> Real | None:
        return self.test.reference_force

    @property
    def width(self) -> float:
        return self.test.width

    @property
    def no_number(self) -> str:
        return self.test.no_number

    def sheared(self, observables: dict[str, Array], diameter: Real) -> tuple[Real, Real] | None:
        return self.test.sheared(observables, diameter)

    def at_rate(self, factor: float) -> "Gauged":
        gauges = tuple(gauge.sampled(1 / factor) for gauge in self.gauges)
        return Gauged.of(self.test.at_rate(factor), gauges)

    def sampled(self, ratio: float) -> "Gauged":
        gauges = tuple(gauge.sampled(ratio) for gauge in self.gauges)
        return Gauged.of(self.test.sampled(ratio), gauges)


def curve_of(readings: Readings, chosen: Array) -> Curve:
    """The chosen samples' curve; displacement counts from the first of them."""
    valid = chosen.astype(readings.force.dtype)
    first = readings.travel[jnp.argmax(valid)]
    travel = (readings.travel - first) * valid
    return Curve(travel, readings.force * valid, valid, readings.window)


# ---------------------------------------------------------------- tools


def machine_segment(
    tools: int,
    speed: dict[int, Real] | None = None,
    spin: dict[int, Real] | None = None,
    placed: dict[int, int] | None = None,
    **given: Real,
) -> Segment:
    """A movement of a cell with `tools` more boundaries: speeds along their axes (m/s), spins about
    them (rad/s), what is placed first, by number; all else as in `Segment`."""
    rates = jnp.zeros(CELL + tools)
    places = jnp.full(CELL + tools, KEEP)
    return Segment(
        speed=_with(rates, speed),
        spin=_with(rates, spin),
        growth=rates,
        placed=_with(places, placed),
        **given,
    )


def _with(row: Array, entries: dict[int, Real] | dict[int, int] | None) -> Array:
    for number, value in (entries or {}).items():
        row = row.at[number].set(value)
    return row


def numbered(segment: Segment, ahead: int, behind: int) -> Segment:
    """The segment of a test with so many tools of other tests ahead of its own and behind them,
    all of which are away."""
    if ahead + behind == 0:
        return segment

    def wide(row: Array, fill: int) -> Array:
        others = [jnp.full(count, fill, row.dtype) for count in (ahead, behind)]
        return jnp.concatenate([row[:CELL], others[0], row[CELL:], others[1]])

    rates = {name: wide(getattr(segment, name), 0) for name in ("speed", "spin", "growth")}
    servo = jnp.where(segment.servo < CELL, segment.servo, segment.servo + ahead)
    return replace(segment, **rates, placed=wide(segment.placed, REMOVE), servo=servo)


def around(counts: Sequence[int], number: int) -> tuple[int, int]:
    """How many tools stand ahead of test `number`'s own and behind them; counts are by test."""
    return sum(counts[:number]), sum(counts[number + 1 :])
