"""Estimate the model discrepancy from reference labs in which no effect is hidden."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.console import RenderableType

from calibrate.core.errors import COMMAND_LINE, InputError
from calibrate.discrepancy import model_discrepancy
from calibrate.discrepancy.library import store
from calibrate.discrepancy.library.description import EmulatedLibrary
from calibrate.io.lab import load_lab
from calibrate.verbs import options
from calibrate.verbs.base import AbstractResult, line, verb


@dataclass(frozen=True, eq=False, repr=False)
class DiscrepancyResult(AbstractResult):
    """The model discrepancy that was estimated.

    Attributes:
        path: the file that was written, for `diagnose` and `next_test`.
        folder: where it is.
        content: the file and the reference labs.
    """

    path: Path
    folder: Path
    content: dict

    def words(self) -> Iterator[RenderableType]:
        count = len(self.content["references"])
        yield line(f"model discrepancy of {count} reference labs in {self.path}")


@verb
def estimate_discrepancy(
    *labs: Annotated[
        str | Path,
        typer.Argument(metavar="LAB.toml...", help="Nothing hidden."),
        options.Typed(list[Path]),
    ],
    library: options.LibraryFile = None,
    out: Annotated[str | Path, typer.Option("--out", help="The file."), options.Typed(Path)] = (
        "discrepancy.json"
    ),
    seed: Annotated[int, typer.Option("--seed", min=0)] = 0,
) -> DiscrepancyResult:
    """Estimates the model discrepancy from reference labs in which no effect is hidden.

    Args:
        labs: lab files with curves of both tests.
        library: file of a library of runs; None: the bundled one.
        out: the file to write.
        seed: of simulated statistics.

    Returns:
        The path of the file.

    Raises:
        InputError: the labs are too few, or have other tests than the library.
    """
    fewest, path = model_discrepancy.FEWEST, Path(out)
    if len(labs) < fewest:
        problem, repair = f"{len(labs)} lab files are too few", f"give {fewest} or more"
        raise InputError(COMMAND_LINE, "LAB.toml", problem, repair)
    references = [load_lab(lab) for lab in labs]
    for reference in references:
        reference.pair()  # refuses other tests than those of a library
    source = store.bundled_library() if library is None else Path(library)
    found = model_discrepancy.estimate(references, EmulatedLibrary.of(store.load(source)), seed)
    model_discrepancy.save(found, path, f"{len(labs)} reference labs")
    content = {"discrepancy": str(path), "references": [str(lab) for lab in labs]}
    return DiscrepancyResult(path, path.parent, content)
