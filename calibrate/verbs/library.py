"""Simulate soils and effects around one kind of lab; keep their features in one file.

`calibrate diagnose` asks such a library.  A simulation of 500, 1000 and 2500 spheres takes some 2,
6 and 18 seconds of one core of two.  Making a library can be stopped and resumed: what is there
already is not simulated again.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import RenderableType

from calibrate.core.errors import COMMAND_LINE, InputError
from calibrate.core.files import make_folder
from calibrate.core.progress import for_terminal
from calibrate.discrepancy.library import other_law, store
from calibrate.discrepancy.library.design import Design
from calibrate.discrepancy.library.run_library import Rows, RunLibrary, collect
from calibrate.discrepancy.library.simulate import (
    Simulator,
    check_cylinder,
    check_extends,
    lacks_refined,
    lacks_shapes,
    reference_run,
    run_points,
)
from calibrate.io.conventions import check_eepa
from calibrate.io.lab import Lab, lab_of
from calibrate.io.soil import base_soil
from calibrate.simulation.session import place_of
from calibrate.verbs import options
from calibrate.verbs.base import AbstractResult, line, verb

DESIGN = "packings x 6 simulations, and 96 repeats; a larger library goes on from a smaller one"
REFINED = "packings x 5 simulations of the effects that are hardest to predict; 0: none"
CONVENTIONS = (
    "Simulate 480 soils that follow these, into a file beside that of --onto; "
    "only LAB.toml and --onto count then."
)
SHAPED = "packings x 6 simulations of specimens of other heights and largest stresses; 0: none"


@dataclass(frozen=True, eq=False, repr=False)
class LibraryResult(AbstractResult):
    """A library of runs.

    Attributes:
        path: its file, for `diagnose` and `next_test`.
        folder: where it is.
        content: the file, how many runs it holds, and the conventions that they follow.
    """

    path: Path
    folder: Path
    content: dict

    def words(self) -> Iterator[RenderableType]:
        count, followed = self.content["runs"], self.content["conventions"]
        if followed is None:
            yield line(f"library of {count} runs in {self.path}")
        else:
            yield line(f"{count} runs that follow '{followed}' in {self.path}")


@verb
def make_library(
    lab: options.LabFile = None,
    *,
    out: Annotated[
        str | Path, typer.Option("--out", help="The library's file."), options.Typed(Path)
    ] = "library.nc",
    packings: Annotated[int, typer.Option("--packings", min=16, max=500, help=DESIGN)] = 160,
    onto: Annotated[
        str | Path | None,
        typer.Option("--onto", help="A smaller library: simulate only what it lacks, join both."),
        options.Typed(Path | None),
    ] = None,
    shaped: Annotated[int, typer.Option("--shaped", min=0, max=300, help=SHAPED)] = 48,
    refined: Annotated[int, typer.Option("--refined", min=0, max=300, help=REFINED)] = 80,
    spheres: Annotated[
        int, typer.Option("--spheres", min=60, help="Spheres of the middle of three sizes.")
    ] = 1000,
    centred: Annotated[
        bool, typer.Option("--centred/--bundled-centre", help="Centre on the lab's own soil.")
    ] = False,
    conventions: Annotated[
        str | None, typer.Option("--conventions", metavar="NAME", help=CONVENTIONS)
    ] = None,
    batch: options.Batch = None,
) -> LibraryResult:
    """Simulates soils and effects around one kind of lab, and keeps their features in one file.

    Args:
        lab: a lab file's path, or what `load_lab` returned; None: the bundled soil.
        out: the library's file.
        packings: of the design, with 6 simulations each; at least 16, as the emulator is judged on
            blocks of 8 that it has not seen.
        onto: file of a smaller library, to which only what it lacks is added; None: a new one.
        shaped: packings of specimens of other heights and largest stresses.
        refined: packings on which the effects that are hardest to predict are simulated.
        spheres: number of spheres of the middle of three sizes.
        centred: on the lab's own soil; False: on the bundled one.
        conventions: rows that follow these go beside the library `onto`; only `lab` counts then.
        batch: specimens to simulate at once on an accelerator; None: on processor cores.

    Returns:
        The path of the file and the number of runs.

    Raises:
        InputError: the lab has other tests than a library, or an argument is wrong.
    """
    measured = lab_of(lab)
    measured.pair()  # refuses other tests than those of a library
    check_eepa(measured.particles.conventions, measured.file)
    larger = None if onto is None else Path(onto)
    if conventions is not None:
        return _beside(larger, conventions, measured, batch)
    path = Path(out)
    make_folder(path.parent)
    smaller = None if larger is None else store.load(larger)
    design = Design(packings=packings, spheres=spheres, shaped=shaped, refined=refined)
    if centred:
        soil = base_soil(measured)
        centre = {name: float(getattr(soil, name)) for name in design.soil_names}
        design = replace(design, centre=centre)
    simulator = Simulator(measured, path.parent / f"{path.stem}_runs", place=place_of(batch=batch))
    library = _simulated(design, simulator, smaller, str(onto))
    for_terminal().say(f"{len(library.rows.values)} simulations have all features; fitting")
    store.save(library.fitted(), path)
    content = {"library": str(path), "runs": len(library.rows.values), "conventions": None}
    return LibraryResult(path, path.parent, content)


def _simulated(
    design: Design, simulator: Simulator, smaller: RunLibrary | None, name: str
) -> RunLibrary:
    """The design's runs; those of a smaller library, of the file `name`, are taken over."""
    progress = for_terminal()
    if smaller is None:
        plain = replace(design, shaped=0, refined=0)
        runs = run_points(plain, plain.rows(), simulator, progress)
        library = collect(plain, simulator.lab, runs, reference_run(plain, simulator))
    else:
        check_extends(design, simulator.lab, smaller, name)
        points = design.rows(smaller.design.packings)
        runs = run_points(design, points, simulator, progress)
        library = smaller.grown(design, runs) if runs else smaller
    if lacks_shapes(design, library):
        runs = run_points(design, design.shaped_rows(), simulator, progress)
        library = library.with_shapes(design, runs)
    if lacks_refined(design, library):
        points = design.refined_rows(library.design.refined)
        library = library.refined(design, run_points(design, points, simulator, progress))
    if library.repeats is None:
        points = design.repeats()
        runs = run_points(design, points, simulator, progress)
        library = replace(library, repeats=Rows.of(library.cylinder, points, runs))
    return library


def _beside(onto: Path | None, conventions: str, lab: Lab, batch: int | None) -> LibraryResult:
    """Rows that follow other conventions, into a file beside a library's."""
    if onto is None:
        problem = "there is no library to lay them beside"
        raise InputError(COMMAND_LINE, "--conventions", problem, "give its file with --onto")
    other_law.check(conventions, COMMAND_LINE, "--conventions")
    library = store.load(onto)
    check_cylinder(library, lab, str(onto))
    path, progress, place = store.of_law(onto, conventions), for_terminal(), place_of(batch=batch)
    runs = path.parent / f"{path.stem}_runs"
    rows = other_law.simulate(conventions, library.design, lab, runs, progress, place)
    progress.say(f"{len(rows.values)} simulations have all features; fitting")
    store.save_law(other_law.fitted(rows, library), library, path)
    content = {"library": str(path), "runs": len(rows.values), "conventions": conventions}
    return LibraryResult(path, path.parent, content)
