"""The audit of the derivatives that fits use, on two sets of packings.

    python -m verification.audit --seeds 21 22         some 15 minutes on two cores

The bundled soil, grown beds at the preset standard's rates: reference slopes by regression over
+-20 %, one parameter at a time, against those of the library and of pairs of runs, on the same
packings; then all of it again on others.
Runs are kept in results/benchmarks; a second call resumes.  Writes after
every seed notebooks/data/audit.json, verification/results/audit.md and docs/images/audit*.png.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibrate.core.progress import for_terminal
from calibrate.discrepancy.library.stand_in import served
from calibrate.figures import save
from calibrate.figures.audit import audit_figure, curve_slopes_figure
from calibrate.inference.audit import Audit, audit, audit_json, judged
from calibrate.inference.parameters import FACTORS, space
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.io.soil import base_soil
from calibrate.records.audit import AuditSlopes
from calibrate.records.base import record
from calibrate.simulation import Campaign
from calibrate.simulation.resolution import PRESETS, specimen, virtual_lab
from verification import reporting

STRATEGIES = {
    "response": "Of the library of runs, by JAX",
    "fit": "By pairs of runs, as fits take them where the library does not serve",
    "ensemble": "All parameters in groups",
}


def audited(spheres: int, seeds: range, folder: Path) -> Audit:
    lab = load_lab(bundled_lab())
    preset = replace(PRESETS["standard"], spheres=spheres)
    work = Campaign(virtual_lab(lab, preset), specimen(lab, preset), folder, for_terminal())
    base = base_soil(lab)
    library, why = served(lab, preset, None, base, work)
    assert library is not None, why
    audited = space(lab, (*FACTORS, "shear_modulus"), base)
    return audit(audited, work, seeds, list(STRATEGIES), library)


def markdown(audits: dict[str, dict], spheres: int, packings: int, origin: dict) -> str:
    begin = (
        f"# Audit of derivatives\n\nBundled soil, {spheres} spheres, {packings} "
        "packings a seed. Slopes per unit of ln p with standard errors. Passed: the reference's "
        "sign, within 15 % (H, mm) or 25 % (F, N) of it; slopes below three standard errors are "
        "not judged. What fits move alone is moved as in the reference, so it agrees.\n\n"
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
        named = {key: rows[0][key] for key in ("parameter", "observable")}
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
        ]
        for row in sorted(found, key=lambda row: not row["judged"])
    ]
    header = ("parameter", "of", "reference", "estimate", "differs by", "verdict")
    return reporting.table(header, rows)


def _word(row: dict) -> str:
    if not row["judged"]:
        return "not judged"
    return "passed" if row["passed"] else "FAILED"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--spheres", type=int, default=1000)
    parser.add_argument("--packings", type=int, default=4, help="packings a seed")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--folder", type=Path, default=reporting.CACHE, help="cache of runs")
    chosen = parser.parse_args()
    reporting.configure()
    audits: dict[str, dict] = {}
    for seed in chosen.seeds:
        seeds = range(100 * seed, 100 * seed + chosen.packings)
        found = audited(chosen.spheres, seeds, chosen.folder)
        audits[str(seed)] = audit_json(found)
        if seed == chosen.seeds[0]:
            drawn = record(AuditSlopes, audits[str(seed)])
            save(audit_figure(drawn), reporting.IMAGES / "audit.png")
            slopes = curve_slopes_figure(drawn)
            save(slopes, reporting.IMAGES / "audit_curves.png")
        origin = reporting.provenance()
        text = markdown(audits, chosen.spheres, chosen.packings, origin)
        reporting.write("audit", {**origin, "spheres": chosen.spheres, "audits": audits}, text)


if __name__ == "__main__":
    main()
