"""`calibrate audit`: gradients beside the slope of the response."""

from pathlib import Path
from typing import Annotated

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
    """Adds `audit` to the program."""
    app.command("audit")(audit_command)


def audit_command(
    lab: LabFile = None,
    strategy: Annotated[
        list[str] | None,
        typer.Option(
            "--strategy",
            help="fit (what fits use; default), ensemble, regression, pathwise, blend, "
            "overdamped, overdamped_blend, virtual_power, virtual_power_blend; may be given "
            "several times.",
        ),
    ] = None,
    changes: Changes = None,
    spheres: Annotated[int, typer.Option("--spheres", min=30, help="Spheres a packing.")] = 300,
    packings: Annotated[int, typer.Option("--packings", min=2, help="Packings.")] = 8,
    preset: PresetName = "quick",
    seed: Seed = 0,
    out: Out = Path("results/audit"),
    dask: Dask = None,
    batch: Batch = None,
    json: Json = None,
) -> None:
    """Compare gradients with the slope of the response over +-20 %, parameter by parameter."""
    from calibrate.verbs.audit import audit

    answer(
        json, "audit.json, audit.png and audit_curves.png", audit, lab,
        strategies=strategy or ["fit"], values=parse_changes(changes), spheres=spheres,
        packings=packings, preset=preset, seed=seed, out=out, dask=dask, batch=batch,
    )  # fmt: skip
