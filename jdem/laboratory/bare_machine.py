"""The testing machine without soil: what its instruments record where nothing yields but they.

    reading R:   lag dR/dt = F - R          recorded by `jdem.effects.composite.recorded`

Frame, platen and base are rigid in the base model, so forces follow from the programme alone:
they go straight from one target to the next, and every curve is vertical.  No bed is settled and
no time step taken, because spheres would only be left out of all results.  Effects act through
their usual hooks: the programme, the servo, the readings; hooks of soil and specimen have nothing
to act on.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jdem.apparatus.base import Reading, Readings
from jdem.core.quantity import Real
from jdem.effects.base import AbstractEffect
from jdem.effects.composite import recorded
from jdem.engine.segment import Segment
from jdem.laboratory.virtual_lab import TestSequence

POINTS = 200  # of each movement
TURNS = 12  # of the iteration for what the load cell reads where the servo turns


class Course(eqx.Module):
    """A test, point by point, from rest on: arrays (points,) of true force and reading (N), nominal
    time (s), and the number of the movement under way."""

    force: Array
    reading: Array
    time: Array
    movement: Array


class BareMachine(eqx.Module):
    """Tests without soil (`jdem.apparatus.platen_on_base`), and the effects on the machine."""

    tests: TestSequence
    effects: tuple[AbstractEffect, ...] = ()

    def run(self) -> dict[str, Reading]:
        """Curve and observables of each test, as the instruments show them."""
        programme, scale = self.tests.programme(), self.tests.timetable().time_scale
        for effect in self.effects:
            programme = effect.programme(programme, scale)
        found = {}
        for number, test in enumerate(self.tests.apparatus):
            first = self.tests.first_movement(number)
            rows = slice(first, first + len(test.movements()))
            own = jax.tree.map(lambda leaf, rows=rows: leaf[rows], programme)
            course = self._driven(course_of(own, scale[rows]), own.force_target[0])
            readings = Readings(jnp.zeros_like(course.force), course.reading)
            shown = recorded(self.effects, readings, course.force, course.time)
            found[test.name] = test.read(shown, course.movement)
        return found

    def _driven(self, course: Course, target: Real) -> Course:
        """The course of a machine that turns where the servo, and not the truth, is at `target`."""
        turn = jnp.argmax(course.force)
        reading = jnp.asarray(target)
        for _ in range(TURNS):  # a contraction as long as errors are small beside the target
            errors = (effect.servo_error(reading, course.time[turn]) for effect in self.effects)
            reading = target - sum(errors, jnp.zeros_like(reading))
        share = reading / course.reading[turn]
        return Course(share * course.force, share * course.reading, course.time, course.movement)


def course_of(programme: Segment, time_scale: Array) -> Course:
    """What the machine does in these movements; time_scale is nominal over simulated time."""
    targets = jnp.asarray(programme.force_target)
    before = jnp.concatenate([jnp.zeros_like(targets[:1]), targets[:-1]])
    share = jnp.arange(1, POINTS + 1) / POINTS
    force = (before[:, None] + (targets - before)[:, None] * share).ravel()
    interval = jnp.repeat(programme.duration / POINTS, POINTS)
    reading = late(force, jnp.repeat(programme.lag, POINTS) / interval)
    time = jnp.cumsum(interval * jnp.repeat(time_scale, POINTS))
    movement = jnp.repeat(jnp.arange(targets.shape[0]), POINTS)
    return Course(_from_rest(force), _from_rest(reading), _from_rest(time), _from_rest(movement))


def late(force: Array, lag: Array) -> Array:
    """The reading (N) of a force that starts from 0: lag dR/dt = F - R, implicitly; both of shape
    (points,), `lag` in intervals."""

    def follow(before: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
        after = now[0] + (before - now[0]) * (now[1] / (now[1] + 1))
        return after, after

    return jax.lax.scan(follow, jnp.zeros_like(force[0]), (force, lag))[1]


def _from_rest(values: Array) -> Array:
    return jnp.concatenate([jnp.zeros_like(values[:1]), values])
