"""Time of one step against the number of spheres, of tangents, of runs at once, and of cores.

    spheres    one settled bed of 500, stacked 1 to 40 times (500 to 20 000 spheres)
    tangents   forward mode through the same steps with 0 to 7 parameters moved
    batch      one program for many soils (`vmap`), sharded over the devices where there are several
    floor      operations and bytes of a step over what one core does of them in plain loops

    python benchmarks/scaling.py                    about 8 minutes on two idle cores
    python benchmarks/scaling.py --part batch --batch 1 16 256    on an accelerator

Every time is the least of --rounds measurements of the same number of steps at any size, with
the list rebuilds that they need, after two that are not counted.  The step is the whole time
step of both tests, walls included.  A run of 500 spheres and one in 20 000 load the same bed,
so contacts per sphere are equal; what differs is how much of it the processor's cache holds.
Writes benchmarks/results/scaling.json and .md; parts that are not asked for stay as an earlier
call on the same kind of device left them.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any
from unittest.mock import patch

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import reporting
import speed
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from calibrate.inference.parameters import FACTORS
from calibrate.io.soil import with_values
from jdem.bodies.spheres import Spheres
from jdem.core import kernel
from jdem.core.quantity import cast
from jdem.engine.loop import Record, run, start
from jdem.engine.segment import Segment
from jdem.engine.step import Bed, BedState, Command, step
from jdem.packing.composite import prepare
from jdem.packing.specimen import Specimen

BED, COPIES = 500, (1, 2, 4, 10, 20, 40)
SAMPLES = 20
PARTS = ("spheres", "tangents", "batch", "floor")


def column(copies: int) -> speed.Spread:
    """A settled bed of BED spheres, stacked."""
    bed = settled()
    lifted = [bed.centres + np.array([0.0, 0.0, k * bed.height]) for k in range(copies)]
    return speed.Spread(
        np.concatenate(lifted), np.tile(bed.radius, copies), np.tile(bed.mass, copies), "stacked"
    )


@cache
def settled() -> speed.Spread:
    """The bed that is stacked."""
    specimen = Specimen(
        diameter=2 * speed.MOULD_RADIUS, height=0.1, density=0.57 * speed.DENSITY, count=BED
    )
    packing = prepare(specimen, 0)
    centres, radius = np.asarray(packing.position.stack()), np.asarray(packing.spheres.radius)
    return speed.Spread(centres, radius, np.asarray(packing.spheres.mass), "packing 0 of jdem")


class Steps:
    """The first SAMPLES samples of loading a bed, as a function of ln p of the seven factors."""

    def __init__(self, bed: speed.Spread, dtype: str):
        self.bed, self._dtype, self.spheres = bed, dtype, len(bed.radius)
        self.numerics = speed.numerics_of(bed, dtype)
        interval = speed.numerics_of(settled(), dtype).sample_time  # a bed's, however many stand
        self.every = max(1, round(interval / speed.TIME_STEP))
        self.steps = SAMPLES * self.every
        self.point = jnp.log(jnp.asarray([float(getattr(speed.SOIL, n)) for n in FACTORS]))

    def given(self, point: jax.Array) -> tuple[Bed, BedState, Segment, jax.Array]:
        """What `run` is given, for a soil."""
        soil = with_values(speed.SOIL, dict(zip(FACTORS, jnp.exp(point), strict=True)))
        built = speed.built_bed(self.bed, self.numerics, soil)
        bed, centres = self.bed, speed.vector(self.bed.centres)
        state = start(built, centres, bed.height, speed.MOULD_RADIUS)
        state = cast(state, jnp.dtype(self._dtype))
        return built, state, speed.loading(400.0, self._dtype), jnp.asarray(self.every)

    def compiled(self) -> Callable[[], Record]:
        """The run as a campaign compiles it: bed, soil and state are arguments."""
        given = self.given(self.point)
        program = speed.compiled_run(*given[:3], self.every, SAMPLES)
        return lambda: program(*given)

    def force(self, point: jax.Array, spheres: Spheres, state: BedState) -> jax.Array:
        """The platen's force; what does not depend on the soil is given, or the compiler would
        know it."""
        bed, _, programme, every = self.given(point)
        bed = eqx.tree_at(lambda b: b.spheres, bed, spheres)
        return run(bed, state, programme, every, SAMPLES).samples.platen_force

    def checked(self) -> "Steps":
        """Refuses a bed whose lists overflow: its time would mean nothing."""
        record, grid = self.compiled()(), self.given(self.point)[0].grid
        if bool(record.overflow_of(grid)):
            raise RuntimeError(record.explain_overflow(grid))
        return self


def seconds(function: Callable, rounds: int, threads: int = 1) -> float:
    """Least wall time of a compiled function, run `threads` times at once, after two that
    bring memory and caches into use."""
    found = []
    for _ in range(2 + rounds):
        begun = time.perf_counter()
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(lambda _: jax.block_until_ready(function()), range(threads)))
        found.append(time.perf_counter() - begun)
    return min(found[2:])


def timed_spheres(rounds: int) -> list[dict]:
    """Milliseconds a step, by number of spheres: one run, and two runs on two cores."""
    rows = []
    for copies in COPIES:
        bed = column(copies)
        row: dict[str, Any] = {"spheres": len(bed.radius)}
        for dtype in ("float64", "float32"):
            steps = Steps(bed, dtype).checked()
            compiled = steps.compiled()
            for threads in (1, 2):
                spent = seconds(compiled, rounds, threads)
                row[f"{dtype}, {threads} at once"] = 1e3 * spent / steps.steps
        rows.append(row)
        print(row, flush=True)
    return rows


def exponents(rows: list[dict]) -> dict[str, float]:
    """Slope of ln(time a step) over ln(spheres), from 1000 spheres on."""
    large = [row for row in rows if row["spheres"] >= 1000]
    size = np.log([row["spheres"] for row in large])
    return {
        name: float(np.polyfit(size, np.log([row[name] for row in large]), 1)[0])
        for name in rows[0]
        if name != "spheres"
    }


def timed_tangents(rounds: int) -> list[dict]:
    """Milliseconds a step with k tangents, 1000 spheres in float64."""
    steps, rows = Steps(column(2), "float64"), []
    bed, state, *_ = steps.given(steps.point)
    known = (steps.point, bed.spheres, state)
    for count in (0, 1, 3, 7):
        directions = jnp.eye(len(FACTORS))[:count]

        def pushed(point, *given, directions=directions):
            def force(point):
                return steps.force(point, *given)

            return jax.vmap(lambda d: jax.jvp(force, (point,), (d,)))(directions)

        compiled = jax.jit(pushed if count else steps.force).lower(*known).compile()
        spent = seconds(lambda c=compiled: c(*known), rounds)
        rows.append({"tangents": count, "ms": 1e3 * spent / steps.steps})
        print(rows[-1], flush=True)
    return [{**row, "forward_runs": row["ms"] / rows[0]["ms"]} for row in rows]


def timed_batch(sizes: Sequence[int], rounds: int) -> list[dict]:
    """M particle-steps/s of many soils in one program, 1000 spheres in float64 and float32."""
    bed, rows, devices = column(2), [], np.array(jax.devices())
    for size in sizes:
        row: dict[str, Any] = {"runs": size}
        for dtype in ("float64", "float32"):
            steps = Steps(bed, dtype)
            shift = 1e-3 * jnp.arange(size)[:, None]
            points = steps.point + shift - jnp.mean(shift)
            if size % len(devices) == 0:
                mesh = NamedSharding(Mesh(devices, ("runs",)), PartitionSpec("runs"))
                points = jax.device_put(points, mesh)
            built, state, *_ = steps.given(steps.point)
            known = (points, built.spheres, state)
            compiled = jax.jit(jax.vmap(steps.force, (0, None, None))).lower(*known).compile()
            spent = seconds(lambda c=compiled, k=known: c(*k), rounds)
            row[dtype] = 1e-6 * size * steps.spheres * steps.steps / spent
        rows.append(row)
        print(row, flush=True)
    return rows


def timed_floor(rounds: int) -> dict[str, float]:
    """A step of 1000 spheres in float64: XLA's count of operations and bytes, the rates at which
    one core does them in loops that do nothing else, and what a step takes."""
    steps = Steps(column(2), "float64").checked()
    bed, state, *_ = steps.given(steps.point)
    zero = jnp.zeros(())
    command = Command(jnp.zeros((3, len(state.boundaries))), zero, zero)
    with patch.object(kernel, "_COMPILABLE", frozenset()):  # XLA does not count inside a kernel
        compiled = eqx.filter_jit(step).lower(bed, state, command).compile().compiled
    cost: Any = compiled.cost_analysis()
    measured = seconds(steps.compiled(), rounds) / steps.steps
    operations, traffic = _core_rates(rounds)
    counted = {"flops": float(cost["flops"]), "bytes": float(cost["bytes accessed"])}
    return {
        **counted,
        "flops_per_s": operations,
        "bytes_per_s": traffic,
        "ms_by_flops": 1e3 * counted["flops"] / operations,
        "ms_by_bytes": 1e3 * counted["bytes"] / traffic,
        "ms_measured": 1e3 * measured,
    }


def _core_rates(rounds: int) -> tuple[float, float]:
    """Operations a second of a fused polynomial, bytes a second of an addition, both in a
    working set of 256 kB, as large as a step's rows."""
    x, repeats, order = jnp.linspace(0.0, 1.0, 16384), 200, 64

    def polynomial(x):
        def nest(_, y):
            for _ in range(order // 2):
                y = y * x + 0.5
            return y

        return jax.lax.fori_loop(0, repeats, nest, x)

    def addition(x):
        return jax.lax.fori_loop(0, repeats, lambda _, y: x + 0.5 * y, x)

    compiled = [jax.jit(f).lower(x).compile() for f in (polynomial, addition)]
    arithmetic, memory = (seconds(lambda c=c: c(x), rounds) for c in compiled)
    return order * repeats * x.size / arithmetic, 3 * x.nbytes * repeats / memory


def markdown(content: dict) -> str:
    text = f"# Scaling\n\nDevice: {content['device']}. Steps of a loaded bed, list rebuilds in.\n\n"
    if "spheres" in content:
        found = content["spheres"]
        text += "Milliseconds a step, by number of spheres:\n\n" + _table(found) + "\n"
        slopes = ", ".join(f"{v:.2f} ({k})" for k, v in exponents(found).items())
        text += f"Time grows from 1000 spheres on with the power {slopes}.\n\n"
    if "tangents" in content:
        text += "Forward mode, 1000 spheres, float64:\n\n" + _table(content["tangents"]) + "\n"
    if "batch" in content:
        text += "One program for many soils, M particle-steps/s:\n\n" + _table(content["batch"])
    if "floor" in content:
        found = {name: f"{value:.3g}" for name, value in content["floor"].items()}
        text += "\nFloor of one step, 1000 spheres, float64, one core:\n\n"
        text += reporting.table(list(found), [list(found.values())])
    if content["device"].startswith("cpu"):
        text += "\nNo accelerator was at hand: `--part batch` has not been run on one.\n"
    return text + reporting.footer(content)


def _table(rows: list[dict]) -> str:
    cells = [[f"{value:.4g}" for value in row.values()] for row in rows]
    return reporting.table(list(rows[0]), cells)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--part", choices=PARTS, action="append", help="default: all")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--batch", type=int, nargs="+", default=[1, 2, 8])
    chosen = parser.parse_args()
    reporting.configure()
    device = jax.devices()[0]
    name = f"{device.platform} ({device.device_kind}) x {jax.device_count()}"
    parts = {
        "spheres": lambda: timed_spheres(chosen.rounds),
        "tangents": lambda: timed_tangents(chosen.rounds),
        "batch": lambda: timed_batch(chosen.batch, chosen.rounds),
        "floor": lambda: timed_floor(chosen.rounds),
    }
    kept = {k: reporting.earlier("scaling", k) for k in PARTS if k not in (chosen.part or PARTS)}
    content = {**reporting.provenance(), "seed": 0, "device": name}
    content |= {key: value for key, value in kept.items() if value}
    for part in chosen.part or PARTS:
        content[part] = parts[part]()
        reporting.write("scaling", content, markdown(content))


if __name__ == "__main__":
    main()
