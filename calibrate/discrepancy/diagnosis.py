"""`calibrate diagnose`: from a lab file and a library of runs to an explanation of the gap.

curves -> features -> description about the best base fit -> null distributions
       -> localisation, comparison of explanations, whether one is named, reduction of the gap,
       next test
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibrate.discrepancy.comparison.compare import Comparison, Prepared, compare, prepare
from calibrate.discrepancy.comparison.generated import plan_of
from calibrate.discrepancy.comparison.lack_of_fit import NullDistributions
from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.localise import Localisation, localise
from calibrate.discrepancy.comparison.naming import Grounds, named
from calibrate.discrepancy.comparison.next_test import (
    BEFORE_TESTS,
    Proposal,
    UpdatedBelief,
    next_tests,
    updated,
)
from calibrate.discrepancy.comparison.probability_calibration import (
    ProbabilityCalibration,
    bundled_calibration,
)
from calibrate.discrepancy.comparison.reduction import Reduction
from calibrate.discrepancy.comparison.repeats import Measured, robust, scatter_of
from calibrate.discrepancy.comparison.verdict import as_json
from calibrate.discrepancy.library.description import (
    DENSITY_SD,
    EmulatedLibrary,
    ModelDiscrepancy,
    describe,
)
from calibrate.discrepancy.library.further_tests import menu, outcomes
from calibrate.discrepancy.library.instruments import (
    left_free,
    with_forces_before_contact,
    with_instruments,
)
from calibrate.discrepancy.library.lab_size import parameters_beyond, soil_prior_for
from calibrate.discrepancy.library.measurements import Measurements, read_measurements
from calibrate.discrepancy.library.run_library import Cylinder
from calibrate.io.lab import Lab

DRAWS = 400  # of null distributions
WITHIN = 16  # soils among the library's runs whose stated errors are typical
LARGE_ERROR = 2.0  # times these, which hardly any soil among the runs reaches
LARGEST_DENSITY_SD = 0.02  # of specimens in one mould; more is the field's scatter
STATED = "stated error"  # of the library at the best base fit, beside parameters beyond its runs
Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Everything that a report shows of one lab."""

    lab: Lab
    found: Measurements
    measured: Measured
    prepared: Prepared
    localisation: Localisation
    comparison: Comparison
    reduction: Reduction | None
    proposals: list[Proposal]
    belief: UpdatedBelief | None = None
    unused: tuple[str, ...] = ()
    beyond: tuple[str, ...] = ()
    library_error: float = 1.0

    def as_json(self) -> dict:
        """The contract's keys."""
        return as_json(
            self.prepared,
            self.localisation,
            self.comparison,
            self.reduction,
            self.proposals,
            self.belief,
        )


def described(
    lab: Lab,
    emulated: EmulatedLibrary,
    seed: int,
    discrepancy: ModelDiscrepancy | None = None,
    before_contact: bool = True,
) -> tuple[Measurements, Linearised, Measured]:
    """What was measured, and the simulator about the best base fit to it; before_contact: with the
    forces before contact; without, records are known to begin at no force."""
    emulated = emulated.for_lab(lab)
    like, usual = emulated.size.curves(emulated.library.reference), emulated.size.cylinder
    found = read_measurements(lab, emulated.size.features, like, from_zero=not before_contact)
    soil_prior = soil_prior_for(lab, emulated.library)
    density = lab.density_kg_m3
    scatter = float(np.std(density, ddof=1) / np.mean(density)) if len(density) > 1 else DENSITY_SD
    scatter = min(scatter, LARGEST_DENSITY_SD)
    d = describe(emulated, soil_prior, found.measured.mean, found.chosen, scatter, discrepancy)
    d = left_free(with_instruments(d, found, like, usual.usual_sizes(), seed), found)
    d, measured = with_forces_before_contact(d, found) if before_contact else (d, found.measured)
    return found, d, robust(measured, scatter_of(d))


def prepared_diagnosis(
    d: Linearised,
    measured: Measured,
    seed: int,
    calibration: ProbabilityCalibration | None = None,
    draws: int = DRAWS,
    null: NullDistributions | None = None,
) -> Prepared:
    """Null distributions of the linear description, unless those of its plan are known; the
    emulator is put back for refits."""
    linear, plan = replace(d, emulator=None), plan_of(measured)
    prepared = prepare(linear, plan, seed, draws, calibration or bundled_calibration(), null)
    return replace(prepared, generator=replace(prepared.generator, description=d))


def diagnosed(
    lab: Lab,
    emulated: EmulatedLibrary,
    seed: int = 0,
    discrepancy: ModelDiscrepancy | None = None,
    say: Say = lambda text: None,
    further: Sequence[Lab] = (),
) -> Diagnosis:
    """The whole diagnosis of one lab; `further`: lab files of further tests."""
    emulated.for_lab(lab).emulator.factors.begin()
    say("reading curves, fitting the base model")
    found, d, measured = described(lab, emulated, seed, discrepancy)
    say("simulating null distributions")
    prepared = prepared_diagnosis(d, measured, seed)
    say("comparing explanations")
    comparison = compare(prepared, measured)
    cylinder = Cylinder.of(lab)
    made, unused = outcomes(lab, further, cylinder, d, comparison.noise)
    belief = None
    if made:
        say("taking in further tests")
        comparison, belief = updated(prepared, comparison, measured.mean, made)
    localisation = localise(d, measured, comparison.noise, comparison.base, seed)
    say("how far the gap shrinks")
    delta = comparison.base.delta
    beyond, error = beyond_library(lab, emulated, delta), library_error(lab, emulated, delta)
    comparison, reduction = answered(lab, emulated, found, d, measured, comparison, seed)
    proposals: list[Proposal] = []
    if comparison.reason not in BEFORE_TESTS:
        say("weighing further tests")
        offers = menu(d, comparison.noise, lab.pair().rates, cylinder.force_high)
        proposals = next_tests(prepared, comparison, measured.mean, offers, seed)
    return Diagnosis(
        lab, found, measured, prepared, localisation, comparison, reduction, proposals, belief,
        tuple(unused), beyond, error,
    )  # fmt: skip


def answered(
    lab: Lab, emulated: EmulatedLibrary, found: Measurements, d: Linearised, measured: Measured,
    comparison: Comparison, seed: int,
) -> tuple[Comparison, Reduction | None]:  # fmt: skip
    """A comparison with the verdict that its grounds allow."""

    def beyond(delta: np.ndarray) -> tuple[str, ...]:
        stated = (STATED,) if library_error(lab, emulated, delta) > LARGE_ERROR else ()
        return (*beyond_library(lab, emulated, delta), *stated)

    grounds = Grounds(found.repeats, beyond, bool(found.specimens))
    return named(d, measured, comparison, grounds, seed)


def beyond_library(lab: Lab, emulated: EmulatedLibrary, delta: np.ndarray) -> tuple[str, ...]:
    """Soil parameters of a fit, shifted by delta (p,) from the lab's prior, that lie clearly
    farther from the library's centre than its runs."""
    library = emulated.for_lab(lab).library
    soil = slice(len(library.design.soil_names))  # base coordinates begin with the soil's
    return parameters_beyond(library, soil_prior_for(lab, library).offset[soil] + delta[soil])


def library_error(lab: Lab, emulated: EmulatedLibrary, delta: np.ndarray) -> float:
    """The error that a library states at a fit, shifted by delta (p,) from the lab's prior, over
    that at soils among its runs: root mean squares over features, each in units of the latter."""
    emulated = emulated.for_lab(lab)
    library, prior = emulated.library, soil_prior_for(lab, emulated.library)
    emulator, none = emulated.at(prior), np.zeros(len(library.design.limits))
    own = delta[: len(prior.offset)]
    rows = np.linspace(0, len(library.rows.base) - 1, WITHIN).astype(int)
    soil = slice(len(library.design.soil_names))
    among = np.repeat(own[None], WITHIN, axis=0)
    among[:, soil] = library.rows.base[rows, soil] - prior.offset[soil]
    usual = np.array([(emulator.wrong(one, none) ** 2).sum(axis=1) for one in among]).mean(axis=0)
    here = (emulator.wrong(own, none) ** 2).sum(axis=1)
    return float(np.sqrt(np.mean(here / np.maximum(usual, 1e-300))))
