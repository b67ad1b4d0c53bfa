"""Files for ParaView, through meshio: spheres as points, contacts as lines, a series in time.

In ParaView: open particles.pvd, filter Glyph (sphere, scale by `diameter`); open contacts.pvd,
filter Tube (radius by `normal_force_n`).  SI units; names say which.
"""

from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np

from calibrate.core.files import whole
from calibrate.view.contacts import Contacts
from calibrate.view.frames import Frame


def write_series(frames: list[Frame], contacts: list[Contacts], folder: Path) -> None:
    """particles.pvd and contacts.pvd in `folder`, and the files that they list in vtk/; what an
    earlier, longer series left there is removed at the end."""
    names: dict[str, list[str]] = {"particles": [], "contacts": []}
    for number, (frame, touching) in enumerate(zip(frames, contacts, strict=True)):
        for kind, mesh in (
            ("particles", particle_mesh(frame, touching)),
            ("contacts", contact_mesh(frame, touching)),
        ):
            name = f"vtk/{kind}_{number:04d}.vtu"
            with whole(folder / name) as part:
                mesh.write(part, file_format="vtu")
            names[kind].append(name)
    for kind, files in names.items():
        _write_collection(folder / f"{kind}.pvd", files, [frame.time for frame in frames])
        for old in (folder / "vtk").glob(f"{kind}_[0-9]*.vtu"):
            if f"vtk/{old.name}" not in files:
                old.unlink(missing_ok=True)


def particle_mesh(frame: Frame, touching: Contacts) -> meshio.Mesh:
    """Spheres as points with their size, motion and load."""
    spheres, motion = frame.bed.spheres, frame.state.motion
    data = {
        "radius_m": spheres.radius,
        "diameter": 2 * spheres.radius,
        "mass_kg": spheres.mass,
        "velocity_m_s": motion.velocity.stack(),
        "spin_rad_s": motion.spin.stack(),
        "load_n": touching.load(spheres.count),
        "contacts": touching.count(spheres.count),
    }
    return meshio.Mesh(
        points=np.asarray(motion.position.stack(), float),
        cells=[("vertex", np.arange(spheres.count)[:, None])],
        point_data={name: np.asarray(values) for name, values in data.items()},
    )


def contact_mesh(frame: Frame, touching: Contacts) -> meshio.Mesh:
    """Contacts as lines from centre to centre, or from centre to wall; of a law with bonds, which
    of them are whole."""
    count = len(touching.first)
    points = np.concatenate([touching.start, touching.end]).astype(float)
    lines = np.stack([np.arange(count), np.arange(count) + count], axis=1)
    wall = np.where(touching.second < 0, -1 - touching.second, -1)
    data = {
        "normal_force_n": touching.normal_force,
        "tangential_force_n": touching.tangential_force,
        "overlap_m": touching.overlap,
        "wall": wall,  # 0 base, 1 platen, 2 mould, -1 none
    }
    if frame.bed.particle_law.bonds:
        data["bond"] = touching.bond
    return meshio.Mesh(
        points=points,
        cells=[("line", lines)],
        cell_data={name: [np.asarray(values)] for name, values in data.items()},
    )


def _write_collection(path: Path, files: list[str], times: list[float]) -> None:
    """A ParaView collection: which file belongs to which time."""
    root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
    collection = ElementTree.SubElement(root, "Collection")
    for file, time in zip(files, times, strict=True):
        ElementTree.SubElement(collection, "DataSet", timestep=f"{time:.9g}", file=file)
    with whole(path) as part:
        ElementTree.ElementTree(root).write(part, encoding="utf-8", xml_declaration=True)
