"""The audit of the derivatives that fits use, on two sets of packings.

    python -m verification.audit --seeds 21 22         some 15 minutes on two cores
    python -m verification.audit --others 4            some 30 minutes on two cores
    python -m verification.audit --seeds 21 22 --halved plasticity_ratio      some 3 minutes
    python -m verification.audit --seeds 21 22 --finer 2000       some 30 minutes on two cores

The bundled soil, grown beds at the preset standard's rates: reference slopes by regression over
+-20 %, one parameter at a time, against those of the library and of pairs of runs, on the same
packings; then all of it again on others.  With --others the library alone, at so many soils of the
bundled lab file's prior, each on packings of its own; there it is also asked for its own regression
over the same steps, which tells a bent response from a wrong one.  With --halved the reference of
these parameters is taken again over half the steps: where a response bends, that is another number.
With --finer the library alone, at the bundled soil with so many spheres.

Runs are kept in results/benchmarks; a second call resumes.  Writes after every seed
notebooks/data/audit.json, the first section of verification/results/audit.md and
docs/images/audit.png; after every other soil, and so on, a section of the page.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from calibrate.core.progress import for_terminal
from calibrate.discrepancy.library.stand_in import served
from calibrate.figures import save
from calibrate.figures.audit import audit_figure
from calibrate.inference.audit import (
    REFERENCE,
    RESPONSE,
    Audit,
    audit,
    audit_json,
    judged,
    simulated_response,
)
from calibrate.inference.on_response import OnResponse
from calibrate.inference.parameters import FACTORS, Space, space
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.io.soil import base_soil, with_values
from calibrate.records.audit import AuditSlopes
from calibrate.records.base import record
from calibrate.simulation import Campaign
from calibrate.simulation.resolution import PRESETS, specimen, virtual_lab
from jdem.materials.soil import SoilParameters
from verification import reporting
from verification.posterior import question_of, share_of

STRATEGIES = {
    "response": "Of the library of runs, by JAX",
    "fit": "By pairs of runs, as fits take them where the library does not serve",
    "ensemble": "All parameters in groups",
}


NEAR = {"depression_depth_mm": 0.10, "crushing_force_n": 0.15}  # of the library's slopes
ERRORS = 3.0  # of both together, within which two slopes agree
STEP = 0.2  # in ln p, of the reference
FIRST_OF_OTHERS = 23  # seed of the packings of the first of the other soils; and of the draw


def audited(
    spheres: int, seeds: range, folder: Path, names: list[str], base: SoilParameters | None = None
) -> tuple[Audit, list[list[float]]]:
    """The audit of strategies, at the bundled soil or another one, and the library's own
    regression (m, p) over the steps of the reference."""
    lab = load_lab(bundled_lab())
    preset = replace(PRESETS["standard"], spheres=spheres)
    work = Campaign(virtual_lab(lab, preset), specimen(lab, preset), folder, for_terminal())
    base = base_soil(lab) if base is None else base
    library, why = served(lab, preset, None, base, work)
    assert library is not None, why
    about = space(lab, (*FACTORS, "shear_modulus"), base)
    found = audit(about, work, seeds, names, library)
    return found, _over_the_steps(found, about, library)


def _over_the_steps(found: Audit, about: Space, library: OnResponse) -> list[list[float]]:
    campaign: Any = library.campaign
    response = simulated_response(about, campaign, [0], found.points)(RESPONSE)
    slopes = REFERENCE(response, jnp.log(jnp.asarray(about.start())), 1).slopes
    return np.asarray(slopes)[: len(found.points.observables)].tolist()


def markdown(audits: dict[str, dict], spheres: int, packings: int, origin: dict) -> str:
    begin = (
        f"# Audit of derivatives\n\nBundled soil, {spheres} spheres, {packings} "
        "packings a seed. Slopes per unit of ln p with standard errors. Passed: the reference's "
        "sign, within 15 % (H, mm) or 25 % (F, N) of it; slopes below three standard errors are "
        "not judged. What fits move alone is moved as in the reference, so it agrees.\n\n"
        "The reference is a regression over steps of 20 %. Beside the library's slope at the point "
        "stands its own regression over the same steps: it tells a response that bends from a "
        "wrong one.\n\n"
    )
    sections = [_section(name, audits, packings) for name in STRATEGIES]
    return begin + "\n".join(sections) + reporting.footer(origin)


def _section(strategy: str, audits: dict[str, dict], packings: int) -> str:
    """The tables of one strategy, seed by seed and together."""
    each = {seed: found["strategies"][strategy] for seed, found in audits.items()}
    cost = next(iter(each.values()))
    tables = [
        f"## {STRATEGIES[strategy]}\n\n{_cost(cost['forward_runs'])} ({cost['described']}).\n"
    ]
    for seed, found in each.items():
        tables.append(
            f"Packings of seed {seed}, {tally(found['rows'])}:\n\n" + _table(found["rows"])
        )
    if len(each) > 1:
        rows = pooled([found["rows"] for found in each.values()])
        together = f"All {len(each) * packings} packings together, {tally(rows)}"
        tables.append(f"{together}:\n\n" + _table(rows))
    return "\n".join(tables)


def _cost(runs: float) -> str:
    if not runs:
        return "No run"
    return f"{runs:.0f} forward runs a packing, the one at the point among them"


def tally(rows: list[dict]) -> str:
    """How many slopes passed of those that can be judged."""
    verdicts = [row["passed"] for row in rows if row["judged"]]
    return f"{sum(verdicts)} of {len(verdicts)} passed"


def pooled(audits: list[list[dict]]) -> list[dict]:
    """Rows of several audits on as many sets of packings, averaged and judged anew."""
    found = []
    for rows in zip(*audits, strict=True):
        means = {
            key: float(np.mean([row[key] for row in rows])) for key in ("estimate", "reference")
        }
        errors = {
            f"{key}_se": float(np.sqrt(np.sum([row[f"{key}_se"] ** 2 for row in rows]))) / len(rows)
            for key in means
        }
        if "chord" in rows[0]:  # one library judged all: its error does not shrink
            errors["estimate_se"] = float(np.mean([row["estimate_se"] for row in rows]))
        same = ("parameter", "observable", "chord")  # the library's does not know packings
        named = {key: rows[0][key] for key in same if key in rows[0]}
        found.append(judged({**named, **means, **errors}))
    return found


def _table(found: list[dict]) -> str:
    rows = [
        [
            row["parameter"],
            "H" if row["observable"] == "depression_depth_mm" else "F",
            f"{row['reference']:.3g} ± {row['reference_se']:.2g}",
            f"{row['estimate']:.3g} ± {row['estimate_se']:.2g}",
            f"{100 * row['relative_error']:+.0f} %" if row["judged"] else "",
            _word(row),
            *_over_the_steps_of(row),
        ]
        for row in sorted(found, key=lambda row: not row["judged"])
    ]
    header = ["parameter", "of", "reference", "estimate", "differs by", "verdict"]
    further = ["over the steps", "this differs by"] if "chord" in found[0] else []
    return reporting.table([*header, *further], rows)


def _over_the_steps_of(row: dict) -> list[str]:
    """The library's own regression, and by how much it differs; empty of other strategies."""
    if "chord" not in row:
        return []
    off = row["chord"] / row["reference"] - 1
    if not np.isfinite(row["chord"]):
        return ["beyond its runs", ""]
    return [f"{row['chord']:.3g}", f"{100 * off:+.0f} %" if row["judged"] else ""]


def _word(row: dict) -> str:
    if not row["judged"]:
        return "not judged"
    return "passed" if row["passed"] else "FAILED"


# ---------------------------------------------------------------- other soils


def other_soils(count: int) -> list[dict[str, float]]:
    """Parameters by name, SI, of soils of the bundled lab file's prior that its library reaches."""
    question = question_of(load_lab(bundled_lab()), PRESETS["standard"])
    drawn = np.random.default_rng(FIRST_OF_OTHERS)
    logs = question.prior.rvs((count, len(question.space.names)), drawn)
    return [dict(zip(question.space.names, np.exp(row).tolist(), strict=True)) for row in logs]


def _with_chords(rows: list[dict], chords: list[list[float]]) -> list[dict]:
    """Rows of the library with its regressions (m, p)."""
    places = np.ndindex(np.shape(chords))
    return [{**row, "chord": chords[m][p]} for (m, p), row in zip(places, rows, strict=True)]


def rows_of_other(values: dict[str, float], seeds: range, spheres: int, folder: Path) -> list[dict]:
    """The audit's rows of one soil that can be judged, with the library's regression."""
    base = with_values(base_soil(load_lab(bundled_lab())), values)
    found, chords = audited(spheres, seeds, folder, [RESPONSE], base)
    return [row for row in _with_chords(found.rows(RESPONSE), chords) if row["judged"]]


def markdown_of_others(soils: list[dict], spheres: int, packings: int, origin: dict) -> str:
    """A row for each slope, and how many are near."""
    header = ("soil", "parameter", "of", "reference", "library, at the point",
              "library, over the steps", "differs by", "in errors")  # fmt: skip
    rows = [_row_of_other(n, row) for n, soil in enumerate(soils, 1) for row in soil["rows"]]
    described = [
        f"{n}. " + ", ".join(f"{name} {value:.3g}" for name, value in soil["values"].items())
        for n, soil in enumerate(soils, 1)
    ]
    return (
        f"# Other soils\n\nSlopes of the library of runs at soils of the prior, {spheres} spheres, "
        f"{packings} packings each, per unit of ln p (H in mm, F in N). The last columns compare "
        "its regression over the steps of the reference with the reference; errors are those of "
        "both together.\n\n"
        + reporting.table(header, rows)
        + "\nSoils (SI):\n\n" + "\n".join(described) + "\n\n" + _near(soils)
        + reporting.footer(origin)
    )  # fmt: skip


def _row_of_other(soil: int, row: dict) -> list[str]:
    off, errors = _apart(row)
    return [
        str(soil), row["parameter"], "H" if row["observable"] == "depression_depth_mm" else "F",
        f"{row['reference']:.3g} ± {row['reference_se']:.2g}",
        f"{row['estimate']:.3g} ± {row['estimate_se']:.2g}",
        f"{row['chord']:.3g}" if np.isfinite(row["chord"]) else "beyond its runs",
        f"{100 * off:+.0f} %", f"{errors:+.1f}",
    ]  # fmt: skip


def _apart(row: dict) -> tuple[float, float]:
    """By which share, and by how many errors, the library's regression is off; its slope where the
    steps leave the library's runs."""
    theirs = row["chord"] if np.isfinite(row["chord"]) else row["estimate"]
    apart = theirs - row["reference"]
    return apart / abs(row["reference"]), apart / np.hypot(row["reference_se"], row["estimate_se"])


def _near(soils: list[dict]) -> str:
    """How many slopes of each number are near enough, and agree within errors."""
    said = []
    for observable, share in NEAR.items():
        rows = [r for soil in soils for r in soil["rows"] if r["observable"] == observable]
        off, errors = np.array([_apart(row) for row in rows]).reshape(-1, 2).T
        if len(rows):
            said.append(
                f"- {observable}: {share_of(np.abs(off) < share)} of {len(rows)} slopes within "
                f"{100 * share:.0f} %, {share_of(np.abs(errors) < ERRORS)} within {ERRORS:g} errors"
            )
    return "\n".join(said) + "\n"


def audit_others(chosen: argparse.Namespace) -> None:
    """Writes the section of other soils, after each of them."""
    soils = []
    for number, values in enumerate(other_soils(chosen.others)):
        first = 100 * (FIRST_OF_OTHERS + number)
        seeds = range(first, first + chosen.packings)
        rows = rows_of_other(values, seeds, chosen.spheres, chosen.folder)
        soils.append({"values": values, "rows": rows})
        origin = reporting.provenance()
        text = markdown_of_others(soils, chosen.spheres, chosen.packings, origin)
        reporting.write_section("audit", text)


# ---------------------------------------------------------------- more spheres


def audit_finer(chosen: argparse.Namespace) -> None:
    """Writes a section for each seed: the bundled soil with another number of spheres."""
    for seed in chosen.seeds:
        seeds = range(100 * seed, 100 * seed + chosen.packings)
        found, chords = audited(chosen.finer, seeds, chosen.folder, [RESPONSE])
        origin, rows = reporting.provenance(), pooled([_with_chords(found.rows(RESPONSE), chords)])
        text = (
            f"# {chosen.finer} spheres, seed {seed}\n\nBundled soil, {chosen.packings} packings: "
            f"slopes of the library of runs, {tally(rows)} (within 15 % for H and 25 % for F).\n\n"
            + _table(rows)
            + reporting.footer(origin)
        )
        reporting.write_section("audit", text)


# ---------------------------------------------------------------- half the steps


def audit_halved(chosen: argparse.Namespace) -> None:
    """Writes the section of parameters whose reference is taken again over half the steps."""
    lab = load_lab(bundled_lab())
    preset = replace(PRESETS["standard"], spheres=chosen.spheres)
    work = Campaign(virtual_lab(lab, preset), specimen(lab, preset), chosen.folder, for_terminal())
    seeds = [100 * seed + n for seed in chosen.seeds for n in range(chosen.packings)]
    rows = [
        [
            name,
            f"{100 * step:g} %",
            f"{slopes.mean():.3g} ± {slopes.std(ddof=1) / len(seeds) ** 0.5:.2g}",
        ]
        for name in chosen.halved
        for step in (STEP, STEP / 2)
        for slopes in [_slopes_of_force(work, base_soil(lab), name, step, seeds)]
    ]
    origin = reporting.provenance()
    text = (
        f"# Half the steps\n\nBundled soil, {chosen.spheres} spheres, {len(seeds)} packings: "
        "slopes of the crushing force (N) per unit of ln p, between runs at both ends of the "
        "steps.\n\n"
        + reporting.table(("parameter", "steps", "slope of F"), rows)
        + reporting.footer(origin)
    )
    reporting.write_section("audit", text)


def _slopes_of_force(
    work: Campaign, base: SoilParameters, name: str, step: float, seeds: list[int]
) -> np.ndarray:
    """Of each packing (n,): [F(p e^h) - F(p e^-h)]/(2 h)."""
    value = float(getattr(base, name))
    ends = [with_values(base, {name: value * float(np.exp(sign * step))}) for sign in (1, -1)]
    what = f"{name}, steps of {100 * step:g} %"
    high, low = (
        np.array([run.observables["crushing_force_n"] for run in row])
        for row in work.runs(ends, seeds, what)
    )
    return (high - low) / (2 * step)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--spheres", type=int, default=1000)
    parser.add_argument("--packings", type=int, default=4, help="packings a seed")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--folder", type=Path, default=reporting.CACHE, help="cache of runs")
    parser.add_argument("--halved", nargs="+", default=[], choices=[*FACTORS, "shear_modulus"])
    parser.add_argument("--others", type=int, default=0, help="soils of the prior, and no other")
    parser.add_argument("--finer", type=int, default=0, help="spheres, for the library alone")
    chosen = parser.parse_args()
    reporting.configure()
    if chosen.finer:
        return audit_finer(chosen)
    if chosen.others:
        return audit_others(chosen)
    if chosen.halved:
        return audit_halved(chosen)
    audits: dict[str, dict] = {}
    for seed in chosen.seeds:
        seeds = range(100 * seed, 100 * seed + chosen.packings)
        found, chords = audited(chosen.spheres, seeds, chosen.folder, list(STRATEGIES))
        whole = audit_json(found)
        library = whole["strategies"][RESPONSE]
        library["rows"] = _with_chords(library["rows"], chords)
        audits[str(seed)] = {name: part for name, part in whole.items() if name != "curves"}
        if seed == chosen.seeds[0]:
            drawn = record(AuditSlopes, whole)
            save(audit_figure(drawn), reporting.IMAGES / "audit.png")
        origin = reporting.provenance()
        text = markdown(audits, chosen.spheres, chosen.packings, origin)
        content = {**origin, "spheres": chosen.spheres, "audits": audits}
        reporting.write_content("audit", content)
        reporting.write_section("audit", text)


if __name__ == "__main__":
    main()
