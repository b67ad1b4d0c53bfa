"""Runs the rows of a design and keeps what their curves say: the simulations of a library.

Every run lies in a campaign's cache the moment it is finished, so a stopped library goes on
where it was.  Simulations are in single precision, for speed; how far means over packings then
differ from those in double precision has not been measured.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import jax
import numpy as np

from calibrate.core.progress import AbstractProgress, Silent
from calibrate.discrepancy.library.design import FIRST_REPEAT, SMOOTHING, SPEEDS, Design
from calibrate.io.lab import Lab
from calibrate.io.soil import base_soil, with_values
from calibrate.simulation import Campaign, Run, side_by_side
from calibrate.simulation.resolution import PRESETS, numerics_for, specimen, virtual_lab
from jdem.core.smooth import Smoothing
from jdem.effects.base import AbstractEffect
from jdem.effects.capillary import CapillaryTension
from jdem.effects.cementation import Cementation
from jdem.effects.composite import EFFECTS, with_strengths
from jdem.laboratory.virtual_lab import VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.packing.specimen import Specimen

Numbers = Sequence[float] | np.ndarray
# Free specimens are pressed twice as fast as in the preset standard, which depth and force bear.
PRESET = replace(PRESETS["standard"], name="library", rate_in_mould=SPEEDS[0], rate_free=0.10)
COSTLY = (CapillaryTension, Cementation)  # longer lists of neighbours, memories of contacts


@dataclass(eq=False)
class Simulator:
    """Runs single specimens of a lab's tests with effects and settings of any strength.

    One compiled program serves all that have the same number of spheres and porosity, a second one
    those without costly effects: strength 0 changes no bit.
    """

    lab: Lab
    folder: Path
    effects: tuple[AbstractEffect, ...] = ()
    costly: tuple[type[AbstractEffect], ...] = COSTLY
    dtype: str = "float32"
    _campaigns: dict[tuple[int, float, float, bool], Campaign] = field(default_factory=dict)

    def __post_init__(self):
        self.effects = self.effects or switched_off(EFFECTS)

    def run(
        self, soil: SoilParameters, setting: Numbers, strengths: Numbers,
        spheres: int, seed: int,
    ) -> Run:  # fmt: skip
        """One specimen through both tests.

        setting: smoothing factor - 1, porosity less the usual one, and pace; strengths in SI in the
        order of `effects`; seed of the packing.
        """
        pairs = list(zip(self.effects, map(float, strengths), strict=True))
        lean = not any(strength and isinstance(effect, self.costly) for effect, strength in pairs)
        loose, pace = (round(float(given), 6) for given in setting[1:3])
        shared = self._campaign(spheres, loose, pace, lean)
        smoothing = jax.tree.map(lambda width: width * (1 + setting[0]), Smoothing())
        numerics = replace(shared.lab.numerics, smoothing=smoothing)
        kept = [s for effect, s in pairs if not (lean and isinstance(effect, self.costly))]
        changed = with_strengths(shared.lab.effects, kept)
        lab = replace(shared.lab, numerics=numerics, effects=changed)
        one = replace(shared, lab=lab, progress=Silent(), workers=1)
        return one.each([[soil]], [seed], "")[0][0]

    def porosity(self, spheres: int) -> float:
        """The usual one of a bed of this many spheres."""
        usual = specimen(self.lab, replace(PRESET, spheres=spheres)).porosity
        assert usual is not None  # PRESET grows its beds
        return usual

    def _campaign(self, spheres: int, loose: float, pace: float, lean: bool) -> Campaign:
        key = (spheres, loose, pace, lean)
        if key not in self._campaigns:
            speed = round(pace * PRESET.rate_in_mould, 6)
            preset = replace(PRESET, spheres=spheres, rate_in_mould=speed)
            cylinder = loosened(specimen(self.lab, preset), loose)
            numerics = numerics_for(cylinder, dtype=self.dtype)
            kept = tuple(e for e in self.effects if not (lean and isinstance(e, self.costly)))
            tests = virtual_lab(self.lab, preset, numerics).tests
            lab = VirtualLab.of(cylinder, tests, numerics, kept)
            folder = self.folder / str(spheres)
            self._campaigns.setdefault(key, Campaign(lab, cylinder, folder))
        return self._campaigns[key]


def switched_off(
    effects: Mapping[str, Callable[..., AbstractEffect]],
) -> tuple[AbstractEffect, ...]:
    """The effects at strength 0."""
    return tuple(effect(0.0) for effect in effects.values())


def loosened(cylinder: Specimen, loose: float) -> Specimen:
    """A specimen of a porosity that is larger by `loose`."""
    assert cylinder.porosity is not None  # PRESET grows its beds
    return replace(cylinder, porosity=round(cylinder.porosity + loose, 4)) if loose else cylinder


def run_design(
    design: Design, simulator: Simulator, progress: AbstractProgress, workers: int | None = None,
    first: int = 0,
) -> list[Run]:  # fmt: skip
    """Runs of a design from the packing `first` on, in the order of its rows; failed ones keep
    their place."""
    base, strengths = design.rows()
    packing = design.of_packing
    spheres = [design.spheres_of(int(j)) for j in packing]
    later = packing >= first
    points = RunPoints(
        base[later], strengths[later], np.array(spheres)[later].tolist(),
        1000 * design.seed + packing[later],
    )  # fmt: skip
    return run_points(design, points, simulator, progress, workers)


def run_repeats(
    design: Design, simulator: Simulator, progress: AbstractProgress, workers: int | None = None
) -> list[Run]:
    """Runs of a design's repeats, in their order; failed ones keep their place."""
    base, soils = design.repeats()
    none = np.zeros((len(base), len(design.limits)))
    spheres = [design.spheres_of(int(soil)) for soil in soils]
    packing = FIRST_REPEAT + np.arange(len(base))
    points = RunPoints(base, none, spheres, 1000 * design.seed + packing)
    return run_points(design, points, simulator, progress, workers)


@dataclass(frozen=True, eq=False)
class RunPoints:
    """What is simulated: base coordinates (n, p), strengths in SI (n, k), numbers of spheres
    (n,), seeds of packings (n,)."""

    base: np.ndarray
    strengths: np.ndarray
    spheres: Sequence[int]
    seeds: np.ndarray


def run_points(
    design: Design, points: RunPoints, simulator: Simulator, progress: AbstractProgress,
    workers: int | None = None,
) -> list[Run]:  # fmt: skip
    """Runs at points in the coordinates of a design; failed ones keep their place."""
    centre = with_values(base_soil(simulator.lab), dict(design.centre))
    wide = len(design.soil_names)

    def one(place: int) -> Run:
        row = order[place]
        values = {
            name: design.centre[name] * math.exp(points.base[row, i])
            for i, name in enumerate(design.soil_names)
        }
        return simulator.run(
            with_values(centre, values), points.base[row, wide : wide + 3],
            points.strengths[row], points.spheres[row], int(points.seeds[row]),
        )  # fmt: skip

    order = _two_packings_in_turn(points.seeds)
    made = side_by_side(one, len(points.base), progress, "simulating", workers)
    return [made[place] for place in np.argsort(order)]


def _two_packings_in_turn(seeds: np.ndarray) -> np.ndarray:
    """The order (n,) in which two workers never wait for the same packing to be prepared."""
    _, packing = np.unique(seeds, return_inverse=True)
    number = np.array([int((packing[:i] == one).sum()) for i, one in enumerate(packing)])
    return np.lexsort((packing % 2, number, packing // 2))


def reference_run(design: Design, simulator: Simulator) -> Run:
    """The centre's soil on the first packing, slowly, without effects."""
    soil = with_values(base_soil(simulator.lab), dict(design.centre))
    none = [0.0] * len(simulator.effects)
    setting = (SMOOTHING[0], 0.0, SPEEDS[1] / SPEEDS[0])
    return simulator.run(soil, setting, none, design.spheres, 1000 * design.seed + 1)
