"""The paper's sequence of designed experiments, on our simulator and any lab's observables.

    screening     Plackett-Burman, all factors       which factors matter to each response
    depth         central composite, two factors     quadratic surface, optimum of the first goal
    force         Box-Behnken, three factors         quadratic surfaces, optimum of all goals
    refinement    one factor at seven levels         the optimum moved along that factor
    verification  the optimum on fresh packings

after Chen et al. 2023, Sustainability 15, 15079, whose factors these are, and the shear modulus
of the particles, which the paper does not give.  Responses are all observables that the tests
give; goals are those with a target, and the two surfaces are called after the first and the last
of them, in the paper depth and force.  Every point is run on the same packings.  They
are the replicates: what differs between packings at one point, beyond a packing's own level, is
the pure error.  That level (one number for each packing and response) is taken out first; the
degrees of freedom that it uses, one less than there are packings, are not subtracted.

Rule of selection: factors are ranked by their contribution to a response.  The first two that
matter to the first goal enter the central composite design, the first three that matter to the
last goal the Box-Behnken design, whether or not their p is below 0.05; the report says which are
not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibrate.core.errors import CalibrationError
from calibrate.designs import designs
from calibrate.designs.design import Design
from calibrate.designs.factors import Factor
from calibrate.designs.optimum import Goal, Optimum, Region, optimise, target
from calibrate.designs.screening import Screening, screen
from calibrate.designs.surface import Surface, fit_surface, select_backward
from calibrate.designs.terms import cubic, quadratic
from calibrate.inference.curve_points import CurvePoints
from calibrate.inference.parameters import Space, probing_steps
from calibrate.io.choices import unit_of
from calibrate.io.soil import with_values
from calibrate.labtests.composite import described
from calibrate.labtests.measured import Target
from calibrate.simulation import Run
from calibrate.simulation.joint import AbstractCampaign
from jdem.materials.soil import SoilParameters

SCREENED, SURFACED = 2.0, 1.5  # half-ranges of designs, in probing steps
FEW_FACTORS, MORE_FACTORS = 2, 3  # of the first and of the second surface
LEVELS = 7  # of the refinement
SIGNIFICANT = 0.05
TOLERATED = 3.0  # scatters of a repeat off the target at which nothing is desirable


@dataclass(frozen=True, eq=False)
class Experiment:
    """A design that was run: responses (points, packings, observables), in mm and N.

    `held` are the natural values of parameters that differ from the base soil's and do not vary.
    """

    title: str
    design: Design
    responses: np.ndarray
    held: dict[str, float]
    observables: tuple[str, ...]

    @property
    def packings(self) -> int:
        return self.responses.shape[1]

    @property
    def simulations(self) -> int:
        return self.responses.shape[0] * self.packings

    def points(self) -> np.ndarray:
        """Coded points (packings x points, p), one whole repeat after the other."""
        return self.replicated().coded

    def replicated(self) -> Design:
        return self.design.replicated(self.packings)

    def of(self, observable: str) -> np.ndarray:
        """One response (points, packings)."""
        return self.responses[:, :, self.observables.index(observable)]

    def means(self, observable: str) -> np.ndarray:
        """Means (points,) over the packings."""
        return self.of(observable).mean(axis=1)

    def blocked(self, observable: str) -> np.ndarray:
        """Responses (packings x points,) with each packing's level moved to the common one."""
        values = self.of(observable)
        return (values - values.mean(axis=0) + values.mean()).T.ravel()


@dataclass(frozen=True, eq=False)
class StudySetup:
    """Where designs are run: a base soil with its free parameters, packings, a campaign."""

    space: Space
    work: AbstractCampaign
    seeds: Sequence[int]

    @property
    def observables(self) -> tuple[str, ...]:
        """The responses: all observables of the tests, by their names in results."""
        return CurvePoints.of(self.work).observables

    def factors(self, names: Sequence[str], reach: float, held: dict[str, float]) -> tuple:
        """Factors on logarithmic scales around their present values.

        Levels lie `reach` probing steps away, or less where star points would leave the bounds.
        """
        steps = dict(zip(self.space.names, probing_steps(self.space), strict=True))
        return tuple(self._factor(name, reach * steps[name], held) for name in names)

    def _factor(self, name: str, reach: float, held: dict[str, float]) -> Factor:
        bounds = self.space.ranges[self.space.names.index(name)]
        value = held.get(name, float(self.space.base.values()[name]))
        room = min(np.log(bounds.high / value), np.log(value / bounds.low)) / _STAR
        half = min(reach, max(float(room), _LEAST))
        low, high = value * np.exp(-half), value * np.exp(half)
        return Factor(name, low, high, unit_of(name), log=True)

    def run(self, title: str, design: Design, held: dict[str, float]) -> Experiment:
        """Every point on every packing; a failed run ends the study with its reason."""
        rows = [dict(zip(design.names, row, strict=True)) for row in design.natural()]
        soils = [self.soil({**held, **row}) for row in rows]
        runs = self.work.runs(soils, self.seeds, title)
        for number, row in enumerate(runs):
            for run in row:
                if run.failure:
                    raise CalibrationError(f"{title}, point {number + 1}: {run.failure}")
        responses = np.array([[_observed(run, self.observables) for run in row] for row in runs])
        return Experiment(title, design, responses, dict(held), self.observables)

    def soil(self, values: dict[str, float]) -> SoilParameters:
        """The base soil with these natural values."""
        return with_values(self.space.base, values)


_STAR = 1.5  # star points of two factors lie at 1.41
_LEAST = 0.02  # half-range of a factor that starts at its bound


def _observed(run: Run, names: Sequence[str]) -> list[float]:
    return [run.observables[name] for name in names]


@dataclass(frozen=True, eq=False)
class Surfaces:
    """An experiment with the whole quadratic surface of each response, and the optimum of surfaces
    without terms whose p exceeds 0.05, left out one after the other, hierarchy kept."""

    experiment: Experiment
    whole: dict[str, Surface]
    optimum: Optimum

    def best(self) -> dict[str, float]:
        """Natural values of the design's factors at the optimum."""
        factors = self.experiment.design.factors
        return {
            factor.name: float(factor.natural(x))
            for factor, x in zip(factors, self.optimum.x, strict=True)
        }


@dataclass(frozen=True, eq=False)
class Study:
    """The whole sequence; `values` are the natural values that it ends with."""

    screening: Experiment
    screens: dict[str, Screening]
    first: Surfaces
    second: Surfaces
    refinement: Surfaces
    goals: tuple[str, ...]  #: observables with a target
    values: dict[str, float]
    fitted: np.ndarray  #: (packings, observables) at `values`
    fresh: np.ndarray  #: (fresh packings, observables)

    @property
    def observables(self) -> tuple[str, ...]:
        """The responses, in the order of their numbers."""
        return self.screening.observables

    @property
    def stages(self) -> tuple[Surfaces, ...]:
        """The surfaces in the order in which they were fitted."""
        return (self.first, self.second, self.refinement)

    @property
    def experiments(self) -> tuple[Experiment, ...]:
        return (self.screening, *(stage.experiment for stage in self.stages))

    @property
    def simulations(self) -> int:
        """On the packings of the designs; verification apart."""
        return sum(experiment.simulations for experiment in self.experiments)


def study(setup: StudySetup, targets: Mapping[str, Target], fresh: Sequence[int]) -> Study:
    """Runs the sequence towards all targets, at least one; resumes from what the campaign holds."""
    goals = {}
    for name in (name for name in setup.observables if name in targets):
        aim, reach = targets[name].mean, TOLERATED * targets[name].scatter
        goals[name] = target(aim - reach, aim, aim + reach)
    first, *_, last = [next(iter(goals)), *goals]
    factors = setup.factors(setup.space.names, SCREENED, {})
    screening = setup.run("screening", designs.plackett_burman(factors, centre=1), {})
    screens = {
        name: screen(screening.replicated(), screening.blocked(name)) for name in setup.observables
    }
    by_first, by_last = (ranked(screens[name]) for name in (first, last))
    called = stage_titles(first, last)

    chosen = setup.factors(by_first[:FEW_FACTORS], SURFACED, {})
    composite = designs.central_composite(chosen, centre=1)
    few = surfaces(setup.run(called[0], composite, {}), {first: goals[first]})
    values = few.best()

    chosen = setup.factors(by_last[:MORE_FACTORS], SURFACED, values)
    behnken = designs.box_behnken(chosen, centre=1)
    more = surfaces(setup.run(called[1], behnken, _others(values, chosen)), goals)
    values |= more.best()

    rest = [name for name in by_first if name not in by_last[:MORE_FACTORS]]
    refined = setup.factors(rest[:1], SURFACED, values)
    sweep = designs.sweep(refined[0], LEVELS)
    refinement = surfaces(setup.run("refinement", sweep, _others(values, refined)), goals, cubic)
    values |= refinement.best()
    return Study(
        screening=screening,
        screens=screens,
        first=few,
        second=more,
        refinement=refinement,
        goals=tuple(goals),
        values=values,
        fitted=verified(setup, setup.soil(values), setup.seeds, "optimum"),
        fresh=verified(setup, setup.soil(values), fresh, "optimum on fresh packings"),
    )


def stage_titles(first: str, last: str) -> tuple[str, str]:
    """What the two surfaces are called: after their goals, apart where these are one."""
    one, other = _title(first), _title(last)
    return one, other if other != one else f"{one}, {MORE_FACTORS} factors"


def _title(name: str) -> str:
    """The last word of a label of two, depth and force in the paper; else the whole label."""
    test, _, plain = name.rpartition(".")
    words = described(plain).label.split()
    title = words[-1] if len(words) == 2 else " ".join(words)
    return f"{title}, {test}" if test else title


def ranked(found: Screening) -> list[str]:
    """Names of the factors, the largest contribution first."""
    return [effect.name for effect in found.ranked()]


def surfaces(experiment: Experiment, goals: dict[str, Goal], terms=quadratic) -> Surfaces:
    """Surfaces of all responses over the design, and the optimum of those that have a goal.

    The optimum is looked for within the points of the design (their largest radius).
    """
    design, points = experiment.design, experiment.points()
    polynomial = terms(len(design.factors))
    whole = {
        name: fit_surface(points, experiment.blocked(name), polynomial, design.names)
        for name in experiment.observables
    }
    aimed = [select_backward(whole[name]) for name in goals]
    edge = float(np.abs(design.coded).max())
    radius = float(np.linalg.norm(design.coded, axis=1).max())
    best = optimise(aimed, list(goals.values()), Region(-edge, edge, radius))
    return Surfaces(experiment, whole, best)


def verified(
    setup: StudySetup, soil: SoilParameters, seeds: Sequence[int], what: str
) -> np.ndarray:
    """All observables (packings, observables) of a soil; NaN where a run failed."""
    runs, names = setup.work.runs([soil], seeds, what)[0], setup.observables
    unknown = [np.nan] * len(names)
    return np.array([unknown if run.failure else _observed(run, names) for run in runs])


def _others(values: dict[str, float], varied: Sequence[Factor]) -> dict[str, float]:
    names = {factor.name for factor in varied}
    return {name: value for name, value in values.items() if name not in names}
