"""What a further test would narrow: of each parameter, and of a number that is to be predicted.

    V after = V - C (S + E + L/n)^-1 C'

V, C and S are covariances over soils of a posterior: of the quantities, of these with what the test
shows, and of what it shows.  E is the error of the response, L the scatter of one specimen, n how
many are tested.  This is what regression on the test leaves on average, whatever it shows
(Bayes linear statistics; Goldstein and Wooff 2007, section 3.2).
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibrate.inference.curve_points import CurvePoints
from calibrate.inference.on_response import OnResponse
from calibrate.inference.prediction import ASKED, shown
from calibrate.io.lab import Lab
from jdem.materials.soil import SoilParameters

REPEATS = (1, 4)  # specimens of a further test
PRESSED = (0.5, 2.0)  # times the largest force of the confined test
SLENDER = (0.5, 2.0)  # times the specimen's height
EVERY = 4  # points of a curve, of which one is read
HARDLY = 1e-9  # of a variance


@dataclass(frozen=True)
class FurtherTest:
    """A test that a laboratory could make: of its name, what is read of it ("numbers" or
    "curves"), and the lab file that describes it."""

    name: str
    read: str
    lab: Lab


def menu(lab: Lab) -> Iterator[FurtherTest]:
    """The lab's own tests again, the same with whole curves, pressed otherwise, or on specimens of
    another height."""
    yield FurtherTest("the same tests again", "numbers", lab)
    yield FurtherTest("the same tests again", "curves", lab)
    pressed = [k for k, test in enumerate(lab.tests) if hasattr(test, "force_high")][:1]
    for press, factor in itertools.product(pressed, PRESSED):
        test = lab.tests[press]
        forces = {name: factor * getattr(test, name) for name in ("force_low", "force_high")}
        other = test.model_copy(update=forces)
        tests = (*lab.tests[:press], other, *lab.tests[press + 1 :])
        called = f"pressed with {forces['force_high']:.3g} N"
        yield FurtherTest(called, "curves", replace(lab, tests=tests))
    for factor in SLENDER:
        height = factor * lab.specimen.height
        called = f"a specimen {1e3 * height:.3g} mm high"
        specimen = replace(lab.specimen, height=height)
        yield FurtherTest(called, "curves", replace(lab, specimen=specimen))


@dataclass(frozen=True, eq=False)
class Told:
    """What a test tells of soils: numbers (n, m) of each, their error (m, m) by the response, and
    the scatter (m, m) of one specimen."""

    numbers: np.ndarray
    error: np.ndarray
    scatter: np.ndarray

    @staticmethod
    def by(
        response: OnResponse, soils: Sequence[SoilParameters], points: CurvePoints, read: str,
        relative_scatter: float | None,
    ) -> "Told":  # fmt: skip
        """By a response.  Specimens scatter as packings do, or if it is known of the laboratory's
        numbers, `relative_scatter` times their mean."""
        beds = response.campaign.beds
        numbers = np.array([shown(beds, points, soil) for soil in soils])
        asked = soils[:: max(1, len(soils) // ASKED)][:ASKED]
        rows = [response.deviations(soil, points.shown) for soil in asked]
        error = np.mean([e.T @ e for e, _ in rows], axis=0)
        luck = np.mean([each.T @ each / len(each) for _, each in rows], axis=0)
        count = len(points.observables)
        if relative_scatter is not None:
            own = np.sqrt(np.diag(luck)[:count]) / np.abs(numbers[:, :count].mean(axis=0))
            luck = luck * (relative_scatter / own.mean()) ** 2
        used = np.arange(count)
        if read == "curves":
            used = np.append(used, np.arange(count, numbers.shape[1], EVERY))
        used = used[np.isfinite(numbers[:, used]).all(axis=0)]  # others lie beyond its curves
        square = np.ix_(used, used)
        return Told(numbers[:, used], error[square], luck[square])


def left(quantities: np.ndarray, told: Told, specimens: int) -> np.ndarray:
    """The share (q,) of each quantity's deviation over soils (n, q) that a test leaves, on average
    over what it may show."""
    known = quantities - quantities.mean(axis=0)
    numbers = told.numbers - told.numbers.mean(axis=0)
    count = len(known) - 1
    total = numbers.T @ numbers / count + told.error + told.scatter / specimens
    total = total + HARDLY * np.diag(np.diag(total))
    joint = known.T @ numbers / count
    explained = np.einsum("qm,mq->q", joint, np.linalg.solve(total, joint.T))
    variance = known.var(axis=0, ddof=1)
    return np.sqrt(np.clip(1 - explained / variance, 0.0, 1.0))


def relative_scatter(lab: Lab) -> float | None:
    """Of the laboratory's repeats, over their mean: the mean over its targets, None without any."""
    known = [t.scatter / abs(t.mean) for t in lab.targets.values() if t.repeats > 1 and t.mean]
    return float(np.mean(known)) if known else None


def row(test: FurtherTest, specimens: int, names: Sequence[str], shares: np.ndarray) -> Mapping:
    """As results have it."""
    return {
        "name": test.name,
        "read": test.read,
        "specimens": specimens,
        "left": dict(zip(names, shares.tolist(), strict=True)),
    }
