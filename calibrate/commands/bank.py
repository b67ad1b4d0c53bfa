"""`calibrate bank`: simulate a bank for labs of one kind, for `calibrate diagnose`.

Takes some two to three seconds of one core for each simulation of 150 spheres, and can be
stopped and resumed; what is there already is not simulated again.
"""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from calibrate.core.errors import COMMAND_LINE, InputError

DESIGN = "packings x 6 simulations; a larger bank goes on from a smaller one"


def register(app: typer.Typer) -> None:
    """Adds `calibrate bank` and `calibrate mismatch`."""
    app.command("bank")(bank_command)
    app.command("mismatch")(mismatch_command)


def bank_command(
    lab: Annotated[
        Path | None, typer.Argument(metavar="[LAB.toml]", help="Lab file; default: bundled soil.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="The bank's file.")] = Path("bank.nc"),
    packings: Annotated[int, typer.Option("--packings", min=8, help=DESIGN)] = 136,
    onto: Annotated[
        Path | None,
        typer.Option("--onto", help="A smaller bank: simulate only what it lacks, join both."),
    ] = None,
    spheres: Annotated[int, typer.Option("--spheres", min=60, help="Spheres a packing.")] = 150,
    centred: Annotated[
        bool, typer.Option("--centred/--bundled-centre", help="Centre on the lab's own soil.")
    ] = False,
) -> None:
    """Simulate soils and effects around one kind of lab; keep their features in one file."""
    from calibrate.core.files import make_folder
    from calibrate.core.progress import for_terminal
    from calibrate.discrepancy.library import store
    from calibrate.discrepancy.library.design import Design
    from calibrate.discrepancy.library.simulate import Simulator, reference_run, run_design
    from calibrate.io.lab import bundled_lab, load_lab
    from calibrate.io.soil import base_soil

    measured = load_lab(bundled_lab() if lab is None else lab)
    make_folder(out.parent)
    smaller = None if onto is None else store.load(onto)
    design = Design(packings=packings, spheres=spheres)
    if centred:
        soil = base_soil(measured)
        centre = {name: float(getattr(soil, name)) for name in design.soil_names}
        design = replace(design, centre=centre)
    progress = for_terminal()
    simulator = Simulator(measured, out.parent / f"{out.stem}_runs")
    if smaller is None:
        runs = run_design(design, simulator, progress)
        bank = store.collect(design, measured, runs, reference_run(design, simulator))
    else:
        store.check_extends(design, measured, smaller, str(onto))
        runs = run_design(design, simulator, progress, first=smaller.design.packings)
        bank = smaller.grown(design, runs)
    progress.say(f"{len(bank.values)} simulations have all features; fitting")
    store.save(bank.fitted(), out)
    print(f"bank of {len(bank.values)} simulations in {out}")


def mismatch_command(
    labs: Annotated[list[Path], typer.Argument(metavar="LAB.toml...", help="Nothing hidden.")],
    bank: Annotated[Path | None, typer.Option("--bank", help="The bank's file.")] = None,
    out: Annotated[Path, typer.Option("--out", help="The file.")] = Path("mismatch.json"),
    seed: Annotated[int, typer.Option("--seed", min=0)] = 0,
) -> None:
    """Learn what simulations are wrong by where nothing is hidden, from reference labs."""
    from calibrate.discrepancy import mismatch
    from calibrate.discrepancy.library import store
    from calibrate.discrepancy.library.description import Ready
    from calibrate.io.lab import load_lab

    if len(labs) < mismatch.FEWEST:
        problem, repair = f"{len(labs)} lab files are too few", f"give {mismatch.FEWEST} or more"
        raise InputError(COMMAND_LINE, "LAB.toml", problem, repair)
    ready = Ready.of(store.load(bank or store.bundled_bank()))
    found = mismatch.learn([load_lab(path) for path in labs], ready, seed)
    mismatch.save(found, out, f"{len(labs)} reference labs")
    print(f"mismatch of {len(labs)} reference labs in {out}")
