"""`calibrate view`: one specimen through its tests, as pictures and as files for ParaView."""

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Adds `view` to the program."""
    app.command("view")(view_command)


def view_command(
    lab: Annotated[
        Path | None, typer.Argument(metavar="[LAB.toml]", help="Default: the bundled soil.")
    ] = None,
    changes: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Change a parameter.")
    ] = None,
    frames: Annotated[
        int, typer.Option("--frames", min=4, max=1000, help="About how many moments.")
    ] = 24,
    preset: Annotated[str, typer.Option("--preset", help="quick, standard or fine.")] = "quick",
    seed: Annotated[int, typer.Option("--seed", min=0, max=10_000_000)] = 0,
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path(
        "results/view"
    ),
    json: Annotated[Path | None, typer.Option("--json", help="Write what was seen here.")] = None,
) -> None:
    """Run one specimen and show its bed: bed.png, bed.gif, and files for ParaView."""
    from calibrate.commands.options import parse_changes
    from calibrate.core.files import check_writable, make_folder, write_json
    from calibrate.figures import bed
    from calibrate.io.soil import base_soil, with_values
    from calibrate.simulation.session import Session
    from calibrate.verbs.base import parameter_values
    from calibrate.view.contacts import contacts_of
    from calibrate.view.frames import frames as states
    from calibrate.view.vtk import write_series

    check_writable(json)
    session = Session.open(lab, preset, out)
    make_folder(out / "vtk")
    values = parameter_values(parse_changes(changes), session.lab.particles.conventions)
    soil = with_values(base_soil(session.lab), values)
    work = session.campaign_of_one(out, None)
    (packing,) = work.packings([seed])
    seen = states(work.lab, packing, soil, frames, session.progress.say)
    touching = [contacts_of(frame.bed, frame.state) for frame in seen]
    write_series(seen, touching, out)
    bed.bed_figure(seen, touching, out / "bed.png")
    bed.bed_animation(seen, touching, out / "bed.gif")
    result = {
        "soil": session.lab.name,
        "preset": session.preset.name,
        "seed": seed,
        "frames": [
            {"movement": f.movement, "time_s": f.time, "platen_force_n": f.platen_force}
            for f in seen
        ],
    }
    write_json(out / "view.json", result)
    if json is not None:
        write_json(json, result)
    print(f"{len(seen)} moments; bed.png, bed.gif, particles.pvd and contacts.pvd are in {out}")
