"""Simulations about one lab's leading explanations: what a bank only estimates there, simulated.

    lab, bank -> explanations -> places -> runs -> bank with these runs joined -> again

A place is the soil and the strength that best explain the curves by one explanation: none, the
leading effects, the leading pair.  Every packing is crushed at every place, so that explanations
are compared on the same packings; soils and strengths scatter a little about a place, which
gives slopes too.  Runs lie in a cache, so that the same question is answered without a new run.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calibrate.core.errors import InputError
from calibrate.core.progress import AbstractProgress, Silent
from calibrate.discrepancy.comparison.compare import Which, diagnose
from calibrate.discrepancy.comparison.refit import Refit
from calibrate.discrepancy.diagnosis import Manner, described, ready_to_diagnose
from calibrate.discrepancy.library.description import Discrepancy, Point, Ready, point_for
from calibrate.discrepancy.library.design import SETTINGS, SHARP, SMOOTHING
from calibrate.discrepancy.library.simulate import Points, Simulator, run_points, switched_off
from calibrate.discrepancy.library.store import Bank, Cylinder, Rows
from calibrate.io.lab import Lab, bundled_lab, load_lab
from jdem.effects.composite import EFFECTS

PLACES = 6  # explanations that are simulated about, in each round
ROUNDS = 2
DRAWS = 200  # of null distributions, to rank explanations
SOIL_SPREAD = 0.25  # prior deviations by which soils scatter about a place
STRENGTH_SPREAD = 0.25  # share by which strengths do
FEWER, MORE = 1.0, 4 / 3  # spheres over the bank's, in turn
FIRST_SEED = 900_000  # of packings, which no bank has
LEAST_STRENGTH = 0.05  # typical strengths; an effect below is off
Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Place:
    """Base coordinates (p,) and strengths in SI (k,)."""

    base: np.ndarray
    strengths: np.ndarray


@dataclass(frozen=True)
class Nearby:
    """How much is simulated, and where runs are kept."""

    packings: int
    folder: Path
    progress: AbstractProgress = field(default_factory=Silent)
    workers: int | None = None


def refined(
    lab: Lab, ready: Ready, seed: int, how: Nearby, discrepancy: Discrepancy | None = None,
    say: Say = lambda text: None,
) -> Ready:  # fmt: skip
    """The bank with simulations about this lab's leading explanations."""
    effects = switched_off({name: EFFECTS[name] for name in ready.bank.design.effect_names})
    simulator = Simulator(simulated_lab(lab, ready.bank), how.folder, effects)
    per_round = how.packings // ROUNDS
    known = ready
    for number in range(ROUNDS):
        say(f"leading explanations, round {number + 1} of {ROUNDS}")
        places = leading_places(lab, known, seed, discrepancy)
        packings = range(number * per_round, (number + 1) * per_round)
        points = about(places, ready.bank, packings, seed)
        runs = run_points(ready.bank.design, points, simulator, how.progress, how.workers)
        of_packing = points.seeds - FIRST_SEED - number * per_round
        rows = Rows.of(ready.bank.features, points.base, points.strengths, of_packing, runs)
        known = known.joined(rows, ready.bank) if len(rows.values) else known
    return known


def simulated_lab(lab: Lab, bank: Bank) -> Lab:
    """The lab file whose specimen is that of the bank: the bundled one, or the one at hand."""
    for candidate in (load_lab(bundled_lab()), lab):
        if Cylinder.of(candidate) == bank.cylinder:
            return candidate
    problem = "its size is not that of the bank's, which simulations about this lab would need"
    raise InputError(lab.file, "specimen", problem, "leave --simulate out, or make a bank for it")


def leading_places(
    lab: Lab, ready: Ready, seed: int, discrepancy: Discrepancy | None
) -> list[Place]:
    """Where the likeliest explanations have their best fits: none first, then effects and the
    likeliest pair."""
    _, d, measured = described(lab, ready, seed, discrepancy)
    prepared = ready_to_diagnose(d, measured, seed, Manner.neutral(), DRAWS)
    which = diagnose(prepared, measured)
    point = point_for(lab, ready.bank)
    return [place_of(fit, point, ready.bank) for fit in leading_fits(which)]


def leading_fits(which: Which) -> list[Refit]:
    """The base fit, then the likeliest refitted effects and the likeliest refitted pair."""
    value = which.facts.evidence.by_key()
    order = sorted(which.refits, key=lambda key: -value[key])
    alone = [key for key in order if len(key) == 1 and which.refits[key].strengths[key[0]]]
    together = [key for key in order if len(key) == 2][:1]
    keys = alone[: PLACES - 1 - len(together)] + together
    return [which.base, *(which.refits[key] for key in keys)]


def place_of(fit: Refit, point: Point, bank: Bank) -> Place:
    """A fit in the coordinates of a bank, within what it covers."""
    base = point.offset + fit.delta[: len(point.offset)]
    strengths = np.where(np.abs(fit.strengths) > LEAST_STRENGTH, fit.strengths, 0.0)
    low, high = np.array(list(bank.design.limits.values())).T
    return Place(base, np.clip(strengths * bank.design.typical(), low, high))


def about(places: Sequence[Place], bank: Bank, packings: range, seed: int) -> Points:
    """Every place on every packing, packing by packing, soils and strengths scattered a little."""
    design = bank.design
    wide, count = len(design.soil_names), len(packings) * len(places)
    base = np.array([place.base for _ in packings for place in places])
    strengths = np.array([place.strengths for _ in packings for place in places])
    random = np.random.default_rng([seed, packings.start])
    normal = np.clip(random.standard_normal((count, wide + strengths.shape[1])), -2, 2)
    base[:, :wide] += SOIL_SPREAD * normal[:, :wide] * np.array(list(design.soil_sd.values()))
    strengths *= np.exp(STRENGTH_SPREAD * normal[:, wide:])
    factor = np.repeat([MORE if j % 2 else FEWER for j in packings], len(places))
    spheres = np.round(design.spheres * factor).astype(int)
    smoothing, preparation, number = (wide + SETTINGS.index(name) for name in SETTINGS)
    base[:, smoothing] = np.clip(base[:, smoothing], SHARP[0], SMOOTHING[1])
    base[:, preparation] = np.repeat(np.mean([p.base[preparation] for p in places]), count)
    base[:, number] = np.log(spheres / design.spheres)
    seeds = FIRST_SEED + np.repeat(np.array(packings), len(places))
    return Points(base, strengths, spheres.tolist(), seeds)
