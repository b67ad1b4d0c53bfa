"""`calibrate simulate`: a lab's virtual tests on several packings."""

from pathlib import Path
from typing import Annotated

import typer

from calibrate.commands.options import (
    Changes,
    Conventions,
    Dask,
    Json,
    LabFile,
    Out,
    Preparation,
    PresetName,
    Seed,
    parse_changes,
)


def register(app: typer.Typer) -> None:
    """Adds `simulate` to the program."""
    app.command("simulate")(simulate_command)


def simulate_command(
    lab: LabFile = None,
    changes: Changes = None,
    conventions: Conventions = None,
    preset: PresetName = "quick",
    seed: Seed = 0,
    prepare_with_soil: Preparation = False,
    single: Annotated[
        bool, typer.Option("--single/--double", help="Numbers in single precision: faster.")
    ] = False,
    out: Out = Path("results/simulate"),
    dask: Dask = None,
    json: Json = None,
) -> None:
    """Run the lab's virtual tests on several packings: curves, observables, scatter."""
    from calibrate.core.files import check_writable
    from calibrate.reports.results import write_simulation
    from calibrate.simulation import specimens
    from calibrate.simulation.session import Session

    check_writable(json)
    session = Session.open(lab, preset, out, dask, conventions)
    if single:
        session = session.in_single_precision()
    values = parse_changes(changes or [], session.lab.particles.conventions)
    work = session.campaign(out, values if prepare_with_soil else None)
    result, runs = specimens.simulate(session.lab, session.preset, values, seed, work)
    write_simulation(session, result, runs, json)
    specimens.check_some_sound(runs)
