"""`calibrate diagnose`: where a calibrated model misses the curves, which effect it leaves out."""

from pathlib import Path
from typing import Annotated

import typer

from calibrate.commands.options import (
    Batch,
    DiscrepancyFile,
    FurtherLabs,
    LibraryFile,
    StatisticsSeed,
    answer,
)


def register(app: typer.Typer) -> None:
    """Adds `diagnose` to the program."""
    app.command("diagnose")(diagnose_command)


def diagnose_command(
    lab: Annotated[Path, typer.Argument(metavar="LAB.toml", help="Lab file with curves.")],
    library: LibraryFile = None,
    discrepancy: DiscrepancyFile = None,
    simulate: Annotated[
        int,
        typer.Option(
            "--simulate",
            min=0,
            max=400,
            metavar="N",
            help="Simulate the leading explanations on N more packings; 0: none.",
        ),
    ] = 0,
    batch: Batch = None,
    further: FurtherLabs = None,
    seed: StatisticsSeed = 0,
    out: Annotated[Path, typer.Option("--out", help="Folder for results.")] = Path(
        "results/diagnose"
    ),
    json: Annotated[Path | None, typer.Option("--json", help="Write the result here.")] = None,
) -> None:
    """Say where model and curves differ, which effect is left out, how far the gap shrinks."""
    from calibrate.verbs.diagnose import diagnose

    answer(
        json, "result.json, diagnosis.html and figures", diagnose, lab, further=further or (),
        simulate=simulate, library=library, discrepancy=discrepancy, seed=seed, out=out,
        batch=batch,
    )  # fmt: skip
