"""The library of runs as `discrepancy.comparison` sees it: mean, slopes, scatter at one lab's soil.

    delta   base coordinates from the lab's own starting soil, with its prior
    e       strengths in typical ones

The description is linear about the best fit of the base coordinates to the measured means, and
keeps the emulator for what is not linear.  Features and strengths are in the lab's own size
(`lab_size`).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import jax
import numpy as np

from calibrate.core.errors import InputError
from calibrate.discrepancy.comparison.linear import FEWEST_SPECIMENS, EffectCandidate, Linearised
from calibrate.discrepancy.comparison.refit import refit
from calibrate.discrepancy.library import other_law
from calibrate.discrepancy.library.cross_validation import EmulatorErrors
from calibrate.discrepancy.library.design import SHAPE_COLUMNS
from calibrate.discrepancy.library.emulator import FeatureEmulator, fit_emulator
from calibrate.discrepancy.library.lab_size import LabSize, SoilPrior
from calibrate.discrepancy.library.run_library import Rows, RunLibrary, limits
from calibrate.io.conventions import check_eepa
from calibrate.io.lab import Lab
from calibrate.response.response import (
    FURTHER,
    BetweenLags,
    Discrepancy,
    Response,
    asked,
    linearised,
)
from jdem.effects.composite import EFFECTS
from jdem.materials.conventions import DEFAULT

MOISTURE_SD = 0.03  # of stiffness and surface energy from specimen to specimen
DENSITY_SD = 0.004  # of density, where the lab does not say
TWO_SIDED = ("platen_friction",)  # may be smoother than assumed, though its docstring says >= 0
CERTAIN = 10**9  # packings; the emulator states its errors itself
Parts = tuple[np.ndarray, ...]


@dataclass(frozen=True, eq=False)
class ModelDiscrepancy:
    """Reality minus simulation where no effect is at work, as estimated from reference labs: mean
    (m,) and directions (m, q), one standard deviation each; in the features of a library of runs,
    warped as its emulator warps them."""

    mean: np.ndarray
    directions: np.ndarray


@dataclass(frozen=True, eq=False)
class EmulatedLibrary:
    """A library of runs with its emulator, the residuals of one row a packing, its errors, and the
    size in which it speaks: its own, or a lab's."""

    library: RunLibrary
    size: LabSize
    _emulators: list[FeatureEmulator] = field(default_factory=list)
    _under: dict[str, "EmulatedLibrary"] = field(default_factory=dict)

    @staticmethod
    def of(library: RunLibrary) -> "EmulatedLibrary":
        return EmulatedLibrary(library, LabSize.of_library(library))

    @property
    def emulator(self) -> FeatureEmulator:
        """That of its rows, made when it is first asked."""
        if not self._emulators:
            self._emulators.append(self.library.emulator(again=True))
        return self._emulators[0]

    def for_lab(self, lab: Lab) -> "EmulatedLibrary":
        """The same in a lab's own size and conventions; `InputError` where its shape is too far
        from the runs, or none follow its conventions."""
        return replace(self._following(lab), size=LabSize.of(lab, self.library))

    def _following(self, lab: Lab) -> "EmulatedLibrary":
        """That of the lab's conventions, made once."""
        wanted = lab.particles.conventions
        check_eepa(wanted, lab.file)
        if wanted == DEFAULT or self.library.law is not None:
            return self
        if wanted not in self.library.other_laws:
            problem = f"no run of the library follows the conventions '{wanted}'"
            repair = f"simulate some: calibrate library --onto FILE --conventions {wanted}"
            raise InputError(lab.file, "particles.conventions", problem, repair)
        if wanted not in self._under:
            self._under[wanted] = EmulatedLibrary.of(other_law.following(self.library, wanted))
        return self._under[wanted]

    @property
    def units(self) -> np.ndarray:
        """By what features (m,) at the library's size are multiplied."""
        return self.size.of_features(self.library.features)

    @property
    def typical(self) -> np.ndarray:
        """Typical strengths (k,), SI, in the lab's own size."""
        design = self.library.design
        return design.typical() * self.size.of_effects(design.effect_names)

    def candidates(self) -> tuple[EffectCandidate, ...]:
        """The candidate effects, with typical strengths in the lab's own size."""
        names, largest = self.library.design.effect_names, limits(self.library.design)
        reach = largest / self.library.design.typical()
        return tuple(
            EffectCandidate(n, EFFECTS[n].about.one_sided and n not in TWO_SIDED, float(t),
                   EFFECTS[n].about.unit, EFFECTS[n].about.kind, float(r))
            for n, t, r in zip(names, self.typical, reach, strict=True)
        )  # fmt: skip

    def joined(self, rows: Rows, own: RunLibrary) -> "EmulatedLibrary":
        """With further runs behind the rows of `own`; their noise counts by so much less as errors
        are widened afterwards (`LocalEmulator.wrong`)."""
        emulator, emulator_errors = self.emulator, self.emulator_errors
        library = self.library.joined(rows)
        known = self.library.machine_shift
        if known is not None:
            behind = library.machine_shifts(emulator)[len(known) :]
            library = replace(library, machine_shift=np.vstack([known, behind]))
        noise = np.ones((len(library.rows.values), len(emulator.components)))
        of_rows = emulator_errors.scatter + emulator_errors.misfit
        noise[len(own.rows.values) :] = of_rows / emulator_errors.widening
        fitted = fit_emulator(
            *library.scaled(), library.rows.packing, library.of_soils, library.scale(),
            library.kernels, emulator.basis, noise, always=library.always,
        )  # fmt: skip
        return replace(self, library=library, _emulators=[fitted])

    def specimens(self, x: np.ndarray) -> np.ndarray:
        """Warped residuals (l, m) of one row without effects of each packing that has one, as they
        scatter at the soil of a scaled point (p,) with spheres of the design's size."""
        _, first = np.unique(self.library.rows.packing[self.emulator.plain], return_index=True)
        soil = np.append(x[:-1], 0.0)
        residuals = self.emulator.without_effects[first]
        return self.emulator_errors.specimens(self.emulator, residuals, soil)

    @property
    def emulator_errors(self) -> EmulatorErrors:
        """Errors of the emulator by cross-validation; none if it was not made."""
        known = len(self.emulator.components), len(self.library.features)
        return self.library.emulator_errors or EmulatorErrors.nothing(*known)

    def at(
        self, soil_prior: SoilPrior, discrepancy: ModelDiscrepancy | None = None
    ) -> "LocalEmulator":
        """The emulator in the coordinates of a diagnosis."""
        library, design = self.library, self.library.design
        machine, typical = None, np.zeros((0, len(design.limits)))
        if library.machine_shift is not None:  # else rows do not tell soil and machine apart
            machine = library.machine(self.size.force)
            names = np.array(design.effect_names)
            typical = (np.array(machine.told)[:, None] == names) * design.typical()
        first, last = np.arange(len(design.base_names))[SHAPE_COLUMNS].tolist()
        known = None
        if discrepancy is not None:
            parts = discrepancy.mean, discrepancy.directions, self.emulator.scale
            known = Discrepancy(*jax.device_put(parts))
        response = Response.plain(
            self.emulator.response, soil_prior.offset, design.spread(),
            design.typical() / limits(design), library.squared, self.units, (first, last), machine,
            typical, known,
        )  # fmt: skip
        return LocalEmulator(self.emulator, self.emulator_errors, response)


@dataclass(frozen=True, eq=False)
class LocalEmulator:
    """`linear.Emulator` about a lab's soil: the response's values (m,) and slopes (m, p) per delta,
    (m, k) per typical strength, and where it may be wrong.

    recorded: half of what machines differ by (m,) as they record, between lags; free (m, q):
    directions in which it may be wrong everywhere; tared (m,): features that do not see strength
    number `offset`.
    """

    emulator: FeatureEmulator
    emulator_errors: EmulatorErrors
    response: Response
    recorded: BetweenLags | None = None
    free: np.ndarray | None = None
    offset: int = 0
    tared: np.ndarray | None = None

    def __call__(
        self, delta: np.ndarray, strengths: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        if self.tared is None:
            return linearised(self.response, delta, strengths)
        values, base, effects = self._as_tared(
            lambda at: linearised(self.response, delta, at), strengths
        )
        effects[np.flatnonzero(self.tared), self.offset] = 0.0
        return values, base, effects

    def wrong(self, delta: np.ndarray, strengths: np.ndarray) -> np.ndarray:
        """Directions (m, q) in which the emulator may be wrong at a point."""
        (found,) = self._as_tared(lambda at: (self._wrong(delta, at),), strengths)
        return np.vstack([found, np.zeros((FURTHER, found.shape[1]))])

    def _as_tared(self, asked: Callable[[np.ndarray], Parts], strengths: np.ndarray) -> Parts:
        """Arrays (m, ...) that are asked for at strengths (k,): rows of tared features, which do
        not see the load cell's offset, as they are without it."""
        found = tuple(map(np.array, asked(strengths)))
        if self.tared is not None and strengths[self.offset]:
            blind = np.where(np.arange(len(strengths)) == self.offset, 0.0, strengths)
            rows = np.flatnonzero(self.tared)
            for part, known in zip(found, asked(blind), strict=True):
                part[rows] = known[rows]
        return found

    def _wrong(self, delta: np.ndarray, strengths: np.ndarray) -> np.ndarray:
        there = asked(self.response, self.recorded or self.response.recorded, delta, strengths)
        x, s, steepness, recorded = map(np.asarray, there)
        roots = self.emulator_errors.of_values(self.emulator, x, s)
        found = [steepness[:, None] * roots]
        if self.recorded is not None:
            found.append(recorded)
        if self.free is not None:
            found.append(self.free)
        return np.column_stack(found)

    def recording(
        self, shifts: BetweenLags, either: BetweenLags, lag: int | None, turn: np.ndarray
    ) -> "LocalEmulator":
        """The same of values as a machine records them, one way or the other, and turns (m, q)."""
        of_lag = np.zeros(len(self.response.lag))
        of_lag[[] if lag is None else [lag]] = 1.0
        response = replace(self.response, recorded=shifts, lag=jax.device_put(of_lag))
        return replace(self, response=response, recorded=either, free=turn)

    def taring(self, offset: int, rows: np.ndarray) -> "LocalEmulator":
        """The same with features (a mask) that do not see the load cell's offset."""
        return replace(self, offset=offset, tared=rows)

    def freed(self, columns: np.ndarray) -> "LocalEmulator":
        """The same with further directions (m, q) in which it may be wrong."""
        free = columns if self.free is None else np.hstack([self.free, columns])
        return replace(self, free=free)

    def longer(self, rows: np.ndarray) -> "LocalEmulator":
        """The same with further features that depend on effects alone, linearly: rows (q, k), at
        most FURTHER."""
        further = np.array(self.response.further)
        further[: len(rows)] = rows
        longer = replace(self.response, further=jax.device_put(further))
        return replace(self, response=longer)

    def under(self, factors: np.ndarray, faster: np.ndarray) -> "LocalEmulator":
        """The same under a condition: factors (k,) on strengths, and what these add to delta
        (p, k)."""
        factors, faster = jax.device_put((factors, faster))
        return replace(self, response=replace(self.response, factors=factors, faster=faster))


def describe(
    emulated: EmulatedLibrary,
    soil_prior: SoilPrior,
    measured: np.ndarray,
    chosen: np.ndarray,
    density_sd: float = DENSITY_SD,
    discrepancy: ModelDiscrepancy | None = None,
) -> Linearised:
    """The description for measured means (m_chosen,) of the library's features `chosen` (indices),
    without instruments."""
    d = _rough(emulated, soil_prior, discrepancy)
    delta = np.zeros(d.base_slopes.shape[1])
    d = _local(emulated, d, delta, density_sd, soil_prior)
    for _ in range(2):  # scatter depends on the fit, the fit on scatter
        few = d.only_features(chosen)
        delta = refit(few, measured, first_covariance(few)).delta
        d = _local(emulated, d, delta, density_sd, soil_prior)
    return replace(d, wrong=d.wrong_at(delta, np.zeros(len(d.effects)))).only_features(chosen)


def _rough(
    emulated: EmulatedLibrary, soil_prior: SoilPrior, discrepancy: ModelDiscrepancy | None
) -> Linearised:
    """The frame of a description; everything that depends on the point is filled by `_local`."""
    library, emulator = emulated.library, emulated.at(soil_prior, discrepancy)
    names, prior = library.design.base_names, soil_prior.prior_sd
    if discrepancy is not None:
        extra = discrepancy.directions.shape[1]
        names = (*names, *(f"discrepancy {i + 1}" for i in range(extra)))
        prior = np.concatenate([prior, np.ones(extra)])
    m, p, k = len(emulated.units), len(prior), len(library.design.limits)
    nothing, square = np.zeros((m, p)), np.zeros((m, m))
    return Linearised(
        features=emulated.size.features, mean=np.zeros(m), base_names=names, base_slopes=nothing,
        prior_sd=prior, effects=emulated.candidates(), effect_slopes=np.zeros((m, k)),
        packing_residuals=np.zeros((FEWEST_SPECIMENS, m)), mean_specimens=CERTAIN,
        base_errors=nothing, extra=square, sensor=square, wrong=np.zeros((m, 0)),
        emulator=emulator, rows=np.arange(m),
    )  # fmt: skip


def _local(
    emulated: EmulatedLibrary,
    d: Linearised,
    delta: np.ndarray,
    density_sd: float,
    soil_prior: SoilPrior,
) -> Linearised:
    """The description linearised at a shift of the base coordinates."""
    none = np.zeros(len(d.effects))
    values, base, effects = d.at(delta, none)
    soil = soil_prior.offset + delta[: len(soil_prior.offset)]
    scaled = soil / emulated.library.design.spread()
    steep = emulated.units * emulated.emulator.steepness(scaled, none)
    typical = emulated.typical
    return replace(
        d, mean=values - base @ delta, base_slopes=base, effect_slopes=effects,
        packing_residuals=emulated.specimens(scaled) * steep,
        extra=_scatter(d, base, effects, density_sd, typical),
    )  # fmt: skip


def _scatter(d: Linearised, base, effects, density_sd: float, typical) -> np.ndarray:
    """Covariance (m, m) of density and moisture from specimen to specimen."""
    names = d.base_names
    moisture = base[:, names.index("shear_modulus")] + base[:, names.index("surface_energy")]
    column = d.effect_names.index("specimen_density")
    density = effects[:, column] * density_sd / typical[column]
    return MOISTURE_SD**2 * np.outer(moisture, moisture) + np.outer(density, density)


def first_covariance(d: Linearised) -> np.ndarray:
    """A covariance good enough for a first fit: that of one simulated specimen, shrunk."""
    residuals = d.packing_residuals
    raw = residuals.T @ residuals / len(residuals) + d.extra
    return 0.8 * raw + 0.2 * np.diag(np.diag(raw)) + 1e-9 * np.diag(np.diag(raw))
