"""How the time of a step and the memory grow with the number of spheres, up to 200,000.

Spheres of one size stand on a cubic lattice, pressed together by half a per cent, so that each has
six neighbours, as in soil; they fill a cylinder as high as wide, and swing a little under gravity.
Their numbers follow space, or are shuffled, as those of a grown bed are.  Each bed runs in a
process of its own for so many steps that it takes some seconds; the second of two runs is timed, by
the processor's clock, with the lists rebuilt as often as in a test.

    python benchmarks/scaling.py                      some five minutes of a core
    python benchmarks/scaling.py --spheres 2000 50000
    python benchmarks/scaling.py --parts              where the time goes: 12 to 20 minutes

With --parts, beds of soil of 500, 2000 and 10,000 spheres that a platen loads: each part of a step
by itself, as often as a step does it.  Writes a section of benchmarks/results/README.md.
"""

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import reporting
from speed import SOIL, TIME_STEP, compiled_run, loading, vector

from calibrate.simulation.resolution import numerics_for
from jdem.bodies.spheres import Spheres
from jdem.core.fusion import fenced
from jdem.core.quantity import cast
from jdem.engine.bed import Numerics, build_bed, plan_grid, steps_per_sample
from jdem.engine.loads import Loads, pair_loads, wall_loads
from jdem.engine.loop import start
from jdem.engine.neighbors import rebuild
from jdem.engine.segment import cell_segment, stack
from jdem.engine.state import Bed, BedState, Command
from jdem.engine.step import next_motion, step
from jdem.packing.composite import prepare
from jdem.packing.specimen import Specimen

COUNTS = (500, 2000, 10_000, 50_000, 100_000, 200_000)
RADIUS, PRESSED = 2.5e-3, 0.995  # m; pitch of the lattice over the diameter
WORK = 4e7  # particle-steps of a run
EVERY = 16  # steps in a sampling interval
WITH_PARTS = (500, 2000, 10_000)  # spheres of beds whose step is taken apart
HEADER = ("spheres", "order", "processor time of a step (ms)", "per sphere and step (ns)",
          "contacts of a sphere", "memory (GiB)")  # fmt: skip


def lattice(count: int, shuffled: bool) -> tuple[np.ndarray, float]:
    """Centres (N, 3) of about so many spheres in a cylinder, and its radius, m."""
    pitch = 2 * RADIUS * PRESSED
    side = int(np.ceil((4 * count / np.pi) ** (1 / 3)))
    grid = np.stack(np.meshgrid(*3 * [np.arange(side)], indexing="ij"), -1).reshape(-1, 3)
    across = grid[:, :2] - (side - 1) / 2
    inside = grid[np.hypot(*across.T) <= side / 2]
    centres = (inside - [(side - 1) / 2, (side - 1) / 2, 0.0]) * pitch + [0, 0, PRESSED * RADIUS]
    if shuffled:
        np.random.default_rng(0).shuffle(centres)
    return centres, (side / 2 + 1) * pitch


def measured(count: int, shuffled: bool) -> dict:
    """One bed in this process."""
    centres, mould = lattice(count, shuffled)
    spheres, dtype = len(centres), "float64"
    height = float(centres[:, 2].max()) + PRESSED * RADIUS
    extent = (2 * mould, 1.2 * height)
    grid = plan_grid(spheres, RADIUS, RADIUS, extent, Numerics(wall_layer=9.0))
    mass = np.full(spheres, 1830 * 4 / 3 * np.pi * RADIUS**3)
    bodies = Spheres(jnp.full(spheres, RADIUS), jnp.asarray(mass))
    bed = build_bed(bodies, SOIL, grid, Numerics(), jnp.asarray(TIME_STEP))
    state = cast(start(bed, vector(centres), height, mould), jnp.dtype(dtype))
    intervals = int(np.clip(WORK / spheres / EVERY, 4, 400))
    still = cell_segment(damping=200.0, duration=(intervals - 0.5) * EVERY * TIME_STEP)
    programme = cast(stack([still]), jnp.dtype(dtype))
    compiled = compiled_run(bed, state, programme, EVERY, intervals)
    record = jax.block_until_ready(compiled(bed, state, programme, jnp.asarray(EVERY)))
    if bool(record.overflow_of(grid)):
        raise SystemExit(record.explain_overflow(grid))
    begun = time.process_time()
    jax.block_until_ready(compiled(bed, state, programme, jnp.asarray(EVERY)))
    spent = time.process_time() - begun
    touching = float(np.sum(np.asarray(record.state.pairs.alive)))
    return {
        "spheres": spheres,
        "order": "shuffled" if shuffled else "space",
        "step_s": spent / (intervals * EVERY),
        "contacts": 2 * touching / spheres,
        "memory_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }


def markdown(rows: list[dict], origin: dict) -> str:
    """A row for each bed, then the power of the number of spheres."""
    cells = [
        [
            f"{row['spheres']}", row["order"], f"{1e3 * row['step_s']:.3g}",
            f"{1e9 * row['step_s'] / row['spheres']:.0f}", f"{row['contacts']:.1f}",
            f"{row['memory_gib']:.2f}",
        ]
        for row in rows
    ]  # fmt: skip
    said = "".join(f"- {sentence}\n" for sentence in _powers(rows))
    return (
        "## Scaling\n\nOne process on one core; spheres on a lattice, listed neighbours counted as "
        "contacts.\n\n" + reporting.table(HEADER, cells) + "\n" + said + reporting.footer(origin)
    )


def _powers(rows: list[dict]) -> list[str]:
    found = []
    for order in ("shuffled", "space"):
        own = [row for row in rows if row["order"] == order]
        if len(own) > 2:
            counts, steps = (np.log([row[k] for row in own]) for k in ("spheres", "step_s"))
            power = np.polyfit(counts, steps, 1)[0]
            found.append(f"Numbered by {order}: the time of a step grows as N^{power:.2f}.")
    return found


# ---------------------------------------------------------------- where the time goes


def loaded(count: int) -> tuple[Bed, BedState]:
    """A bed of soil under 400 N."""
    specimen = Specimen(diameter=0.05, height=0.1, density=1000.0, count=count)
    packing, numerics = prepare(specimen, 0), numerics_for(specimen)
    radius = np.asarray(packing.spheres.radius)
    centres = np.asarray(packing.position.stack())
    height = float((centres[:, 2] + radius).max())
    extent = (0.05, 1.5 * height)
    grid = plan_grid(count, float(radius.mean()), float(radius.max()), extent, numerics)
    bed = build_bed(packing.spheres, SOIL, grid, numerics)
    state, programme = start(bed, vector(centres), height, 0.025), loading(400.0, "float64")
    every = steps_per_sample(bed, numerics)
    capacity = int(np.ceil(0.3 / (float(every) * float(bed.time_step))))
    compiled = compiled_run(bed, state, programme, int(every), capacity)
    record = compiled(bed, state, programme, jnp.asarray(int(every)))
    if bool(record.overflow_of(grid)):
        raise SystemExit(record.explain_overflow(grid))
    return bed, record.state


def parts(count: int) -> dict[str, float]:
    """Microseconds of the whole step, of each of its parts and of renewing the lists."""
    fixed = loaded(count)
    bed, state = fixed
    still, loads = jnp.zeros(()), jnp.zeros((count, 8))
    rows, position = bed.spheres.rows(state.motion), state.motion.position
    command = Command(jnp.zeros((3, 3)), jnp.asarray(200.0), still)

    def pairs(fixed, carry):
        rows, listed = carry
        found, listed = pair_loads(fixed[0], rows, listed)
        return rows + 1e-40 * found.rows[0, 0], listed

    def walls(fixed, carry):
        (bed, state), (rows, listed, loads) = fixed, carry
        given = Loads(loads, jnp.zeros(4), still)
        found, listed, _ = wall_loads(bed, rows, state.boundaries, listed, given)
        return rows + 1e-40 * found.rows[0, 0], listed, loads

    def motion(fixed, carry):
        return next_motion(fixed[0], carry[0], still, carry[1], command)[0], carry[1]

    def lists(fixed, carry):
        (bed, state), (position, *old) = fixed, carry
        pairs, met, _ = rebuild(bed.grid, bed.spheres, state.boundaries, position, *old)
        nothing = 1e-40 * pairs.alive[0]  # without it the search is done once, before the loop
        return jax.tree.map(lambda axis: axis + nothing, position), pairs, met

    listed, met = state.pairs, state.wall_contacts
    return {
        "step": _microseconds(lambda fixed, now: step(fixed[0], now, command), fixed, state),
        "pairs": _microseconds(pairs, fixed, (rows, listed)),
        "walls": _microseconds(walls, fixed, (rows, met, loads)),
        "motion": _microseconds(motion, fixed, (state.motion, loads)),
        "lists": _microseconds(lists, fixed, (position, listed, met)),
        "listed": float(np.sum(np.asarray(listed.alive) > 0)),
    }


def _microseconds(part: Callable, fixed: tuple[Bed, BedState], carry) -> float:
    """Least processor time of a turn, of three times so many turns that it takes a second; the bed
    is an argument, so that no program knows it."""
    turns = max(50, int(1e6 / fixed[0].spheres.count))

    @eqx.filter_jit
    def turned(fixed, carry):
        with fenced():
            return jax.lax.fori_loop(0, turns, lambda _, now: part(fixed, now), carry)

    spent = []
    for _ in range(4):
        begun = time.process_time()
        jax.block_until_ready(turned(fixed, carry))
        spent.append(time.process_time() - begun)
    return 1e6 * min(spent[1:]) / turns


def markdown_of_parts(found: dict[int, dict[str, float]], origin: dict) -> str:
    rows = []
    for count, row in found.items():
        named = row["pairs"] + row["walls"] + row["motion"]
        rows.append(
            [
                f"{count}", f"{row['step']:.0f}", f"{1e3 * row['step'] / count:.0f}",
                *(f"{row[part]:.0f}" for part in ("pairs", "walls", "motion")),
                f"{row['step'] - named:.0f}", f"{row['lists']:.0f}",
                f"{1e3 * row['pairs'] / row['listed']:.0f}",
            ]
        )  # fmt: skip
    header = (
        "spheres", "step (us)", "per sphere (ns)", "contacts of spheres (us)",
        "contacts with boundaries (us)", "motion (us)", "the rest (us)", "renewing lists (us)",
        "per listed pair (ns)",
    )  # fmt: skip
    return (
        "## Parts of a step\n\nBeds of soil under 400 N, one process on one core, float64. Lists "
        "are renewed once in many steps. A part by itself finds the caches in another state, so "
        "that parts do not quite add up.\n\n"
        + reporting.table(header, rows)
        + reporting.footer(origin)
    )


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--spheres", nargs="+", type=int, default=list(COUNTS))
    parser.add_argument("--orders", nargs="+", default=["shuffled", "space"])
    parser.add_argument("--one", action="store_true", help="the first bed, as JSON")
    parser.add_argument("--parts", action="store_true", help="where the time of a step goes")
    chosen = parser.parse_args()
    reporting.configure()
    if chosen.parts:
        found = {count: parts(count) for count in WITH_PARTS}
        return reporting.write_page(markdown_of_parts(found, reporting.provenance()))
    if chosen.one:
        found = measured(chosen.spheres[0], chosen.orders[0] == "shuffled")
        return print(json.dumps(found))
    rows = []
    for count in chosen.spheres:
        for order in chosen.orders:
            asked = [sys.executable, __file__, "--one", "--spheres", str(count), "--orders", order]
            done = subprocess.run(asked, check=True, capture_output=True, text=True)
            rows.append(json.loads(done.stdout.splitlines()[-1]))
            print(rows[-1], flush=True)
    origin = reporting.provenance()
    reporting.write_page(markdown(rows, origin))


if __name__ == "__main__":
    main()
