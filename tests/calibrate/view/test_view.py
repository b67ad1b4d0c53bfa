"""The bed at many moments: its frames, the forces in its contacts, files for ParaView.

One bed of 60 spheres goes once through short tests; everything is checked on its frames.
ParaView reads them where it is installed.
"""

import json
import shutil
import subprocess
from types import SimpleNamespace
from typing import cast

import equinox as eqx
import jax.numpy as jnp
import meshio
import numpy as np
import pytest

from calibrate import figures
from calibrate.core.errors import CalibrationError
from calibrate.figures import bed
from calibrate.view import frames as series
from calibrate.view.contacts import contacts_of
from calibrate.view.frames import Frame, frames
from calibrate.view.vtk import contact_mesh, write_series
from jdem.apparatus.confined import ConfinedCompression
from jdem.apparatus.unconfined import UnconfinedCompression
from jdem.engine.bed import reach_of
from jdem.engine.step import GRAVITY
from jdem.laboratory.virtual_lab import TestSequence, VirtualLab
from jdem.materials.catalogue import soil_of
from jdem.packing.composite import prepare
from jdem.packing.specimen import Packing
from tests.support.effect_lab import NUMERICS, SMALL, SOIL, small_lab
from tests.support.hand_made_beds import bed_of, listed, spheres_of, state_of

pytestmark = [pytest.mark.slow, pytest.mark.thorough]
SEATED = 1.0  # N; the servo's tolerance is 0.75 N


@pytest.fixture(scope="module")
def packing():
    return prepare(SMALL, 0)


@pytest.fixture(scope="module")
def seen(packing):
    """Packing, laboratory, frames, and the contacts of each."""
    confined = ConfinedCompression(
        simulated_rate=0.05, force_low=100.0, force_high=200.0, stroke=0.2 * SMALL.height
    )
    unconfined = UnconfinedCompression(stroke=5e-4, rest=4e-2, opening=1e-4)
    lab = small_lab(TestSequence((confined, unconfined)))
    states = frames(lab, packing, SOIL, 6)
    return packing, lab, states, [contacts_of(f.bed, f.state) for f in states]


def at_end_of(seen, movement):
    """The last frame of a movement, and its contacts."""
    _, _, states, contacts = seen
    number = max(k for k, frame in enumerate(states) if frame.movement == movement)
    return states[number], contacts[number]


def test_frames_follow_the_machine_in_time(seen):
    _, lab, states, _ = seen
    assert list(dict.fromkeys(f.movement for f in states)) == list(lab.tests.names)
    times = [frame.time for frame in states]
    assert times == sorted(times) and len(set(times)) == len(times)
    assert len(states) <= 2 * 6 + len(lab.tests.names)


def test_loading_ends_at_its_force_and_unloading_without(seen):
    """The servo's target on loading lies two widths of 1.5 N above 200 N."""
    loaded, _ = at_end_of(seen, "loading")
    assert loaded.platen_force == pytest.approx(203, abs=SEATED)
    unloaded, _ = at_end_of(seen, "unloading")
    assert unloaded.platen_force == pytest.approx(0, abs=SEATED)


def test_contacts_carry_the_platen_force(seen):
    """Forces of the platen's contacts add up to what the engine says that it feels; the engine's
    include dashpots, which at 0.05 m/s on a bed that takes 200 N are below a hundredth."""
    frame, contacts = at_end_of(seen, "loading")
    on_platen = contacts.normal_force[contacts.second == -2].sum()
    assert on_platen == pytest.approx(float(frame.state.wall_force[1]), rel=0.01)


def test_every_sphere_is_in_balance_at_rest(seen):
    """Base and mould carry the bed: after the rest what the base carries is its weight."""
    packing, _, _, _ = seen
    _, contacts = at_end_of(seen, "resting")
    weight = float(packing.spheres.mass.sum()) * GRAVITY
    on_base = contacts.normal_force[contacts.second == -1].sum()
    assert on_base == pytest.approx(weight, rel=0.1)
    assert not np.any(contacts.second == -2)  # the platen was taken away


def test_overlaps_are_those_of_the_geometry(seen):
    frame, contacts = at_end_of(seen, "loading")
    radius = np.asarray(frame.bed.spheres.radius)
    pair = contacts.second >= 0
    apart = np.linalg.norm(contacts.start - contacts.end, axis=1)[pair]
    expected = radius[contacts.first[pair]] + radius[contacts.second[pair]] - apart
    np.testing.assert_allclose(contacts.overlap[pair], expected, atol=1e-12)
    assert contacts.overlap.min() > 0
    assert contacts.count(len(radius)).sum() == 2 * pair.sum() + (~pair).sum()
    size = np.abs(contacts.normal_force)
    total = 2 * size[pair].sum() + size[~pair].sum()
    assert contacts.load(len(radius)).sum() == pytest.approx(total)


def test_files_for_paraview_hold_the_bed(seen, tmp_path):
    _, _, states, contacts = seen
    write_series(states, contacts, tmp_path)
    last = len(states) - 1
    mesh = meshio.read(tmp_path / f"vtk/particles_{last:04d}.vtu")
    np.testing.assert_allclose(mesh.points, np.asarray(states[-1].state.motion.position.stack()))
    np.testing.assert_allclose(mesh.point_data["load_n"], contacts[-1].load(SMALL.count))
    lines = meshio.read(tmp_path / f"vtk/contacts_{last:04d}.vtu")
    np.testing.assert_allclose(lines.cell_data["normal_force_n"][0], contacts[-1].normal_force)
    collection = (tmp_path / "particles.pvd").read_text()
    assert collection.count("<DataSet") == len(states)
    assert all((tmp_path / f"vtk/contacts_{k:04d}.vtu").exists() for k in range(len(states)))


# ------------------------------------------------------------------ bonds


@pytest.fixture(scope="module")
def bonded_soil():
    stated = {"normal_stiffness": 1e9, "shear_stiffness": 4e8, "shear_modulus": 2e6}
    return soil_of("parallel_bond", tensile_strength=5e4, shear_strength=5e4, **stated)


def test_a_bond_across_a_gap_is_shown_with_what_it_carries(bonded_soil):
    """F = k_n pi r^2 gap, r of the smaller one of two spheres; a third one only touches."""
    spheres = spheres_of(3, spread=0.3)
    bed = bed_of(spheres, bonded_soil)
    small, middle, large = np.asarray(spheres.radius)
    gap, depth = 1e-6, 2e-6
    heights = np.cumsum([1.0, small + middle + gap, middle + large - depth])
    state = listed(bed, state_of(bed, np.outer(heights, [0.0, 0.0, 1.0])))
    pairs = state.pairs
    joined = (pairs.first == 0) & (pairs.second == 1) & (pairs.alive > 0)
    formed = jnp.where(joined, 1.0, 0.0)
    state = eqx.tree_at(lambda s: s.pairs.history.bond.formed, state, formed)
    contacts = contacts_of(bed, state)
    assert (contacts.first.tolist(), contacts.second.tolist()) == ([0, 1], [1, 2])
    np.testing.assert_allclose(contacts.overlap, [-gap, depth], rtol=1e-6)
    assert contacts.normal_force[0] == pytest.approx(-1e9 * np.pi * small**2 * gap, rel=1e-6)
    assert contacts.normal_force[1] > 0
    mesh = contact_mesh(Frame("crushing", 0.0, 0.0, bed, state), contacts)
    assert contacts.bond.tolist() == [1, 0]
    np.testing.assert_array_equal(mesh.cell_data["bond"][0], contacts.bond)


def test_bonds_form_as_the_mould_opens_and_break_one_after_the_other(packing, bonded_soil):
    confined = ConfinedCompression(simulated_rate=0.2, force_low=20.0, force_high=60.0, stroke=0.02)
    tests = TestSequence((confined, UnconfinedCompression(simulated_rate=0.3, stroke=4e-3)))
    reach = 1.05 * reach_of(bonded_soil, 2 * SMALL.mean_radius(), SMALL.max_radius())
    lab = VirtualLab.of(SMALL, tests, NUMERICS, reach=reach)
    states = frames(lab, packing, bonded_soil, 6)
    contacts = [contacts_of(frame.bed, frame.state) for frame in states]
    counts = [int(each.bond.sum()) for each in contacts]
    assert counts == [
        int(jnp.sum(pairs.alive * pairs.history.bond.whole()))
        for pairs in (frame.state.pairs for frame in states)
    ]
    opening = [frame.movement for frame in states].index("opening")
    pressed, freed = counts[:opening], counts[opening:]
    assert pressed and not any(pressed)
    assert freed == sorted(freed, reverse=True) and freed[0] > freed[-1]
    assert any(np.any(each.overlap[each.bond > 0] < 0) for each in contacts)


def test_soils_without_bonds_have_no_array_of_them(seen):
    _, _, states, contacts = seen
    assert "bond" not in contact_mesh(states[-1], contacts[-1]).cell_data
    assert not contacts[-1].bond.any()


# ------------------------------------------------------------------ lists, pictures


def test_full_contact_lists_are_made_larger_once(monkeypatch):
    """As `simulate` does; without larger ones it is said which list was too small."""
    lab, roomier = (cast(VirtualLab, SimpleNamespace()) for _ in range(2))
    packing, frame = cast(Packing, None), SimpleNamespace(movement="loading")

    class Pieces:
        def __init__(self, used, packing, soil):
            self.full = used is lab

        def run(self):
            yield frame, False
            if self.full:
                raise series._FullError("pairs: have 3, need 4")

    monkeypatch.setattr(series, "_Pieces", Pieces)
    said: list[str] = []
    assert frames(lab, packing, SOIL, 6, said.append, roomier) == [frame]
    assert said == ["a contact list was too small: once more with larger ones"]
    with pytest.raises(CalibrationError, match="pairs: have 3, need 4"):
        frames(lab, packing, SOIL, 6)


def test_pictures_are_drawn(seen, tmp_path):
    _, _, states, contacts = seen
    figures.save(bed.bed_figure(states, contacts), tmp_path / "bed.png")
    bed.bed_animation(states[-3:], contacts[-3:], tmp_path / "bed.gif")
    assert (tmp_path / "bed.png").stat().st_size > 10_000
    assert (tmp_path / "bed.gif").read_bytes().startswith(b"GIF")


# ------------------------------------------------------------------ as a user would

PARAVIEW = """
from paraview.simple import OpenDataFile, UpdatePipeline
for name, point_data in (("particles", True), ("contacts", False)):
    reader = OpenDataFile(f"{name}.pvd")
    times = list(reader.TimestepValues)
    UpdatePipeline(time=times[-1], proxy=reader)
    data = reader.GetDataInformation()
    arrays = reader.PointData if point_data else reader.CellData
    ranges = {array.GetName(): array.GetRange(-1) for array in arrays}
    print(name, len(times), data.GetNumberOfPoints(), data.GetNumberOfCells(), repr(ranges))
"""


@pytest.mark.skipif(shutil.which("pvpython") is None, reason="ParaView is not installed")
def test_paraview_reads_the_series(seen, tmp_path):
    _, _, states, contacts = seen
    write_series(states, contacts, tmp_path)
    (tmp_path / "read.py").write_text(PARAVIEW)
    done = subprocess.run(
        ["pvpython", "read.py"], cwd=tmp_path, capture_output=True, text=True, timeout=600
    )
    particles, lines = (line.split(maxsplit=4) for line in done.stdout.splitlines())
    count = len(contacts[-1].first)
    assert particles[:4] == ["particles", str(len(states)), str(SMALL.count), str(SMALL.count)]
    assert lines[:4] == ["contacts", str(len(states)), str(2 * count), str(count)]
    assert f"{contacts[-1].normal_force.max():.6g}"[:5] in lines[4]


def test_an_earlier_series_does_not_stay(seen, tmp_path):
    _, _, states, contacts = seen
    write_series(states, contacts, tmp_path)
    write_series(states[:2], contacts[:2], tmp_path)
    assert len(list((tmp_path / "vtk").iterdir())) == 4


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["nowhere.toml"], "nowhere.toml"),
        (["--preset", "huge"], "--preset"),
        (["--set", "bounce=1"], "bounce"),
        (["--set", "restitution=2"], "restitution"),
        (["--frames", "1"], "frames"),
        (["--frames", "many"], "frames"),
        (["--out", "file"], "file"),
        (["--out", "taken"], "vtk"),
        (["--json", "."], "--json"),
    ],
)
def test_bad_input_is_refused_in_one_line(calibrate, tmp_path, options, words):
    (tmp_path / "file").touch()
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "vtk").touch()
    status, _, error = calibrate("view", *options)
    assert status == 2 and words in error and len(error.splitlines()) == 1


def test_the_verb_writes_into_its_folder_and_nowhere_else(seen, calibrate, tmp_path, monkeypatch):
    """The soil is named like a path; the simulation is the one that the other tests look at."""
    packing, _, states, _ = seen
    monkeypatch.setattr("calibrate.simulation.Campaign.packings", lambda self, seeds: [packing])
    monkeypatch.setattr("calibrate.verbs.view.states", lambda *given: states[-3:])
    name = "../../evil \\\\ $(touch evil)"
    (tmp_path / "lab.toml").write_text(
        f'[soil]\nname = "{name}"\n[specimen]\ndiameter = "50 mm"\nheight = "60 mm"\n'
        '[targets.crushing_force]\nmean = "140 N"\nscatter = "12 N"\nrepeats = 5\n'
    )
    status, said, error = calibrate("view", "lab.toml", "--out", "out/seen", "--json", "seen.json")
    assert (status, error) == (0, "")
    assert "3 moments" in said
    top = {path.name for path in tmp_path.iterdir()}
    assert top == {"lab.toml", "out", "seen.json"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"seen"}
    written = {path.name for path in (tmp_path / "out/seen").iterdir()}
    assert {"bed.png", "bed.gif", "particles.pvd", "contacts.pvd", "view.json"} <= written
    content = json.loads((tmp_path / "seen.json").read_text())
    assert [frame["platen_force_n"] for frame in content["frames"]] == [
        pytest.approx(state.platen_force) for state in states[-3:]
    ]


@pytest.mark.parametrize(
    ("movements", "drawn"),
    [
        (["loading", "loading", "unloading", "resting", "crushing"], [1, 3, 4]),
        (["load 1", "load 1", "hold 2", "unload 3", "reload 4"], [1, 3, 4]),
        (["load"], [0]),
        (["load", "hold"], [0, 1]),
        (["loading", "hold"], [0]),
    ],
)
def test_a_protocol_without_the_usual_movements_is_drawn_too(movements, drawn):
    assert bed.moments([SimpleNamespace(movement=name) for name in movements]) == drawn
