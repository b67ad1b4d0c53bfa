"""Virtual power against the committed audit's references, on the same packings.

    python benchmarks/virtual_power.py                 8 packings of 300 spheres, about 3 hours
    python benchmarks/virtual_power.py --float32       in single precision

The references and the ensemble's slopes are those of benchmarks/results/audit.json (all of its
packings of one seed); virtual power is computed on the first of the same packings, and once more
on some of them with nothing carried over from the tests before (`FrozenMotion.carried`).  The
blend weighs virtual power and ensemble (`jdem.sensitivity.composite`).  Cost is processor time of
all slopes on one packing over that of one run.  Finished packings are kept in results/benchmarks;
a second call resumes.  Writes benchmarks/results/virtual_power.json and .md after every packing.
"""

import argparse
import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import reporting

from calibrate.audit import OBSERVABLES, POINTS, CurvePoints, judged, traced
from calibrate.campaign import Campaign, engine_hash
from calibrate.measurements import bundled_lab, load_lab
from calibrate.parameters import FACTORS, Space, space
from calibrate.presets import PRESETS, numerics_for, specimen, virtual_lab
from jdem.experiments.composite import VirtualLab
from jdem.packing import Packing
from jdem.sensitivity.base import Sensitivity, averaged
from jdem.sensitivity.composite import blended
from jdem.sensitivity.virtual_power import VirtualPower

NAMES = (*FACTORS, "shear_modulus")
VARIANTS = {"carried": VirtualPower(), "dropped": VirtualPower(carried=False)}


@dataclass(frozen=True)
class Bench:
    """What is measured with: the audit's soil, specimen and tests, and where results are kept."""

    work: Campaign
    space: Space
    points: CurvePoints
    folder: Path

    @staticmethod
    def of(spheres: int, dtype: str, folder: Path) -> "Bench":
        lab = load_lab(bundled_lab())
        preset = replace(PRESETS["quick"], spheres=spheres)
        cylinder = specimen(lab, preset)
        virtual = virtual_lab(lab, preset, numerics_for(cylinder, dtype=dtype))
        work = Campaign(virtual, cylinder, folder)
        return Bench(work, space(lab, NAMES), CurvePoints.of(work), folder)

    @property
    def lab(self) -> VirtualLab:
        return self.work.lab

    def slopes(self, variant: str) -> Callable[[int], dict]:
        """Slopes (m, p) as `result`, and processor seconds, on the packing of a seed."""
        strategy = VARIANTS[variant]
        both = traced(strategy, strategy.laboratory(self.lab), self.space, self.points)
        each = eqx.filter_jit(lambda packing, time_step: both(packing, time_step)[1])

        def on(seed: int) -> dict:
            return self.kept(f"{self._hash(variant)}-{seed}", each, seed)

        return on

    def run_seconds(self, seed: int) -> float:
        """Processor seconds of one run of both tests at the base soil."""

        @eqx.filter_jit
        def forward(packing: Packing, time_step):
            return self.points.traced(self.lab.run(packing, self.space.base, time_step))

        return float(self.kept(f"{self._hash()}-run-{seed}", forward, seed)["seconds"])

    def kept(self, name: str, program, seed: int) -> dict:
        """What a program gives for the packing of a seed, from disk if it is there."""
        path = self.folder / "virtual_power" / f"{name}.npz"
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            result, seconds = self.timed(program, self.work.packings([seed])[0])
            np.savez(path, result=np.asarray(result), seconds=seconds)
        return dict(np.load(path))

    def timed(self, program, packing: Packing):
        """What a compiled program gives for a packing, and its processor seconds."""
        step = self.lab.time_step(packing, self.space.base)
        compiled = program.lower(packing, step).compile()
        begun = time.process_time()
        result = jax.block_until_ready(compiled(packing, step))
        return result, time.process_time() - begun

    def _hash(self, variant: str | None = None) -> str:
        strategy = VARIANTS[variant] if variant else None
        content = [engine_hash(), repr(strategy), repr(self.lab.numerics)]
        content.append(repr(self.work.specimen))
        return hashlib.sha256("".join(content).encode()).hexdigest()[:16]


def committed(seed: str) -> tuple[Sensitivity, Sensitivity, int]:
    """The audit's reference and ensemble (slopes and standard errors), and its packings."""
    content = json.loads((reporting.RESULTS / "audit.json").read_text(encoding="utf-8"))
    found = content["audits"][seed]
    rows = {(r["observable"], r["parameter"]): r for r in found["rows"]}
    keys = [[(observable, name) for name in NAMES] for observable in OBSERVABLES]

    def part(name: str) -> Sensitivity:
        slopes, errors = (
            jnp.asarray([[rows[key][kind] for key in line] for line in keys])
            for kind in (name, f"{name}_se")
        )
        return Sensitivity(jnp.zeros((1, len(keys))), slopes, errors)

    return part("reference"), part("estimate"), found["packings"]


def curve_means(seed: str, found: list[dict]) -> list[dict]:
    """Slopes (N) of the force averaged over the whole crushing curve: audit's and these."""
    content = json.loads((reporting.RESULTS / "audit.json").read_text(encoding="utf-8"))
    curves = content["audits"][seed]["curves"]["unconfined"]["slopes"]
    each = np.array([one["result"][-POINTS:].mean(axis=0) for one in found])
    errors = each.std(axis=0, ddof=1) / np.sqrt(len(each))
    return [
        {
            "parameter": name,
            "reference": float(np.mean(curves[name]["reference"]["slope"])),
            "estimate": float(each[:, p].mean()),
            "estimate_se": float(errors[p]),
        }
        for p, name in enumerate(NAMES)
    ]


def rows(reference: Sensitivity, estimate: Sensitivity) -> list[dict]:
    """The audit's rows, judged by the audit's rules."""
    return [
        judged(
            {
                "parameter": name,
                "observable": observable,
                "estimate": float(estimate.slopes[m, p]),
                "estimate_se": float(estimate.standard_error[m, p]),
                "reference": float(reference.slopes[m, p]),
                "reference_se": float(reference.standard_error[m, p]),
            }
        )
        for m, observable in enumerate(OBSERVABLES)
        for p, name in enumerate(NAMES)
    ]


def together(found: list[dict]) -> Sensitivity:
    """Slopes of both observables on several packings."""
    count = len(OBSERVABLES)
    slopes = jnp.asarray([each["result"][:count] for each in found])
    return averaged(jnp.zeros(slopes.shape[:2]), slopes)


def content_of(found: dict[str, list[dict]], run_seconds: float, seed: str) -> dict:
    """Everything that is reported."""
    reference, ensemble, packings = committed(seed)
    estimates = {name: together(each) for name, each in found.items() if len(each) > 1}
    estimates["blend"] = blended(estimates["carried"], ensemble)
    seconds = {name: [float(one["seconds"]) for one in each] for name, each in found.items()}
    return {
        "reference_packings": packings,
        "packings": {name: len(each) for name, each in found.items()},
        "rows": {name: rows(reference, each) for name, each in estimates.items()},
        "each": {
            name: [one["result"][: len(OBSERVABLES)].tolist() for one in each]
            for name, each in found.items()
        },
        "curve_means": curve_means(seed, found["carried"]),
        "run_seconds": run_seconds,
        "seconds": seconds,
        "forward_runs": {
            name: float(np.median(each)) / run_seconds for name, each in seconds.items()
        },
    }


def markdown(content: dict, chosen: argparse.Namespace, origin: dict) -> str:
    counts, runs = content["packings"], content["forward_runs"]
    what = VARIANTS["carried"].describe()
    text = (
        f"# Virtual power\n\nBundled soil, {chosen.spheres} spheres, "
        f"{'float32' if chosen.float32 else 'float64'}. References are the audit's, on "
        f"{content['reference_packings']} packings (`audit.md`, seed {chosen.seed}; an earlier "
        f"engine). Virtual power on {counts['carried']} of them ({what}); "
        f"with nothing carried over on {counts.get('dropped', 0)}; blend of virtual power and "
        "ensemble. Slopes per unit of ln p, mm (H) and N (F), with standard errors; "
        "judged as in the audit.\n\n"
    )
    cost = ", ".join(f"{value:.1f} ({name})" for name, value in runs.items())
    cost = f"\nCost of all slopes on one packing, in forward runs: {cost}.\n"
    means = [
        [row["parameter"], f"{row['reference']:.3g}", _with_error(row, "estimate")]
        for row in content["curve_means"]
    ]
    curve = "\nThe same for the force averaged over the whole crushing curve (N):\n\n"
    curve += reporting.table(("parameter", "reference", "virtual power"), means)
    slopes = reporting.table(HEADER, table_rows(content["rows"]))
    return text + slopes + curve + cost + reporting.footer(origin)


HEADER = ("parameter", "of", "reference", "virtual power", "verdict", "nothing carried",
          "blend", "verdict of the blend")  # fmt: skip


def table_rows(found: dict[str, list[dict]]) -> list[list[str]]:
    """One line for each slope; those that can be judged come first."""
    lines = []
    dropped = found.get("dropped", [None] * len(found["carried"]))
    for power, without, blend in zip(found["carried"], dropped, found["blend"], strict=True):
        line = [
            power["parameter"],
            "H" if power["observable"] == OBSERVABLES[0] else "F",
            _with_error(power, "reference"),
            _with_error(power, "estimate"),
            _word(power),
            _with_error(without, "estimate") if without else "",
            _with_error(blend, "estimate"),
            _word(blend),
        ]
        lines.append((not power["judged"], line))
    return [line for _, line in sorted(lines, key=lambda pair: pair[0])]


def _with_error(row: dict, key: str) -> str:
    return f"{row[key]:.3g} ± {row[f'{key}_se']:.2g}"


def _word(row: dict) -> str:
    if not row["judged"]:
        return "not judged"
    return f"{'passed' if row['passed'] else 'FAILED'} ({100 * row['relative_error']:+.0f} %)"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--spheres", type=int, default=300)
    parser.add_argument("--packings", type=int, default=8)
    parser.add_argument("--dropped", type=int, default=3, help="packings with nothing carried")
    parser.add_argument("--seed", default="0", help="the audit's seed")
    parser.add_argument("--float32", action="store_true")
    parser.add_argument("--folder", type=Path, default=reporting.CACHE, help="what is kept")
    chosen = parser.parse_args()
    reporting.configure()
    bench = Bench.of(chosen.spheres, "float32" if chosen.float32 else "float64", chosen.folder)
    first = 100 * int(chosen.seed)
    found: dict[str, list[dict]] = {"carried": []}
    run_seconds = bench.run_seconds(first)
    for variant, count in (("carried", chosen.packings), ("dropped", chosen.dropped)):
        found[variant] = []
        slopes = bench.slopes(variant)
        for seed in range(first, first + count):
            found[variant].append(slopes(seed))
            if len(found["carried"]) > 1:
                origin = reporting.provenance()
                content = content_of(found, run_seconds, chosen.seed)
                report = markdown(content, chosen, origin)
                reporting.write("virtual_power", {**origin, **content}, report)


if __name__ == "__main__":
    main()
