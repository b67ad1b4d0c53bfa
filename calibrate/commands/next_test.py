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
    from rich.console import Console

    from calibrate.commands.diagnose import NO_PRESET, RUNS, library_used
    from calibrate.core.files import check_writable, make_folder
    from calibrate.core.progress import for_terminal
    from calibrate.discrepancy.diagnosis import diagnosed
    from calibrate.discrepancy.infill import InfillPlan, with_infill_runs
    from calibrate.discrepancy.library.description import EmulatedLibrary
    from calibrate.discrepancy.library.store import bundled_library, load
    from calibrate.discrepancy.model_discrepancy import load as load_discrepancy
    from calibrate.io.lab import load_lab
    from calibrate.reports import next_test
    from calibrate.simulation.session import made_by

    check_writable(json)
    measured, others = load_lab(lab), [load_lab(path) for path in further or []]
    measured.pair()  # refuses other tests than those of a library
    make_folder(out)
    say = for_terminal().say
    say("preparing the library's emulator")
    source = library or bundled_library()
    simulated = load(source)
    emulated = EmulatedLibrary.of(simulated)
    estimated = None if discrepancy is None else load_discrepancy(discrepancy, emulated)
    if simulate:
        plan = InfillPlan(simulate, out / RUNS, for_terminal())
        emulated = with_infill_runs(measured, emulated, seed, plan, estimated, say)
    found = diagnosed(measured, emulated, seed, discrepancy=estimated, say=say, further=others)
    used = library_used(source.name, simulated, emulated.library, seed)
    origin = {"soil": measured.name, "preset": NO_PRESET, **made_by(), "settings": used}
    next_test.write(out, found, origin, json, Console())
