"""Runs the rows of a design and keeps what their curves say: the simulations of a library.

Every run lies in a campaign's cache the moment it is finished, so a stopped library goes on
where it was.  Simulations are in single precision, for speed: over 24 specimens that changes the
mean depth by 0.02 +- 0.04 % and the mean crushing force by -0.2 +- 0.9 %.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import jax
import numpy as np

from calibrate.core.errors import CalibrationError, InputError
from calibrate.core.progress import AbstractProgress, Silent
from calibrate.discrepancy.library.design import SLOW, SMOOTHING, SPEEDS, Design, RunPoints
from calibrate.discrepancy.library.run_library import Cylinder, RunLibrary
from calibrate.io.lab import Lab
from calibrate.io.soil import base_soil, with_values
from calibrate.simulation import (
    HERE,
    AbstractPlace,
    Campaign,
    Run,
    cores,
    not_simulated,
    side_by_side,
)
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
POROSITY_CLASS = 0.03  # width; radii within one differ by less than 2 %
COSTLY = (CapillaryTension, Cementation)  # longer lists of neighbours, memories of contacts


@dataclass(eq=False)
class Simulator:
    """Runs single specimens of a lab's tests with effects and settings of any strength; one
    compiled program serves all of one number of spheres, height and class of porosity, a second one
    those without costly effects: strength 0 changes no bit."""

    lab: Lab
    folder: Path
    effects: tuple[AbstractEffect, ...] = ()
    costly: tuple[type[AbstractEffect], ...] = COSTLY
    place: AbstractPlace = HERE
    _campaigns: dict[tuple, Campaign] = field(default_factory=dict)

    def __post_init__(self):
        self.effects = self.effects or switched_off(EFFECTS)

    def run(
        self, soil: SoilParameters, setting: Numbers, strengths: Numbers,
        spheres: int, seed: int,
    ) -> Run:  # fmt: skip
        """One specimen through both tests; a failed run where its packing does not stand.

        setting: as `design.SETTINGS`, the size of spheres aside; strengths in SI in the order of
        `effects`; spheres: in the library's cylinder, a higher one has more; seed of the packing.
        """
        pairs = list(zip(self.effects, map(float, strengths), strict=True))
        lean = not any(strength and isinstance(effect, self.costly) for effect, strength in pairs)
        loose, pace, *shape = (round(float(given), 6) for given in setting[1:5])
        shared = self._campaign(spheres, loose, pace, lean, *shape)
        smoothing = jax.tree.map(lambda width: width * (1 + setting[0]), Smoothing())
        numerics = replace(shared.lab.numerics, smoothing=smoothing)
        kept = [s for effect, s in pairs if not (lean and isinstance(effect, self.costly))]
        changed = with_strengths(shared.lab.effects, kept)
        lab = replace(shared.lab, numerics=numerics, effects=changed)
        one = replace(shared, lab=lab, progress=Silent(), workers=1)
        try:
            return one.each([[soil]], [seed], "")[0][0]
        except CalibrationError as error:  # this packing does not stand
            return not_simulated(lab, str(error))

    @property
    def slots(self) -> int:
        """How many specimens may be handed in at once."""
        return self.place.slots(cores())

    def _campaign(
        self, spheres: int, loose: float, pace: float, lean: bool, slenderness: float = 0.0,
        stress: float = 0.0,
    ) -> Campaign:  # fmt: skip
        key = (spheres, loose, pace, lean, slenderness, stress)
        if key not in self._campaigns:
            own = shaped(self.lab, slenderness, stress)
            speed = round(pace * PRESET.rate_in_mould, 6)
            count = round(spheres * math.exp(slenderness))
            preset = replace(PRESET, spheres=count, rate_in_mould=speed)
            cylinder = loosened(specimen(own, preset), loose)
            room = loosened(specimen(own, preset), densest(loose))
            numerics = numerics_for(room, dtype="float32")
            kept = tuple(e for e in self.effects if not (lean and isinstance(e, self.costly)))
            tests = virtual_lab(own, preset, numerics).tests
            lab = VirtualLab.of(room, tests, numerics, kept)
            folder = self.folder / str(spheres)
            self._campaigns.setdefault(key, Campaign(lab, cylinder, folder, place=self.place))
        return self._campaigns[key]


def switched_off(
    effects: Mapping[str, Callable[..., AbstractEffect]],
) -> tuple[AbstractEffect, ...]:
    """The effects at strength 0."""
    return tuple(effect(0.0) for effect in effects.values())


def shaped(lab: Lab, slenderness: float, stress: float = 0.0) -> Lab:
    """A lab whose height is exp(slenderness) times as large, and whose forces of the depth are
    exp(stress) times."""
    if not (slenderness or stress):
        return lab
    own, high = lab.specimen, lab.pair().compression.force_high
    height = own.height * math.exp(slenderness)
    return resized(lab, own.diameter, height, high * math.exp(stress))


def resized(lab: Lab, diameter: float, height: float, force_high: float) -> Lab:
    """A lab with specimens of a diameter and height (m), and a largest force (N) in the mould; both
    forces of the depth in proportion."""
    cylinder = replace(lab.specimen, diameter=diameter, height=height, mould_height=None)
    first = lab.pair().compression
    factor = force_high / first.force_high
    forces = {n: factor * getattr(first, n) for n in ("force_low", "force_high")}
    tests = tuple(t.model_copy(update=forces) if t is first else t for t in lab.tests)
    return replace(lab, specimen=cylinder, tests=tests)


def densest(loose: float) -> float:
    """The least porosity, over the usual one, of a class of specimens: lists of neighbours and
    samples of its one program are made for the largest spheres."""
    return round(math.floor(loose / POROSITY_CLASS) * POROSITY_CLASS, 6)


def loosened(cylinder: Specimen, loose: float) -> Specimen:
    """A specimen of a porosity that is larger by `loose`."""
    assert cylinder.porosity is not None  # PRESET grows its beds
    return replace(cylinder, porosity=round(cylinder.porosity + loose, 4)) if loose else cylinder


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
            with_values(centre, values), points.base[row, wide : wide + 5],
            points.strengths[row], int(points.spheres[row]), int(points.seeds[row]),
        )  # fmt: skip

    order = _two_packings_in_turn(points.seeds)
    made = side_by_side(one, len(points.base), progress, "simulating", workers or simulator.slots)
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
    setting = (SMOOTHING[0], 0.0, SLOW)
    return simulator.run(soil, setting, none, design.spheres, 1000 * design.seed + 1)


def check_extends(design: Design, lab: Lab, smaller: RunLibrary, file: str) -> None:
    """Refuses to grow a library of another plan or cylinder, or by nothing."""
    own = smaller.design
    like = replace(design, packings=own.packings, shaped=own.shaped, refined=own.refined)
    if like != smaller.design or Cylinder.of(lab) != smaller.cylinder:
        problem = "this library was made for another centre, cylinder or number of spheres"
        raise InputError(file, "design", problem, "give the options that made it, or no --onto")
    if own.shaped and design.shaped != own.shaped:
        problem = f"it has {own.shaped} packings of --shaped already, and they do not grow"
        raise InputError(file, "shaped", problem, f"give --shaped {own.shaped}, or no --onto")
    if design.refined < own.refined:
        problem = f"it has {own.refined} packings of --refined, and fewer are asked for"
        raise InputError(file, "refined", problem, f"give --refined {own.refined} or more")
    more = design.packings > own.packings
    lacks = lacks_shapes(design, smaller) or lacks_refined(design, smaller)
    if not more and not lacks:
        problem = f"it has {own.packings} packings already"
        raise InputError(file, "packings", problem, "ask for more with --packings")
    if design.packings < own.packings:
        problem = f"it has {own.packings} packings, and --packings asks for fewer"
        raise InputError(file, "packings", problem, "ask for as many or more")


def check_cylinder(library: RunLibrary, lab: Lab, file: str) -> None:
    """Refuses runs of another cylinder beside a library."""
    if Cylinder.of(lab) != library.cylinder:
        problem = "this library was made for another cylinder, or for other forces, than this lab's"
        raise InputError(file, "cylinder", problem, "give the lab file that it was made for")


def lacks_shapes(design: Design, smaller: RunLibrary) -> bool:
    """Whether a library has no specimens of other shapes, and a design has."""
    return bool(design.shaped and not smaller.design.shaped)


def lacks_refined(design: Design, smaller: RunLibrary) -> bool:
    """Whether a design samples effects again on more packings than a library has."""
    return design.refined > smaller.design.refined
