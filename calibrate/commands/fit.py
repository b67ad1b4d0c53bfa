"""`calibrate fit`: the parameters that the data can fix."""

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
from calibrate.core.errors import COMMAND_LINE, InputError, suggestion


def register(app: typer.Typer) -> None:
    """Adds `fit` to the program."""
    app.command("fit")(fit_command)


def fit_command(
    lab: LabFile = None,
    free: Annotated[
        str | None, typer.Option("--free", help="Names, comma-separated; default: chosen by data.")
    ] = None,
    changes: Changes = None,
    conventions: Conventions = None,
    preset: PresetName = "quick",
    seed: Seed = 0,
    prepare_with_soil: Preparation = False,
    out: Out = Path("results/fit"),
    dask: Dask = None,
    json: Json = None,
) -> None:
    """Calibrate the parameters that the data can fix; say which those are."""
    from calibrate.core.files import check_writable
    from calibrate.inference.calibration import calibrate
    from calibrate.inference.resolutions import Coarse
    from calibrate.io.conventions import check_free
    from calibrate.reports.results import write_fit
    from calibrate.simulation.session import Session

    check_writable(json)
    session = Session.open(lab, preset, out, dask, conventions)
    values = parse_changes(changes or [], session.lab.particles.conventions)
    names = parse_free(free)
    check_free(session.lab.particles.conventions, names or (), COMMAND_LINE, "--free ")
    preparation = values if prepare_with_soil else None
    work, spheres = session.campaign(out, preparation), session.preset.explored
    coarse = None
    if spheres is not None:
        smaller = session.resized(spheres).campaign(out, preparation)
        coarse = Coarse(smaller, spheres, session.preset.spheres)
    done = calibrate(session.lab, session.preset, names, values, seed, work, coarse)
    write_fit(session, done, json)


def parse_free(free: str | None) -> tuple[str, ...] | None:
    """`--free` as names of parameters that may be fitted."""
    from calibrate.inference.parameters import RANGES

    if free is None:
        return None
    names = tuple(name.strip() for name in free.split(",") if name.strip())
    for name in names:
        if name not in RANGES:
            repair = suggestion(name, RANGES) or f"give some of {', '.join(RANGES)}"
            raise InputError(COMMAND_LINE, "--free", f"'{name}' cannot be fitted", repair)
    if not names or len(set(names)) < len(names):
        raise InputError(
            COMMAND_LINE, "--free", "no name, or one name twice", "name each parameter once"
        )
    return names
