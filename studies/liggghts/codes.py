"""Where this simulator and LIGGGHTS part, level by level, and whether a calibration carries over.

    python -m studies.liggghts.codes --soils wheat_after_rice trumao strong

levels: the bundled soil's start (tensile exponent 1) at equal parameters, in one contact, a sphere
on a wall, and both tests on the same six beds of 1000 spheres.  Three ways: our law and what an
export of it can say; LIGGGHTS' conventions in both codes; the same with its sorting off.

carried: three soils fitted at `standard` with `--conventions liggghts` and exported; LIGGGHTS' own
tests on six packings of 2000 spheres that took no part in the fit.

Needs the Debian package `liggghts`; a soil takes some 25 minutes on two idle cores, the levels 12.
Fits and runs are kept in results/benchmarks/codes, so that a second call resumes; parts and soils
that are not asked for keep their rows.  Writes studies/results/codes.json and .md,
docs/images/codes.png, and what LIGGGHTS makes of a contact into tests/data/export_contact.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path
from typing import cast

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from calibrate.core.files import write_text
from calibrate.core.progress import for_terminal
from calibrate.exporters import liggghts
from calibrate.exporters.source import Found, find
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.io.soil import base_soil, with_values
from calibrate.simulation import Campaign
from calibrate.simulation.resolution import PRESETS, Preset
from calibrate.simulation.run import Run
from calibrate.simulation.specimens import campaign, soil_json
from jdem.observables import displacement_on_rise
from jdem.packing.specimen import Packing
from studies import reporting
from studies.liggghts import both_tests, one_contact

WORK = reporting.CACHE / "codes"
IMAGE = reporting.IMAGES / "codes.png"
DATA = reporting.ROOT / "tests" / "data" / "export_contact"
MADE = {  # a stiffer and stronger soil: trumao's lab file with other targets, none of them measured
    "trumao, natural state": "made soil, stiff and strong",
    "1.621 mm": "2.2 mm",
    "0.413 mm": "0.1 mm",
    "142.7 N": "320 N",
    "33.1 N": "15 N",
}
STRONG = WORK / "strong.toml"
TWO = ("--free", "shear_modulus,surface_energy")
SOILS: dict[str, tuple[Path, tuple[str, ...]]] = {  # lab file, options of the fit
    "wheat_after_rice": (bundled_lab("wheat_after_rice"), TWO),
    "trumao": (bundled_lab("trumao"), TWO),
    "strong": (STRONG, TWO),
}
STANDARD = PRESETS["standard"]
COARSER = replace(STANDARD, spheres=1000)
PACKINGS = 6
SLOWER = 0.5  # LIGGGHTS' time step over ours
SEATING, LOW = 2.0, 50.0  # N; the toe is the way between these
SMOOTHED = 0.1e-3  # m of travel over which a crushing force is averaged
SORTED = {True: "spheres sorted", False: "sorting off"}
WAYS = (("eepa", True), ("liggghts", True), ("liggghts", False))  # conventions, spheres sorted
MARKS = (("#20344f", "o"), ("0.5", "s"), ("k", "^"))
NAMES = {"eepa": "our law, exported", "liggghts": "LIGGGHTS' conventions"}


def theirs(found: Found, packing: Packing, preset: Preset, step: float, sort: bool, folder: Path):
    """Both tests by LIGGGHTS on a bed of ours; kept in the folder."""
    kept = folder / "curves.npz"
    if not kept.exists():
        section = liggghts.text(found)
        if sort:
            section = section.replace(liggghts.KEPT, f"# {liggghts.KEPT}")
        radius, mass = (np.asarray(x) for x in (packing.spheres.radius, packing.spheres.mass))
        density = float(mass.sum() / (4 / 3 * np.pi * radius**3).sum())
        spheres = both_tests.Spheres(np.asarray(packing.position.stack()), radius, density)
        tests = both_tests.Tests(
            mould=float(packing.mould_radius),
            press=preset.rate_in_mould,
            crush=preset.rate_free,
            target=400.0,
            stroke=0.012,
            step=SLOWER * step,
        )
        curves = both_tests.tested(section, liggghts.model(found), spheres, tests, folder)
        np.savez_compressed(kept, loading=curves.loading, crushing=curves.crushing)
    with np.load(kept) as curves:
        return both_tests.Curves(curves["loading"], curves["crushing"])


def of_theirs(curves: both_tests.Curves) -> dict[str, float]:
    """Toe (mm), H (mm) and F (N); F is 0 where the specimen fell apart."""
    return {**_pressed(*curves.loading.T), "crushing_force_n": _peak(curves.crushing)}


def of_ours(run: Run) -> dict[str, float]:
    """The same of a run of ours; H and F as it states them."""
    way, force = run.curves["confined"].T
    top = int(np.argmax(force)) + 1
    found = _pressed(1e-3 * way[:top], force[:top])
    return {**found, **{n: run.observables[n] for n in ("depression_depth_mm", "crushing_force_n")}}


def _pressed(way: np.ndarray, force: np.ndarray) -> dict[str, float]:
    """Toe and H (mm) of a loading curve in m and N."""
    forces = (SEATING, LOW, 200.0, 400.0)
    seat, toe, low, high = displacement_on_rise(1e3 * way, force, forces)
    return {"toe_mm": float(toe - seat), "depression_depth_mm": float(high - low)}


def _peak(crushing: np.ndarray) -> float:
    if not len(crushing):
        return 0.0
    rows = max(1, int(SMOOTHED / np.diff(crushing[:, 0]).mean()))
    return float(np.convolve(crushing[:, 1], np.ones(rows) / rows, mode="valid").max())


def _work(lab: Lab, preset: Preset, folder: Path) -> Campaign:
    """Where runs and beds of a lab's two tests come from: specimens of one size."""
    return cast(Campaign, campaign(lab, preset, folder, for_terminal()))


def levels() -> list[dict]:
    """Levels 1 and 2 as they are, level 3 and 4 packing by packing."""
    keep_contacts()
    lab = load_lab(bundled_lab())
    rows: list[dict] = []
    for conventions in NAMES:
        followed = _with_exponent_one(lab).following(conventions)
        work, soil = _work(followed, COARSER, WORK / "ours"), base_soil(followed)
        seeds = range(PACKINGS)
        runs = work.runs([soil], seeds, conventions)[0]
        beds = work.packings(seeds)
        found = replace(_found(soil_json(soil), beds[0]), conventions=conventions)
        for one in one_contact.compared(found, WORK / "contact"):
            rows.append({"conventions": conventions, **asdict(one)})
        step = float(work.lab.time_step(beds[0], soil))
        for sort in (way[1] for way in WAYS if way[0] == conventions):
            name = f"{conventions}-{'sorted' if sort else 'kept'}"
            curves = _each(found, beds, COARSER, step, sort, WORK / name)
            rows += [
                {"conventions": conventions, "sorted": sort, "level": "both tests", "seed": seed,
                 "ours": of_ours(run), "theirs": of_theirs(curve)}
                for seed, run, curve in zip(seeds, runs, curves, strict=True)
            ]  # fmt: skip
    return rows


def keep_contacts() -> None:
    """What LIGGGHTS makes of held contacts in its own conventions, for tests where it is absent:
    the bundled soil's start, spheres of the quick preset."""
    rows = ["conventions,slip_m,traction_n,turn_rad,torque_nm"]
    for conventions in ("liggghts", "liggghts_history"):
        found = find(bundled_lab(), {"tensile_exponent": 1.0}, None)
        found = replace(found, conventions=conventions)
        columns = zip(*one_contact.slip_and_roll(found, WORK / "contact"), strict=True)
        rows += [",".join([conventions, *(f"{x:.6e}" for x in row)]) for row in columns]
    write_text(DATA / "liggghts_conventions.csv", "\n".join(rows) + "\n")


def make_strong() -> None:
    text = bundled_lab("trumao").read_text(encoding="utf-8")
    for old, new in MADE.items():
        assert old in text, old
        text = text.replace(old, new)
    STRONG.parent.mkdir(parents=True, exist_ok=True)
    write_text(STRONG, text)


def _with_exponent_one(lab: Lab) -> Lab:
    """The lab at the one tensile exponent that both codes know."""
    return lab.following("liggghts").following("eepa")


def _found(values: dict[str, float], bed: Packing) -> Found:
    diameter = float(bed.mean_diameter())
    return Found("the bundled soil", "its start", values, {}, diameter, diameter)


def _each(found: Found, beds, preset: Preset, step: float, sort: bool, folder: Path):
    """LIGGGHTS on all beds, two at a time."""
    with ThreadPoolExecutor(2) as pool:
        return list(
            pool.map(
                lambda pair: theirs(
                    found, pair[1], preset, step, sort, folder / f"packing_{pair[0]}"
                ),
                enumerate(beds),
            )
        )


def carried(soils: Sequence[str]) -> list[dict]:
    """Each soil on packings that took no part in its fit, ours and theirs."""
    rows = []
    for name in soils:
        (path, free), out = SOILS[name], WORK / name
        command = [sys.executable, "-m", "calibrate", "fit", str(path), "--preset", "standard"]
        options = ["--conventions", "liggghts", *free, "--out", str(out)]
        if not (out / "result.json").exists():
            subprocess.run([*command, *options], check=True)
        result = json.loads((out / "result.json").read_text(encoding="utf-8"))
        lab = load_lab(path).following("liggghts")
        fitted = {n: result["parameters"][n] for n in (*result["free"], "tensile_exponent")}
        soil, work = with_values(base_soil(lab), fitted), _work(lab, STANDARD, out)
        seeds = result["fresh_seeds"][:PACKINGS]
        runs, beds = work.runs([soil], seeds, "fresh packings")[0], work.packings(seeds)
        found = find(out, {}, None)
        step = float(work.lab.time_step(beds[0], soil))
        curves = _each(found, beds, STANDARD, step, False, out / "liggghts")
        rows += [
            {"soil": name, "seed": seed, "free": result["free"], "targets": result["targets"],
             "ours": of_ours(run), "theirs": of_theirs(curve)}
            for seed, run, curve in zip(seeds, runs, curves, strict=True)
        ]  # fmt: skip
    return rows


def _ratio(rows: list[dict], name: str) -> str:
    """LIGGGHTS over ours, %, and the standard error of its mean over packings."""
    pairs = np.array([[row["ours"][name], row["theirs"][name]] for row in rows])
    if not pairs[:, 1].all():
        return f"{int((pairs[:, 1] == 0).sum())} of {len(pairs)} fell apart"
    share = 100 * (pairs[:, 1] / pairs[:, 0] - 1)
    return f"{share.mean():+.1f} ± {share.std(ddof=1) / len(share) ** 0.5:.1f} %"


def _means(rows: list[dict], who: str, name: str) -> str:
    values = np.array([row[who][name] for row in rows])
    return f"{values.mean():.4g} ± {values.std(ddof=1):.2g}"


def markdown(found: dict[str, list[dict]], origin: dict) -> str:
    text = "# This simulator and LIGGGHTS at equal parameters\n\n## Level by level\n\n"
    text += "The bundled soil's start, tensile exponent 1. Contacts: largest difference over the "
    text += "largest value. Beds: six packings of 1000 spheres, LIGGGHTS over ours, mean ± its "
    text += "standard error.\n\n"
    text += reporting.table(
        ("level", "quantity", *(f"{NAMES[c]}" for c in NAMES)), _contact_rows(found["levels"])
    )
    text += "\n" + reporting.table(
        ("both tests", "LIGGGHTS", "toe, 2 to 50 N", "H", "F"), _bed_rows(found["levels"])
    )
    text += "\n## Calibrated here, verified there\n\nFitted at `standard` with `--conventions "
    text += "liggghts`, exported; six packings of 2000 spheres that took no part. Mean ± scatter "
    text += "of one packing.\n\n"
    head = ("soil", "observable", "target", "ours", "LIGGGHTS", "LIGGGHTS over ours")
    return text + reporting.table(head, _carried_rows(found["carried"])) + reporting.footer(origin)


def _contact_rows(rows: list[dict]) -> list[list[str]]:
    single = [row for row in rows if "quantity" in row]
    names = dict.fromkeys((row["level"], row["quantity"]) for row in single)
    apart = {(r["level"], r["quantity"], r["conventions"]): r["apart"] for r in single}
    return [[*key, *(f"{apart[*key, c]:.1e}" for c in NAMES)] for key in names]


def _bed_rows(rows: list[dict]) -> list[list[str]]:
    beds = [row for row in rows if "quantity" not in row]
    cells = []
    names = ("toe_mm", "depression_depth_mm", "crushing_force_n")
    for conventions, sort in WAYS:
        some = [r for r in beds if (r["conventions"], r["sorted"]) == (conventions, sort)]
        cells.append([NAMES[conventions], SORTED[sort], *(_ratio(some, n) for n in names)])
    return cells


def _carried_rows(rows: list[dict]) -> list[list[str]]:
    cells = []
    for soil in dict.fromkeys(row["soil"] for row in rows):
        some = [row for row in rows if row["soil"] == soil]
        for name, unit in (("depression_depth_mm", "H (mm)"), ("crushing_force_n", "F (N)")):
            target = f"{some[0]['targets'][name]:.4g}"
            means = (_means(some, who, name) for who in ("ours", "theirs"))
            cells.append([soil, unit, target, *means, _ratio(some, name)])
    return cells


def figure(found: dict[str, list[dict]]) -> None:
    """F of every packing in both codes, before and after; and every soil carried over."""
    drawn, axes = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
    beds = [row for row in found["levels"] if "quantity" not in row]
    before = [r for r in beds if r["conventions"] == "eepa" and r["sorted"]]
    after = [r for r in beds if r["conventions"] == "liggghts" and not r["sorted"]]
    sets = {"our law, as LIGGGHTS is set": ("0.6", "s", before),
            "LIGGGHTS' conventions, sorting off": ("#20344f", "o", after)}  # fmt: skip
    for axis, name, label in zip(
        axes, ("depression_depth_mm", "crushing_force_n"), ("H (mm)", "F (N)"), strict=False
    ):
        for words, (colour, mark, rows) in sets.items():
            _scatter(axis, rows, name, color=colour, marker=mark, label=words)
        axis.set(xlabel=f"{label}, ours", ylabel=f"{label}, LIGGGHTS", title="1000 spheres")
        _diagonal(axis)
    axes[0].legend(frameon=False, fontsize=7)
    soils = dict.fromkeys(row["soil"] for row in found["carried"])
    for soil, (colour, mark) in zip(soils, MARKS, strict=False):
        rows = [row for row in found["carried"] if row["soil"] == soil]
        _scatter(axes[2], rows, "crushing_force_n", color=colour, marker=mark, label=soil)
    axes[2].set(xlabel="F (N), ours", ylabel="F (N), LIGGGHTS", title="fitted soils, 2000 spheres")
    axes[2].legend(frameon=False, fontsize=7)
    _diagonal(axes[2])
    drawn.savefig(IMAGE, dpi=130)
    plt.close(drawn)


def _scatter(axis, rows: list[dict], name: str, **style) -> None:
    pairs = [(row["ours"][name], row["theirs"][name]) for row in rows]
    axis.scatter(*zip(*pairs, strict=True), s=22, **style)


def _diagonal(axis) -> None:
    low, high = (
        min(axis.get_xlim()[0], axis.get_ylim()[0]),
        max(axis.get_xlim()[1], axis.get_ylim()[1]),
    )
    axis.plot((low, high), (low, high), color="0.8", lw=0.8, zorder=0)


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--soils", nargs="*", choices=SOILS, default=[], help="to fit and carry")
    parser.add_argument("--levels", action=argparse.BooleanOptionalAction, default=True)
    chosen = parser.parse_args()
    reporting.configure()
    make_strong()
    found = {name: list(reporting.earlier("codes", name)) for name in ("levels", "carried")}
    if chosen.levels:
        found["levels"] = levels()
    others = [row for row in found["carried"] if row["soil"] not in chosen.soils]
    found["carried"] = [*others, *carried(chosen.soils)]
    figure(found)
    origin = reporting.provenance()
    reporting.write("codes", {**origin, **found}, markdown(found, origin))


if __name__ == "__main__":
    main()
