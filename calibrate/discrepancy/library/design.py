"""Which simulations a library holds: rows of soil, settings and effects, several on each packing.

A row is a point x of

    soil      ln p - ln p_centre                 as far as 2.2 prior deviations, normal
    settings  smoothing (factor - 1), denser where roundings are small, as soils have none;
              porosity less the usual one (-); pace, the platen's speed in the mould over the fast
              one; size of the spheres over that of the design, less 1
    effects   strengths, uniform within their limits where they are at work: each in ACTIVE of the
              rows (so that pairs occur); on two packings of five all rows share one soil, the
              first has no effect at work and the others one each, strong, in turn

drawn from a Sobol sequence, so that every beginning of the list is a smaller library.  Rows of one
packing differ in all else, or in an effect alone: what packings have in common drops out of the
slopes (common random numbers).

Numbers of spheres take turns: most rows are cheap, enough are dear.  The size of spheres is the
coordinate, d/D ~ N^(-1/3): walls and the ends of a specimen count in proportion to it, and the
limit of fine grains lies at -1.  A simulated press is twenty times as fast as a laboratory's, so
the rows of some packings are simulated again, slowly: a laboratory lies near the pace 0.

Further packings:

    shaped   heights of HEIGHTS in turn, and a largest stress within STRESSES for each row
    refined  what the emulator misses most, again: all rows share one soil, the first has no effect
             at work, the others one each of REFINED, from packing AGAIN on of REFINED_AGAIN
    plain    soils without effects, a few on each, under other conventions (`other_law`)
    repeats  further soils without effects, each on SPECIMENS packings of its own: rows alone cannot
             tell what a packing does from what a smooth function of the soil misses
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import ndtr, ndtri

from jdem.effects.composite import EFFECTS
from jdem.materials.catalogue import CATALOGUE

ACTIVE = 0.12  # share of rows in which an effect is at work
ALONE, OF = (1, 4), 5  # packings of five on which effects are at work one at a time
FURTHEST = 2.2  # prior deviations of a soil parameter
SMOOTHING = (-0.95, 0.3)  # of the factor on all widths, minus 1
SIZES = (0.5, 1.0, 0.5, 1.0, 2.5, 0.5, 1.0, 0.5)  # spheres of packings over the design's, in turn
POROSITIES = (0.0, -0.02, 0.01)  # over the usual one of spheres of their size, in turn
WEAKEST = 0.3  # of its limit, an effect by itself
SPEEDS = (0.16, 0.045)  # m/s, of the platen in the mould: fast and slow
SLOW = SPEEDS[1] / SPEEDS[0]  # the pace of slow rows
TURN = 16  # packings in a row that are slow too, or are not
SPECIMENS = 4  # packings of each repeated soil
FIRST_REPEAT = 500  # number of the first packing of repeats; a library has fewer (`--packings`)
FIRST_SHAPED = 600  # of the first packing of other shapes
HEIGHTS = (0.5, 1.5, 0.8, 1.25, 0.63, 1.0)  # of their specimens over the library's, in turn
STRESSES = (0.25, 2.5)  # largest stress over the library's
SHAPED_SIZES = (0.5, 1.0)  # spheres in the library's cylinder over the design's, after each turn
FIRST_REFINED = 700  # of the first packing of effects that are sampled again
REFINED = ("capillary_tension", "capillary_tension", "specimen_density", "wall_friction")
AGAIN = 32  # packing from which others take turns: what was missed most then
REFINED_AGAIN = ("cementation", "cementation", "capillary_tension", "specimen_density")
REFINED_SHARE = (0.08, 0.65)  # of their limits
REFINED_SIZES = (1.0, 0.5, 1.0, 1.0)  # spheres over the design's, in turn
OTHER_LAW_SIZES = (1.0, 0.5, 1.0, 1.0)  # spheres of packings under other conventions, in turn
SETTINGS = ("smoothing", "porosity", "pace", "slenderness", "stress", "sphere_size")
SETTING_SPREAD = (0.5, 0.02, 0.5, 0.4, 0.7, 0.3)
SHAPE = ("slenderness", "stress")  # settings that a specimen and its test state
SHAPE_COLUMNS = [SETTINGS.index(name) - len(SETTINGS) for name in SHAPE]  # of base coordinates

SOIL = (  # parameters that are varied, in the order of a point's coordinates
    "shear_modulus",
    "surface_energy",
    "plasticity_ratio",
    "static_friction",
    "rolling_friction",
    "restitution",
    "tensile_exponent",
    "tangential_multiplier",
)


def _calibrated_sd(name: str) -> float:
    search = CATALOGUE[name].search
    if search is None or search.calibrated_sd is None:
        raise ValueError(f"{name} has no calibrated_sd in its catalogue entry: give it one")
    return search.calibrated_sd


# Standard deviations of ln p about a lab's own starting soil, and the centre of the library.
SOIL_PRIOR_SD: dict[str, float] = {name: _calibrated_sd(name) for name in SOIL}
CENTRE: dict[str, float] = {
    "shear_modulus": 7.7e6,
    "surface_energy": 17.0,
    "plasticity_ratio": 0.7,
    "static_friction": 0.64,
    "rolling_friction": 0.1,
    "restitution": 0.31,
    "tensile_exponent": 1.4,
    "tangential_multiplier": 0.9,
}
HIGHEST = {"plasticity_ratio": 0.82}

# Least and largest strength that is simulated, SI; wider than typical, as reality may be.
LIMITS: dict[str, tuple[float, float]] = {
    "load_frame_compliance": (0.0, 2e-6),
    "seating_gap": (0.0, 1.5e-3),
    "load_cell_gain": (-0.2, 0.2),
    "load_cell_offset": (-30.0, 30.0),
    "load_cell_drift": (-0.05, 0.05),
    "acquisition_lag": (0.0, 0.25),
    "wall_friction": (0.0, 0.7),
    "platen_friction": (-0.25, 1.2),
    "second_test_factor": (-0.45, 0.8),
    "capillary_tension": (0.0, 3e4),
    "cementation": (0.0, 2e5),
    "rate_dependence": (0.0, 0.25),
    "specimen_density": (-0.03, 0.03),
}


@dataclass(frozen=True, eq=False)
class RunPoints:
    """What is simulated: base coordinates (n, p), strengths in SI (n, k), numbers of spheres (n,)
    in the library's cylinder, seeds (n,) of packings, and their numbers (n,) in a library."""

    base: np.ndarray
    strengths: np.ndarray
    spheres: Sequence[int]
    seeds: np.ndarray
    packing: np.ndarray


@dataclass(frozen=True)
class Design:
    """The plan of a library: packings x rows_each simulations of specimens of `spheres` spheres,
    and those of one block of TURN packings in `slow_in` again, slowly (0: of none); repeats of
    `repeated` further soils; `shaped` packings of other heights; `refined` packings of effects that
    are sampled again."""

    packings: int = 160
    rows_each: int = 6
    spheres: int = 1000
    seed: int = 40
    slow_in: int = 4
    repeated: int = 24
    shaped: int = 0
    refined: int = 0
    centre: Mapping[str, float] = field(default_factory=lambda: dict(CENTRE))
    soil_sd: Mapping[str, float] = field(default_factory=lambda: dict(SOIL_PRIOR_SD))
    limits: Mapping[str, tuple[float, float]] = field(default_factory=lambda: dict(LIMITS))

    @property
    def soil_names(self) -> tuple[str, ...]:
        return tuple(self.soil_sd)

    @property
    def base_names(self) -> tuple[str, ...]:
        """Coordinates that a calibration may move: soil, then settings."""
        return (*self.soil_names, *SETTINGS)

    @property
    def effect_names(self) -> tuple[str, ...]:
        return tuple(self.limits)

    def spread(self) -> np.ndarray:
        """By what base coordinates are scaled, about their deviations, shape (p,)."""
        return np.array([*self.soil_sd.values(), *SETTING_SPREAD])

    def typical(self) -> np.ndarray:
        """Typical strengths by which strengths are scaled, SI, shape (k,)."""
        return np.array([max(abs(t) for t in EFFECTS[n].about.typical) for n in self.effect_names])

    def sphere_size(self, spheres: int) -> float:
        """The coordinate of a number of spheres: their size over that of the design's, less 1."""
        return (spheres / self.spheres) ** (-1 / 3) - 1

    def rows(self, first: int = 0) -> RunPoints:
        """Soils and effects from packing `first` on, packing by packing."""
        (row, slow), (base, strengths) = self._fast_row(), self._fast_rows()
        base = base[row]
        base[slow, self.base_names.index("pace")] = SLOW
        packing = row // self.rows_each
        later = packing >= first
        spheres = self._in_turn(SIZES, packing[later])
        return self._points(base[later], strengths[row[later]], spheres, packing[later])

    def repeats(self) -> RunPoints:
        """Soils without effects, specimen by specimen, each on a packing of its own; `packing` is
        the number of the soil.  Of `slow_in` soils one is slow."""
        soil = np.arange(self.repeated)
        unit = _sobol(len(self.soil_names), self.repeated, self.seed + 1)
        slow = soil % self.slow_in == self.slow_in - 1 if self.slow_in else soil < 0
        spheres = self._in_turn(SIZES, soil)
        base = self._base(self._soil(unit), SMOOTHING[0], soil, slow, spheres)
        base, soil = np.repeat(base, SPECIMENS, axis=0), np.repeat(soil, SPECIMENS)
        of_bed = FIRST_REPEAT + np.arange(len(soil))
        return replace(
            self._points(base, None, np.repeat(spheres, SPECIMENS).tolist(), of_bed), packing=soil
        )

    def shaped_rows(self) -> RunPoints:
        """Soils and effects on specimens of other shapes; of three turns through HEIGHTS and
        SHAPED_SIZES one is slow."""
        count, soils = self.shaped * self.rows_each, len(self.soil_names)
        unit = _sobol(soils + 2 + len(self.limits), count, self.seed + 2)
        packing = np.repeat(np.arange(self.shaped), self.rows_each)
        turn = packing // len(HEIGHTS)
        spheres, (low, high) = self._in_turn(SHAPED_SIZES, turn), SMOOTHING
        smoothing = low + (high - low) * unit[:, soils] ** 2
        slow, (least, most) = turn // len(SHAPED_SIZES) % 3 == 2, map(math.log, STRESSES)
        shape = np.log(HEIGHTS)[packing % len(HEIGHTS)], _between(least, most, unit[:, soils + 1])
        base = self._base(
            self._soil(unit[:, :soils]), smoothing, packing + turn, slow, spheres, shape
        )
        strengths = self._strengths(unit[:, soils + 2 :])
        return self._points(base, strengths, spheres, FIRST_SHAPED + packing)

    def plain_rows(self, packings: int, each: int) -> RunPoints:
        """Soils without effects, `each` a packing, of which every third is slow."""
        packing = np.repeat(np.arange(packings), each)
        unit = _sobol(len(self.soil_names), len(packing), self.seed + 4)
        spheres, slow = self._in_turn(OTHER_LAW_SIZES, packing), packing % 3 == 2
        base = self._base(self._soil(unit), SMOOTHING[0], packing // 3, slow, spheres)
        return self._points(base, None, spheres, packing)

    def refined_rows(self, first: int = 0) -> RunPoints:
        """Effects that are sampled again, from packing `first` on; every other packing is slow, and
        those of every other pair, later of every other four, weaken, where an effect can."""
        number, soils = np.arange(self.refined), len(self.soil_names)
        unit = _sobol(soils + len(REFINED), self.refined, self.seed + 3)
        spheres, slow = self._in_turn(REFINED_SIZES, number), number % 2 == 1
        base = self._base(self._soil(unit[:, :soils]), SMOOTHING[0], number, slow, spheres)
        strengths = [self._refined_strengths(int(j), unit[j, soils:]) for j in number[first:]]
        rows = [len(of_packing) for of_packing in strengths]
        return self._points(
            np.repeat(base[first:], rows, axis=0),
            np.concatenate([*strengths, np.zeros((0, len(self.limits)))]),
            np.repeat(spheres[first:], rows).tolist(),
            FIRST_REFINED + np.repeat(number[first:], rows),
        )  # fmt: skip

    def _points(
        self, base: np.ndarray, strengths: np.ndarray | None, spheres: Sequence[int], packing
    ) -> RunPoints:
        """Points on the packings of this design; strengths None: without effects."""
        strengths = np.zeros((len(base), len(self.limits))) if strengths is None else strengths
        return RunPoints(base, strengths, spheres, 1000 * self.seed + packing, packing)

    def _in_turn(self, sizes: Sequence[float], turn: np.ndarray) -> list[int]:
        """Numbers of spheres (n,), whose sizes over the design's take turns."""
        return [round(self.spheres * sizes[j % len(sizes)]) for j in turn.tolist()]

    def _base(
        self, soil: np.ndarray, smoothing, turn: np.ndarray, slow: np.ndarray,
        spheres: Sequence[int], shape=(0.0, 0.0),
    ) -> np.ndarray:  # fmt: skip
        """Base coordinates (n, p) of soils (n, q); turn (n,): of POROSITIES."""
        porosity = np.array(POROSITIES)[turn % len(POROSITIES)]
        sizes = [self.sphere_size(number) for number in spheres]
        settings = (smoothing, porosity, np.where(slow, SLOW, 1.0), *shape, sizes)
        return np.column_stack([soil, *(np.broadcast_to(each, len(soil)) for each in settings)])

    def _refined_strengths(self, packing: int, unit: np.ndarray) -> np.ndarray:
        """Strengths (n, k) of the rows of a packing, by numbers between 0 and 1."""
        later = packing >= AGAIN
        known = [name for name in (REFINED_AGAIN if later else REFINED) if name in self.limits]
        weaker = packing // (4 if later else 2) % 2 == 1
        strengths = np.zeros((1 + len(known), len(self.limits)))
        for row, name in enumerate(known):
            low, high = self.limits[name]
            largest = low if weaker and low else high
            share = _between(*REFINED_SHARE, unit[row])
            strengths[1 + row, self.effect_names.index(name)] = largest * share
        return strengths

    def _fast_row(self) -> tuple[np.ndarray, np.ndarray]:
        """For each row (n,) the fast one of the same soil and effects, and whether it is slow."""
        row = np.arange(self.packings * self.rows_each)
        of_packing = row // self.rows_each
        again = row[of_packing // TURN % self.slow_in == 0] if self.slow_in else row[:0]
        every, slow = np.concatenate([row, again]), np.repeat([False, True], [len(row), len(again)])
        order = np.argsort(every // self.rows_each, kind="stable")
        return every[order], slow[order]

    def _fast_rows(self) -> tuple[np.ndarray, np.ndarray]:
        packing = np.repeat(np.arange(self.packings), self.rows_each)
        soils, (low, high) = len(self.soil_names), SMOOTHING
        unit = _sobol(soils + 1 + len(self.effect_names), len(packing), self.seed)
        smoothing = low + (high - low) * unit[:, soils] ** 2
        spheres = self._in_turn(SIZES, packing)
        base = self._base(self._soil(unit[:, :soils]), smoothing, packing, packing < 0, spheres)
        strengths = unit[:, soils + 1 :]
        alone = np.isin(packing % OF, ALONE)
        base[alone] = base[packing[alone] * self.rows_each]
        return base, np.where(alone[:, None], self._single(strengths), self._strengths(strengths))

    def _soil(self, unit: np.ndarray) -> np.ndarray:
        log = _normal(unit) * np.array(list(self.soil_sd.values()))
        for name, highest in HIGHEST.items():
            if name in self.soil_names:
                column = self.soil_names.index(name)
                log[:, column] = np.minimum(log[:, column], np.log(highest / self.centre[name]))
        return log

    def _strengths(self, unit: np.ndarray) -> np.ndarray:
        low, high = np.array(list(self.limits.values())).T
        share = np.minimum(unit / ACTIVE, 1.0)
        return np.where(unit < ACTIVE, low + (high - low) * share, 0.0)

    def _single(self, unit: np.ndarray) -> np.ndarray:
        """Strengths (n, k) of rows with one effect each, in turn, but none in a packing's first."""
        row, found = np.arange(len(unit)), np.zeros_like(unit)
        number, of_packing = row % self.rows_each - 1, row // self.rows_each
        turn = of_packing // OF * len(ALONE) + (of_packing % OF == ALONE[1])
        which = (turn * (self.rows_each - 1) + number) % unit.shape[1]
        low, high = np.array(list(self.limits.values()))[which].T
        drawn = unit[row, which]
        downward = (low < 0) & (drawn < 0.5)
        share = np.where(low < 0, 2 * drawn % 1, drawn)
        strength = np.where(downward, low, high) * (WEAKEST + (1 - WEAKEST) * share)
        found[row, which] = np.where(number >= 0, strength, 0.0)
        return found


def _sobol(dimensions: int, count: int, seed: int) -> np.ndarray:
    from scipy.stats import qmc  # half a second, which only making a library needs

    power = int(np.ceil(np.log2(max(count, 2))))
    # `seed`, not `rng`: the two scramble differently, and the bundled library was drawn with this.
    return qmc.Sobol(dimensions, seed=seed).random_base2(power)[:count]  # pyright: ignore[reportCallIssue]


def _between(low: float, high: float, unit: np.ndarray) -> np.ndarray:
    return low + (high - low) * unit


def _normal(unit: np.ndarray) -> np.ndarray:
    """Standard normal values cut at `FURTHEST`."""
    edge = ndtr(-FURTHEST)
    return ndtri(edge + (1 - 2 * edge) * unit)
