"""What a testing machine adds to the features of a soil's curves, in closed form.

    d_shown = d + C F + s (1 - exp(-F/F_s))        compliance C of the frame, seating gap s
    F_shown = (1 + g) R + b + c t                  gain g, offset b, drift c of the load cell
    tau dR/dt = F - R                              lag tau of its reading

An emulator of warped features would have to learn these for every soil, though they need only the
soil's own curve.  So the curve is laid through the features that the emulator gives, is read as the
machine reads it (`mould_reading`, `crushing_reading`), and what has changed is added.

A machine turns by what it shows.  Where its load cell errs, the soil is pressed to another force,

    F_turn/F_asked = (1 - b/F_asked)/(1 + g)

and what is crushed then is stronger or weaker for it.  The largest stress is a coordinate of the
emulator: so it is asked for the soil at the stress that this machine reaches (`overload`).

A library's rows are the other way round: what the machine adds is taken off before the emulator
sees them.  To find a curve from its readings would be a deconvolution; so what is taken off a row
is what the emulator's own curve of its soil gives.  The emulator learns what is left: with the
square of a machine's error, for it is small where that is weak; with that of a fuller mould itself,
of which only the beginning of the curve is told (`filling`).

Everything is done for all rows at once, and holds for complex numbers: an imaginary part that is
small beyond rounding carries a derivative through exactly (Squire and Trapp 1998,
doi 10.1137/S003614459631241X), since no two such parts ever multiply to anything.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from calibrate.discrepancy.library.crushing_reading import LARGEST, CrushingReading
from calibrate.discrepancy.library.design import SHAPE, SHAPE_COLUMNS
from calibrate.discrepancy.library.filling import DENSITY, Filling
from calibrate.discrepancy.library.mould_reading import MouldReading
from calibrate.discrepancy.library.reading import MachineErrors
from calibrate.labtests.diagnosis.base import Feature
from calibrate.labtests.diagnosis.curves import TARGETS, TESTS
from jdem.effects.composite import EFFECTS
from jdem.effects.seating import SeatingGap

LAG = "acquisition_lag"
MACHINE = (  # in the order of `MachineErrors`
    "load_frame_compliance", "seating_gap", "load_cell_gain", "load_cell_offset",
    "load_cell_drift", LAG,
)  # fmt: skip
TOLD = (*MACHINE, DENSITY)
MILLIMETRES = ("m", "m/N")  # units of strengths that are told in mm
TOP, DEPTH, STRENGTH = "largest force", *TARGETS
CRUSHED = TESTS[1]
LEAST_FORCE = 1e-3  # N; of smaller ones no power is told
POWERS = (-2.0, 3.0)  # of the force that a soil was pressed with, by which it may be stronger
OVERLOADS = (0.3, 3.0)  # times the force that is asked for; others are no test
SMALL = 0.01  # s; step of the lag for a slope where there is none
LEAST = 1e-12  # s; a lag below is none
STRESS = SHAPE.index("stress")
TINY = 1e-30  # imaginary parts of derivatives


@dataclass(frozen=True, eq=False)
class Machine:
    """A machine at the library's size: the features that it reads, the platen's speeds (mm/s) in
    the mould and in crushing, those of `TOLD` that are told in closed form, the force (N) by which
    a seating gap closes, what fills a mould, and the height (mm) of specimens."""

    features: Sequence[Feature]
    speed: float
    crushing_speed: float
    told: tuple[str, ...] = MACHINE
    closing_force: float = field(default_factory=lambda: float(SeatingGap().closing_force))
    filling: Filling | None = None
    height: float = 100.0

    def overload(self, strengths: np.ndarray, shape: np.ndarray) -> np.ndarray:
        """Logarithms (n,) of the force at which machines with errors (n, e) turn over the one that
        they are asked for, with specimens of shapes (n, 2) over the library's; 0 where that is no
        test."""
        return self._overload(self._errors(strengths), shape)[:, 0]

    def _overload(self, errors: MachineErrors, shape: np.ndarray) -> np.ndarray:
        """The same (n, 1)."""
        asked = self.features[0].scale * np.exp(shape[:, 1:])
        over = (1 - errors.offset / asked) / np.where(np.real(errors.gain) > -1, 1 + errors.gain, 1)
        low, high = OVERLOADS
        return np.log(np.where((np.real(over) > low) & (np.real(over) < high), over, 1.0))

    def shift(
        self, values: np.ndarray, strengths: np.ndarray, shape: np.ndarray, by_stress: np.ndarray
    ) -> np.ndarray:
        """What errors of strengths (n, e), SI, in the order of `told`, add to features (n, m) that
        are read without any where the machine turns (`overload`), of specimens whose shapes (n, 2)
        over the library's are given; by_stress (n, m): their slopes with the logarithm of the
        largest stress, which a lag exceeds."""
        moved = np.zeros(values.shape, np.result_type(values, strengths, shape))
        on = np.flatnonzero((strengths != 0).any(axis=1))
        if len(on):
            slender, stress = np.exp(shape[on]).T[:, :, None]
            errors = self._errors(strengths[on])
            over = np.exp(self._overload(errors, shape[on]))
            filled = self._filled(values[on], strengths[on], slender)
            known = values[on] + filled
            in_mould = errors.in_forces_of(stress * over)
            in_the_mould, turn = self._mould.moved(known, in_mould, over)
            stronger = self._stronger(known, by_stress[on], turn[:, :1])
            crushing = self._crushing.moved(known + stronger, errors, slender)
            top, depth, strength = self._scalars
            largest = np.where(np.abs(known) < LARGEST, known, 0.0)[:, top]
            for rows, change in (
                (self._mould.rows, in_the_mould),
                (self._crushing.rows, crushing),
                (top, errors.gain * largest + errors.offset + turn[:, 1:] * largest),
                (depth, self._mould.deeper(in_mould, over)),
                (strength, crushing[:, -2:-1]),
            ):
                moved[on[:, None], rows] = change
            filled += stronger
            moved[on] += filled
        return moved

    def _filled(self, values: np.ndarray, strengths: np.ndarray, slender: np.ndarray) -> np.ndarray:
        """What fuller moulds add to features (n, m) of specimens that are `slender` (n, 1) times as
        slender as the library's."""
        if self.filling is None or DENSITY not in self.told:
            return np.zeros_like(values)
        growth = strengths[:, [self.told.index(DENSITY)]]
        return self.filling.moved(self.features, values, growth, self.height * slender)

    def _stronger(self, values: np.ndarray, by_stress: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """What crushing features (n, m) change as a soil was pressed to 1 + turn (n, 1) times the
        force: as a power of it."""
        some = self._crushed & (np.abs(values) > LEAST_FORCE) & (np.abs(values) < LARGEST)
        safe = np.where(some, values, 1.0)
        power = np.clip(np.real(by_stress / safe), *POWERS)
        return np.where(some, safe * ((1 + turn) ** power - 1), 0.0)

    @cached_property
    def _crushed(self) -> np.ndarray:
        """Mask (m,) of forces as the soil is crushed."""
        return np.array([f.test == CRUSHED and f.unit == "N" for f in self.features])

    @cached_property
    def _scalars(self) -> tuple[np.ndarray, ...]:
        """The features of these kinds or names, if there are any: TOP, DEPTH, STRENGTH."""
        named = [(f.kind, f.name) for f in self.features]
        return tuple(
            np.array([i for i, names in enumerate(named) if wanted in names], int)
            for wanted in (TOP, DEPTH, STRENGTH)
        )

    def read(
        self, values: np.ndarray, slopes: np.ndarray, strengths: np.ndarray, shape: np.ndarray,
        along: np.ndarray, by_stress: np.ndarray, asked: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """Features (m,) and slopes (m, q) of these as they are read with errors of strengths (e,),
        and the slopes (m, e) that these add, of those that are `asked` for (a mask, (e,)); along
        (q, 2): slopes of the shape (2,); by_stress (m,): the features' own slopes with the
        logarithm of the largest stress."""
        e, m = len(strengths), len(values)
        some = np.arange(e) if asked is None else np.flatnonzero(asked)
        carried = slopes.T if strengths.any() else slopes.T[:0]
        by_strength = np.zeros((m, e))
        if not len(carried) and not len(some):
            return values, slopes, by_strength
        late = [i for i in self._lag_from_none(strengths) if i in some]
        q, own, more = len(carried), len(carried) + len(some), len(some) + len(late)
        every = values + 1j * TINY * np.vstack([carried, np.zeros((more, m))])
        shapes = shape + 1j * TINY * np.vstack([along[:q], np.zeros((more, 2))])
        unit = np.eye(e)
        steps = np.vstack([np.zeros((q, e)), 1j * TINY * unit[some], SMALL * unit[late]])
        pressed = 1j * np.imag(self.overload(strengths + steps, shapes))[:, None] * by_stress
        slope = np.broadcast_to(by_stress, every.shape)
        moved = self.shift(every + pressed, strengths + steps, shapes, slope)
        shift, turned = np.real(moved[0]), np.imag(moved + pressed)[:own].T / TINY
        by_strength[:, some] = turned[:, q:]
        by_strength[:, late] = (np.real(moved[own:]) - shift).T / SMALL
        return values + shift, slopes + turned[:, :q] if q else slopes, by_strength

    def _lag_from_none(self, strengths: np.ndarray) -> list[int]:
        """The place of the lag where there is none.  Its slope is taken over SMALL: the turn of a
        curve bends within a few readings, so the slope at no lag says little of a real one."""
        return [i for i, name in enumerate(self.told) if name == LAG and strengths[i] < LEAST]

    def _errors(self, strengths: np.ndarray) -> MachineErrors:
        """Strengths (n, e) in mm, N and s; those that are not told here are none."""
        none = np.zeros((len(strengths), 1))
        columns = (strengths * self._units).T[:, :, None]
        of = dict(zip(self.told, columns, strict=True))
        parts = [of.get(name, none) for name in MACHINE]
        return MachineErrors(*parts, closing_force=none + self.closing_force)

    @cached_property
    def _units(self) -> np.ndarray:
        """By what strengths (e,) are multiplied."""
        lengths = [EFFECTS[name].about.unit in MILLIMETRES for name in self.told]
        return np.where(lengths, 1e3, 1.0)

    @cached_property
    def _mould(self) -> MouldReading:
        return MouldReading(self.features, self.speed)

    @cached_property
    def _crushing(self) -> CrushingReading:
        return CrushingReading(self.features, self.crushing_speed)


@dataclass(frozen=True, eq=False)
class LocalMachine:
    """A machine at the library's size, and its errors (e, k), SI, per typical strength."""

    machine: Machine
    typical: np.ndarray

    def read(self, strengths, shape, of_library: int, values, base, effects, wanted=None):
        """Features (m,) of a specimen of a shape (2,) and their slopes as the machine reads them,
        those of the `wanted` effects (numbers) alone, of all if there is no such list; the shape is
        among the first `of_library` base coordinates."""
        some = slice(None) if wanted is None else list(wanted)
        slopes, own = np.hstack([base, effects[:, some]]), self.typical[:, some]
        along, of_shape = np.zeros((slopes.shape[1], len(shape))), self._columns(of_library)
        along[of_shape, range(len(shape))] = 1.0
        shown, turned, more = self.machine.read(
            values, slopes, self.typical @ strengths, shape, along, base[:, of_shape[STRESS]],
            np.asarray(own.any(axis=1)),
        )  # fmt: skip
        every = np.full(effects.shape, np.nan)
        base, every[:, some] = np.split(turned, [base.shape[1]], axis=1)
        every[:, some] += more @ own
        return shown, base, every

    def pressed(self, base: np.ndarray, strengths: np.ndarray) -> np.ndarray:
        """Base coordinates (p,) of a soil that is pressed as hard as this machine does."""
        shape = base[SHAPE_COLUMNS]
        over = self.machine.overload((self.typical @ strengths)[None], shape[None])
        return base + np.eye(len(base))[self._columns(len(base))[STRESS]] * over

    @staticmethod
    def _columns(of_library: int) -> np.ndarray:
        return np.arange(of_library)[SHAPE_COLUMNS]
