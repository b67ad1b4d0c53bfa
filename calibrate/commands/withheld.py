"""`calibrate withheld`: cases with sealed labels, diagnosed, opened and scored."""

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Adds `calibrate withheld`."""
    app.command("withheld")(withheld_command)


def withheld_command(
    given: Annotated[
        Path | None, typer.Option("--given", help="Folder of sealed cases; default: make them.")
    ] = None,
    bank: Annotated[Path | None, typer.Option("--bank", help="The bank's file.")] = None,
    mismatch: Annotated[
        Path | None, typer.Option("--mismatch", help="What `calibrate mismatch` wrote.")
    ] = None,
    share: Annotated[
        float, typer.Option("--share", min=0.01, max=1.0, help="Of the usual 309 cases.")
    ] = 1.0,
    fresh: Annotated[
        bool, typer.Option("--fresh/--no-fresh", help="Check shrinkage on fresh specimens.")
    ] = True,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the diagnoses.")] = 0,
    out: Annotated[
        Path, typer.Option("--out", help="Folder for results; a second run resumes.")
    ] = Path("results/withheld"),
    json: Annotated[Path | None, typer.Option("--json", help="Write the result here.")] = None,
) -> None:
    """Make cases whose effect is withheld, diagnose them, open the seal, score."""
    from rich.console import Console

    from calibrate.core.files import check_writable, make_folder
    from calibrate.core.progress import for_terminal
    from calibrate.discrepancy import mismatch as mismatches
    from calibrate.discrepancy.library import store
    from calibrate.discrepancy.library.description import Ready
    from calibrate.reports import withheld as report
    from calibrate.simulation.origin import made_by
    from calibrate.validation import run
    from calibrate.validation.plan import COUNTS

    check_writable(json)
    make_folder(out)
    progress = for_terminal()
    ready = Ready.of(store.load(bank or store.bundled_bank()))
    discrepancy = None if mismatch is None else mismatches.load(mismatch, ready)
    if given is None:
        counts = {kind: max(round(share * count), 1) for kind, count in COUNTS.items()}
        run.generate(out, ready, counts, None, progress)
    source = out if given is None else given
    run.judge(source, out, ready, seed, progress, discrepancy)
    repeatable = (source / run.PLAN).exists()  # made by this simulator, which can make more
    result, _ = run.opened(source, out, ready, seed, progress, fresh and repeatable, discrepancy)
    result = {**made_by(), "seed": seed, **result}
    report.write(out, result, json)
    report.show(result, Console())
    print(f"withheld.json, withheld.html and figures are in {out}")
