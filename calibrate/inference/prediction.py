"""What a test would show of soils of a posterior, and what it is unsure of, one by one.

    number of a specimen = number(soil) + error of the response + luck of a packing

A laboratory's specimens may vary more than packings do: then luck is as large as theirs.

Numbers are observables and points of curves (`CurvePoints`).  A response gives them of every soil
at once.  Where it does not know the test, runs of a few soils do: their variance is split into that
between soils and that between packings of one soil (one-way analysis of variance with random
effects; Searle, Casella and McCulloch 1992, Variance Components, section 3.6).  No two soils share
a packing: its luck is much the same for all of them, and would be in their mean unseen.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import equinox as eqx
import numpy as np
from jax import Array
from scipy.stats import t as student

from calibrate.core.errors import CalibrationError
from calibrate.inference.curve_points import CurvePoints
from calibrate.inference.on_response import OnResponse
from calibrate.response.beds import Beds
from calibrate.simulation.joint import AbstractCampaign
from jdem.materials.soil import SoilParameters

SHARE = 0.9  # of specimens, or of means, that an interval holds
ASKED = 12  # soils at which errors and luck are worked out
LUCK = 4  # packings that are drawn for each soil


@dataclass(frozen=True, eq=False)
class Prediction:
    """Of each number (m,): the middle, and ends between which SHARE of specimens and of means over
    many packings lie; standard deviations by cause; what half as many spheres would add, None where
    that is not known.  `by` says where it comes from, of how many soils and runs."""

    points: CurvePoints
    middle: np.ndarray
    of_specimens: tuple[np.ndarray, np.ndarray]
    of_means: tuple[np.ndarray, np.ndarray]
    sd: dict[str, np.ndarray]
    fewer_spheres: np.ndarray | None
    by: str
    soils: int
    runs: int

    def sd_of(self, specimens: int) -> np.ndarray:
        """Of the mean over so many specimens (m,)."""
        causes = {**self.sd, "packings": self.sd["packings"] / np.sqrt(specimens)}
        return np.sqrt(sum(sd**2 for sd in causes.values()))


def by_response(
    response: OnResponse, fewer: OnResponse | None, soils: Sequence[SoilParameters],
    points: CurvePoints, seed: int, wider: Mapping[str, float] | None = None,
) -> Prediction:  # fmt: skip
    """From a response, of soils (n) that are drawn; `fewer` is the same with half as many spheres,
    if there is any; `wider` as of `SoilDraws`."""
    beds = response.campaign.beds
    values = np.array([shown(beds, points, soil) for soil in soils])
    asked = soils[:: max(1, len(soils) // ASKED)][:ASKED]
    more = np.sqrt(points.by_group(wider or {}))
    rows = [response.deviations(soil, points.shown) for soil in asked]
    rows = [(error, more * luck) for error, luck in rows]
    random = np.random.default_rng([seed, 4])
    errors, lucky = [], []
    for number in range(LUCK * len(soils)):
        error, luck = rows[number % len(rows)]
        errors.append(random.normal(size=len(error)) @ error)
        lucky.append(luck[random.integers(len(luck))])
    means = np.repeat(values, LUCK, axis=0) + errors
    half = None
    if fewer is not None:
        other = [shown(fewer.campaign.beds, points, soil) for soil in asked]
        half = np.mean(other - np.array([shown(beds, points, s) for s in asked]), axis=0)
    return Prediction(
        points=points,
        middle=np.median(values, axis=0),
        of_specimens=_ends(means + lucky),
        of_means=_ends(means),
        sd={
            "parameters": values.std(axis=0),
            "packings": _root_mean([(luck**2).mean(axis=0) for _, luck in rows]),
            "library": _root_mean([(error**2).sum(axis=0) for error, _ in rows]),
        },
        fewer_spheres=half,
        by="the library of runs",
        soils=len(soils),
        runs=0,
    )


def _ends(numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    low, high = np.percentile(numbers, [50 - 50 * SHARE, 50 + 50 * SHARE], axis=0)
    return low, high


def _root_mean(variances: Sequence[np.ndarray]) -> np.ndarray:
    return np.sqrt(np.mean(variances, axis=0))


@eqx.filter_jit
def shown(beds: Beds, points: CurvePoints, soil: SoilParameters) -> Array:
    """Numbers (m,) that beds show of a soil."""
    return points.shown(*beds.shown(beds.values(soil)))


def by_runs(
    work: AbstractCampaign, soils: Sequence[SoilParameters], packings: Sequence[int]
) -> Prediction:
    """From runs of soils (two at least).  `packings` are shared out: each soil has as many of its
    own (two at least).

    Raises:
        CalibrationError: fewer than two soils could be simulated.
    """
    points, each = CurvePoints.of(work), len(packings) // len(soils)
    row = [soil for soil in soils for _ in range(each)]
    (runs,) = work.each([row], packings, "soils of the posterior")
    rows = [runs[first : first + each] for first in range(0, len(runs), each)]
    values = np.array([[points.read(run) for run in row] for row in rows])
    sound = np.array([not any(run.failure for run in row) for row in rows])
    values, count = values[sound], int(sound.sum())
    if count < 2:
        why = next((run.failure for row in rows for run in row if run.failure), "")
        raise CalibrationError(
            f"{count} of {len(soils)} soils could be simulated on all packings, and two are "
            f"needed; the first failure: {why}"
        )
    means, within = values.mean(axis=1), values.var(axis=1, ddof=1).mean(axis=0)
    between = np.maximum(means.var(axis=0, ddof=1) - within / each, 0.0)
    middle, wide = means.mean(axis=0), student.ppf(0.5 + SHARE / 2, count - 1)
    least = np.where((values > 0).all(axis=(0, 1)), 0.0, -np.inf)  # where nothing is below 0

    def ends(variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        half = wide * np.sqrt(variance + means.var(axis=0, ddof=1) / count)
        return np.maximum(middle - half, least), middle + half

    return Prediction(
        points=points,
        middle=middle,
        of_specimens=ends(between + within),
        of_means=ends(between),
        sd={"parameters": np.sqrt(between), "packings": np.sqrt(within)},
        fewer_spheres=None,
        by="simulations",
        soils=count,
        runs=len(runs),
    )


def prediction_json(found: Prediction, targets: dict[str, dict]) -> dict:
    """The contract's keys: observables and curves with their intervals; `targets` are measured
    numbers by name, with mean and repeats."""
    names = found.points.observables
    return {
        "by": found.by,
        "soils": found.soils,
        "simulations": found.runs,
        "share": SHARE,
        "observables": {name: _number(found, k, targets.get(name)) for k, name in enumerate(names)},
        "curves": {test: _curve(found, test) for test in found.points.slices()},
    }


def _number(found: Prediction, k: int, measured: dict | None) -> dict:
    fewer = found.fewer_spheres
    row = {
        "middle": float(found.middle[k]),
        "specimen": [float(end[k]) for end in found.of_specimens],
        "mean": [float(end[k]) for end in found.of_means],
        "sd": {cause: float(sd[k]) for cause, sd in found.sd.items()},
        "half_the_spheres": None if fewer is None else float(fewer[k]),
    }
    if measured is None:
        return row
    # The same share of means over as many specimens as were measured.
    half = (found.of_specimens[1][k] - found.of_specimens[0][k]) / 2
    half *= found.sd_of(measured["repeats"])[k] / found.sd_of(1)[k]
    holds = abs(measured["mean"] - found.middle[k]) <= half
    return {**row, "measured": {**measured, "half_width": float(half), "holds": bool(holds)}}


def _curve(found: Prediction, test: str) -> dict:
    rows = found.points.slices()[test]
    reading = next(each for each in found.points.readings if each.test == test)
    return {
        reading.along: reading.points.tolist(),
        "middle": found.middle[rows].tolist(),
        "specimen": [end[rows].tolist() for end in found.of_specimens],
        "mean": [end[rows].tolist() for end in found.of_means],
    }


def prediction_sentences(called: str, row: dict) -> Iterator[str]:
    """What a number is unsure of, and whether it holds."""
    parts = ", ".join(f"{sd:.2g} by {cause}" for cause, sd in row["sd"].items())
    said = f"{called} has a standard deviation of {parts}"
    if row["half_the_spheres"] is not None:
        said += f"; half as many spheres would show {row['half_the_spheres']:+.2g}"
    yield said
    if (measured := row.get("measured")) is not None:
        verdict = "holds" if measured["holds"] else "does NOT hold"
        off = measured["mean"] - row["middle"]
        yield (
            f"the prediction of {called} {verdict}: {measured['mean']:.4g} was measured, "
            f"{off:+.2g} from what was expected, and {100 * SHARE:.0f} % of means over "
            f"{measured['repeats']} specimens lie within ± {measured['half_width']:.2g}"
        )
