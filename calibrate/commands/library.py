"""`calibrate library`: simulate a library of runs for labs of one kind, for `calibrate diagnose`.

Takes some 2, 6 and 18 seconds of one core of two for each simulation of 500, 1000 and 2500
spheres, and can be stopped and resumed; what is there already is not simulated again.
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from calibrate.io.lab import Lab

from calibrate.commands.options import Batch

DESIGN = "packings x 6 simulations, and 96 repeats; a larger library goes on from a smaller one"
REFINED = "packings x 5 simulations of the effects that are hardest to predict; 0: none"
CONVENTIONS = (
    "Simulate 480 soils that follow these, into a file beside that of --onto; "
    "only LAB.toml and --onto count then."
)
SHAPED = "packings x 6 simulations of specimens of other heights and largest stresses; 0: none"


def register(app: typer.Typer) -> None:
    """Adds `library` to the program."""
    app.command("library")(library_command)


def library_command(
    lab: Annotated[
        Path | None, typer.Argument(metavar="[LAB.toml]", help="Lab file; default: bundled soil.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="The library's file.")] = Path("library.nc"),
    packings: Annotated[int, typer.Option("--packings", min=8, max=500, help=DESIGN)] = 160,
    onto: Annotated[
        Path | None,
        typer.Option("--onto", help="A smaller library: simulate only what it lacks, join both."),
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
    batch: Batch = None,
) -> None:
    """Simulate soils and effects around one kind of lab; keep their features in one file."""
    from calibrate.core.files import make_folder
    from calibrate.core.progress import for_terminal
    from calibrate.discrepancy.library import store
    from calibrate.discrepancy.library.design import Design
    from calibrate.discrepancy.library.run_library import collect, repeats_of
    from calibrate.discrepancy.library.simulate import (
        Simulator,
        check_extends,
        lacks_refined,
        lacks_shapes,
        reference_run,
        run_design,
        run_refined,
        run_repeats,
        run_shaped,
    )
    from calibrate.io.lab import bundled_lab, load_lab
    from calibrate.io.soil import base_soil
    from calibrate.simulation.session import place_of

    measured = load_lab(bundled_lab() if lab is None else lab)
    measured.pair()  # refuses other tests than those of a library
    if conventions is not None:
        return _beside(onto, conventions, measured, batch)
    make_folder(out.parent)
    smaller = None if onto is None else store.load(onto)
    design = Design(packings=packings, spheres=spheres, shaped=shaped, refined=refined)
    if centred:
        soil = base_soil(measured)
        centre = {name: float(getattr(soil, name)) for name in design.soil_names}
        design = replace(design, centre=centre)
    progress = for_terminal()
    folder = out.parent / f"{out.stem}_runs"
    simulator = Simulator(measured, folder, place=place_of(batch=batch))
    if smaller is None:
        plain = replace(design, shaped=0, refined=0)
        runs = run_design(plain, simulator, progress)
        library = collect(plain, measured, runs, reference_run(plain, simulator))
    else:
        check_extends(design, measured, smaller, str(onto))
        runs = run_design(design, simulator, progress, first=smaller.design.packings)
        library = smaller.grown(design, runs) if runs else smaller
    if lacks_shapes(design, library):
        library = library.with_shapes(design, run_shaped(design, simulator, progress))
    if lacks_refined(design, library):
        more = run_refined(design, simulator, progress, library.design.refined)
        library = library.refined(design, more)
    if library.repeats is None:
        repeats = repeats_of(design, measured, run_repeats(design, simulator, progress))
        library = replace(library, repeats=repeats)
    progress.say(f"{len(library.values)} simulations have all features; fitting")
    store.save(library.fitted(), out)
    print(f"library of {len(library.values)} runs in {out}")


def _beside(onto: Path | None, conventions: str, lab: "Lab", batch: int | None) -> None:
    """Rows that follow other conventions, into a file beside a library's."""
    from calibrate.core.errors import COMMAND_LINE, InputError
    from calibrate.core.progress import for_terminal
    from calibrate.discrepancy.library import other_law, store
    from calibrate.discrepancy.library.simulate import check_cylinder
    from calibrate.simulation.session import place_of

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
    print(f"{len(rows.values)} runs that follow '{conventions}' in {path}")
