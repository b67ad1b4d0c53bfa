"""Does a library whose slopes are wrong at a soil mend them by runs beside it?

`verification.audit --others` found slopes of the library at soils of the prior, and the reference
of each.  Here soils within REACH (ln p) of each are simulated on packings that took no part, and
what they show corrects the library, as runs of a posterior do (`calibrate.inference.posterior`):
a Gaussian process of the difference.  Its slopes, by JAX, stand beside both.

    python -m verification.beside              some 20 minutes of a core
    python -m verification.beside --soils 4 --runs 32

Runs are kept in results/benchmarks, and a second call goes on.  Writes a section of
verification/results/audit.md after each soil.
"""

import argparse
import re
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from calibrate.core.progress import for_terminal
from calibrate.discrepancy.library.stand_in import served
from calibrate.inference.parameters import Space
from calibrate.inference.posterior import Density, Question, Shown
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.io.soil import base_soil, with_values
from calibrate.simulation import Campaign
from calibrate.simulation.resolution import PRESETS, specimen, virtual_lab
from calibrate.simulation.specimens import Seeds
from verification import reporting
from verification.posterior import share_of

REACH = 0.3  # of ln p; the reference's regression reaches 0.2
PACKINGS = 2  # of each soil
FIRST = 9000  # seed of the packings; the audit's are 2300 to 2603
NEAR = {"H": 0.10, "F": 0.15}  # of the reference
ERRORS = 3.0  # of both together, within which two slopes agree
ROW = ("parameter", "of", "reference", "reference_se", "before", "before_se")
HEADER = ("soil", "parameter", "of", "reference", "library", "with runs beside it",
          "library differs by", "with runs", "in errors, before", "after")  # fmt: skip


def references() -> list[dict]:
    """What the audit's page says of each other soil: parameters, SI, and rows of slopes."""
    text = (reporting.RESULTS / "audit.md").read_text(encoding="utf-8")
    section = re.split(r"(?m)^# ", text.partition("# Other soils\n")[2])[0]
    soils = []
    for number, line in re.findall(r"(?m)^(\d+)\. (.+)$", section):
        values = {name: float(value) for name, value in (e.split(" ") for e in line.split(", "))}
        slopes = r"(\w+) \| (\w) \| (\S+) ± (\S+) \| (\S+) ± (\S+) \|"
        rows = re.findall(rf"(?m)^\| {number} \| {slopes}", section)
        soils.append({"values": values, "rows": [(n, of, *map(float, x)) for n, of, *x in rows]})
    return soils


def question_at(values: dict[str, float], spheres: int) -> tuple[Question, Campaign]:
    """What is asked of the bundled library about a soil, and what simulates."""
    lab = load_lab(bundled_lab())
    preset, base = (
        replace(PRESETS["standard"], spheres=spheres),
        with_values(base_soil(lab), values),
    )
    bodies, machine = specimen(lab, preset), virtual_lab(lab, preset)
    work = Campaign(machine, bodies, reporting.CACHE, for_terminal())
    library, why = served(lab, preset, None, base, work)
    if library is None:
        raise SystemExit(why)
    seeds = Seeds.of(FIRST // 100, PACKINGS, PACKINGS)
    return Question.of(lab, base, library, work, seeds), work


def beside(space: Space, centre: np.ndarray, count: int) -> list[np.ndarray]:
    """Parameters (p,), SI, of soils within REACH of ln p = `centre`, spread evenly."""
    low, high = space.log_bounds()
    drawn = qmc.Sobol(len(centre), rng=0).random(count)
    return list(np.exp(np.clip(centre + REACH * (2 * drawn - 1), low, high)))


def slopes_of(density: Density, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """d features/d ln p (m, p), and their errors: what runs leave of the variance of the slopes of
    the process that corrects the library."""
    at, runs = jnp.asarray(logs), density.runs
    found = jax.jacfwd(lambda logs: density.shown(jnp.exp(logs))[0])(at)

    def near(logs):
        return jnp.exp(-0.5 * (((runs.points - logs) / runs.distance) ** 2).sum(axis=1))

    turn = jax.jacfwd(near)(at)
    left = runs.distance**-2 - jnp.einsum("np,mnk,kp->mp", turn, runs.known, turn)
    own = density.features(jnp.exp(at)) * jnp.sqrt((density.error(at) ** 2).sum(axis=0))
    return np.asarray(found), np.asarray(own[:, None] * jnp.sqrt(jnp.maximum(left, 0.0)))


def rows_of(soil: dict, spheres: int, count: int) -> list[dict]:
    """The library's slopes before and after runs at `count` soils beside one."""
    question, work = question_at(soil["values"], spheres)
    names = question.space.names
    values = np.array([soil["values"][name] for name in names])
    packings = range(FIRST, FIRST + PACKINGS)
    places = [values, *beside(question.space, np.log(values), count - 1)]
    shown = [
        Shown.by(work, question.problem, question.space, at, packings, f"beside, soil {number}")
        for number, at in enumerate(places)
    ]
    error = question.own_error()
    known = [one for one in shown if one is not None]
    slopes, errors = slopes_of(question.density(error, known), np.log(values))
    of = {"depression_depth_mm": "H", "crushing_force_n": "F"}
    features = [of[feature.name] for feature in question.problem.features]
    return [
        {
            **dict(zip(ROW, row, strict=True)),
            "after": float(slopes[features.index(row[1]), names.index(row[0])]),
            "after_se": float(errors[features.index(row[1]), names.index(row[0])]),
        }
        for row in soil["rows"]
        if row[0] in names
    ]


def markdown(found: dict[int, list[dict]], spheres: int, count: int, origin: dict) -> str:
    """A row for each slope, and how many are near before and after."""
    cells = [_cells(number, row) for number, rows in found.items() for row in rows]
    every = [row for rows in found.values() for row in rows]
    said = [
        f"- {which}, {said}: {share_of(off < NEAR[which])} of {len(off)} slopes within "
        f"{100 * NEAR[which]:.0f} %, {share_of(errors < ERRORS)} within {ERRORS:g} errors"
        for which in NEAR
        for when, said in (("before", "library alone"), ("after", "with runs"))
        for off, errors in [_apart([row for row in every if row["of"] == which], when)]
        if len(off)
    ]
    return (
        f"# Other soils, with runs beside them\n\n{count} soils within {REACH:g} of ln p of each, "
        f"{spheres} spheres, {PACKINGS} packings each; slopes per unit of ln p (H in mm, F in N). "
        "References are those above.\n\n"
        + reporting.table(HEADER, cells)
        + "\n" + "\n".join(said) + "\n"
        + reporting.footer(origin)
    )  # fmt: skip


def _apart(rows: list[dict], when: str) -> tuple[np.ndarray, np.ndarray]:
    """Shares of the reference, and numbers of errors, by which slopes are off."""
    off, errors = [], []
    for row in rows:
        apart = abs(row[when] - row["reference"])
        off.append(apart / abs(row["reference"]))
        errors.append(apart / np.hypot(row["reference_se"], row[f"{when}_se"]))
    return np.array(off), np.array(errors)


def _cells(number: int, row: dict) -> list[str]:
    (before,), (in_before,) = _apart([row], "before")
    (after,), (in_after,) = _apart([row], "after")
    return [
        str(number), row["parameter"], row["of"],
        *(f"{row[k]:.3g} ± {row[f'{k}_se']:.2g}" for k in ("reference", "before", "after")),
        f"{100 * before:.0f} %", f"{100 * after:.0f} %", f"{in_before:.1f}", f"{in_after:.1f}",
    ]  # fmt: skip


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--soils", nargs="+", type=int, default=[1, 2, 3, 4])
    parser.add_argument("--runs", type=int, default=16, help="soils beside each")
    parser.add_argument("--spheres", type=int, default=1000)
    chosen = parser.parse_args()
    reporting.configure()
    found, soils = {}, references()
    for number in chosen.soils:
        found[number] = rows_of(soils[number - 1], chosen.spheres, chosen.runs)
        text = markdown(found, chosen.spheres, chosen.runs, reporting.provenance())
        reporting.write_section("audit", text)


if __name__ == "__main__":
    main()
