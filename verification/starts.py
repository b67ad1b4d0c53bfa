"""Where do fits end from other starts, and what do they cost, on the library and on smaller beds?

    library        what `calibrate fit` does: it explores on the bundled library of runs
    smaller beds   what it does with --runs-alone: slopes from pairs of runs with 500 spheres

Both choose their free parameters, decide on four packings of 2000 spheres, and are checked on
fresh packings.  The bundled soil is fitted from three starts; hidden soils
(`verification.hidden_soils`) from the bundled soil.  Processor seconds are those of the whole fit,
with compiling and the check; beds are grown before.

    python -m verification.starts --hidden           the three starts, an hour of a core
    python -m verification.starts --hidden 0 1 2     these hidden soils instead, as long

With --equal, a fit on smaller beds is stopped when it has used the processor time that the
library's fit of the same soil took as a whole; it has then met nothing.

Fits are kept in results/benchmarks; a second call goes on with the next one.  Writes one of two
sections of verification/results/recovery.md after each.
"""

import argparse
import json
import shutil
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibrate.core.files import write_text
from calibrate.core.progress import for_terminal
from calibrate.discrepancy.library.stand_in import served
from calibrate.inference.calibration import Calibrated, calibrate
from calibrate.inference.resolutions import Coarse
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.io.soil import base_soil
from calibrate.labtests.composite import label
from calibrate.simulation.resolution import PRESETS
from calibrate.simulation.specimens import campaign
from verification import reporting
from verification.hidden_soils import STANDARD, Laboratory
from verification.made_lab import scaled
from verification.sizes import STARTS, prepared, simulated

WAYS = ("library", "smaller beds")
SEED = 0
HEADER = ("soil", "start", "explored on", "met", "processor (s)", "runs", "observable", "measured",
          "fresh packings: mean ± s.e.", "error")  # fmt: skip


class TimeIsUp(Exception):
    """A fit has used the processor time that it was given."""


@contextmanager
def processor_seconds(allowed: float) -> Iterator[None]:
    """Raise TimeIsUp inside when this process has used so many; infinity never ends."""

    def stop(*_: object) -> None:
        raise TimeIsUp

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, allowed if np.isfinite(allowed) else 0.0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def fitted(
    lab: Lab, start: str, way: str, folder: Path, beds: Path, allowed: float = np.inf
) -> dict:
    """One fit within processor seconds, what it cost, and what fresh packings give."""
    done = folder / "done.json"
    if done.exists():
        kept = json.loads(done.read_text(encoding="utf-8"))
        if kept["measured"] or np.isfinite(allowed):  # else it was stopped, and may now go on
            return kept
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(beds / "packings", folder / "packings")
    begun = time.process_time()
    try:
        with processor_seconds(allowed):
            numbers = _numbers(_fit(lab, start, way, folder))
    except TimeIsUp:
        numbers = {"met": False, "measured": {}}
    spent = time.process_time() - begun
    row = {"processor_s": spent, "runs": simulated(folder)["runs"], **numbers}
    write_text(done, json.dumps(row))
    return row


def _fit(lab: Lab, start: str, way: str, folder: Path) -> Calibrated:
    base = scaled(base_soil(lab), STARTS[start])
    work = campaign(lab, STANDARD, folder, for_terminal())
    if way == "library":
        coarse, why = served(lab, STANDARD, None, base, work)
        if coarse is None:
            raise SystemExit(why)
    else:
        small = replace(STANDARD, spheres=PRESETS["standard"].explored)
        beds = campaign(lab, small, folder, for_terminal())
        coarse = Coarse(beds, small.spheres, STANDARD.spheres)
    return calibrate(lab, STANDARD, None, base, SEED, work, coarse)


def _numbers(found: Calibrated) -> dict:
    """What the fit met, and what its fresh packings show."""
    problem = found.setup.problem
    fresh = problem.simulated(found.fresh_runs)
    names = [feature.name for feature in problem.features]
    return {
        "free": list(found.calibration.space.names),
        "met": found.met,
        "measured": dict(zip(names, problem.measured.tolist(), strict=True)),
        "mean": dict(zip(names, np.nanmean(fresh, axis=0).tolist(), strict=True)),
        "scatter": dict(zip(names, np.nanstd(fresh, axis=0, ddof=1).tolist(), strict=True)),
        "packings": len(fresh),
    }


def markdown(title: str, rows: list[dict], origin: dict) -> str:
    """A row for each fit and observable, then what both ways cost."""
    cells = [line for row in rows for line in _lines(row)]
    return (
        f"# {title}\n\nFour packings of "
        f"{STANDARD.spheres} spheres decide; smaller beds have {PRESETS['standard'].explored}.\n\n"
        + reporting.table(HEADER, cells)
        + "\n" + _summary(rows) + reporting.footer(origin)
    )  # fmt: skip


def _lines(row: dict) -> list[list[str]]:
    """A line of the table for each observable; one for a fit that was stopped."""
    runs = ", ".join(f"{n} of {spheres}" for spheres, n in sorted(row["runs"].items()))
    fit = [row["soil"], row["start"], row["way"], "yes" if row["met"] else "NO"]
    fit += [f"{row['processor_s']:.0f}", runs]
    if not row["measured"]:
        return [[*fit, "stopped at the library's time", "", "", ""]]
    return [[*fit, *_cells(row, name)] for name in row["measured"]]


def _cells(row: dict, name: str) -> list[str]:
    measured, mean = row["measured"][name], row["mean"][name]
    return [
        label(name),
        f"{measured:.4g}",
        f"{mean:.4g} ± {row['scatter'][name] / np.sqrt(row['packings']):.2g}",
        f"{100 * (mean / measured - 1):+.1f} %",
    ]


def _summary(rows: list[dict]) -> str:
    """A sentence for each way."""
    said = []
    for way in WAYS:
        own = [row for row in rows if row["way"] == way]
        if own:
            spent = [row["processor_s"] for row in own]
            met, stopped = sum(row["met"] for row in own), sum(not row["measured"] for row in own)
            cut = f"{stopped} were stopped at the library's time; " * (stopped > 0)
            said.append(
                f"- Explored on {way}: {cut}{met} of the {len(own) - stopped} that ended meet both "
                f"numbers. Fits took {min(spent):.0f} to {max(spent):.0f} processor seconds.\n"
            )
    return "".join(said)


def cases(hidden: list[int]) -> list[tuple[str, str, Lab]]:
    """(soil, start, lab) of every pair of fits."""
    if not hidden:
        bundled = load_lab(bundled_lab())
        return [("bundled", start, bundled) for start in STARTS]
    soils = reporting.earlier("hidden_soils", "entries")
    return [
        (f"hidden {number}", "base", Laboratory.made(number, truth, reporting.CACHE).lab)
        for number in hidden
        for truth in [soils[str(number)]["hidden"]]
    ]


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--hidden", nargs="*", type=int, default=[])
    parser.add_argument("--equal", action="store_true")
    chosen = parser.parse_args()
    reporting.configure()
    title = "Fits of hidden soils, both ways" if chosen.hidden else "Fits from several starts"
    folder, rows = reporting.kept("starts"), []
    for soil, start, lab in cases(chosen.hidden):
        prepared(lab, folder / "beds")
        allowed = np.inf
        for way in WAYS:
            place = folder / f"{soil}-{start}-{way}".replace(", ", "-").replace(" ", "-")
            rows.append({"soil": soil, "start": start, "way": way,
                         **fitted(lab, start, way, place, folder / "beds", allowed)})  # fmt: skip
            allowed = rows[-1]["processor_s"] if chosen.equal else np.inf
            origin = reporting.provenance()
            reporting.write_content("starts", {**origin, "rows": rows})
            reporting.write_section("recovery", markdown(title, rows, origin))
            print(rows[-1], flush=True)


if __name__ == "__main__":
    main()
