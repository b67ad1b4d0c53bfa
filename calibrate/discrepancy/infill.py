"""Infill runs: simulations about one lab's leading explanations, where a library only interpolates.

    lab, library -> explanations -> locations -> runs -> library with these runs joined -> again

A location is the soil and the strength that best explain the curves by one explanation: none, the
leading effects, the leading pair.  Every packing is tested at every location; soils and strengths
scatter a little about it, which gives slopes too.  Runs lie in a cache.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calibrate.core.errors import InputError
from calibrate.core.progress import AbstractProgress, Silent
from calibrate.discrepancy.comparison.compare import Comparison, compare
from calibrate.discrepancy.comparison.probability_calibration import ProbabilityCalibration
from calibrate.discrepancy.comparison.refit import Refit
from calibrate.discrepancy.diagnosis import described, prepared_diagnosis
from calibrate.discrepancy.library.description import EmulatedLibrary, ModelDiscrepancy
from calibrate.discrepancy.library.design import (
    POROSITIES,
    SETTINGS,
    SHAPE_COLUMNS,
    SLOW,
    SMOOTHING,
    RunPoints,
)
from calibrate.discrepancy.library.lab_size import SoilPrior, soil_prior_for
from calibrate.discrepancy.library.run_library import Cylinder, Rows, RunLibrary
from calibrate.discrepancy.library.simulate import Simulator, run_points, switched_off
from calibrate.io.conventions import HELD
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.simulation import HERE, AbstractPlace
from jdem.effects.composite import EFFECTS

LOCATIONS = 6  # explanations that are simulated about, in each round
ROUNDS = 2
DRAWS = 200  # of null distributions, to rank explanations
SOIL_SPREAD = 0.25  # prior deviations by which soils scatter about a location
STRENGTH_SPREAD = 0.25  # share by which strengths do
SIZES = (1.0, 1.0, 1.0, 2.5)  # spheres of packings over the design's, in turn
FIRST_SEED = 900_000  # of packings, which no library has
LEAST_STRENGTH = 0.05  # typical strengths; an effect below is off
Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class InfillLocation:
    """Where infill runs lie: base coordinates (p,) and strengths in SI (k,)."""

    base: np.ndarray
    strengths: np.ndarray


@dataclass(frozen=True)
class InfillPlan:
    """How much is simulated, where, and where runs are kept."""

    packings: int
    folder: Path
    progress: AbstractProgress = field(default_factory=Silent)
    place: AbstractPlace = HERE
    workers: int | None = None


def with_infill_runs(
    lab: Lab, emulated: EmulatedLibrary, seed: int, plan: InfillPlan,
    discrepancy: ModelDiscrepancy | None = None, say: Say = lambda text: None,
) -> EmulatedLibrary:  # fmt: skip
    """The library with runs about this lab's leading explanations."""
    extended = emulated.for_lab(lab)
    own, per_round = extended.library, plan.packings // ROUNDS
    for number in range(ROUNDS):
        say(f"leading explanations, round {number + 1} of {ROUNDS}")
        packings = range(number * per_round, (number + 1) * per_round)
        rows = rows_about(lab, extended, packings, seed, plan, discrepancy)
        extended = extended.joined(rows, own) if len(rows.values) else extended
    return extended


def rows_about(
    lab: Lab, emulated: EmulatedLibrary, packings: range, seed: int, plan: InfillPlan,
    discrepancy: ModelDiscrepancy | None = None, sizes: Sequence[float] = SIZES,
) -> Rows:  # fmt: skip
    """Simulations about the leading explanations of a lab, in whose size the library speaks, on
    packings with spheres of these sizes over the design's."""
    library = emulated.library
    effects = switched_off({name: EFFECTS[name] for name in library.design.effect_names})
    simulator = Simulator(simulated_lab(lab, library), plan.folder, effects, place=plan.place)
    locations = leading_locations(lab, emulated, seed, discrepancy)
    held = tuple(HELD.get(lab.particles.conventions, ()))
    points = scattered_about(locations, library, packings, seed, held, sizes)
    runs = run_points(library.design, points, simulator, plan.progress, plan.workers)
    return Rows.of(library.cylinder, points, runs)


def simulated_lab(lab: Lab, library: RunLibrary) -> Lab:
    """A lab whose cylinder is the library's: the bundled one, or the one at hand."""
    for candidate in (load_lab(bundled_lab()), lab):
        if Cylinder.of(candidate) == library.cylinder:
            return candidate.following(lab.particles.conventions)
    problem = "the library was made for a cylinder that neither this lab nor the bundled one has"
    raise InputError(
        lab.file, "specimen", problem, "leave --simulate out, or give the bundled library"
    )


def leading_locations(
    lab: Lab, emulated: EmulatedLibrary, seed: int, discrepancy: ModelDiscrepancy | None
) -> list[InfillLocation]:
    """Where the likeliest explanations have their best fits: none first, then effects and the
    likeliest pair."""
    _, d, measured = described(lab, emulated, seed, discrepancy)
    prepared = prepared_diagnosis(d, measured, seed, ProbabilityCalibration(), DRAWS)
    comparison = compare(prepared, measured)
    soil_prior = soil_prior_for(lab, emulated.library)
    return [
        location_of(fit, soil_prior, emulated.library, d.effect_names)
        for fit in leading_fits(comparison)
    ]


def leading_fits(comparison: Comparison) -> list[Refit]:
    """The base fit, then the likeliest refitted effects and the likeliest refitted pair."""
    value = comparison.summary.evidence.by_key()
    order = sorted(comparison.refits, key=lambda key: -value[key])
    alone = [key for key in order if len(key) == 1 and comparison.refits[key].strengths[key[0]]]
    together = [key for key in order if len(key) == 2][:1]
    keys = alone[: LOCATIONS - 1 - len(together)] + together
    return [comparison.base, *(comparison.refits[key] for key in keys)]


def location_of(
    fit: Refit, soil_prior: SoilPrior, library: RunLibrary, names: Sequence[str]
) -> InfillLocation:
    """A fit with these candidate effects in a library's coordinates, within its strengths; of the
    lab's own shape, so that one packing serves all."""
    base = soil_prior.offset + fit.delta[: len(soil_prior.offset)]
    base[SHAPE_COLUMNS] = np.round(soil_prior.offset[SHAPE_COLUMNS], 6)
    of_name = dict(zip(names, fit.strengths, strict=True))
    every = np.array([of_name.get(name, 0.0) for name in library.design.effect_names])
    strengths = np.where(np.abs(every) > LEAST_STRENGTH, every, 0.0)
    low, high = np.array(list(library.design.limits.values())).T
    return InfillLocation(base, np.clip(strengths * library.design.typical(), low, high))


def scattered_about(
    locations: Sequence[InfillLocation], library: RunLibrary, packings: range, seed: int,
    held: Sequence[str] = (), sizes: Sequence[float] = SIZES,
) -> RunPoints:  # fmt: skip
    """Every location on every packing, packing by packing; soils and strengths scatter a little,
    but for soil parameters that are `held`.  sizes: spheres of packings over the design's."""
    design = library.design
    wide, count = len(design.soil_names), len(packings) * len(locations)
    base = np.array([location.base for _ in packings for location in locations])
    strengths = np.array([location.strengths for _ in packings for location in locations])
    random = np.random.default_rng([seed, packings.start])
    normal = np.clip(random.standard_normal((count, wide + strengths.shape[1])), -2, 2)
    normal[:, [i for i, name in enumerate(design.soil_names) if name in held]] = 0.0
    base[:, :wide] += SOIL_SPREAD * normal[:, :wide] * np.array(list(design.soil_sd.values()))
    strengths *= np.exp(STRENGTH_SPREAD * normal[:, wide:])
    factor = np.repeat([sizes[j % len(sizes)] for j in packings], len(locations))
    spheres = np.round(design.spheres * factor).astype(int)
    smoothing, porosity, pace, *_, size = (wide + SETTINGS.index(name) for name in SETTINGS)
    base[:, smoothing] = np.clip(base[:, smoothing], *SMOOTHING)
    looser = np.mean([location.base[porosity] for location in locations])
    base[:, porosity] = min(POROSITIES, key=lambda level: abs(level - looser))
    base[:, pace] = SLOW
    base[:, size] = [design.sphere_size(number) for number in spheres]
    number = np.repeat(np.array(packings), len(locations))
    return RunPoints(
        base, strengths, spheres.tolist(), FIRST_SEED + number, number - packings.start
    )
