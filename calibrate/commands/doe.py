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
    answer,
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
    from calibrate.verbs.doe import doe

    answer(
        json, "result.json, study.html and run sheets", doe, lab, values=parse_changes(changes),
        preset=preset, seed=seed, out=out, dask=dask, batch=batch,
    )  # fmt: skip
