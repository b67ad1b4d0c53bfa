"""`calibrate diagnose`: where a calibrated model misses the curves, which effect it leaves out."""

from pathlib import Path
from typing import Annotated

import typer


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

    from calibrate import output
    from calibrate.bank.description import Ready
    from calibrate.bank.mismatch import load as load_mismatch
    from calibrate.bank.store import bundled_bank, load
    from calibrate.diagnosed import diagnosed
    from calibrate.progress import for_terminal
    from calibrate.report import diagnosis as report

    output.check_writable(json)
    source = bank or bundled_bank()
    session = output.Session.open(lab, "quick", out)
    simulated = load(source)
    say = for_terminal().say
    say(f"bank of {len(simulated.values)} simulations: preparing its emulator")
    ready = Ready.of(simulated)
    known = None if mismatch is None else load_mismatch(mismatch, ready)
    found = diagnosed(session.lab, ready, seed, discrepancy=known, say=say)
    origin = {
        **output.origin_of(session),
        "preset": NO_PRESET,
        "settings": {
            "bank": source.name,
            "simulations": len(simulated.values),
            "packings": len(set(simulated.packing.tolist())),
            "seed": seed,
        },
    }
    report.show(report.write(out, found, origin, json), Console())
    print(f"result.json, {report.PAGE} and figures are in {out}")


NO_PRESET = "none: a bank stands for simulations"
