"""`calibrate next`: which further test would tell most, and a lab file for its answer."""

from pathlib import Path
from typing import Annotated

import typer

from calibrate.commands.options import (
    DiscrepancyFile,
    FurtherLabs,
    LibraryFile,
    StatisticsSeed,
    answer,
)


def register(app: typer.Typer) -> None:
    """Adds `next` to the program."""
    app.command("next")(next_command)


def next_command(
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
            help="Simulate the leading explanations on N more packings first; 0: none.",
        ),
    ] = 0,
    further: FurtherLabs = None,
    seed: StatisticsSeed = 0,
    out: Annotated[Path, typer.Option("--out", help="Folder for results.")] = Path("results/next"),
    json: Annotated[Path | None, typer.Option("--json", help="Write the result here.")] = None,
) -> None:
    """Say what to measure next: what each test would tell, what it costs, what it would show."""
    from calibrate.verbs.next_test import next_test

    answer(
        json, "next.json and figures", next_test, lab, further=further or (), simulate=simulate,
        library=library, discrepancy=discrepancy, seed=seed, out=out,
    )  # fmt: skip
