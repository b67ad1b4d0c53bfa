"""Both virtual tests as a series of states.

The engine's loop hands back the state at its end.  Here each of the machine's movements is cut
into pieces of a few samples, and every piece goes on from the state before it, contact
histories included: the physics is that of `VirtualLab.run`, and only the moments at which
contact lists are rebuilt differ.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from calibrate.core.errors import CalibrationError
from jdem.core.kernel import program
from jdem.core.quantity import cast
from jdem.engine.bed import build_bed, steps_per_sample
from jdem.engine.loop import Record, begun, run
from jdem.engine.segment import KEEP, Segment, stack
from jdem.engine.step import Bed, BedState
from jdem.laboratory.virtual_lab import VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.packing.specimen import Packing

PIECE = 8  # samples between frames, to begin with


@dataclass(frozen=True, eq=False)
class Frame:
    """The bed at one moment: the machine's movement by name, time (s), force (N) on the platen,
    or on the tool that moves."""

    movement: str
    time: float
    platen_force: float
    bed: Bed
    state: BedState


def frames(
    lab: VirtualLab,
    packing: Packing,
    soil: SoilParameters,
    most: int,
    say: Callable[[str], None] = lambda line: None,
    roomier: VirtualLab | None = None,
) -> list[Frame]:
    """At most 2 `most` and at least about `most` states, evenly spaced; the last of each
    movement is always among them.  `say` hears of each movement that is finished.  If a contact
    list of `lab` is too small, `roomier`, the same with larger ones, begins anew."""
    try:
        return _frames(lab, packing, soil, most, say)
    except _FullError as full:
        if roomier is None:
            raise CalibrationError(f"a contact list was too small: {full}") from None
        say("a contact list was too small: once more with larger ones")
        return frames(roomier, packing, soil, most, say)


class _FullError(Exception):
    """A contact list was too small; the message says which, and the capacity that would do."""


def _frames(
    lab: VirtualLab, packing: Packing, soil: SoilParameters, most: int, say: Callable[[str], None]
) -> list[Frame]:
    kept: list[Frame] = []
    pieces = _Pieces(lab, packing, soil)
    for frame, is_last in pieces.run():
        kept.append(frame)
        if is_last:
            say(f"{frame.movement}: {frame.time:.3f} s, {frame.platen_force:.0f} N")
        if len(kept) > 2 * most:
            kept = _thinned(kept)
            pieces.samples *= 2
    return kept


def _thinned(kept: list[Frame]) -> list[Frame]:
    """Every second frame, and the last of each movement."""
    ends = {frame.movement: frame for frame in kept}.values()
    return [f for k, f in enumerate(kept) if k % 2 == 1 or any(f is end for end in ends)]


class _Pieces:
    """The machine's programme in pieces of `samples` samples; one compiled loop serves all."""

    def __init__(self, lab: VirtualLab, packing: Packing, soil: SoilParameters):
        dtype = jnp.dtype(lab.numerics.dtype)
        self.lab = lab
        surfaces = lab.tests.surfaces
        self.bed = build_bed(packing.spheres, soil, lab.grid, lab.numerics, surfaces=surfaces)
        self.steps = steps_per_sample(self.bed, lab.numerics)
        self.interval = float(self.steps * self.bed.time_step)
        position = cast(packing.position, dtype)
        self.state = begun(self.bed, position, lab.boundaries(packing, dtype))
        self.samples = PIECE
        self.loop = program(run)

    def run(self) -> Iterator[tuple[Frame, bool]]:
        """Frames of all movements, each with whether it ends its movement."""
        joining = self.lab.tests.joining if self.bed.particle_law.bonds else None
        for number, movement in enumerate(self.lab.tests.movements()):
            yield from self._movement(movement.name, movement.segment, number == joining)

    def _movement(self, name: str, segment: Segment, joins: bool) -> Iterator[tuple[Frame, bool]]:
        """Where it `joins`, bonds form within its first sampling interval."""
        left, target = float(segment.duration), float(segment.force_target)
        while True:
            length = min((1 if joins else self.samples) * self.interval, left)
            piece = eqx.tree_at(_duration, segment, jnp.asarray(length))
            force, taken = self._advance(piece, joins)
            left, joins = left - taken, False
            reached = abs(force - target) < float(segment.tolerance)
            ended = reached or left < 0.5 * self.interval
            yield Frame(name, float(self.state.time), force, self.bed, self.state), ended
            if ended:
                return
            segment = replace(segment, placed=jnp.full_like(segment.placed, KEEP))

    def _advance(self, segment: Segment, joins: bool) -> tuple[float, float]:
        """Runs one piece, in which bonds form or do not; the load cell's mean reading in its last
        sample (N), its duration (s)."""
        law = self.bed.particle_law.joining(jnp.asarray(joins))
        bed = replace(self.bed, particle_law=law)
        programme = cast(stack([segment]), jnp.dtype(self.lab.numerics.dtype))
        before = float(self.state.time)
        record: Record = self.loop(bed, self.state, programme, self.steps, self.lab.capacity)
        if bool(record.overflow_of(self.bed.grid)):
            raise _FullError(record.explain_overflow(self.bed.grid))
        self.state = record.state
        last = int(np.flatnonzero(np.asarray(record.samples.segment) >= 0)[-1])
        force = float(record.samples.reading[last])
        if not np.isfinite(force):
            raise CalibrationError("a number is not finite: a parameter is extreme")
        return force, float(self.state.time) - before


def _duration(segment: Segment):
    return segment.duration
