"""Run one specimen and show its bed: bed.png, bed.gif, and files for ParaView."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.console import RenderableType

from calibrate.core.files import make_folder, write_json
from calibrate.figures.bed import bed_animation
from calibrate.simulation.session import Session
from calibrate.verbs import options
from calibrate.verbs.base import AbstractDrawnResult, line, verb
from calibrate.view.contacts import Contacts, contacts_of
from calibrate.view.frames import Frame
from calibrate.view.frames import frames as states
from calibrate.view.vtk import write_series


@dataclass(frozen=True, eq=False, repr=False)
class ViewResult(AbstractDrawnResult):
    """Moments of one specimen in its tests.

    Attributes:
        frames: the bed at each moment.
        contacts: those of each moment.
        folder: where the pictures and the files for ParaView are.
        content: the moments, with the keys of view.json.
    """

    verb = "view"
    files = ("bed.gif", "particles.pvd", "contacts.pvd")
    frames: list[Frame]
    contacts: list[Contacts]
    folder: Path
    content: dict

    def words(self) -> Iterator[RenderableType]:
        yield line(f"{len(self.frames)} moments")

    @property
    def drawn(self) -> tuple[list[Frame], list[Contacts]]:
        """Moments and their contacts."""
        return self.frames, self.contacts


@verb
def view(
    lab: options.LabFile = None,
    *,
    values: options.Changes = None,
    frames: Annotated[
        int, typer.Option("--frames", min=4, max=1000, help="About how many moments.")
    ] = 24,
    preset: options.PresetName = "quick",
    seed: options.Seed = 0,
    out: options.Folder = "results/view",
) -> ViewResult:
    """Runs one specimen through its tests and shows its bed.

    Args:
        lab: a lab file's path, or what `load_lab` returned; None: the bundled soil.
        values: parameters in place of the lab file's, by name, in SI units or with a unit.
        frames: about how many moments.
        preset: "quick", "standard" or "fine": how many spheres.
        seed: choice of the packing, from 0.
        out: folder for results.

    Returns:
        The moments; bed.png, bed.gif and files for ParaView in `out`.

    Raises:
        InputError: the lab file or an argument is wrong.
    """
    folder = Path(out)
    session = Session.open(lab, preset, folder)
    make_folder(folder / "vtk")
    soil = session.soil(values)
    work = session.campaign_of_one(folder)
    (packing,) = work.packings([seed])
    roomier = work.lab.roomier(work.specimen)
    seen = states(work.lab, packing, soil, frames, session.progress.say, roomier)
    touching = [contacts_of(frame.bed, frame.state) for frame in seen]
    write_series(seen, touching, folder)
    bed_animation(seen, touching, folder / "bed.gif")
    content = {
        "soil": session.lab.name,
        "preset": session.preset.name,
        "seed": seed,
        "frames": [_moment(f, c) for f, c in zip(seen, touching, strict=True)],
    }
    write_json(folder / "view.json", content)
    found = ViewResult(seen, touching, folder, content)
    found.save_figures()
    return found


def _moment(frame: Frame, contacts: Contacts) -> dict:
    """What view.json says of one moment."""
    bonds = {"intact_bonds": int(contacts.bond.sum())} if frame.bed.particle_law.bonds else {}
    moment = {"movement": frame.movement, "time_s": frame.time}
    return {**moment, "platen_force_n": frame.platen_force, **bonds}
