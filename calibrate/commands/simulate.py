"""`calibrate simulate`: a lab's virtual tests on several packings."""

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
    """Adds `simulate` to the program."""
    app.command("simulate")(simulate_command)


def simulate_command(
    lab: LabFile = None,
    changes: Changes = None,
    conventions: Conventions = None,
    preset: PresetName = "quick",
    seed: Seed = 0,
    prepare_with_soil: Preparation = False,
    single: Annotated[
        bool, typer.Option("--single/--double", help="Numbers in single precision: faster.")
    ] = False,
    out: Out = Path("results/simulate"),
    dask: Dask = None,
    json: Json = None,
) -> None:
    """Run the lab's virtual tests on several packings: curves, observables, scatter."""
    from calibrate.verbs.simulate import simulate

    answer(
        json, "result.json and curves.png", simulate, lab, values=parse_changes(changes),
        preset=preset, seed=seed, single=single, prepare_with_soil=prepare_with_soil,
        conventions=conventions, out=out, dask=dask,
    )  # fmt: skip
