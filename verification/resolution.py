"""What depends on the number of spheres: depth, force and curves over 150 to 20 000 spheres.

The bundled soil at the preset standard's rates, on beds grown to the porosity that is usual for
their size (interiors alike, more room at the walls), and at one porosity for all.  Surface energy
goes with the diameter, so a contact's stiffness goes with R and its pull-off with R2, as in
Thakur et al. 2016.  From the crushing curve: strain at the peak, force at 14 mm over the peak,
and roughness, the deviation from a line through 1 mm around each point, over the peak.

    python -m verification.resolution                       all sizes, some 25 minutes on two cores
    python -m verification.resolution --most 2000           up to 2000 spheres, 6 minutes
    python -m verification.resolution --check --most 1000   the same as on file?  some minutes

Of 150 spheres there are six packings: the seventh does not reach its usual porosity.
Runs are kept in results/benchmarks; a second call resumes.  Writes resolution.json and .md in
verification/results and a picture in results/benchmarks after each size.
"""

import argparse
import json
import resource
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from calibrate.core.progress import for_terminal
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.io.soil import base_soil
from calibrate.labtests.pair import KINDS
from calibrate.simulation import Run
from calibrate.simulation.resolution import PRESETS
from calibrate.simulation.specimens import campaign
from verification import reporting

PACKINGS = {150: 6, 250: 10, 500: 8, 1000: 6, 2000: 6, 5000: 3, 10_000: 2, 20_000: 1}
MATCHED = 0.46  # reached by every size from 500 spheres on
DIFFERS = 3.0  # standard errors of the average change from which a check says so
LAST = 14.0  # mm
WINDOW = 1.0  # mm
HEADER = (
    *("beds", "spheres", "D/d", "porosity", "packings", "H (mm)", "F (N)", "peak at strain"),
    *("residual / peak", "roughness", "run (s)", "M particle-steps/s", "µs a step"),
)
PICTURE = reporting.CACHE / "resolution.png"


def measured(lab: Lab, spheres: int, folder: Path) -> list[Run]:
    """Runs of the bundled soil, one a packing."""
    preset = replace(PRESETS["standard"], spheres=spheres)
    work = campaign(lab, preset, folder, for_terminal())
    return work.runs([base_soil(lab)], range(PACKINGS[spheres]), f"{spheres} spheres")[0]


def shape(run: Run, height: float) -> dict[str, float]:
    """Of the crushing curve: strain at the peak, residual over peak, roughness over peak."""
    travel, force = run.curves[KINDS[1]].T
    smooth = np.array([force[np.abs(travel - at) < WINDOW / 2].mean() for at in travel])
    top = int(np.argmax(smooth))
    inner = (travel > WINDOW) & (travel < LAST)
    end = smooth[np.abs(travel - LAST) < WINDOW / 2]
    return {
        "peak_strain": float(travel[top] / (1e3 * height)),
        "residual": float(end.mean() / smooth[top]) if len(end) else float("nan"),
        "roughness": float(np.std((force - smooth)[inner]) / smooth[top]),
    }


def row(runs: list[Run], height: float) -> dict:
    """Values of each packing, and what the runs cost."""
    sound = [run for run in runs if not run.failure]
    each = [{**run.observables, **shape(run, height)} for run in sound]
    quality = [run.quality for run in sound]
    return {
        "values": {name: [one[name] for one in each] for name in each[0]},
        "spheres_across": float(np.mean([q["spheres_across"] for q in quality])),
        "porosity": float(np.mean([q["porosity"] for q in quality])),
        "inertial_number": float(max(q["inertial_number"] for q in quality)),
        "steps": float(np.mean([q["steps"] for q in quality])),
        "runtime_s": float(np.mean([q["runtime_s"] for q in quality])),
        "peak_memory_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
        "failures": [run.failure for run in runs if run.failure],
        "curves": {name: curve[:: max(1, len(curve) // 150)].round(4).tolist()
                   for name, curve in sound[0].curves.items()},
    }  # fmt: skip


def markdown(found: dict, origin: dict) -> str:
    cells = [
        [kind, spheres, f"{r['spheres_across']:.1f}", f"{r['porosity']:.3f}",
         str(len(r["values"]["peak_strain"])),
         *[_spread(r["values"][n], digits) for n, digits in SHOWN.items()],
         f"{r['runtime_s']:.0f}", f"{1e-6 * int(spheres) * r['steps'] / r['runtime_s']:.2f}",
         f"{1e6 * r['runtime_s'] / r['steps']:.0f}"]
        for kind, rows in found.items() for spheres, r in rows.items()
    ]  # fmt: skip
    return (
        "# Resolution\n\nBundled soil; mean ± scatter of one packing. Two runs at a time share the "
        "cores.\n\n" + reporting.table(HEADER, cells) + "\n" + _exponents(found)
        + reporting.footer(origin)
    )  # fmt: skip


SHOWN = {
    "depression_depth_mm": 2,
    "crushing_force_n": 0,
    "peak_strain": 3,
    "residual": 2,
    "roughness": 3,
}


def _spread(values: list[float], digits: int) -> str:
    mean = f"{np.mean(values):.{digits}f}"
    return f"{mean} ± {np.std(values, ddof=1):.{digits}f}" if len(values) > 1 else mean


def _exponents(found: dict) -> str:
    """How scatter and time a step go with the number of spheres, where several packings show it."""
    lines = []
    for kind, rows in found.items():
        several = {int(n): r for n, r in rows.items() if len(r["values"]["peak_strain"]) > 4}
        for name in ("depression_depth_mm", "crushing_force_n"):
            if len(several) > 2:
                cv = [np.std(r["values"][name], ddof=1) / np.mean(r["values"][name])
                      for r in several.values()]  # fmt: skip
                power = np.polyfit(np.log(list(several)), np.log(cv), 1)[0]
                lines.append(f"- {kind}: scatter of {name} over its mean goes with N^{power:.2f}\n")
        large = {int(n): r["runtime_s"] / r["steps"] for n, r in rows.items() if int(n) >= 500}
        if len(large) > 2:
            power = np.polyfit(np.log(list(large)), np.log(list(large.values())), 1)[0]
            lines.append(f"- {kind}: time a step goes with N^{power:.2f} from 500 spheres on\n")
    return "".join(lines)


def picture(found: dict) -> None:
    """Crushing curves of one packing a size, and depth and force over spheres across."""
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
    usual = found["usual porosity"]
    shades = plt.get_cmap("viridis")(np.linspace(0.85, 0.0, len(usual)))
    for (spheres, r), shade in zip(usual.items(), shades, strict=True):
        axes[0].plot(*np.array(r["curves"][KINDS[1]]).T, color=shade, lw=1.2, label=spheres)
    axes[0].set(xlabel="displacement (mm)", ylabel="crushing force (N)", xlim=(0, LAST))
    axes[0].legend(title="spheres", fontsize=7, title_fontsize=8, ncols=2)
    names = ("depression_depth_mm", "crushing_force_n")
    for axis, name, label in zip(axes[1:], names, ("H (mm)", "F (N)"), strict=True):
        for (kind, rows), marker in zip(found.items(), "os", strict=False):
            across = [r["spheres_across"] for r in rows.values()]
            each = [r["values"][name] for r in rows.values()]
            error = [np.std(v, ddof=1) / np.sqrt(len(v)) if len(v) > 1 else 0.0 for v in each]
            axis.errorbar(across, [np.mean(v) for v in each], error, marker=marker, capsize=3,
                          color="k" if marker == "o" else "0.55", lw=1, label=kind)  # fmt: skip
        axis.set(xlabel="spheres across the specimen, D/d (-)", ylabel=f"mean {label} ± s.e.")
        axis.axvline(8, color="0.7", ls=":", lw=1)
        axis.legend(fontsize=8)
    PICTURE.parent.mkdir(parents=True, exist_ok=True)  # runs may be kept elsewhere
    figure.savefig(PICTURE, dpi=130)
    plt.close(figure)


def check(lab: Lab, most: int) -> list[list[str]]:
    """Runs beds of the usual porosity anew: by how much depth and force differ from the file, on
    average and in one packing at most, and whether the averages agree."""
    kept = json.loads(reporting.file_of("resolution").read_text(encoding="utf-8"))
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for spheres in [n for n in PACKINGS if n <= most]:
            now = row(measured(lab, spheres, Path(folder)), lab.specimen.height)["values"]
            before = kept["beds"]["usual porosity"][str(spheres)]["values"]
            for name in ("depression_depth_mm", "crushing_force_n"):
                change = 100 * (np.array(now[name]) / np.array(before[name]) - 1)
                error = float(np.std(change, ddof=1) / np.sqrt(len(change)))
                mean = float(np.mean(change))
                found.append([str(spheres), name, str(len(change)), f"{mean:+.1f} ± {error:.1f}",
                              f"{np.abs(change).max():.1f}",
                              "yes" if abs(mean) <= DIFFERS * error else "NO"])  # fmt: skip
    return found


def checked(found: list[list[str]], origin: dict) -> str:
    """The section about what `--check` found."""
    kept = json.loads(reporting.file_of("resolution").read_text(encoding="utf-8"))
    header = ("spheres", "observable", "packings", "mean difference (%)", "largest (%)", "agrees")
    return (
        f"# The same once more\n\nSpecimens of the usual porosity, made again: differences from "
        f"those above, made with physics {reporting.physics_of(kept)}. Means agree within "
        f"{DIFFERS:g} standard errors.\n\n" + reporting.table(header, found)
        + reporting.footer(origin)
    )  # fmt: skip


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--most", type=int, default=20_000, help="largest number of spheres")
    parser.add_argument("--folder", type=Path, default=reporting.CACHE, help="cache of runs")
    parser.add_argument("--check", action="store_true", help="compare with the file, write none")
    chosen = parser.parse_args()
    reporting.configure()
    lab = load_lab(bundled_lab())
    if chosen.check:
        found = check(lab, chosen.most)
        reporting.write_section("resolution", checked(found, reporting.provenance()))
        sys.exit(any(line[-1] == "NO" for line in found))
    same = replace(lab, particles=replace(lab.particles, porosity=MATCHED))
    beds: dict = {}
    for spheres in [n for n in PACKINGS if n <= chosen.most]:
        for kind, each in (("usual porosity", lab), (f"porosity {MATCHED}", same)):
            if kind != "usual porosity" and not 500 <= spheres <= 5000:
                continue
            runs = measured(each, spheres, chosen.folder)
            beds.setdefault(kind, {})[str(spheres)] = row(runs, lab.specimen.height)
        origin = reporting.provenance()
        kept = {k: {n: {**r, "curves": {}} for n, r in rows.items()} for k, rows in beds.items()}
        reporting.write_content("resolution", {**origin, "beds": kept})  # curves are drawn alone
        reporting.write_section("resolution", markdown(beds, origin))
        picture(beds)


if __name__ == "__main__":
    main()
