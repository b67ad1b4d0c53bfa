"""`calibrate fit`: the parameters that the data can fix."""

from pathlib import Path
from typing import Annotated

import typer

from calibrate.commands.options import (
    Changes,
    Conventions,
    Dask,
    Json,
    LabFile,
    Out,
    Preparation,
    PresetName,
    Seed,
    answer,
    parse_changes,
)


def register(app: typer.Typer) -> None:
    """Adds `fit` to the program."""
    app.command("fit")(fit_command)


def fit_command(
    lab: LabFile = None,
    free: Annotated[
        str | None, typer.Option("--free", help="Names, comma-separated; default: chosen by data.")
    ] = None,
    changes: Changes = None,
    conventions: Conventions = None,
    preset: PresetName = "quick",
    seed: Seed = 0,
    prepare_with_soil: Preparation = False,
    out: Out = Path("results/fit"),
    dask: Dask = None,
    json: Json = None,
) -> None:
    """Calibrate the parameters that the data can fix; say which those are."""
    from calibrate.verbs.fit import fit

    answer(
        json, "result.json, history.csv and fit.png", fit, lab, free=free,
        values=parse_changes(changes), preset=preset, seed=seed,
        prepare_with_soil=prepare_with_soil, conventions=conventions, out=out, dask=dask,
    )  # fmt: skip
