"""Particle-steps per second of 1000 spheres loaded from 100 N to 400 N, beside LIGGGHTS.

The bed, soil and time step are those of benchmarks/peers: LIGGGHTS settles the spheres
and times its own EEPA ('edinburgh') on 1 and 2 ranks, measured in turn with ours
(A/B/A/B), because a machine's speed drifts.  Ours is timed in float64 and float32, one
run alone and two runs in two threads (what a campaign does).  Without LIGGGHTS on PATH our
own packing is used and the peer is reported as not measured.

    python benchmarks/speed.py                 about 3 minutes on two idle cores
    python benchmarks/speed.py --rounds 1      quicker, less certain

Cores that other work keeps busy are noted before every measurement; --wait gives it some
time to end.  Where it does not end, compare rates per second of processor time.
Writes a section of benchmarks/results/README.md.
"""

import argparse
import os
import re
import shutil
import subprocess
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import reporting

from calibrate.simulation.resolution import numerics_for
from jdem.bodies.spheres import Spheres
from jdem.core.kernel import program
from jdem.core.quantity import cast
from jdem.core.vector import Vector
from jdem.engine.bed import Numerics, build_bed, plan_grid
from jdem.engine.loop import Record, run, start
from jdem.engine.segment import Segment, cell_segment, stack
from jdem.engine.step import Bed, BedState
from jdem.materials.soil import SoilParameters
from jdem.packing.composite import prepare
from jdem.packing.specimen import Specimen

PEERS = Path(__file__).parent / "peers"
MOULD_RADIUS = 0.025  # m, as in benchmarks/peers
DENSITY = 1830.0  # kg/m3 of the spheres, as in benchmarks/peers
TIME_STEP = 1.5e-5  # s, as in benchmarks/peers

# As in benchmarks/peers/in.common: k2/k1 = 1.667 is a plasticity ratio of 0.4.
SOIL = SoilParameters(
    restitution=0.5,
    static_friction=0.6,
    rolling_friction=0.3,
    surface_energy=15.0,
    plasticity_ratio=0.4,
    shear_modulus=12e6,
    wall_friction=0.6,
    platen_friction=0.6,
    reference_diameter=6e-3,
)


@dataclass(frozen=True, eq=False)
class Spread:
    """A settled bed: centres (N, 3) and radii (N,) in m, masses (N,) in kg, and its origin."""

    centres: np.ndarray
    radius: np.ndarray
    mass: np.ndarray
    origin: str

    @property
    def height(self) -> float:
        return float((self.centres[:, 2] + self.radius).max())


def liggghts_bed(path: Path) -> Spread:
    """The bed in a LIGGGHTS data file (atom_style granular: id type d rho x y z ...)."""
    text = path.read_text(encoding="utf-8")
    section = re.split(r"^(?:Atoms|Velocities)[^\n]*\n", text, flags=re.MULTILINE)[1]
    rows = np.array(
        [[float(cell) for cell in line.split()[:7]] for line in section.split("\n") if line.strip()]
    )
    radius = rows[:, 2] / 2
    mass = rows[:, 3] * 4 / 3 * np.pi * radius**3
    return Spread(rows[:, 4:7], radius, mass, "settled by LIGGGHTS")


def own_bed() -> Spread:
    """The nearest bed of our own, where there is no LIGGGHTS."""
    specimen = Specimen(diameter=2 * MOULD_RADIUS, height=0.1, density=0.57 * DENSITY, count=1000)
    packing = prepare(specimen, 0)
    centres = np.asarray(packing.position.stack())
    return Spread(
        centres,
        np.asarray(packing.spheres.radius),
        np.asarray(packing.spheres.mass),
        "packing 0 of jdem",
    )


@dataclass(frozen=True, eq=False)
class Timed:
    """A compiled loading, ready to be run from 100 N; `steps` is what it last took."""

    name: str
    compiled: Callable
    inputs: tuple
    every: int
    spheres: int
    compile_seconds: float
    steps: int


def ready(bed: Spread, dtype: str) -> Timed:
    """Compiles, loads the bed to 100 N, and runs to 400 N once to warm up."""
    numerics = numerics_of(bed, dtype)
    built = built_bed(bed, numerics)
    every = max(1, round(numerics.sample_time / TIME_STEP))
    state = cast(start(built, vector(bed.centres), bed.height, MOULD_RADIUS), jnp.dtype(dtype))
    capacity = int(np.ceil(0.3 / (every * TIME_STEP)))
    begun = time.perf_counter()
    compiled = compiled_run(built, state, loading(0.0, dtype), every, capacity)
    seconds = time.perf_counter() - begun
    seated = compiled(built, state, loading(100.0, dtype), jnp.asarray(every)).state
    inputs = (built, seated, loading(400.0, dtype), jnp.asarray(every))
    record = _checked(compiled(*inputs), built)
    return Timed(dtype, compiled, inputs, every, len(bed.radius), seconds, _steps(record, every))


def numerics_of(bed: Spread, dtype: str) -> Numerics:
    specimen = Specimen(diameter=2 * MOULD_RADIUS, height=bed.height, count=len(bed.radius))
    return numerics_for(specimen, dtype=dtype)


def built_bed(bed: Spread, numerics: Numerics, soil: SoilParameters = SOIL) -> Bed:
    extent = (2 * MOULD_RADIUS, 1.5 * bed.height)
    radius = bed.radius
    grid = plan_grid(len(radius), float(radius.mean()), float(radius.max()), extent, numerics)
    spheres = Spheres(jnp.asarray(radius), jnp.asarray(bed.mass))
    return build_bed(spheres, soil, grid, numerics, jnp.asarray(TIME_STEP))


def vector(centres: np.ndarray) -> Vector:
    return Vector(*[jnp.asarray(centres[:, axis]) for axis in range(3)])


def loading(force: float, dtype: str) -> Segment:
    """At 0.1 m/s to `force` (N); the end is sharp, as the peer's is."""
    segment = cell_segment(
        platen_speed=0.1,
        force_target=force + 2,
        servo_width=0.1,
        tolerance=2.0,
        damping=200.0,
        duration=0.25,
    )
    return cast(stack([segment]), jnp.dtype(dtype))


def compiled_run(
    bed: Bed, state: BedState, programme: Segment, every: int, capacity: int
) -> Callable:
    jitted = program(
        lambda bed, state, programme, steps: run(bed, state, programme, steps, capacity)
    )
    return jitted.lower(bed, state, programme, jnp.asarray(every)).compile()


def _checked(record: Record, bed: Bed) -> Record:
    force = float(np.max(np.asarray(record.samples.platen_force)))
    if bool(record.overflow_of(bed.grid)):
        raise RuntimeError(record.explain_overflow(bed.grid))
    if not force >= 396:
        raise RuntimeError(f"the platen reached {force:.0f} N only")
    return record


def _steps(record: Record, every: int) -> int:
    return int(np.sum(np.asarray(record.samples.segment) >= 0)) * every


def once(timed: Timed, threads: int) -> dict:
    """Particle-steps per second of `threads` simultaneous runs together, and cores used."""
    busy = busy_cores()
    begun, processor = time.perf_counter(), time.process_time()
    with ThreadPoolExecutor(threads) as pool:
        list(
            pool.map(lambda _: jax.block_until_ready(timed.compiled(*timed.inputs)), range(threads))
        )
    seconds = time.perf_counter() - begun
    return {
        "seconds": seconds,
        "particle_steps_per_s": threads * timed.steps * timed.spheres / seconds,
        "cores_used": (time.process_time() - processor) / seconds,
        "busy_cores_before": busy,
    }


def peer(folder: Path) -> dict[str, dict]:
    """What benchmarks/peers/run.sh prints, by number of ranks."""
    busy = busy_cores()
    command = ["bash", str(PEERS / "run.sh"), str(folder)]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    pattern = r"ranks (\d+): (\d+) steps, ([\d.]+) s"
    return {
        f"LIGGGHTS edinburgh, {ranks} rank{'s' if ranks != '1' else ''}": {
            "seconds": float(seconds),
            "particle_steps_per_s": 1000 * int(steps) / float(seconds),
            "steps": int(steps),
            "busy_cores_before": busy,
        }
        for ranks, steps, seconds in re.findall(pattern, printed)
    }


def rounds(count: int, ours: list[Timed], folder: Path | None) -> dict[str, list[dict]]:
    """Everything measured `count` times in turn."""
    found: dict[str, list[dict]] = {}
    for _ in range(count):
        for timed in ours:
            for threads in (1, 2):
                alone = "one run" if threads == 1 else "two runs in two threads"
                found.setdefault(f"{timed.name}, {alone}", []).append(once(timed, threads))
        for name, numbers in peer(folder).items() if folder else ():
            found.setdefault(name, []).append(numbers)
    return found


def summarised(found: dict[str, list[dict]]) -> dict[str, dict]:
    """Median, least and greatest of the rounds."""
    return {
        name: {
            "particle_steps_per_s": float(np.median([r["particle_steps_per_s"] for r in rows])),
            "range": [
                min(r["particle_steps_per_s"] for r in rows),
                max(r["particle_steps_per_s"] for r in rows),
            ],
            "rounds": rows,
        }
        for name, rows in found.items()
    }


def wait_for_idle(most: float) -> None:
    """Waits until other work leaves the cores alone, at most `most` seconds."""
    begun = time.monotonic()
    while busy_cores(2.0) > 0.2 and time.monotonic() - begun < most:
        time.sleep(3)


def busy_cores(seconds: float = 0.5) -> float:
    """Cores that other work keeps busy while this process sleeps; on Linux, else the load."""
    stat = Path("/proc/stat")
    if not stat.exists():
        return os.getloadavg()[0]
    first = _busy_ticks(stat)
    time.sleep(seconds)
    return (_busy_ticks(stat) - first) / os.sysconf("SC_CLK_TCK") / seconds


def _busy_ticks(stat: Path) -> int:
    """Clock ticks spent so far on anything but idling and waiting for disks."""
    ticks = [int(cell) for cell in stat.read_text(encoding="utf-8").split("\n")[0].split()[1:9]]
    return sum(ticks) - ticks[3] - ticks[4]


def markdown(content: dict) -> str:
    rows = [_cells(name, entry) for name, entry in content["measured"].items()]
    compiled = [
        f"- {entry['name']}: compiled in {entry['compile_seconds']:.1f} s, {entry['steps']} steps\n"
        for entry in content["ours"]
    ]
    return (
        "## Particle-steps a second\n\n"
        f"{content['spheres']} spheres ({content['bed']}) in confined compression "
        f"from 100 N to 400 N, dt {TIME_STEP:g} s; M particle-steps/s, median and range of "
        f"{content['rounds']} rounds measured in turn. {content['peer']}\n\n"
        + reporting.table(
            (
                "",
                "M particle-steps/s",
                "range",
                "cores used",
                "M a second of processor time",
                "others busy (cores)",
            ),
            rows,
        )
        + "\n"
        + "".join(compiled)
        + reporting.footer(content)
    )


def _cells(name: str, entry: dict) -> list[str]:
    low, high = (1e-6 * value for value in entry["range"])
    timed = [r for r in entry["rounds"] if "cores_used" in r]
    used = [r["cores_used"] for r in timed]
    rates = [1e-6 * r["particle_steps_per_s"] / r["cores_used"] for r in timed]
    busy = [r["busy_cores_before"] for r in entry["rounds"]]
    return [
        name,
        f"{1e-6 * entry['particle_steps_per_s']:.2f}",
        f"{low:.2f} to {high:.2f}",
        f"{np.median(used):.1f}" if used else "-",
        f"{np.median(rates):.2f}" if used else "-",
        f"{min(busy):.1f} to {max(busy):.1f}",
    ]


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=3, help="measurements of each")
    parser.add_argument("--wait", type=float, default=120, help="longest wait for idle cores, s")
    parser.add_argument(
        "--folder", type=Path, default=reporting.CACHE / "peers", help="where LIGGGHTS runs"
    )
    return parser.parse_args()


def main() -> None:
    chosen = arguments()
    reporting.configure(compilation_cache=False)
    folder = (
        chosen.folder.resolve() if shutil.which("liggghts") and shutil.which("mpirun") else None
    )
    if folder:
        folder.mkdir(parents=True, exist_ok=True)
        peer(folder)  # settles the bed and warms up
    bed = liggghts_bed(folder / "bed.data") if folder else own_bed()
    ours = [ready(bed, dtype) for dtype in ("float64", "float32")]
    wait_for_idle(chosen.wait)
    measured = summarised(rounds(chosen.rounds, ours, folder))
    content = {
        **reporting.provenance(),
        "seed": "none: the bed is a file" if folder else 0,
        "bed": bed.origin,
        "spheres": len(bed.radius),
        "rounds": chosen.rounds,
        "peer": "" if folder else "The peer was not measured: no liggghts or mpirun on PATH.",
        "ours": [
            {"name": t.name, "steps": t.steps, "compile_seconds": t.compile_seconds} for t in ours
        ],
        "measured": measured,
    }
    reporting.write_page(markdown(content))


if __name__ == "__main__":
    main()
