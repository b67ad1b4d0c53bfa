"""`calibrate diagnose`: where a calibrated model misses the curves, which effect it leaves out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calibrate.commands.options import (
    Batch,
    DiscrepancyFile,
    FurtherLabs,
    LibraryFile,
    StatisticsSeed,
)

if TYPE_CHECKING:
    from calibrate.discrepancy.library.run_library import RunLibrary


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
    from rich.console import Console

    from calibrate.core.files import check_writable
    from calibrate.core.progress import for_terminal
    from calibrate.discrepancy.diagnosis import diagnosed
    from calibrate.discrepancy.infill import InfillPlan, with_infill_runs
    from calibrate.discrepancy.library.description import EmulatedLibrary
    from calibrate.discrepancy.library.store import bundled_library, load
    from calibrate.discrepancy.model_discrepancy import load as load_discrepancy
    from calibrate.io.lab import load_lab
    from calibrate.reports import diagnosis as report
    from calibrate.simulation.session import Session, origin_of

    check_writable(json)
    source = library or bundled_library()
    session = Session.open(lab, "quick", out, batch=batch)
    session.lab.pair()  # refuses other tests than those of a library
    simulated = load(source)
    say = for_terminal().say
    say(f"library of {len(simulated.values)} runs: preparing its emulator")
    emulated = EmulatedLibrary.of(simulated)
    estimated = None if discrepancy is None else load_discrepancy(discrepancy, emulated)
    if simulate:
        plan = InfillPlan(simulate, out / RUNS, for_terminal(), session.place)
        emulated = with_infill_runs(session.lab, emulated, seed, plan, estimated, say)
    labs = [load_lab(path) for path in further or []]
    found = diagnosed(session.lab, emulated, seed, discrepancy=estimated, say=say, further=labs)
    settings = library_used(source.name, simulated, emulated.library, seed)
    origin = {**origin_of(session), "preset": NO_PRESET, "settings": settings}
    report.show(report.write(out, found, origin, json), Console())
    print(f"result.json, {report.PAGE} and figures are in {out}")


def library_used(
    name: str, library: "RunLibrary", used: "RunLibrary", seed: int
) -> dict[str, str | int]:
    """Which library answers, how many simulations it holds, and how many infill runs were added for
    this lab."""
    return {
        "library": name,
        "seed": seed,
        "simulations": len(library.values),
        "simulated_about_this_lab": len(used.values) - len(library.values),
        "packings": len(set(library.packing.tolist())),
    }


RUNS = "simulated"  # folder of runs about the lab's explanations, in the output folder
NO_PRESET = "none: a library of runs stands for simulations"
