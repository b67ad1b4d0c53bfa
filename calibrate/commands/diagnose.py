"""`calibrate diagnose`: where a calibrated model misses the curves, which effect it leaves out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from calibrate.discrepancy.library.store import Bank


def register(app: typer.Typer) -> None:
    """Adds `diagnose` to the program."""
    app.command("diagnose")(diagnose_command)


def diagnose_command(
    lab: Annotated[Path, typer.Argument(metavar="LAB.toml", help="Lab file with curves.")],
    bank: Annotated[
        Path | None, typer.Option("--bank", help="Bank of simulations; default: the bundled one.")
    ] = None,
    mismatch: Annotated[
        Path | None, typer.Option("--mismatch", help="What `calibrate mismatch` wrote.")
    ] = None,
    simulate: Annotated[
        int,
        typer.Option(
            "--simulate",
            min=0,
            max=400,
            metavar="N",
            help="Simulate the leading explanations on N more packings; 0: the bank alone.",
        ),
    ] = 0,
    seed: Annotated[
        int, typer.Option("--seed", min=0, max=10_000_000, help="Of simulated statistics.")
    ] = 0,
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
    from calibrate.discrepancy.infill import Nearby, refined
    from calibrate.discrepancy.library.description import Ready
    from calibrate.discrepancy.library.store import bundled_bank, load
    from calibrate.discrepancy.mismatch import load as load_mismatch
    from calibrate.reports import diagnosis as report
    from calibrate.simulation.session import Session, origin_of

    check_writable(json)
    source = bank or bundled_bank()
    session = Session.open(lab, "quick", out)
    simulated = load(source)
    say = for_terminal().say
    say(f"bank of {len(simulated.values)} simulations: preparing its emulator")
    ready = Ready.of(simulated)
    known = None if mismatch is None else load_mismatch(mismatch, ready)
    if simulate:
        how = Nearby(simulate, out / RUNS, for_terminal())
        ready = refined(session.lab, ready, seed, how, known, say)
    found = diagnosed(session.lab, ready, seed, discrepancy=known, say=say)
    settings = {"bank": source.name, **_size(simulated, ready.bank), "seed": seed}
    origin = {**origin_of(session), "preset": NO_PRESET, "settings": settings}
    report.show(report.write(out, found, origin, json), Console())
    print(f"result.json, {report.PAGE} and figures are in {out}")


def _size(bank: "Bank", used: "Bank") -> dict[str, int]:
    """How many simulations the bank holds, and how many were added about this lab."""
    return {
        "simulations": len(bank.values),
        "simulated_about_this_lab": len(used.values) - len(bank.values),
        "packings": len(set(bank.packing.tolist())),
    }


RUNS = "simulated"  # folder of runs about the lab's explanations, in the output folder
NO_PRESET = "none: a bank stands for simulations"
