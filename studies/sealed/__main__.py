"""Sealed validation: cases with sealed labels, diagnosed, opened and scored.

python -m studies.sealed --out results/withheld --make-only    seals cases; hours
python -m studies.sealed --out results/withheld                judges them
"""

import sys
from pathlib import Path
from typing import Annotated

import typer

from calibrate import cli
from calibrate.verbs.command import typed
from calibrate.verbs.options import Batch, DiscrepancyFile, LibraryFile

NAME = "python -m studies.sealed"
app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
@typed
def sealed_command(
    given: Annotated[
        Path | None, typer.Option("--given", help="Folder of sealed cases; default: make them.")
    ] = None,
    library: LibraryFile = None,
    discrepancy: DiscrepancyFile = None,
    share: Annotated[
        float, typer.Option("--share", min=0.01, max=1.0, help="Of the usual 200 or 30 cases.")
    ] = 1.0,
    shapes: Annotated[
        bool,
        typer.Option(
            "--shapes/--usual-shape", help="30 cases of six other sizes and largest stresses."
        ),
    ] = False,
    fresh: Annotated[
        bool, typer.Option("--fresh/--no-fresh", help="Check shrinkage on fresh specimens.")
    ] = True,
    judge: Annotated[
        bool,
        typer.Option("--judge/--make-only", help="Judge now; or make and seal the cases, no more."),
    ] = True,
    batch: Batch = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the diagnoses.")] = 0,
    out: Annotated[
        Path, typer.Option("--out", help="Folder for results; a second run resumes.")
    ] = Path("results/withheld"),
    json: Annotated[Path | None, typer.Option("--json", help="Write the result here.")] = None,
) -> None:
    """Make cases whose effect is withheld, diagnose them, open the seal, score."""
    from rich.console import Console

    from calibrate.core.errors import InputError
    from calibrate.core.files import check_writable, make_folder
    from calibrate.core.progress import for_terminal
    from calibrate.discrepancy.library import store
    from calibrate.discrepancy.library.description import EmulatedLibrary
    from calibrate.discrepancy.model_discrepancy import load as load_discrepancy
    from calibrate.simulation.session import made_by, place_of
    from studies.sealed import report, run
    from studies.sealed.plan import COUNTS, OF_SHAPES, SHAPES, USUAL

    if given is not None and not judge:
        problem = "there is nothing to make where cases are given"
        raise InputError(str(given), "--make-only", problem, "leave out --given or --make-only")
    check_writable(json)
    make_folder(out)
    progress = for_terminal()
    emulated = EmulatedLibrary.of(store.load(Path(library or store.bundled_library())))
    estimated = None if discrepancy is None else load_discrepancy(Path(discrepancy), emulated)
    if given is None:
        usual, sizes = (OF_SHAPES, SHAPES) if shapes else (COUNTS, (USUAL,))
        counts = {kind: max(round(share * count), 1) for kind, count in usual.items()}
        place = place_of(batch=batch)
        run.generate(out, emulated, counts, None, progress, sizes=sizes, place=place)
    if not judge:
        print(f"cases are in {out}, hashes of their labels in labels.sha256; a second run judges")
        return
    source = out if given is None else given
    run.judge(source, out, emulated, seed, progress, estimated)
    repeatable = (source / run.PLAN).exists()  # made by this simulator, which can make more
    result, _ = run.opened(source, out, emulated, seed, progress, fresh and repeatable, estimated)
    result = {**made_by(), "seed": seed, **result}
    report.write(out, result, json)
    report.show(result, Console())
    print(f"withheld.json, withheld.html and figures are in {out}")


if __name__ == "__main__":
    cli.run(app, NAME, sys.argv[1:])
