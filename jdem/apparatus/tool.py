"""What a test brings along beside the testing cell: tools, and what is recorded of them.

A test numbers boundaries for itself: 0 to 2 are the cell's base, platen and mould, its own tools
come after.  A sequence of tests puts the tools of all of them behind the cell (`numbered`); while
one test runs, the tools of the others are away.

    channel = sum over boundaries of direction . (force on it, torque on it, or place of its point)
"""

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.boundaries.base import DOWN, AbstractBoundary, Axis
from jdem.boundaries.composite import PLATEN
from jdem.core.quantity import Real
from jdem.engine.loop import Sample
from jdem.engine.segment import CELL, KEEP, REMOVE, Segment

FORCE, TORQUE, PLACE = "force", "torque", "place"
KINDS = (FORCE, TORQUE, PLACE)


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
