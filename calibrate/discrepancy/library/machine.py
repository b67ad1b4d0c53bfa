"""What a testing machine adds to the features of a soil's curves, in closed form.

    d_shown = d + C F + s (1 - exp(-F/F_s))        compliance C of the frame, seating gap s
    F_shown = (1 + g) R + b + c t                  gain g, offset b, drift c of the load cell
    tau dR/dt = F - R                              lag tau of its reading

An emulator of warped features would have to learn these for every soil, though they need only the
soil's own curve.  So the curve is laid through the features that the emulator gives, is read as the
machine reads it (`mould_reading`, `crushing_reading`), and what has changed is added.  A library's
rows are the other way round: what the machine adds is taken off before the emulator sees them.
To find a curve from its readings would be a deconvolution; so what is taken off a row is what the
emulator's own curve of its soil gives.  The emulator then learns what is left: that a soil which
was pressed harder is stronger, for one.

Everything is done for all rows at once, and holds for complex numbers: an imaginary part that is
small beyond rounding carries a derivative through exactly (Squire and Trapp 1998,
doi 10.1137/S003614459631241X), since no two such parts ever multiply to anything.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibrate.discrepancy.library.crushing_reading import CrushingReading
from calibrate.discrepancy.library.mould_reading import MouldReading
from calibrate.discrepancy.library.reading import MachineErrors
from calibrate.labtests.diagnosis.base import Feature
from jdem.effects.composite import EFFECTS
from jdem.effects.seating import SeatingGap

LAG = "acquisition_lag"
MACHINE = (  # in the order of `MachineErrors`
    "load_frame_compliance", "seating_gap", "load_cell_gain", "load_cell_offset",
    "load_cell_drift", LAG,
)  # fmt: skip
MILLIMETRES = ("m", "m/N")  # units of strengths that are told in mm
SMALL = 0.01  # s; step of the lag for a slope where there is none
LEAST = 1e-12  # s; a lag below is none
TINY = 1e-30  # imaginary parts of derivatives


@dataclass(frozen=True, eq=False)
class Machine:
    """A machine at the library's size: the features that it reads, the platen's speeds (mm/s) in
    the mould and in crushing, those of `MACHINE` that are told in closed form, and the force (N) by
    which a seating gap closes."""

    features: Sequence[Feature]
    speed: float
    crushing_speed: float
    told: tuple[str, ...] = MACHINE
    closing_force: float = float(SeatingGap().closing_force)

    def shift(self, values: np.ndarray, strengths: np.ndarray, shape: np.ndarray) -> np.ndarray:
        """What errors of strengths (n, e), SI, in the order of `told`, add to features (n, m)
        that are read without any, of specimens whose shapes (n, 2) over the library's are given."""
        moved = np.zeros(values.shape, np.result_type(values, strengths, shape))
        on = np.flatnonzero((strengths != 0).any(axis=1))
        if len(on):
            slender, stress = np.exp(shape[on]).T[:, :, None]
            errors = self._errors(strengths[on])
            for rows, change in (
                (self._mould.rows, self._mould.moved(values[on], errors.in_forces_of(stress))),
                (self._crushing.rows, self._crushing.moved(values[on], errors, slender)),
            ):
                moved[on[:, None], rows] = change
        return moved

    def read(
        self, values: np.ndarray, slopes: np.ndarray, strengths: np.ndarray, shape: np.ndarray,
        along: np.ndarray, asked: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """Features (m,) and slopes (m, q) of these as they are read with errors of strengths (e,),
        and the shift's slopes (m, e) with these, of those that are `asked` for (a mask, (e,));
        along (q, 2): slopes of the shape (2,)."""
        e, m = len(strengths), len(values)
        some = np.arange(e) if asked is None else np.flatnonzero(asked)
        carried = slopes.T if strengths.any() else slopes.T[:0]
        by_strength = np.zeros((m, e))
        if not len(carried) and not len(some):
            return values, slopes, by_strength
        q, more = len(carried), len(some) + 1
        every = values + 1j * TINY * np.vstack([carried, np.zeros((more, m))])
        shapes = shape + 1j * TINY * np.vstack([along[:q], np.zeros((more, 2))])
        steps = 1j * TINY * np.vstack([np.zeros((q, e)), np.eye(e)[some], np.zeros((1, e))])
        late = self._lag_from_none(strengths)
        steps[-1, late] = SMALL
        moved = self.shift(every, strengths + steps, shapes)
        shift, turned = np.real(moved[-2]), np.imag(moved[:-1]).T / TINY
        by_strength[:, some] = turned[:, q:]
        by_strength[:, late] = (np.real(moved[-1]) - shift)[:, None] / SMALL
        return values + shift, slopes + turned[:, :q] if q else slopes, by_strength

    def _lag_from_none(self, strengths: np.ndarray) -> list[int]:
        """The place of the lag where there is none.  Its slope is taken over SMALL: the turn of a
        curve bends within a few readings, so the slope at no lag says little of a real one."""
        return [i for i, name in enumerate(self.told) if name == LAG and strengths[i] < LEAST]

    def _errors(self, strengths: np.ndarray) -> MachineErrors:
        """Strengths (n, e) in mm, N and s; those that are not told here are none."""
        none = np.zeros((len(strengths), 1))
        of = {
            name: column[:, None] * (1e3 if EFFECTS[name].about.unit in MILLIMETRES else 1.0)
            for name, column in zip(self.told, strengths.T, strict=True)
        }
        parts = [of.get(name, none) for name in MACHINE]
        return MachineErrors(*parts, closing_force=none + self.closing_force)

    @cached_property
    def _mould(self) -> MouldReading:
        return MouldReading(self.features, self.speed)

    @cached_property
    def _crushing(self) -> CrushingReading:
        return CrushingReading(self.features, self.crushing_speed)
