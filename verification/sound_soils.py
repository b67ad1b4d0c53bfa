"""Do intervals, predictions and promises hold for the sound soils of studies/sound_cases.py?

48 soils were simulated on four packings each, with porosities, roundings and noise of their own.
The library of runs alone judges them:

- parameters: how often intervals of the posterior from H and F hold the truth, by brute force
  (`verification.posterior`);
- zeros: how far records of a test begin from where the library's curves do;
- predictions: H and F of three specimens are known, and the fourth one's numbers and both its
  curves are predicted;
- promises, for the first PROMISED soils: what `calibrate next` says that whole curves of the four
  specimens leave of each parameter's deviation, beside what they leave.

    python -m verification.sound_soils                   half an hour of a core
    python -m verification.sound_soils --part promises   the others as they were

Writes a section of verification/results/posterior.md after each soil; a second call goes on with
promises.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.stats import kstest
from scipy.stats import t as student

from calibrate.discrepancy.library import stand_in
from calibrate.discrepancy.library.design import CENTRE, SETTINGS, SOIL_PRIOR_SD, SPEEDS
from calibrate.inference.curve_points import POINTS, CurvePoints
from calibrate.inference.narrowing import Told, left, relative_scatter
from calibrate.inference.posterior import Question
from calibrate.inference.prediction import by_response
from calibrate.inference.sampling import mixing, starts, values_of
from calibrate.io.choices import ParameterChoice
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.labtests.features import (
    SEATED,
    DisplacementOnLoading,
    ForceAtDisplacement,
)
from calibrate.labtests.measured import Target
from calibrate.labtests.reading import displacement_on_rise, loading, rising
from calibrate.simulation.resolution import PRESETS, specimen
from jdem.materials.soil import SoilParameters
from studies import open_cases, sound_cases
from studies.sealed.plan import PACE, SMOOTHING, WithheldCase
from studies.sealed.run import planned_case
from verification import reporting
from verification.posterior import Brute, question_of, random_walk, share_of

DRAWN = 80_000  # soils of the prior that are weighed
READINGS = 3  # of a record, over which noise is averaged
HOLDS = (0.5, 0.9)  # shares of draws, or of specimens, that intervals are to hold
KNOWN = 3  # specimens, of four, from which the last is predicted
PREDICTED = 200  # soils of a posterior of which tests are predicted
# Shares of the largest force up to which a record begins: specimens hardly scatter there.
BEGUN = (0.0125, 0.3)
PROMISED = 20
STEPS = (3_000, 8_000)  # of random walks: to learn how they have to step, and to draw
ASKED = 400  # draws by which a test is weighed, as `calibrate next` does
NAMES = ("depression_depth_mm", "crushing_force_n")


@dataclass(frozen=True, eq=False)
class Sound:
    """A soil as it was made, its lab file with curves, and H and F (specimens, 2), mm and N."""

    case: WithheldCase
    lab: Lab
    numbers: np.ndarray

    @staticmethod
    def every(folder: Path) -> "list[Sound]":
        found = []
        for path in sorted((folder / "cases").glob("*/lab.toml")):
            lab, rows = load_lab(path), []
            low, high = lab.tests[0].guides()
            for press, crush in zip(*Sound._curves(lab), strict=True):
                top = int(np.argmax(press.force_n)) + 1
                rising = np.maximum.accumulate(press.force_n[:top])
                start, end = np.interp([low, high], rising, press.displacement_mm[:top])
                smooth = np.convolve(crush.force_n, np.full(READINGS, 1 / READINGS), "valid")
                rows.append([end - start, smooth.max()])
            found.append(Sound(planned_case(folder, path.parent.name), lab, np.array(rows)))
        return found

    @staticmethod
    def _curves(lab: Lab) -> list[list]:
        return [[c for c in lab.curves if c.test == test.called] for test in lab.tests]

    def record(self, number: int) -> list[np.ndarray]:
        """Curves (rows, 2) of one specimen, mm and N, in the order of the tests."""
        curves = [every[number] for every in Sound._curves(self.lab)]
        return [np.stack([c.displacement_mm, c.force_n], axis=1) for c in curves]

    def two_numbers(self) -> Lab:
        """Its lab file with H and F of all specimens in place of curves."""
        targets = {
            name: Target(float(column.mean()), float(column.std(ddof=1)), len(column))
            for name, column in zip(NAMES, self.numbers.T, strict=True)
        }
        return replace(self.lab, targets=targets, curves=())

    def question(self, lab: Lab) -> Question:
        """Of beds as it was simulated with: nearly without roundings."""
        preset = replace(PRESETS["standard"], spheres=1100, rate_in_mould=PACE * SPEEDS[0])
        choices = {n: ParameterChoice(CENTRE[n], None, None, sd, None)
                   for n, sd in SOIL_PRIOR_SD.items()}  # fmt: skip
        usual = specimen(load_lab(bundled_lab()), preset).porosity
        porosity = None if usual is None else usual + self.case.porosity
        own = replace(
            lab,
            particles=replace(lab.particles, porosity=porosity),
            parameters={**lab.parameters, **choices},
        )
        settings = stand_in._settings

        def smooth(*given) -> list[float]:
            known = dict(zip(SETTINGS, settings(*given), strict=True))
            return [*{**known, "smoothing": SMOOTHING}.values()]

        with mock.patch.object(stand_in, "_settings", smooth):
            return question_of(own, preset)


# ---------------------------------------------------------------- parameters and predictions


@dataclass(frozen=True)
class Seated:
    """What is predicted of a specimen: H, F, and points of its curves, whose displacement begins
    where it carries (a laboratory's zero is arbitrary): mm at forces, N at displacements."""

    pressed: str
    crushed: str
    forces: tuple[float, ...]
    displacements: tuple[float, ...]

    @staticmethod
    def of(points: CurvePoints) -> "Seated":
        press, crush = points.readings
        ends = (tuple(each.points.tolist()) for each in (press, crush))
        return Seated(press.test, crush.test, *ends)

    def by_group(self, of: Mapping[str, float]) -> np.ndarray:
        """As that of `CurvePoints`."""
        each = [of[name] for name in NAMES]
        return np.concatenate([each, *(np.full(POINTS, number) for number in each)])

    def named(self, curves: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
        """Curves of both tests, by test."""
        return {self.pressed: curves[0], self.crushed: curves[1]}

    def shown(self, observables: Mapping, curves: Mapping) -> Array:
        """H, F, and POINTS of each curve; NaN beyond a curve's end."""
        press, crush = curves[self.pressed], curves[self.crushed]
        forces, ways = np.array(self.forces), np.array(self.displacements)
        risen = DisplacementOnLoading("", "mm", self.pressed, forces, SEATED).of_curve(*press.T)
        carried = ForceAtDisplacement("", "N", self.crushed, ways, SEATED, 0.0)
        risen = jnp.where(forces <= press[:, 1].max(), risen, jnp.nan)
        end = crush[:, 0].max() - SEATED.of(*loading(*crush.T))
        borne = jnp.where(ways <= end, carried.of_curve(*crush.T), jnp.nan)
        return jnp.concatenate([jnp.stack([observables[n] for n in NAMES]), risen, borne])


def points_of(question: Question) -> CurvePoints:
    """Points of the curves that a question's response gives."""
    return CurvePoints.of(question.response.campaign)  # pyright: ignore[reportArgumentType]


def scatter_of(sound: Sequence[Sound]) -> np.ndarray:
    """Relative deviation of H and of F (2,) from specimen to specimen, over all soils."""
    return np.mean([np.var(np.log(s.numbers), axis=0, ddof=1) for s in sound], axis=0) ** 0.5


def by_porosity(sound: Sequence[Sound], count: int) -> Iterator[tuple[Question, Brute, list]]:
    """Soils whose beds are as porous, what is asked of them, and soils of the prior."""
    for porosity in sorted({s.case.porosity for s in sound}):
        these = [s for s in sound if s.case.porosity == porosity]
        question = these[0].question(these[0].two_numbers())
        density = question.density(question.own_error(), [])
        brute = Brute.of(question, replace(density, covariance=jnp.zeros((2, 2))), count, 5)
        yield question, brute, these


def judged(sound: Sequence[Sound], count: int) -> dict:
    """Parameters, from all specimens, and predictions of the last one, from the others."""
    scatter = scatter_of(sound)
    below, least, held, zeros = [], np.inf, [], []
    for question, brute, these in by_porosity(sound, count):
        points = Seated.of(points_of(question))
        for each in these:
            weights = _weights(brute, each.numbers, scatter)
            jax.clear_caches()  # or programs of all soils together use up the system's maps
            truth = np.log([each.case.soil[name] for name in question.space.names])
            below.append(brute.below(weights, truth))
            zeros.append(begun(each, question, points))
            least = min(least, 1 / (weights**2).sum())
            known = _weights(brute, each.numbers[:KNOWN], scatter)
            drawn = np.random.default_rng(21).choice(len(known), PREDICTED, p=known)
            soils = [question.space.soil(np.exp(brute.logs[number])) for number in drawn]
            luck = np.diag(question.scatter)
            wider = dict(zip(NAMES, np.maximum(1.0, scatter**2 / luck), strict=True))
            low, high = _band(question, soils, points, wider)
            numbers = dict(zip(NAMES, each.numbers[-1], strict=True))
            seen = np.asarray(points.shown(numbers, points.named(each.record(-1))))
            known = np.isfinite(low) & np.isfinite(seen)
            held.append(np.where(known, (seen > low) & (seen < high), np.nan))
    return {
        "names": list(SOIL_PRIOR_SD), "scatter": scatter.tolist(), "least_effective": float(least),
        "below": np.array(below).tolist(), "zeros": zeros, "held_back": np.array(held).tolist(),
    }  # fmt: skip


def begun(sound: Sound, question: Question, points: Seated) -> list[float]:
    """By how much more (mm) records move from the seating force to BEGUN of the largest one than
    the response's curves of the true soil: mean over specimens, confined and unconfined."""
    soil = question.space.soil(np.array([sound.case.soil[n] for n in question.space.names]))
    beds = question.response.campaign.beds
    curves = beds.shown(beds.values(soil))[1]
    names = (points.pressed, points.crushed)
    expected = [_begun(np.asarray(curves[n]), k) for k, n in enumerate(names)]
    specimens = range(len(sound.numbers))
    records = [[_begun(c, k) for k, c in enumerate(sound.record(n))] for n in specimens]
    return (np.mean(records, axis=0) - expected).tolist()


def _begun(curve: np.ndarray, test: int) -> float:
    way, force = curve[: int(curve[:, 1].argmax()) + 1].T
    rise = rising(way, force)
    ends = [SEATED.force or 0.0, BEGUN[test] * force.max()]
    return float(np.diff([displacement_on_rise(*rise, end) for end in ends])[0])


def _band(
    question: Question, soils: Sequence[SoilParameters], points: Seated, wider: Mapping
) -> tuple[np.ndarray, np.ndarray]:
    """Ends between which 90 % of specimens lie, each (m,)."""
    read = cast(CurvePoints, points)  # it is asked for `shown` and `by_group` alone
    return by_response(question.response, None, soils, read, 0, wider).of_specimens


def _weights(brute: Brute, numbers: np.ndarray, scatter: np.ndarray) -> np.ndarray:
    """Of soils, given H and F (specimens, 2), which scatter relatively by `scatter` (2,)."""
    measured = numbers.mean(axis=0)
    own = np.diag((scatter * measured) ** 2 / len(numbers))
    return replace(brute, covariance=brute.covariance + own).weights(measured)


# ---------------------------------------------------------------- promises


def promises(sound: Sequence[Sound], count: int, found: list[dict]) -> Iterator[list[dict]]:
    """Of each parameter's deviation given H and F: the share that whole curves of as many
    specimens leave, promised and come; shares of draws given curves below the truth.  Goes on from
    what was `found`, and gives all after each soil."""
    known, spread = {row["case"] for row in found}, scatter_of(sound)
    left_over = [each for each in sound if each.case.name not in known]
    for question, brute, these in by_porosity(left_over, count):
        for each in these:
            weights = _weights(brute, each.numbers, spread)
            drawn = np.random.default_rng(23).choice(len(weights), ASKED, p=weights)
            logs = brute.logs[drawn]
            soils = [question.space.soil(np.exp(row)) for row in logs]
            usual = relative_scatter(each.two_numbers())
            told = Told.by(question.response, soils, points_of(question), "curves", usual)
            after = walked(each.question(each.lab))
            draws = after.reshape(-1, after.shape[-1])
            truth = np.log([each.case.soil[name] for name in question.space.names])
            found.append({
                "case": each.case.name,
                "promised": left(logs, told, len(each.numbers)).tolist(),
                "came": (draws.std(axis=0) / logs.std(axis=0)).tolist(),
                "below": (draws < truth).mean(axis=0).tolist(),
                "least_ess": float(mixing(after)[1].min()),
                "rhat": float(mixing(after)[0].max()),
            })  # fmt: skip
            yield found


def walked(question: Question) -> np.ndarray:
    """ln p (chains, draws, p) of a posterior by the library alone, by random walks that begin
    where NUTS would."""
    density = question.density(question.own_error(), [])
    begin, covariance = (jnp.asarray(part) for part in question.best())
    y = starts(density, (begin, covariance), 4, 0)
    learned = random_walk(density, np.asarray(y), np.asarray(covariance), STEPS[0])[
        :, STEPS[0] // 2 :
    ]
    spread = np.cov(learned.reshape(-1, learned.shape[-1]).T)
    return np.log(values_of(density, random_walk(density, learned[:, -1], spread, STEPS[1])))


# ---------------------------------------------------------------- the page


def markdown(found: dict, origin: dict) -> str:
    names, below = found["judged"]["names"], np.array(found["judged"]["below"])
    ratio = np.array([np.divide(r["came"], r["promised"]) for r in found["promises"]])
    rows = []
    for k, name in enumerate(names):
        inside = [np.abs(below[:, k] - 0.5) < share / 2 for share in HOLDS]
        promised, came = (
            f"{100 * np.median([r[key][k] for r in found['promises']]):.0f} %"
            for key in ("promised", "came")
        )
        rows.append([name, *map(share_of, inside), f"{kstest(below[:, k], 'uniform').pvalue:.2f}",
                     promised, came, f"{np.median(ratio[:, k]):.2f}"])  # fmt: skip
    scatter = found["judged"]["scatter"]
    return (
        "# Sound soils\n\n"
        f"{len(below)} soils were simulated on four packings each; the library alone judged them, "
        "by depression depth and crushing force, which scatter by "
        f"{100 * scatter[0]:.1f} % and {100 * scatter[1]:.1f} % from specimen to specimen.\n\n"
        + reporting.table(
            ("parameter", "50 % intervals hold the truth of soils", "90 % intervals", "ranks: p",
             "curves leave of its deviation, promised", "come", "come over promised"), rows)
        + "\n" + "\n".join(f"- {each}" for each in _sentences(found, ratio)) + "\n"
        + reporting.footer(origin)
    )  # fmt: skip


def _sentences(found: dict, ratio: np.ndarray) -> list[str]:
    held = np.array(found["judged"]["held_back"], float)
    numbers = [
        f"{name} of {share_of(column == 1)}" for name, column in zip(NAMES, held.T, strict=False)
    ]
    curves = (held[:, 2 : 2 + POINTS], held[:, 2 + POINTS :])
    confined, free = (_mean(np.nanmean(part, axis=1)) for part in curves)
    zeros = np.sqrt(np.mean(np.square(found["judged"]["zeros"]), axis=0))
    logs = np.log(ratio).mean(axis=1)
    half = student.ppf(0.975, len(logs) - 1) * logs.std(ddof=1) / np.sqrt(len(logs))
    middle, low, high = np.exp([logs.mean(), logs.mean() - half, logs.mean() + half])
    inside = np.abs(np.array([r["below"] for r in found["promises"]]) - 0.5) < HOLDS[1] / 2
    return [
        f"Given curves, 90 % intervals hold {share_of(inside.ravel())} of the true parameters of "
        f"{len(inside)} soils.",
        f"Up to {100 * BEGUN[0]:.3g} and {100 * BEGUN[1]:.3g} % of the largest force, records move "
        f"more or less than the library's curves of the true soil by {zeros[0]:.3f} mm (confined) "
        f"and {zeros[1]:.3f} mm (unconfined), root mean square over soils.",
        f"Of specimens that took no part, 90 % intervals hold {' and '.join(numbers)}; of the "
        f"points of their curves {confined} (confined) and {free} (unconfined).",
        f"Whole curves of {len(ratio)} soils leave {middle:.2f} times ({low:.2f} to {high:.2f}, "
        "95 %) the deviations that were promised, in the geometric mean over parameters.",
    ]  # fmt: skip


def _mean(shares: np.ndarray) -> str:
    error = shares.std(ddof=1) / np.sqrt(len(shares))
    return f"{100 * shares.mean():.0f} ± {100 * error:.0f} %"


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--part", choices=("judged", "promises"), help="only this one")
    parser.add_argument("--drawn", type=int, default=DRAWN, help="soils of the prior")
    parser.add_argument("--most", type=int, help="soils, of all")
    chosen = parser.parse_args()
    reporting.configure()
    open_cases.unpack(("sound_cases.tar.xz",))
    sound = Sound.every(sound_cases.WORK)[: chosen.most]
    found: dict = {part: reporting.earlier("sound_soils", part) for part in ("judged", "promises")}
    if chosen.part in (None, "judged"):
        found["judged"] = judged(sound, chosen.drawn)
        _save(found)
    if chosen.part in (None, "promises"):
        before = list(found["promises"] or [])
        for found["promises"] in promises(sound[:PROMISED], chosen.drawn, before):
            _save(found)


def _save(found: dict) -> None:
    """What there is; the page as soon as there is some of both, which one command makes."""
    origin = {**reporting.provenance(), "command": "python -m verification.sound_soils"}
    reporting.write_content("sound_soils", {**origin, **found})
    if all(found.values()):
        reporting.write_section("posterior", markdown(found, origin))


if __name__ == "__main__":
    main()
