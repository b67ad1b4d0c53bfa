"""`calibrate doe`: calibration by designed experiments, with gradients beside it."""

from pathlib import Path

import typer

from calibrate.commands.options import (
    Batch,
    Changes,
    Dask,
    Json,
    LabFile,
    Out,
    PresetName,
    Seed,
    parse_changes,
)


def register(app: typer.Typer) -> None:
    """Adds `doe` to the program."""
    app.command("doe")(doe_command)


def doe_command(
    lab: LabFile = None,
    changes: Changes = None,
    preset: PresetName = "quick",
    seed: Seed = 0,
    out: Out = Path("results/doe"),
    dask: Dask = None,
    batch: Batch = None,
    json: Json = None,
) -> None:
    """Calibrate by designed experiments, the paper's way, and lay gradients beside them."""
    from rich.console import Console

    from calibrate.core.files import check_writable
    from calibrate.designs.comparison import design
    from calibrate.reports import study as report
    from calibrate.simulation.session import Session

    check_writable(json)
    session = Session.open(lab, preset, out, dask, batch=batch).on_soil()
    values = parse_changes(changes or [], session.lab.particles.conventions)
    work = session.campaign(out, None)
    done = design(session.lab, session.preset, values, seed, work)
    report.write(session, done, json)
    report.show(done, Console())
    print(f"result.json, {report.PAGE} and run sheets are in {out}")
