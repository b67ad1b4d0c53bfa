"""`calibrate discrepancy`: the model discrepancy that reference labs without any effect show."""

from pathlib import Path
from typing import Annotated

import typer

from calibrate.commands.options import LibraryFile
from calibrate.core.errors import COMMAND_LINE, InputError


def register(app: typer.Typer) -> None:
    """Adds `discrepancy` to the program."""
    app.command("discrepancy")(discrepancy_command)


def discrepancy_command(
    labs: Annotated[list[Path], typer.Argument(metavar="LAB.toml...", help="Nothing hidden.")],
    library: LibraryFile = None,
    out: Annotated[Path, typer.Option("--out", help="The file.")] = Path("discrepancy.json"),
    seed: Annotated[int, typer.Option("--seed", min=0)] = 0,
) -> None:
    """Estimate the model discrepancy from reference labs in which no effect is hidden."""
    from calibrate.discrepancy import model_discrepancy
    from calibrate.discrepancy.library import store
    from calibrate.discrepancy.library.description import EmulatedLibrary
    from calibrate.io.lab import load_lab

    fewest = model_discrepancy.FEWEST
    if len(labs) < fewest:
        problem, repair = f"{len(labs)} lab files are too few", f"give {fewest} or more"
        raise InputError(COMMAND_LINE, "LAB.toml", problem, repair)
    references = [load_lab(path) for path in labs]
    for reference in references:
        reference.pair()  # refuses other tests than those of a library
    emulated = EmulatedLibrary.of(store.load(library or store.bundled_library()))
    found = model_discrepancy.estimate(references, emulated, seed)
    model_discrepancy.save(found, out, f"{len(labs)} reference labs")
    print(f"model discrepancy of {len(labs)} reference labs in {out}")
