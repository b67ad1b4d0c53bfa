"""Any programme of one test: steps that load, unload, hold, open the mould or let it rest.

    load, unload   to a force F by the servo v tanh((F - F_platen)/width), or through a travel
    hold           the platen stands still, or keeps its force
    open, rest     the mould opens slowly and is taken away; the specimen comes to rest

Simulated rates are far above the laboratory's, so each movement states its time scale.  A hold
lasts as long as loading is sped up, but LONGEST_HOLD at most: the base model knows no time, and
what the specimen still does has then died away.
"""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.apparatus.base import (
    RESPONSE,
    AbstractApparatus,
    Damping,
    Movement,
    Reading,
    Readings,
    curve_of,
)
from jdem.core.quantity import Real, quantity
from jdem.engine.segment import KEEP, LOWER, REMOVE, cell_segment
from jdem.observables import AbstractGauge, Curve, displacement_at

TO_FORCE, TRAVEL, HOLD, KEEP_FORCE, OPEN, REST = "force", "travel", "hold", "keep", "open", "rest"
MOVING = (TO_FORCE, TRAVEL)
KINDS = (TO_FORCE, TRAVEL, HOLD, KEEP_FORCE, OPEN, REST)
LONGEST_HOLD = 0.02  # s, simulated
REST_TIME = 0.05  # s, simulated
OPENING, OPENING_RATE = 1e-3, 0.02  # m, m/s; of the mould


class Step(eqx.Module):
    """One step: `kind` (one of the names above), `name` in the curves.

    value is a force (N) to reach, a travel (m, downward positive), or a time (s) in the
    laboratory; nominal_rate (m/s) that of the laboratory's platen.
    """

    kind: str = eqx.field(static=True)
    name: str = eqx.field(static=True)
    value: Real = quantity(0.0)
    nominal_rate: Real = quantity(1e-3)

    def __check_init__(self):
        if self.kind not in KINDS:
            raise ValueError(f"no kind of step '{self.kind}'; give one of {', '.join(KINDS)}")


class Protocol(AbstractApparatus):
    """A test made of steps.

    simulated_rate (m/s) is the platen's; servo_width and tolerance (N) and response (s) as in
    `Segment`; stroke
    (m) is the farthest that one step may go; displacement counts from seating_force (N) on the
    first loading; gauges are the observables.  The platen is lowered onto the specimen before
    the first step that moves, and again after the mould was taken away.
    """

    steps: tuple[Step, ...]
    simulated_rate: Real = quantity(0.05)
    nominal_rate: Real = quantity(1e-3)
    servo_width: Real = quantity(1.5)
    response: Real = quantity(RESPONSE)
    tolerance: Real = quantity(0.75)
    stroke: Real = quantity(0.025)
    damping: Damping = eqx.field(default_factory=Damping)
    gauges: tuple[AbstractGauge, ...] = ()
    seating_force: float = eqx.field(static=True, default=2.0)
    name: str = eqx.field(static=True, default="protocol")

    def movements(self) -> list[Movement]:
        made: list[Movement] = []
        free, lowered, force = False, False, None
        for step in self.steps:
            if step.kind in (OPEN, REST):
                free, lowered = True, False
                made.append(self._free(step))
            elif step.kind in MOVING:
                made.append(self._moving(step, KEEP if lowered else LOWER, free))
                lowered, force = True, step.value if step.kind == TO_FORCE else None
            else:
                made.append(self._holding(step, force, free))
        return made

    def __check_init__(self):
        kinds = [step.kind for step in self.steps if step.kind != HOLD]
        for before, kind in zip([None, *kinds], kinds, strict=False):
            if kind == KEEP_FORCE and before not in (TO_FORCE, KEEP_FORCE):
                raise ValueError("a step 'keep' has no force to keep; put a step 'force' before it")

    def read(self, readings: Readings, movement: Array) -> Reading:
        movements = self.movements()
        testing = jnp.asarray([m.testing for m in movements])
        number = jnp.clip(movement, 0, len(movements) - 1)
        chosen = (movement >= 0) & (movement < len(movements)) & testing[number]
        curve = self._seated(curve_of(readings, chosen))
        found = {gauge.name: gauge.of(curve, movement) for gauge in self.gauges}
        highest = jnp.max(curve.force * curve.valid)
        needed = 0.0 if self.required_force is None else self.required_force - 2 * self.tolerance
        return Reading(curve, found, highest >= needed)

    @property
    def observables(self) -> tuple[str, ...]:
        return tuple(gauge.name for gauge in self.gauges)

    @property
    def required_force(self) -> Real | None:
        forces = [step.value for step in self.steps if step.kind == TO_FORCE]
        return jnp.max(jnp.stack([jnp.asarray(f, float) for f in forces])) if forces else None

    @property
    def reference_force(self) -> Real | None:
        return None if self.required_force is None else 0.5 * self.required_force

    def at_rate(self, factor: float) -> "Protocol":
        return replace(self, simulated_rate=self.simulated_rate * factor).sampled(1 / factor)

    def sampled(self, ratio: float) -> "Protocol":
        """With gauges that average over `ratio` times as many samples."""
        return replace(self, gauges=tuple(gauge.sampled(ratio) for gauge in self.gauges))

    def _seated(self, curve: Curve) -> Curve:
        """Displacement from where the force first reaches the seating force."""
        zero = displacement_at(curve, self.seating_force)
        return replace(curve, displacement=(curve.displacement - zero) * curve.valid)

    def _moving(self, step: Step, platen: int, free: bool) -> Movement:
        common = {
            "damping": self.damping.loading,
            "unloaded_damping": self.damping.unloaded,
            "platen": platen,
        }
        scale = self.simulated_rate / step.nominal_rate
        if step.kind == TRAVEL:
            speed = self.simulated_rate * jnp.sign(step.value)
            duration = jnp.abs(step.value) / self.simulated_rate
            segment = cell_segment(platen_speed=speed, duration=duration, **common)
        else:
            segment = cell_segment(
                platen_speed=self.simulated_rate,
                force_target=step.value,
                servo_width=self.servo_width,
                response=self.response,
                tolerance=self.tolerance,
                duration=self.stroke / self.simulated_rate,
                **common,
            )
        return Movement(step.name, segment, scale, free=free)

    def _holding(self, step: Step, force: Real | None, free: bool) -> Movement:
        time = jnp.minimum(step.value * step.nominal_rate / self.simulated_rate, LONGEST_HOLD)
        common = {"damping": self.damping.loading, "unloaded_damping": self.damping.unloaded}
        if step.kind == KEEP_FORCE and force is not None:
            segment = cell_segment(
                platen_speed=self.simulated_rate,
                force_target=force,
                servo_width=10 * self.servo_width,
                response=self.response,
                duration=time,
                **common,
            )
        else:
            segment = cell_segment(duration=time, **common)
        return Movement(step.name, segment, step.value / jnp.maximum(time, 1e-9), free=free)

    def _free(self, step: Step) -> Movement:
        opens = step.kind == OPEN
        segment = cell_segment(
            mould_speed=OPENING_RATE if opens else 0.0,
            damping=self.damping.resting,
            unloaded_damping=self.damping.unloaded,
            duration=OPENING / OPENING_RATE if opens else REST_TIME,
            platen=REMOVE if opens else KEEP,
            mould=KEEP if opens else REMOVE,
        )
        scale = 1.0 if opens else step.value / REST_TIME
        return Movement(step.name, segment, scale, testing=False, free=True, resting=not opens)
