"""What the command line reads from its options and writes to files and terminal.

Every file is written whole or not at all.  Options that are wrong raise `InputError`
with the option's name as the field.
"""

import csv
import io
import os
import platform
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from calibrate import plotting, workflow
from calibrate.audit import STRATEGIES, Audit, audit, audit_json
from calibrate.campaign import Campaign, Run, engine_hash
from calibrate.campaign.places import HERE, AbstractPlace
from calibrate.errors import InputError, suggestion
from calibrate.labfile import PARAMETER_UNITS, check_parameter
from calibrate.measurements import Lab, bundled_lab, load_lab
from calibrate.parameters import FACTORS, RANGES, base_soil, space, with_values
from calibrate.presets import PRESETS, Preset
from calibrate.progress import AbstractProgress, for_terminal
from calibrate.records.audit import AuditRecord
from calibrate.records.base import Measured, as_json, record
from calibrate.records.fit import FitRecord
from calibrate.single_contact import Spheres
from calibrate.workflow import Calibrated, fit_json

COMMAND_LINE = "command line"


@dataclass(frozen=True)
class Session:
    """What a verb works with: the lab, the preset, where results go, who hears of progress,
    and where simulations run."""

    lab: Lab
    preset: Preset
    out: Path
    progress: AbstractProgress
    place: AbstractPlace = HERE

    @staticmethod
    def open(lab: Path | None, preset: str, out: Path, dask: str | None = None) -> "Session":
        if preset not in PRESETS:
            known = ", ".join(PRESETS)
            raise InputError(COMMAND_LINE, "--preset", f"no preset '{preset}'", f"give {known}")
        loaded = load_lab(bundled_lab() if lab is None else lab)
        make_folder(out)
        return Session(loaded, PRESETS[preset], out, for_terminal(), place_of(dask))

    def resized(self, spheres: int) -> "Session":
        """The same session with another number of spheres in the preset."""
        return replace(self, preset=replace(self.preset, spheres=spheres))

    def campaign(self, out: Path, preparation: dict[str, float] | None) -> Campaign:
        """Simulations of this session; beds settle with the soil under test if its changed
        parameters are given, with a neutral soil if not."""
        soil = None if preparation is None else with_values(base_soil(self.lab), preparation)
        work = workflow.campaign(self.lab, self.preset, out, self.progress, soil)
        return replace(work, place=self.place)


def place_of(dask: str | None) -> AbstractPlace:
    """The cluster at the address of `--dask`, or the cores of this machine."""
    if dask is None:
        return HERE
    from calibrate.campaign.cluster import DaskCluster  # loads Dask, which takes a second

    return DaskCluster(dask)


def make_folder(out: Path, option: str = "--out") -> None:
    """Creates the folder for results, and says so in one line where that is impossible."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / f".write-{os.getpid()}"
        probe.touch()
        probe.unlink()
    except OSError as error:
        problem = error.strerror or str(error)
        repair = "give a folder that can be written to"
        raise InputError(str(out), option, problem, repair) from None


def check_writable(path: Path | None) -> None:
    """Refuses a `--json` path that cannot be written, before anything is simulated."""
    if path is None:
        return
    if path.is_dir():
        raise InputError(COMMAND_LINE, "--json", f"{path} is a folder", "give the name of a file")
    make_folder(path.parent, "--json")


def parse_changes(changes: Sequence[str]) -> dict[str, float]:
    """`--set name=value` options as numbers in SI units."""
    values = {}
    for change in changes:
        name, equals, value = change.partition("=")
        if not equals:
            raise InputError(COMMAND_LINE, f"--set {change}", "no '='", "write name=value")
        values[name.strip()] = check_parameter(
            name.strip(), value.strip(), COMMAND_LINE, f"--set {name.strip()}"
        )
    return values


def parse_free(free: str | None) -> tuple[str, ...] | None:
    """`--free` as names of parameters that may be fitted."""
    if free is None:
        return None
    names = tuple(name.strip() for name in free.split(",") if name.strip())
    for name in names:
        if name not in RANGES:
            repair = suggestion(name, RANGES) or f"give some of {', '.join(RANGES)}"
            raise InputError(COMMAND_LINE, "--free", f"'{name}' cannot be fitted", repair)
    if not names or len(set(names)) < len(names):
        raise InputError(
            COMMAND_LINE, "--free", "no name, or one name twice", "name each parameter once"
        )
    return names


def parse_strategies(names: Sequence[str]) -> tuple[str, ...]:
    """`--strategy` options as names of sensitivity strategies."""
    for name in names:
        if name not in STRATEGIES:
            repair = suggestion(name, STRATEGIES) or f"give {', '.join(STRATEGIES)}"
            raise InputError(COMMAND_LINE, "--strategy", f"no strategy '{name}'", repair)
    return tuple(dict.fromkeys(names))


def parse_path(path_um: str) -> list[float]:
    """`--path-um` turning points in m."""
    try:
        points = [1e-6 * float(point) for point in path_um.split(",")]
    except ValueError:
        points = [float("nan")]
    if not np.all(np.isfinite(points)):
        raise InputError(
            COMMAND_LINE, "--path-um", f"'{path_um}' is no list of numbers", "write 20,2,32,-28"
        )
    return points


def parse_pair(radius_mm: float, young_mpa: float, poisson: float) -> Spheres:
    """Radius, modulus and Poisson's ratio of `calibrate contact`, checked."""
    for field, value in (("--radius-mm", radius_mm), ("--young-mpa", young_mpa)):
        if not (np.isfinite(value) and value > 0):
            raise InputError(COMMAND_LINE, field, f"{value:g} is not positive", "give e.g. 2.5")
    if not -1 < poisson < 0.5:
        raise InputError(COMMAND_LINE, "--poisson", f"{poisson:g} is out of range", "give e.g. 0.3")
    return Spheres(radius_mm * 1e-3, young_mpa * 1e6, poisson)


def write_text(path: Path, text: str) -> None:
    """Writes a file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + f".{os.getpid()}.part")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def write_json(path: Path, content: dict) -> None:
    """Strict JSON: NaN and infinities become null."""
    write_text(path, as_json(content))


def write_simulation(session: Session, result: dict, runs: list[Run], path: Path | None) -> None:
    """result.json (and `--json`), a figure, and a table on the terminal."""
    _write_result(session.out, {**origin_of(session), **result}, path)
    measured = record(Measured, workflow.measured_json(session.lab))
    plotting.simulation_figure(runs, measured, session.out / "curves.png")
    console = Console()
    console.print(_observables_table(session.lab, {"simulated": result}))
    for failure in result["failures"]:
        console.print(f"failed: {failure}", markup=False)
    speed = result["particle_steps_per_s"] / 1e6
    inertial = result["quality"]["inertial_number"]
    console.print(
        f"inertial number {inertial:.1e}, {speed:.2f} M particle-steps/s per run; "
        f"curves and figure in {session.out}",
        highlight=False,
    )


def write_fit(session: Session, done: Calibrated, path: Path | None) -> None:
    """result.json (and `--json`), history.csv, a figure, and what was found on the terminal."""
    result = {**origin_of(session), "spheres": session.preset.spheres, **fit_json(done)}
    _write_result(session.out, result, path)
    _write_history(session.out / "history.csv", result["history"])
    plotting.fit_figure(record(FitRecord, result), session.out / "fit.png")
    console = Console()
    groups = {
        **{f"set '{name}'": group for name, group in result["named_sets"].items()},
        "fitted packings": result,
        "fresh packings": result["fresh_packings"],
    }
    console.print(_observables_table(session.lab, groups))
    console.print(_parameters_table(done))
    for line in _conclusions(done, result):
        console.print(line, markup=False, highlight=False)
    console.print(f"result.json, history.csv and fit.png are in {session.out}", highlight=False)


def run_audit(
    session: Session,
    strategies: tuple[str, ...],
    changes: dict[str, float],
    packings: int,
    seed: int,
    path: Path | None,
) -> None:
    """audit.json (and `--json`), two figures, and a table on the terminal."""
    base = with_values(base_soil(session.lab), changes)
    audited = space(session.lab, (*FACTORS, "shear_modulus"), base)
    seeds = range(100 * seed, 100 * seed + packings)
    work = session.campaign(session.out, None)
    found = audit(audited, work, seeds, strategies)
    settings = {
        "spheres": session.preset.spheres,
        "seeds": list(seeds),
        "parameters": workflow.soil_json(base),
    }
    result = {**origin_of(session), **settings, **audit_json(found)}
    write_json(session.out / "audit.json", result)
    if path is not None:
        write_json(path, result)
    drawn = record(AuditRecord, result)
    plotting.audit_figure(drawn, session.out / "audit.png")
    plotting.curve_slopes_figure(drawn, session.out / "audit_curves.png")
    console = Console()
    for name in strategies:
        console.print(_audit_table(found, name))
        console.print(f"{name}: {_judgement(found.rows(name))}", highlight=False)
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
    if not row["judged"]:
        return "too small to judge"
    return "passed" if row["passed"] else "FAILED"


def _judgement(rows: list[dict]) -> str:
    judged = [row for row in rows if row["judged"]]
    passed = sum(bool(row["passed"]) for row in judged)
    return f"{passed} of {len(judged)} slopes that can be judged pass"


def write_contact(result: dict, out: Path, path: Path | None) -> None:
    """contact.json (and `--json`) and a figure."""
    make_folder(out)
    write_json(out / "contact.json", result)
    if path is not None:
        write_json(path, result)
    overlap, force = np.array(result["overlap_m"]), np.array(result["normal_force_n"])
    plotting.contact_figure(overlap, force, out / "contact.png")
    print(f"largest force {force.max():.4g} N, largest tension {-force.min():.4g} N; in {out}")


def _write_result(out: Path, result: dict, path: Path | None) -> None:
    write_json(out / "result.json", result)
    if path is not None:
        write_json(path, result)


def origin_of(session: Session) -> dict:
    """What made a result from a laboratory's data: `made_by`, soil and preset."""
    return {"soil": session.lab.name, "preset": session.preset.name, **made_by()}


def made_by() -> dict:
    """What made a result: command, versions, hash of the simulator's source."""
    packages = ("differentiable-soil", "jax", "equinox", "optimistix", "numpy")
    return {
        "command": shlex.join(["calibrate", *sys.argv[1:]]),
        "versions": {
            "python": platform.python_version(),
            **{name: metadata.version(name) for name in packages},
        },
        "engine": engine_hash(),
    }


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


def _observables_table(lab: Lab, groups: dict[str, dict]) -> Table:
    table = Table(title=lab.name, title_justify="left")
    for column in ("", "depression depth (mm)", "crushing force (N)"):
        table.add_column(column)
    names = ("depression_depth_mm", "crushing_force_n")
    measured = [
        f"{lab.targets[n].mean:.4g} ± {lab.targets[n].scatter:.2g}" if n in lab.targets else "-"
        for n in names
    ]
    table.add_row("measured (± one repeat)", *measured)
    for label, group in groups.items():
        cells = [f"{group['observables'][n]:.4g} ± {group['spread'][n]:.2g}" for n in names]
        table.add_row(f"{label} (± one packing)", *cells)
    return table


def _parameters_table(done: Calibrated) -> Table:
    table = Table(title="free parameters", title_justify="left")
    for column in ("", "start", "fitted", "95 % interval", "unit"):
        table.add_column(column)
    found = done.result.identifiability
    first = done.result.history[0]["parameters"]
    for row, name in enumerate(found.names):
        low, high = found.interval[row]
        cells = [f"{x:.4g}" for x in (first[name], found.values[row])]
        table.add_row(name, *cells, f"{low:.4g} to {high:.4g}", PARAMETER_UNITS[name])
    return table


def _conclusions(done: Calibrated, result: dict) -> list[str]:
    """What the data fixed, what they left open, and how the fit ended."""
    held = [name for name in RANGES if name not in done.space.names]
    lines = [
        f"stopped: {done.result.stopped}; {len(done.result.history)} evaluations, "
        f"{done.simulations} simulations in this start",
        "held at their starting values: " + ", ".join(held),
    ]
    for entry in result["identifiability"]["directions"]:
        weights = " ".join(f"{w:+.2f} {name}" for name, w in entry["weights"].items())
        verdict = "fixed by the data" if entry["fixed_by_data"] else "LEFT OPEN by the data"
        lines.append(f"{verdict} (signal/noise {entry['signal_to_noise']:.1f}): {weights}")
    for name in result["at_bound"]:
        lines.append(f"warning: {name} ended at its bound")
    return lines
