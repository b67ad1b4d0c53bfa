"""A lab's virtual tests on several packings: `calibrate simulate`, and results as plain data."""

import operator
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from calibrate.core.errors import CalibrationError
from calibrate.core.progress import AbstractProgress
from calibrate.io.choices import differing, expanded
from calibrate.io.lab import Lab
from calibrate.labtests.base import AbstractLabTest, Shown
from calibrate.labtests.composite import names_of
from calibrate.simulation.campaign import Campaign
from calibrate.simulation.executors import HERE, AbstractPlace
from calibrate.simulation.joint import AbstractCampaign, BareCampaign, JointCampaign
from calibrate.simulation.resolution import Preset, bare_machine, specimen, virtual_lab
from calibrate.simulation.run import DEEPEST_AT_TOOL, LEAST_ACROSS, LEAST_AT_TOOL, Run
from jdem.materials.catalogue import own_values
from jdem.materials.soil import SoilParameters

SCATTER_PACKINGS = 8  # from which one packing's scatter is estimated


@dataclass(frozen=True)
class Seeds:
    """Packings that are fitted, packings held back, and all that scatter is taken from."""

    fitted: tuple[int, ...]
    fresh: tuple[int, ...]
    scatter: tuple[int, ...]

    @staticmethod
    def of(seed: int, fitted: int, fresh: int = 3) -> "Seeds":
        every = tuple(range(100 * seed, 100 * seed + max(SCATTER_PACKINGS, fitted + fresh)))
        scatter = every[: max(SCATTER_PACKINGS, fitted)]
        return Seeds(every[:fitted], every[fitted : fitted + fresh], scatter)


def campaign(
    lab: Lab,
    preset: Preset,
    folder: Path,
    progress: AbstractProgress,
    preparation: SoilParameters | None = None,
    place: AbstractPlace = HERE,
) -> AbstractCampaign:
    """The lab's virtual tests at a preset, with results kept in `folder`.

    Beds settle with `preparation`, or by default with a slippery, cohesionless soil; `place` is
    where simulations run.
    """
    parts = tuple(
        Campaign(
            virtual_lab(lab, preset, number=number),
            specimen(lab, preset, number),
            folder,
            progress,
            preparation=preparation,
            place=place,
            moisture=tested.cylinder.moisture,
        )
        for number, tested in enumerate(lab.specimens())
    )
    machine = bare_machine(lab)
    if machine is None and len(parts) == 1 and not lab.differing():
        return parts[0]
    return JointCampaign(parts, machine and BareCampaign(machine, folder, progress))


def simulate(
    lab: Lab, preset: Preset, soil: SoilParameters, seed: int, work: AbstractCampaign
) -> tuple[dict, list[Run]]:
    """All tests on the preset's packings; the contract's JSON and the runs."""
    seeds = Seeds.of(seed, preset.packings).fitted
    runs = work.runs([soil], seeds, "simulating")[0]
    result = {
        **simulation_json(runs),
        "together": together(lab, runs),
        "observable_warnings": doubts(lab, runs),
        "rates": rates_json(work),
        "parameters": soil_json(soil),
        "seeds": list(seeds),
    }
    return result, runs


def simulation_json(runs: Sequence[Run]) -> dict:
    """Means and scatter over packings, the first packing's curves, quality and speed."""
    seconds = sum(run.quality["runtime_s"] for run in runs)
    work = sum(run.quality["steps"] * run.quality["spheres"] for run in runs)
    return {
        **summary_json(runs),
        "curves": curves_json(runs[0]),
        "packings": [{**run.observables, "failure": run.failure} for run in runs],
        "quality": quality_json(runs),
        "failures": [run.failure for run in runs if run.failure],
        "runtime_s": seconds,
        "particle_steps_per_s": work / seconds,
    }


def together(lab: Lab, runs: Sequence[Run]) -> dict[str, float]:
    """What several tests of one type say together, of means over packings."""
    called, means = names_of(lab.tests), summary_json(runs)["observables"]
    found: dict[str, float] = {}
    for kind in dict.fromkeys(type(test) for test in lab.tests):
        rows = {
            test.called: {
                o.name: means[called[test.called, o.source][0]] for o in test.given
            } | test.conditions()
            for test in lab.tests
            if test.type_name == kind.type_name
        }  # fmt: skip
        found |= kind.together(rows)
    return found


def doubts(lab: Lab, runs: Sequence[Run]) -> dict[str, str]:
    """By observable, why its number is not what its name says; those without a doubt are left
    out."""
    called, sound = names_of(lab.tests), [run for run in runs if not run.failure]
    found = {}
    for test in (each for each in lab.tests if each.with_soil):
        shown = [_shown(lab, test, run) for run in sound if test.called in run.curves]
        for observable in test.given:
            said = [doubt for each in shown if (doubt := test.doubt(observable, each))]
            if len(said) > len(shown) / 2:
                name, _ = called[test.called, observable.source]
                found[name] = f"{said[0]} ({len(said)} of {len(shown)} packings)"
    return found


def _shown(lab: Lab, test: AbstractLabTest, run: Run) -> Shown:
    """What a test showed in one run."""
    called = names_of(lab.tests)
    numbers = {o.source: run.observables[called[test.called, o.source][0]] for o in test.given}
    across = run.quality.get("spheres_across", np.inf) * _wider(lab, test)
    return Shown(lab.cylinder_of(test.called), run.curves[test.called], numbers, across)


def _wider(lab: Lab, test: AbstractLabTest) -> float:
    """How many times as many spheres across a test's specimen is as the narrowest of the lab: as
    many spheres fill each, so that their diameter goes with the cube root of its volume."""
    every = [lab.cylinder_of(each.called) for each in lab.tests if each.with_soil]
    slender = min(each.diameter / each.height for each in every)
    own = lab.cylinder_of(test.called)
    return float((own.diameter / own.height / slender) ** (1 / 3))


AT_TOOL = ("tool_across", "tool_overlap")
ACROSS = ("spheres_across", "tool_across", "porosity")
OVER_PACKINGS = dict.fromkeys(ACROSS, np.mean) | {"repeats": np.sum}
FINER = "give a finer --preset for results"
RESERVATIONS = {  # of a quality: what is beyond its limit, the limit, what is said
    "spheres_across": (
        operator.lt, LEAST_ACROSS, "the specimen is {:.1f} spheres across, below {:.0f}: numbers "
        f"and scatter depend on the size of the spheres; {FINER}",
    ),
    "tool_across": (
        operator.lt, LEAST_AT_TOOL, "a tool is {:.1f} spheres across, below {:.0f}: a few chains "
        f"of spheres carry it; {FINER}",
    ),
    "tool_overlap": (
        operator.gt, DEEPEST_AT_TOOL, "spheres overlap a tool by {:.2f} of their radius, "
        "above {:.1f}: contact laws hold for small overlaps, and this soil is too soft for the "
        "tool's force; raise shear_modulus, or end the test at a smaller depth",
    ),
}  # fmt: skip


def reservations(quality: dict) -> list[str]:
    """Why the numbers of runs are not to be trusted: specimen or tool are too few spheres across,
    or spheres overlap a tool too far."""
    return [
        said.format(value, limit)
        for name, (beyond, limit, said) in RESERVATIONS.items()
        if (value := quality.get(name, np.nan)) is not None and beyond(value, limit)
    ]


def quality_json(runs: Sequence[Run]) -> dict:
    """The worst of each check over packings, their mean resolution, how many were run twice, and
    whether any list stayed too small."""
    worst = {
        name: float(OVER_PACKINGS.get(name, np.max)([run.quality[name] for run in runs]))
        for name in runs[0].quality
        if name not in ("runtime_s", "steps", "overflow")
    }
    absent = [name for name in AT_TOOL if np.isnan(worst.get(name, 0.0))]  # no test has a tool
    worst = {name: value for name, value in worst.items() if name not in absent}
    return {**worst, "overflow": any(run.quality["overflow"] > 0 for run in runs)}


def rates_json(work: AbstractCampaign) -> dict:
    """Nominal and simulated platen speeds (mm/s) of all tests whose platen moves, their ratio."""
    return {
        test.name: {
            "nominal_mm_s": 1e3 * float(test.nominal_rate),
            "simulated_mm_s": 1e3 * float(test.simulated_rate),
            "scaled_by": float(test.simulated_rate / test.nominal_rate),
        }
        for test in work.apparatus
        if test.nominal_rate > 0
    }


def curves_json(run: Run) -> dict:
    """A run's curves as lists, with what was recorded beside them."""
    return {
        name: {"displacement_mm": curve[:, 0].tolist(), "force_n": curve[:, 1].tolist()}
        | {channel: values.tolist() for channel, values in run.channels.get(name, {}).items()}
        for name, curve in run.curves.items()
    }


DRAWN = 300  # points of a curve in a fit's result; all of them are in the campaign's cache


def drawn(displacement_mm: np.ndarray, force_n: np.ndarray) -> dict[str, list[float]]:
    """At most `DRAWN` points of a curve, first and last among them, to six digits."""
    count = len(force_n)
    rows = np.unique(np.linspace(0, count - 1, min(count, DRAWN)).round().astype(int))
    columns = {"displacement_mm": displacement_mm[rows], "force_n": force_n[rows]}
    return {name: [float(f"{x:.6g}") for x in column] for name, column in columns.items()}


def checked_json(lab: Lab, seeds: Seeds, fitted: Sequence[Run], fresh: Sequence[Run]) -> dict:
    """Runs at fitted values on the packings of the fit and on fresh ones, what was measured beside
    them, and what says whether to believe them."""
    return {
        **summary_json(fitted),
        "fresh_packings": summary_json(fresh),
        "measured": measured_json(lab),
        "seeds": list(seeds.fitted),
        "fresh_seeds": list(seeds.fresh),
        "packings": {
            "fitted": _packings_json(seeds.fitted, fitted),
            "fresh": _packings_json(seeds.fresh, fresh),
        },
        "quality": quality_json(fitted),
        "observable_warnings": doubts(lab, fresh),
    }


def summary_json(runs: Sequence[Run]) -> dict[str, dict[str, float]]:
    """Means over packings that did not fail, and the scatter of one; NaN where these are none, or
    only one."""
    sound = [run for run in runs if not run.failure]
    values = {name: [run.observables[name] for run in sound] for name in runs[0].observables}
    nan, count = float("nan"), len(sound)
    return {
        "observables": {n: float(np.mean(v)) if count else nan for n, v in values.items()},
        "spread": {n: float(np.std(v, ddof=1)) if count > 1 else nan for n, v in values.items()},
    }


def _packings_json(seeds: Sequence[int], runs: Sequence[Run]) -> list[dict]:
    """Simulated specimens with their curves as drawn."""
    return [
        {
            "seed": seed,
            **run.observables,
            "failure": run.failure,
            "curves": {name: drawn(*curve.T) for name, curve in run.curves.items()},
        }
        for seed, run in zip(seeds, runs, strict=True)
    ]


def measured_json(lab: Lab) -> dict:
    """What the laboratory measured: targets with their scatter, curves as drawn."""
    return {
        "targets": {name: asdict(target) for name, target in lab.targets.items()},
        "curves": [
            {
                "test": curve.test,
                "file": curve.file,
                **drawn(curve.displacement_mm, curve.force_n),
            }
            for curve in lab.curves
        ],
        "tests": {test.called: _test_json(test, lab) for test in lab.tests},
    }


def _test_json(test: AbstractLabTest, lab: Lab) -> dict:
    """What readers have to know of a test: its type, its title, what its figures mark (N)."""
    own = "" if test.called == test.type_name else f", {test.called}"
    called = names_of(lab.tests)
    drawn = [called[test.called, o.source][0] for o in test.given if o.drawn]
    return {
        "type": test.type_name,
        "title": f"{test.title}{own}",
        "axes": list(test.axes),
        "seated": not test.in_mould,
        "guides_n": list(test.guides()),
        "drawn": drawn,
    }


def check_some_sound(runs: Sequence[Run], which: str = "packings", result: object = None) -> None:
    """`CalibrationError` with the `result` where every run failed: then there are no numbers."""
    if runs and all(run.failure for run in runs):
        sentence = f"all {len(runs)} {which} failed, so there are no observables"
        raise CalibrationError(f"{sentence}: {runs[0].failure}", result)


def soil_json(soil: SoilParameters) -> dict[str, float]:
    """All parameters of the soil's law by name, SI; one that differs with moisture once for each of
    its values."""
    values = differing(soil.further)
    own = expanded(own_values(soil), values)
    return {name: float(soil.further.get(name, value)) for name, value in own.items()}
