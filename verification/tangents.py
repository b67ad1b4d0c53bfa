"""Growth of a derivative along both tests: pathwise, and with more or less drag in contacts.

Derivatives with respect to three parameters are carried through both tests, on beds of several
sizes.  A derivative of the platen's force that grows beyond the force itself is none of the soil.
Too little drag lets it grow; too much holds contacts that slide, and then depth's slope in the
tangential multiplier is too large.  Differences of runs over +-20 % stand beside it.

    python -m verification.tangents               some 20 minutes on two cores
    python -m verification.tangents --chain       some 4 minutes: why a derivative does not see a
                                                  crushing force

What values with seven derivatives cost, in forward runs, is measured in turn with values alone.

Each size and drag is kept once it is there, in results/benchmarks.  Writes
notebooks/data/tangents.json, verification/results/tangents.md and docs/images/tangents.png.
"""

import argparse
import json
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from calibrate.core.files import write_text
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.io.soil import base_soil, with_values
from calibrate.simulation import Campaign
from calibrate.simulation.resolution import PRESETS, specimen, virtual_lab
from jdem.core.vector import Vector
from jdem.engine.loop import AbstractDerivative, run, start
from jdem.engine.segment import cell_segment, stack
from jdem.engine.state import TangentDrag
from jdem.laboratory.virtual_lab import VirtualLab
from jdem.packing.specimen import Packing
from jdem.sensitivity.overdamped import Overdamped, OverdampedMotion
from tests.support.hand_made_beds import FAR, RADIUS, Smoothing, bed_of, soil_of, spheres_of
from verification import reporting

SEVEN = ("restitution", "static_friction", "rolling_friction", "surface_energy", "plasticity_ratio",
         "tangential_multiplier", "shear_modulus")  # fmt: skip
PARAMETERS = ("shear_modulus", "tangential_multiplier", "rolling_friction")
SIZES = (150, 500, 1000, 2500)
DRAGS = (None, 0.05, 0.2, 0.4)  # in contacts; None: pathwise
SHOWN = 500  # spheres of the picture's left half
STEP = 0.2  # in ln p, of differences
STAGES = ("loading", "unloading", "crushing")
COLOURS, LINES, MARKS = ("#9fb7c9", "#7a7a7a", "#20344f", "#c4622d"), (":", "--", "-", "-."), "osD^"
POINTS = 200
BEYOND = 1e18  # where the picture ends
FREED = 0.23  # share of both tests after which the specimen stands free
ROUNDS = 3


class Case:
    """Both tests of the bundled soil on packings of one size."""

    def __init__(self, spheres: int, packings: int, folder: Path):
        lab = load_lab(bundled_lab())
        preset = replace(PRESETS["standard"], spheres=spheres)
        self.soil, self.plain = base_soil(lab), virtual_lab(lab, preset)
        campaign = Campaign(self.plain, specimen(lab, preset), folder)
        self.packings = campaign.packings(range(packings))

    def run(self, virtual: VirtualLab, packing: Packing, time_step, x, names=PARAMETERS):
        """The platen's force (N), depth (mm), and the segments of the samples."""
        old = [getattr(self.soil, name) for name in names]
        changed = {n: jnp.exp(v) * p for n, v, p in zip(names, x, old, strict=True)}
        found = virtual.run(packing, with_values(self.soil, changed), time_step)
        depth = 1e3 * found.observables["confined"]["depression_depth"]
        samples = found.record.samples
        return (samples.platen_force, depth), samples.segment

    def derivatives(self, drag: float | None):
        """On each packing the force (N), the derivatives of force and depth, and segments."""
        virtual = self.plain
        if drag is not None:
            virtual = Overdamped(contact=jnp.asarray(drag)).laboratory(self.plain)

        def on(packing: Packing) -> list[np.ndarray]:
            found = self._taken(virtual, packing, self.plain.time_step(packing, self.soil))
            return [np.asarray(part) for part in found]

        with ThreadPoolExecutor(2) as pool:
            return list(pool.map(on, self.packings))

    @cached_property
    def _taken(self):
        """Compiled once for all drags."""

        @eqx.filter_jit
        def taken(virtual, packing, time_step):
            def push(tangent):
                run = partial(self.run, virtual, packing, time_step)
                return jax.jvp(run, (origin,), (tangent,), has_aux=True)

            origin = jnp.zeros(len(PARAMETERS))
            pushed = jax.vmap(push, out_axes=(None, -1, None))(jnp.eye(len(origin)))
            (force, _), slopes, segment = pushed
            return force, *slopes, segment

        return taken

    def differences(self) -> list[float]:
        """Slopes of depth (mm) over +-STEP in each parameter, means over the packings."""

        @eqx.filter_jit
        def depth(packing, time_step, x):
            return self.run(self.plain, packing, time_step, x)[0][1]

        def on(packing: Packing) -> list[float]:
            time_step = self.plain.time_step(packing, self.soil)
            moved = STEP * jnp.eye(len(PARAMETERS))
            pairs = [[depth(packing, time_step, s * x) for s in (1, -1)] for x in moved]
            return [float(up - down) / (2 * STEP) for up, down in pairs]

        with ThreadPoolExecutor(2) as pool:
            return np.mean(list(pool.map(on, self.packings)), axis=0).tolist()


def cost(case: Case) -> dict:
    """Forward runs that values with seven derivatives take: of both tests and of the first alone;
    the median of some rounds, each with both ways in turn, one packing, compiled before."""
    packing, origin, found = case.packings[0], jnp.zeros(len(SEVEN)), {}
    for name, count in (("confined", 1), ("both tests", 2)):
        tests = replace(case.plain.tests, apparatus=case.plain.tests.apparatus[:count])
        plain = replace(case.plain, tests=tests)
        time_step = plain.time_step(packing, case.soil)

        @eqx.filter_jit
        def values(virtual, time_step, x):
            return case.run(virtual, packing, time_step, x, SEVEN)[0]

        @eqx.filter_jit
        def slopes(virtual, time_step, x):
            def push(tangent):
                return jax.jvp(partial(values, virtual, time_step), (x,), (tangent,))

            return jax.vmap(push, out_axes=(None, -1))(jnp.eye(len(SEVEN)))

        overdamped = Overdamped().laboratory(plain)
        ratios = []
        for _ in range(ROUNDS + 1):
            taken = [_seconds(values, plain, time_step, origin),
                     _seconds(slopes, overdamped, time_step, origin)]  # fmt: skip
            ratios.append(taken[1] / taken[0])
        found[name] = float(np.median(ratios[1:]))
    return found


def _seconds(function, *arguments) -> float:
    begun = time.perf_counter()
    jax.block_until_ready(function(*arguments))
    return time.perf_counter() - begun


def measured(case: Case, drag: float | None) -> dict:
    """Sizes over the largest force, by stage: the median and largest of packings and parameters;
    depth's slopes; and how the size goes along the tests."""
    names, sizes, depths, traces = case.plain.tests.names, [], [], []
    for force, slope, depth, segment in case.derivatives(drag):
        share = slope / np.abs(force).max()
        sizes.append([[_rms(column[segment == names.index(stage)]) for stage in STAGES]
                      for column in share.T])  # fmt: skip
        depths.append(depth)
        traces.append(_trace(share[segment >= 0]))
    by_stage = np.array(sizes).reshape(-1, len(STAGES))
    rows = (np.median(by_stage, axis=0), by_stage.max(axis=0))
    keyed = [dict(zip(STAGES, map(_number, row), strict=True)) for row in rows]
    trace = [np.linspace(0, 1, POINTS).tolist(), [*map(_number, np.median(traces, axis=0))]]
    return {"typical": keyed[0], "worst": keyed[1], "depth": np.mean(depths, axis=0).tolist(),
            "trace": trace}  # fmt: skip


def _number(value: float) -> float | None:
    """None for what is too large to be computed."""
    return float(value) if np.isfinite(value) else None


def _shown(typical: float | None, worst: float | None) -> str:
    """Both sizes; derivatives that are zero all along were not followed."""
    if worst == 0:
        return "not followed"
    sizes = ["overflow" if value is None else f"{value:.2g}" for value in (typical, worst)]
    return "{} ({})".format(*sizes)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _trace(shares: np.ndarray) -> np.ndarray:
    """log10 of the size of shares (samples, parameters), over a common axis from 0 to 1."""
    squares = np.convolve(np.mean(shares**2, axis=1), np.ones(15) / 15, mode="same")
    axis = np.linspace(0, 1, len(squares))
    return np.interp(np.linspace(0, 1, POINTS), axis, 0.5 * np.log10(squares + 1e-16))


def label(drag: float | None) -> str:
    """What tables and pictures call a variant."""
    if drag is None:
        return "pathwise"
    default = " (default)" if drag == float(Overdamped().contact) else ""
    return f"drag {drag:g}{default}"


def figure(found: dict, path: Path) -> None:
    """Left: along the tests as far as they are followed, one line a drag; right: the largest while
    loading, over the size."""
    drawn, (along, over) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    sizes = sorted(map(int, found))
    for drag, colour, line, mark in zip(DRAGS, COLOURS, LINES, MARKS, strict=True):
        name = label(drag)
        share, size = (np.array(c, float) for c in found[str(SHOWN)]["variants"][name]["trace"])
        along.plot(share, np.where(size > -6, size, np.nan), line, color=colour, label=name)
        worst = np.array([found[str(n)]["variants"][name]["worst"]["loading"] for n in sizes])
        over.loglog(sizes, np.minimum(worst, BEYOND), line, marker=mark, color=colour, label=name)
        for spheres, value in zip(sizes, worst, strict=True):
            if value > BEYOND:
                mantissa = f"$10^{{{np.log10(value):.0f}}}$"
                over.annotate(mantissa, (spheres, BEYOND), (-28, -12), textcoords="offset points")
    along.axhline(0, color="0.7", lw=3, zorder=0)
    along.set(xlabel="share of both tests that has passed (-)", ylim=(-4, 12), xlim=(0, FREED),
              ylabel="log10 of |dF/d ln p| over the largest force (-)",
              title=f"{SHOWN} spheres")  # fmt: skip
    over.axhline(1, color="0.7", lw=3, zorder=0)
    over.set(xlabel="spheres (-)", title="loading in the mould, worst of all",
             ylabel="|dF/d ln p| over the largest force (-)", ylim=(0.03, 10 * BEYOND))  # fmt: skip
    over.set_xticks(sizes, map(str, sizes))
    over.minorticks_off()
    over.legend(frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    drawn.savefig(path, dpi=130)


def markdown(found: dict, packings: int, origin: dict) -> str:
    rows = []
    for spheres, entry in sorted(found.items(), key=lambda item: int(item[0])):
        for name, each in entry["variants"].items():
            sizes = [_shown(each["typical"][s], each["worst"][s]) for s in STAGES]
            rows.append([spheres, name, *sizes, *(f"{slope:.3g}" for slope in each["depth"])])
        blank = [""] * len(STAGES)
        rows.append([spheres, "differences", *blank, *(f"{s:.3g}" for s in entry["differences"])])
    costs = ", ".join(f"{name} {runs:.1f}" for name, runs in found[str(SHOWN)]["cost"].items())
    slopes = [f"dH/d ln {name} (mm)" for name in PARAMETERS]
    return (
        "# Growth of derivatives\n\nRoot mean square of d(platen force)/d ln p along each stage, "
        f"over the largest force; {len(PARAMETERS)} parameters, {packings} packings: "
        "median (largest). "
        "Depth's slopes are means over the packings.\n\n"
        + reporting.table(("spheres", "drag in contacts", *STAGES, *slopes), rows)
        + f"\nValues with {len(SEVEN)} derivatives, {SHOWN} spheres, in forward runs: {costs}.\n"
        + reporting.footer(origin)
    )


# ---------------------------------------------------------------- a chain that is pulled apart

TRAVEL, SPEED, STEPS = 4e-3, 0.05, 10  # m, m/s
CHAINS = ((4, 2.0), (12, 5.0))  # spheres, exponent of the adhesive branch
CHAIN = ("spheres", "tensile exponent", "largest tension (N)", "difference (mN)",
          "pathwise", "overdamped")  # fmt: skip


def pulled(count: int, exponent: float):
    """Platen's forces (N) while pulling, as a function of the shift in ln surface energy."""
    plain = {"plasticity_ratio": 0.5, "shear_modulus": 1e6, "restitution": 0.4}
    time_step = bed_of(spheres_of(count), soil_of(**plain), gravity=0.0).time_step
    z = RADIUS * (2 * jnp.arange(count) + 1.0)
    legs = stack(
        [
            cell_segment(platen_speed=v, duration=way / SPEED, damping=500.0)
            for v, way in ((SPEED, TRAVEL), (-SPEED, 2 * TRAVEL))
        ]
    )

    @eqx.filter_jit
    def force(shift, derivative: AbstractDerivative | None = None):
        adhesion = {"surface_energy": 60 * jnp.exp(shift), "wall_adhesion": 1.0}
        soil = soil_of(**plain, **adhesion, tensile_exponent=exponent)
        bed = bed_of(spheres_of(count), soil, gravity=0.0, smoothing=Smoothing())
        bed = eqx.tree_at(lambda b: b.time_step, bed, time_step)
        state = start(bed, Vector(0 * z, 0 * z, z), 2 * RADIUS * count, FAR)
        samples = run(bed, state, legs, jnp.asarray(STEPS), 4096, derivative=derivative).samples
        return jnp.where(samples.segment == 1, samples.platen_force, jnp.nan)

    return force


def of_chain(count: int, exponent: float) -> dict:
    """Mean slope (N per ln surface energy) while pulling, by differences and both derivatives."""
    force, given = pulled(count, exponent), Overdamped()
    drag = TangentDrag(given.background, given.contact)
    ways = {"pathwise": None, "overdamped": OverdampedMotion(drag, turning=())}
    up, down = (np.asarray(force(jnp.asarray(s))) for s in (STEP, -STEP))
    difference = float(np.nanmean(up - down) / (2 * STEP))
    slopes = {}
    for name, way in ways.items():
        _, slope = jax.jvp(lambda x, way=way: force(x, way), (jnp.zeros(()),), (jnp.ones(()),))
        slopes[name] = float(np.nansum(slope) / np.sum(np.isfinite(up)))
    tension = -float(np.nanmin(np.asarray(force(jnp.zeros(())))))
    return {"spheres": count, "exponent": exponent, "tension": tension,
            "difference": difference, **slopes}  # fmt: skip


def chain() -> None:
    """Writes the section of chains of spheres that are pressed and pulled apart: far from the
    moment when one contact lets go, the force does not know how strong it is."""
    found = [of_chain(*chain) for chain in CHAINS]
    rows = [
        [
            str(each["spheres"]),
            f"{each['exponent']:g}",
            f"{each['tension']:.3f}",
            f"{1e3 * each['difference']:.2f}",
            *(f"{each[way] / each['difference']:.0%}" for way in ("pathwise", "overdamped")),
        ]
        for each in found
    ]
    origin = reporting.provenance()
    text = (
        "# A chain that is pulled apart\n\nMean over the pulling of d(force)/d ln(surface energy): "
        f"by differences over +-{STEP:g}, and the share of it that each derivative finds.\n\n"
        + reporting.table(CHAIN, rows)
        + reporting.footer(origin)
    )
    reporting.write_section("tangents", text)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--packings", type=int, default=2)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--folder", type=Path, default=reporting.CACHE, help="what is kept")
    parser.add_argument("--chain", action="store_true", help="the chain that is pulled apart")
    chosen = parser.parse_args()
    reporting.configure()
    if chosen.chain:
        return chain()
    kept = reporting.kept("tangents", chosen.folder) / f"{chosen.packings}.json"
    found = json.loads(kept.read_text()) if kept.exists() else {}
    for spheres in chosen.sizes:
        case = Case(spheres, chosen.packings, chosen.folder / "tangents")
        entry = found.setdefault(str(spheres), {"variants": {}})
        for drag in DRAGS:
            if label(drag) not in entry["variants"]:
                entry["variants"][label(drag)] = measured(case, drag)
                write_text(kept, json.dumps(found))
                print(spheres, label(drag), entry["variants"][label(drag)]["typical"], flush=True)
        if "differences" not in entry:
            entry["differences"] = case.differences()
            write_text(kept, json.dumps(found))
        if spheres == SHOWN and "cost" not in entry:
            entry["cost"] = cost(case)
            write_text(kept, json.dumps(found))
    origin = reporting.provenance()
    shown = found[str(SHOWN)]["variants"]
    variants = {name: {"typical": of["typical"]} for name, of in shown.items()}  # what is drawn
    content = {**origin, "seed": 0, "packings": chosen.packings, "variants": variants}
    figure(found, reporting.IMAGES / "tangents.png")
    reporting.write_content("tangents", content)
    reporting.write_section("tangents", markdown(found, chosen.packings, origin))


if __name__ == "__main__":
    main()
