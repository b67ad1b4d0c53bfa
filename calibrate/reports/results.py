"""What `simulate`, `fit`, `audit` and `contact` leave in their folder and say on the terminal."""

import csv
import io
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from calibrate import figures
from calibrate.core.files import make_folder, write_json, write_text
from calibrate.inference.audit import Audit, audit_json
from calibrate.inference.calibration import Calibrated, fit_json
from calibrate.inference.parameters import RANGES
from calibrate.io.lab import Lab
from calibrate.io.labfile import PARAMETER_UNITS
from calibrate.labtests.composite import label
from calibrate.records.audit import AuditRecord
from calibrate.records.base import Measured, record
from calibrate.records.fit import FitRecord
from calibrate.simulation.run import Run
from calibrate.simulation.session import Session, origin_of
from calibrate.simulation.specimens import (
    check_some_sound,
    coarse,
    doubts,
    measured_json,
)


def write_simulation(session: Session, result: dict, runs: list[Run], path: Path | None) -> None:
    """result.json (and `--json`), a figure, and a table on the terminal."""
    _write_result(session.out, {**origin_of(session), **result}, path)
    measured = record(Measured, measured_json(session.lab))
    figures.simulation_figure(runs, measured, session.out / "curves.png")
    console = Console()
    if len(result["failures"]) < len(runs):
        console.print(_observables_table(session.lab, {"simulated": result}))
    _warn_of_observables(console, result)
    for failure in result["failures"]:
        console.print(f"failed: {failure}", markup=False)
    console.print(f"{_course(result)}; curves and figure in {session.out}", highlight=False)
    _warn_if_coarse(console, result)


def write_fit(session: Session, done: Calibrated, path: Path | None) -> None:
    """result.json (and `--json`), history.csv, a figure, and what was found on the terminal."""
    result = {**origin_of(session), "spheres": session.preset.spheres, **fit_json(done)}
    result["observable_warnings"] = doubts(session.lab, done.fresh_runs)
    _write_result(session.out, result, path)
    _write_history(session.out / "history.csv", result["history"])
    found = record(FitRecord, result)
    figures.fit_figure(found, session.out / "fit.png")
    console = Console()
    groups = {
        **{f"set '{name}'": group for name, group in result["named_sets"].items()},
        "fitted packings": result,
        "fresh packings": result["fresh_packings"],
    }
    console.print(_observables_table(session.lab, groups))
    console.print(_parameters_table(done))
    for line in _verification(done, result):
        console.print(line, markup=False, highlight=False)
    for line in _conclusions(done, found):
        console.print(line, markup=False, highlight=False)
    _warn_of_observables(console, result)
    console.print(f"result.json, history.csv and fit.png are in {session.out}", highlight=False)
    check_some_sound(done.fresh_runs, "fresh packings")


def write_audit(session: Session, found: Audit, settings: dict, path: Path | None) -> None:
    """audit.json (and `--json`), two figures, and a table on the terminal."""
    result = {**origin_of(session), **settings, **audit_json(found)}
    write_json(session.out / "audit.json", result)
    if path is not None:
        write_json(path, result)
    drawn = record(AuditRecord, result)
    figures.audit_figure(drawn, session.out / "audit.png")
    figures.curve_slopes_figure(drawn, session.out / "audit_curves.png")
    console = Console()
    for name in found.estimates:
        console.print(_audit_table(found, name))
        console.print(f"{name}: {_judgement(found.rows(name))}", highlight=False)
        for sentence in _refusals(found, name):
            console.print(f"{name}: {sentence}", highlight=False)
    console.print(
        f"audit.json, audit.png and audit_curves.png are in {session.out}", highlight=False
    )


def _audit_table(found: Audit, strategy: str) -> Table:
    table = Table(title=f"{strategy}, {found.packings} packings", title_justify="left")
    for column in ("parameter", "observable", "estimate per ln p", "reference per ln p", "verdict"):
        table.add_column(column)
    for row in found.rows(strategy):
        cells = [f"{row[key]:.3g} ± {row[key + '_se']:.2g}" for key in ("estimate", "reference")]
        table.add_row(row["parameter"], row["observable"], *cells, _word(row))
    return table


def _word(row: dict) -> str:
    if not np.isfinite(row["estimate"]):
        return "no derivative"
    if not row["judged"]:
        return "too small to judge"
    return "passed" if row["passed"] else "FAILED"


def _judgement(rows: list[dict]) -> str:
    judged = [row for row in rows if row["judged"]]
    passed = sum(bool(row["passed"]) for row in judged)
    return f"{passed} of {len(judged)} slopes that can be judged pass"


def _refusals(found: Audit, strategy: str) -> list[str]:
    """Which tests have slopes that their strategy does not believe, on how many packings, and why
    on the first of them."""
    sentences, certificates = [], found.certificates.get(strategy, [])
    for test, reading in enumerate(found.points.readings):
        why = [reason for each in certificates for reason in each.refused[test] if reason]
        packings = sum(any(each.refused[test]) for each in certificates)
        if why:
            share = f"{packings} of {len(certificates)} packings"
            sentences.append(f"no derivative of {reading.test} on {share}: {why[0]}")
    return sentences


def write_contact(result: dict, out: Path, path: Path | None) -> None:
    """contact.json (and `--json`) and a figure."""
    make_folder(out)
    write_json(out / "contact.json", result)
    if path is not None:
        write_json(path, result)
    overlap, force = np.array(result["overlap_m"]), np.array(result["normal_force_n"])
    figures.contact_figure(overlap, force, out / "contact.png")
    print(f"largest force {force.max():.4g} N, largest tension {-force.min():.4g} N; in {out}")


def _write_result(out: Path, result: dict, path: Path | None) -> None:
    write_json(out / "result.json", result)
    if path is not None:
        write_json(path, result)


def _write_history(path: Path, history: list[dict]) -> None:
    rows = [
        {k: v for k, v in row.items() if k not in ("parameters", "features")}
        | row["parameters"]
        | row["features"]
        for row in history
    ]
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())


def _course(result: dict) -> str:
    """How the runs went: their resolution, how quasi-static and how fast they were."""
    if not result["quality"]["spheres"]:
        return "no test has soil in it"
    speed = result["particle_steps_per_s"] / 1e6
    inertial = result["quality"]["inertial_number"]
    each = f"{speed:.2f} M particle-steps/s per run"
    return f"{_resolution(result)}, inertial number {inertial:.1e}, {each}"


def _resolution(result: dict) -> str:
    """How finely the specimen is resolved."""
    quality = result["quality"]
    return f"{quality['spheres_across']:.1f} spheres across, porosity {quality['porosity']:.2f}"


def _warn_if_coarse(console: Console, result: dict) -> None:
    warning = coarse(result["quality"])
    if warning:
        console.print(f"warning: {warning}", highlight=False)


def _warn_of_observables(console: Console, result: dict) -> None:
    """Numbers that are not what they are called."""
    for name, why in result.get("observable_warnings", {}).items():
        console.print(f"warning: {label(name)}: {why}", markup=False, highlight=False)


def _observables_table(lab: Lab, groups: dict[str, dict]) -> Table:
    table = Table(title=lab.name, title_justify="left")
    names = list(next(iter(groups.values()))["observables"])
    for column in ("", *map(label, names)):
        table.add_column(column)
    measured = [
        f"{lab.targets[n].mean:.4g} ± {lab.targets[n].scatter:.2g}" if n in lab.targets else "-"
        for n in names
    ]
    table.add_row("measured (± one repeat)", *measured)
    for which, group in groups.items():
        cells = [f"{group['observables'][n]:.4g} ± {group['spread'][n]:.2g}" for n in names]
        table.add_row(f"{which} (± one packing)", *cells)
    return table


def _parameters_table(done: Calibrated) -> Table:
    table = Table(title="free parameters", title_justify="left")
    for column in ("", "start", "fitted", "95 % interval", "unit"):
        table.add_column(column)
    found = done.result.identifiability
    start = done.space.start()
    for row, name in enumerate(found.names):
        low, high = found.interval[row]
        cells = [f"{x:.4g}" for x in (start[row], found.values[row])]
        table.add_row(name, *cells, f"{low:.4g} to {high:.4g}", PARAMETER_UNITS[name])
    return table


def _verification(done: Calibrated, result: dict) -> list[str]:
    """How far fresh packings' means are from what was measured, and a publication's own error."""
    fresh, lines = result["fresh_packings"], []
    count = len([run for run in done.fresh_runs if not run.failure])
    for name, target in done.lab.targets.items():
        mean, error = fresh["observables"][name], fresh["spread"][name] / max(count, 1) ** 0.5
        line = (
            f"{label(name)} on {count} fresh packings: {mean:.4g} ± {error:.2g} (standard error), "
            f"{100 * (mean / target.mean - 1):+.1f} % of what was measured"
        )
        if target.published_error is not None:
            line += f"; the publication's own simulation: {100 * target.published_error:.1f} % off"
        lines.append(line)
    return lines


def _conclusions(done: Calibrated, found: FitRecord) -> list[str]:
    """What the data fixed, what they left open, how the fit ended, and what it warns of."""
    held = [name for name in RANGES if name not in done.space.names]
    lines = [
        f"stopped: {done.result.stopped}; {len(done.result.history)} evaluations, "
        f"{done.simulations} simulations in this start",
        "held at their starting values: " + ", ".join(held),
    ]
    for direction in found.identifiability.directions:
        weights = " ".join(f"{w:+.2f} {name}" for name, w in direction.weights.items())
        verdict = {"fixed": "fixed by the data", "left open": "LEFT OPEN by the data"}
        word = verdict.get(direction.verdict, "SEEN BY THE DATA, WHICH THE FIT MISSED")
        lines.append(f"{word} (signal/noise {direction.signal_to_noise:.1f}): {weights}")
    return [*lines, *(f"warning: {sentence}" for sentence in found.all_warnings())]
