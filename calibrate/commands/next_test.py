"""`calibrate next`: which further test would tell most, and a lab file for its answer."""

from pathlib import Path
from typing import Annotated

import typer

from calibrate.commands.options import DiscrepancyFile, FurtherLabs, LibraryFile, StatisticsSeed


def register(app: typer.Typer) -> None:
    """Adds `next` to the program."""
    app.command("next")(next_command)


def next_command(
    lab: Annotated[Path, typer.Argument(metavar="LAB.toml", help="Lab file with curves.")],
    library: LibraryFile = None,
    discrepancy: DiscrepancyFile = None,
    further: FurtherLabs = None,
    seed: StatisticsSeed = 0,
    out: Annotated[Path, typer.Option("--out", help="Folder for results.")] = Path("results/next"),
    json: Annotated[Path | None, typer.Option("--json", help="Write the result here.")] = None,
) -> None:
    """Say what to measure next: what each test would tell, what it costs, what it would show."""
    from rich.console import Console

    from calibrate.core.files import check_writable, make_folder
    from calibrate.core.progress import for_terminal
    from calibrate.discrepancy.diagnosis import diagnosed
    from calibrate.discrepancy.library.description import EmulatedLibrary
    from calibrate.discrepancy.library.store import bundled_library, load
    from calibrate.discrepancy.model_discrepancy import load as load_discrepancy
    from calibrate.io.lab import load_lab
    from calibrate.reports import next_test

    check_writable(json)
    measured, others = load_lab(lab), [load_lab(path) for path in further or []]
    measured.pair()  # refuses other tests than those of a library
    make_folder(out)
    say = for_terminal().say
    say("preparing the library's emulator")
    emulated = EmulatedLibrary.of(load(library or bundled_library()))
    estimated = None if discrepancy is None else load_discrepancy(discrepancy, emulated)
    found = diagnosed(measured, emulated, seed, discrepancy=estimated, say=say, further=others)
    next_test.write(out, found, json, Console())
