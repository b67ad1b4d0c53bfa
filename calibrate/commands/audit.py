"""`calibrate audit`: gradients beside the slope of the response."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from calibrate.commands.options import (
    Batch,
    Changes,
    Dask,
    Json,
    LabFile,
    Out,
    PresetName,
    Seed,
    parse_changes,
)
from calibrate.core.errors import COMMAND_LINE, InputError, suggestion


def register(app: typer.Typer) -> None:
    """Adds `audit` to the program."""
    app.command("audit")(audit_command)


def audit_command(
    lab: LabFile = None,
    strategy: Annotated[
        list[str] | None,
        typer.Option(
            "--strategy",
            help="fit (what fits use; default), ensemble, regression, pathwise, blend, "
            "overdamped, overdamped_blend, virtual_power, virtual_power_blend; may be given "
            "several times.",
        ),
    ] = None,
    changes: Changes = None,
    spheres: Annotated[int, typer.Option("--spheres", min=30, help="Spheres a packing.")] = 300,
    packings: Annotated[int, typer.Option("--packings", min=2, help="Packings.")] = 8,
    preset: PresetName = "quick",
    seed: Seed = 0,
    out: Out = Path("results/audit"),
    dask: Dask = None,
    batch: Batch = None,
    json: Json = None,
) -> None:
    """Compare gradients with the slope of the response over +-20 %, parameter by parameter."""
    from calibrate.core.files import check_writable
    from calibrate.inference.audit import audit, traces
    from calibrate.inference.parameters import FACTORS, space
    from calibrate.io.soil import base_soil, with_values
    from calibrate.reports.results import write_audit
    from calibrate.simulation.session import Session
    from calibrate.simulation.specimens import soil_json

    check_writable(json)
    session = Session.open(lab, preset, out, dask, batch=batch).resized(spheres)
    values = parse_changes(changes or [], session.lab.particles.conventions)
    names = parse_strategies(strategy or ["fit"])
    base = with_values(base_soil(session.lab), values)
    audited = space(session.lab, (*FACTORS, "shear_modulus"), base)
    seeds = range(100 * seed, 100 * seed + packings)
    campaign = session.campaign_of_one if traces(names) else session.on_soil().campaign
    found = audit(audited, campaign(out, None), seeds, names)
    settings = {"spheres": spheres, "seeds": list(seeds), "parameters": soil_json(base)}
    write_audit(session, found, settings, json)


def parse_strategies(names: Sequence[str]) -> tuple[str, ...]:
    """`--strategy` options as names of sensitivity strategies."""
    from calibrate.inference.audit import STRATEGIES

    for name in names:
        if name not in STRATEGIES:
            repair = suggestion(name, STRATEGIES) or f"give {', '.join(STRATEGIES)}"
            raise InputError(COMMAND_LINE, "--strategy", f"no strategy '{name}'", repair)
    return tuple(dict.fromkeys(names))
