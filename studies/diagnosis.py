"""One table of what the diagnosis does today, beside what was asked of it.

    python -m studies.diagnosis        four minutes

Reads the results of open_cases, sound_cases, infill, further_tests, liggghts.references,
liggghts.codes and of sealed, with and without --shapes, and times both commands on a case of
open_cases.  What is asked was written down before any of these cases was made.  Writes
studies/results/diagnosis.md.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import product
from pathlib import Path

import numpy as np

from calibrate.discrepancy.comparison.classes import TOGETHER
from calibrate.discrepancy.comparison.naming import BEYOND, FEWEST
from calibrate.discrepancy.comparison.probability_calibration import NONE, UNKNOWN
from calibrate.discrepancy.diagnosis import diagnosed
from calibrate.io.lab import bundled_lab, load_lab
from jdem.effects.composite import EFFECTS
from jdem.materials.conventions import DEFAULT
from studies import further_tests, open_cases, reporting, sound_cases
from studies.sealed import run, training
from studies.sealed.scores import CLOSE, expected_error, share

SURE = 0.8
LAWS = {DEFAULT: "", "liggghts": "; LIGGGHTS' friction and rolling"}
CLAY, OF_CLAY = "trumao_curves", "trumao_2021"
NOT_TOLD = ("single below 2", "outside below 2")  # too little to see
Row = tuple[str, str, str, str, str]
HEADER = ("question", "asked", "found", "95 % interval", "of which cases")
OF_WRONG = ("hidden", "signal-to-noise", "verdict", "stated", "by scatter alone")
OF_FURTHER = ("hidden", "signal-to-noise", "at first", "tests")
NOTES = (
    "Open cases served development. Their answers are told by cross-validation. Sealed cases were "
    "judged once, by what the diagnosis was then. Further tests were asked for by today's, on "
    "sets that had been opened, but that taught it no probabilities. Lines about infill runs and "
    "about LIGGGHTS' cases with nothing hidden in them are of the state before fits were compared "
    "where they end. Cases with infill runs are the first that were simulated; of these the films "
    "above 6 are mostly those that the library alone misses. Signal-to-noise is what calibration "
    "leaves of an effect, over scatter and errors; in LIGGGHTS what two specimens that were "
    "simulated without the effect tell, of the machine's errors what equations do. Stated: the "
    "probability that the diagnosis gives its verdict. By scatter alone: the share of "
    "laboratories without any gap whose curves would miss the model as much."
)


def result(name: str) -> dict:
    """A result file; empty where it was not made."""
    path = reporting.file_of(name)
    return reporting.content_of(path) if path.exists() else {}


def line(words: str, asked: str, right: Sequence[bool], cases: str) -> Row:
    """A share with its interval (Clopper and Pearson)."""
    found = share(right)
    if not found["n"]:
        return words, asked, "no such cases", "", cases
    shown = f"{sum(right)} of {found['n']} ({100 * found['value']:.0f} %)"
    return words, asked, shown, f"{100 * found['low']:.0f} to {100 * found['high']:.0f} %", cases


def kind_of(name: str) -> str:
    """Whether an effect is one of the machine, or of soil and walls."""
    return "machine" if EFFECTS[name].about.kind == "instrument" else "soil and walls"


def of_open() -> Iterator[Row]:
    yield from of_cases(result("open_cases").get("cases", []), "open")


def of_cases(
    cases: Sequence[dict], words: str, accused: str = "at most 5 %", strong: str = "at least 90 %"
) -> Iterator[Row]:
    """First answers, before any further test; what is asked of sound cases and strong effects."""
    sound = [c["verdict"] != NONE for c in cases if c["stratum"] == NONE]
    yield line("nothing hidden: something named", accused, sound, words)
    for stratum, asked in (("above 6", strong), ("2 to 6", "at least 60 %")):
        single = [c for c in cases if c["stratum"] == f"single {stratum}"]
        yield line(f"one effect {stratum}: named first", asked, [c["right"] for c in single], words)
        for kind in ("machine", "soil and walls"):
            some = [c["right"] for c in single if kind_of(c["hidden"][0]) == kind]
            yield line(f"- of these {kind}", asked, some, words)
    for called, stratum in (("one effect below 2: named first", "single below 2"),
                            ("two effects: both named", "two")):  # fmt: skip
        some = [c["right"] for c in cases if c["stratum"] == stratum]
        if some:
            yield line(called, "", some, words)
    unknown = [c["verdict"] == UNKNOWN for c in cases if c["stratum"] == "outside"]
    if unknown:
        called = "effects that the library lacks, above 2: called unknown"
        yield line(called, "at least 70 %", unknown, words)
    sure = [c["stated"] >= SURE and not c["right"] for c in cases]
    yield line(f"wrong, and stated with {SURE:g} or more", "below 5 %", sure, words)
    yield from _calibration(cases, words)


def _calibration(cases: Sequence[dict], words: str) -> Iterator[Row]:
    """Beside what perfect forecasters of as many cases stay below in 95 % of sets."""
    if not cases:
        return
    stated, right = (np.array([float(c[key]) for c in cases]) for key in ("stated", "right"))
    rng = np.random.default_rng(0)
    perfect = [
        expected_error(stated, (rng.random(len(stated)) < stated) * 1.0)
        for _ in range(further_tests.DRAWS)
    ]
    error = expected_error(stated, right)
    bound = f"at most {np.quantile(perfect, 0.95):.3f}"
    yield "calibration error of stated probabilities", bound, f"{error:.3f}", "", words


def of_further() -> Iterator[Row]:
    found, words = result("further_tests"), "opened, effects above 1"
    single = [row for row in found.get("cases", []) if row["kind"] == "single"]
    for called, way in further_tests.WAYS.items():
        asked = "at least 90 %" if way == "asked" else ""
        yield _named_after(single, called, way, asked, words)
    if single:
        value, low, high = found["ratio"]
        yield (
            "tests until named, asked for over at random", "below 1", f"{value:.2f}",
            f"{low:.2f} to {high:.2f}", words,
        )  # fmt: skip
    rows = result("withheld_liggghts").get("further", {}).get("cases", [])
    others = [row for row in rows if row["kind"] == "single"]
    words = "opened, LIGGGHTS, effects above 1"
    yield _named_after(others, "asked for", "asked", "at least 75 %", words)


def _named_after(rows: Sequence[dict], called: str, way: str, asked: str, words: str) -> Row:
    right = [further_tests.right_after(row, way)[-1] for row in rows]
    return line(f"named after at most three further tests, {called}", asked, right, words)


def of_infill() -> Iterator[Row]:
    """Answers to some open cases by the library alone, and once infill runs have joined it."""
    every = result("infill").get("cases", [])
    for stratum, called, asked in (
        ("single above 6", "a film of water above 6: named first", "at least 90 %"),
        ("single 2 to 6", "one effect 2 to 6: named first", "at least 60 %"),
        (NONE, "nothing hidden: called so", "at least 95 %"),
    ):
        some = [case for case in every if case["stratum"] == stratum]
        for way, words in (("library", "by the library alone"), ("infill", "with 24 runs more")):
            right = [case[way]["right"] for case in some]
            yield line(f"{called}, {words}", asked, right, "open, some; films missed before")


def sealed(name: str) -> list[dict]:
    """The cases of a sealed set that was judged, as those of open_cases.py, which says how visible
    an effect is where the labels do not."""
    found = result(name)
    told = {(c["set"], c["case"]): c["snr"] for c in result("open_cases").get("cases", [])}
    return [
        {**row, "hidden": [one["name"] for one in found["hidden"][row["case"]]],
         "right": row["verdict"] == row["truth"], "p_gap": row["p_before"],
         "stratum": stratum_of(row["kind"], told.get((name, row["case"]), visible(row)))}
        for row in found.get("rows", [])
    ]  # fmt: skip


def visible(row: dict) -> float:
    """Signal-to-noise, as twins without the effect tell it where there are any."""
    return row.get("snr_simulated", row["snr"])


def stratum_of(kind: str, snr: float) -> str:
    """As open_cases.py calls it."""
    band = int(np.searchsorted(training.EDGES, snr, side="right"))
    if kind == "single":
        return training.STRATA[band]
    unseen = kind == training.OUTSIDE and band == 0
    return training.UNSEEN if unseen else kind


def of_sealed() -> Iterator[Row]:
    own = sealed(further_tests.SET)
    yield from of_cases(own, "sealed")
    for spheres in sorted({c["spheres"] for c in own}):
        some = [c["verdict"] != NONE for c in own if (c["kind"], c["spheres"]) == (NONE, spheres)]
        words = f"sealed, {spheres} spheres"
        yield line("nothing hidden: something named", "at most 5 %", some, words)
    claims = [c for c in own if None not in (c["claimed"], c["realised"])]
    close = [abs(c["claimed"] - c["realised"]) <= CLOSE for c in claims]
    words = "claimed reduction of the gap within 10 points of that on fresh specimens"
    yield line(words, "at least 80 %", close, "sealed")
    yield from of_cases(sealed("withheld_shapes_second"), "sealed, other specimens")
    others = "sealed, LIGGGHTS, 1000 spheres", "at most 10 %", "at least 80 %"
    yield from of_cases(sealed("withheld_liggghts"), *others)


def of_references() -> Iterator[Row]:
    """Another code's specimens with nothing hidden."""
    found = result("references").get("cases", [])
    for way in dict.fromkeys(row["way"] for row in found):
        named = [row["verdict"] != NONE for row in found if row["way"] == way]
        words = f"open, LIGGGHTS, 1000 spheres; {way}"
        yield line("nothing hidden: something named", "at most 10 %", named, words)


def of_sound() -> Iterator[Row]:
    """What the command says, with the grounds on which it may name a cause."""
    cases = result("sound_cases").get("cases", [])
    fresh = [c for c in cases if c["set"] == sound_cases.FRESH]
    enough = [c["verdict"] != NONE for c in fresh if c["specimens"] >= FEWEST]
    fewer = [c["verdict"] != NONE for c in fresh if c["specimens"] < FEWEST]
    words = "fresh, records from 0 to 10 N on"
    yield line("nothing hidden, three specimens or four: named", "at most 5 %", enough, words)
    yield line("nothing hidden, one specimen or two: named", "never", fewer, words)
    strong = [c for c in cases if c["set"] == sound_cases.STRONG]
    for called, key in (
        ("without regard to grounds, cross-validated", "before"),
        ("likeliest", "likeliest"),
        ("named by the command", "verdict"),
    ):
        right = [c[key] == c["truth"] for c in strong]
        yield line(f"one effect above 6: {called}", "at least 90 %", right, "opened")
    beyond = [c["reason"] == BEYOND for c in strong]
    yield line(
        "- soil beyond the library: not named before it has runs there", "", beyond, "opened"
    )


def of_codes() -> Iterator[Row]:
    every = result("codes").get("carried", [])
    for soil in dict.fromkeys(each["soil"] for each in every):
        own = [each for each in every if each["soil"] == soil]
        words = f"six packings, {soil.replace('_', ' ')}"
        for name, called, asked in (
            ("depression_depth_mm", "H", "within 5 %"), ("crushing_force_n", "F", "within 10 %"),
        ):  # fmt: skip
            ours, theirs = (np.mean([e[who][name] for e in own]) for who in ("ours", "theirs"))
            text = f"{100 * (theirs / ours - 1):+.1f} %"
            yield f"calibrated here, in LIGGGHTS: {called}", asked, text, "", words


def of_real_soil() -> Iterator[Row]:
    """What is said of a natural clay, from all that was measured, and from parts of it."""
    parts = parts_of(bundled_lab(CLAY).read_text(encoding="utf-8"))
    for (conventions, law), (words, text) in product(LAWS.items(), parts.items()):
        with tempfile.TemporaryDirectory() as folder:
            here = Path(folder)
            shutil.copytree(bundled_lab(CLAY).parent / OF_CLAY, here / OF_CLAY)
            (here / "lab.toml").write_text(text, encoding="utf-8")
            lab = load_lab(here / "lab.toml").following(conventions)
            found = diagnosed(lab, open_cases.emulated()).comparison
        misfit = f"misfit {found.base.objective:.0f} for {len(found.base.values)} features"
        answer = f"{found.verdict}, stated with {found.stated:.2f}; {misfit}"
        if found.reason:
            answer = f"no cause named: {found.reason}; {misfit}"
        yield f"a natural clay, oedometer {words}{law}", "", answer, "", "cause not known"


def parts_of(whole: str) -> dict[str, str]:
    """Lab files of the clay by what they hold."""
    begin, end = whole.index("[tests.targets]"), whole.index("[particles]")
    lower = whole.replace('"785.4 N"', '"392.7 N"').replace('low = "392.7 N"', 'low = "196.35 N"')
    return {
        "to 400 kPa, and strengths": whole,
        "to 400 kPa": whole[:begin] + whole[end:],
        "to 200 kPa, and strengths": lower,
    }


def of_time() -> Iterator[Row]:
    """Whole commands, on this machine, with nothing beside them."""
    open_cases.unpack()
    lab = run.case_folders(open_cases.WORK)[0] / "lab.toml"
    for verb, asked in (("diagnose", "at most 30 s"), ("next", "at most 60 s")):
        with tempfile.TemporaryDirectory() as folder:
            begun = time.perf_counter()
            command = [sys.executable, "-m", "calibrate", verb, str(lab), "--out", folder]
            subprocess.run(command, check=True, capture_output=True)
            taken = time.perf_counter() - begun
        cores = f"{os.cpu_count()} cores"
        yield f"`calibrate {verb}`, four specimens", asked, f"{taken:.0f} s", "", cores


def wrong() -> list[tuple[str, ...]]:
    """Open cases above 2 that are not answered rightly."""
    cases = [c for c in result("open_cases").get("cases", []) if not c["right"]]
    order = sorted(cases, key=lambda c: (c["stratum"], c["hidden"], c["snr"]))
    return [
        (TOGETHER.join(c["hidden"]) or "nothing", f"{c['snr']:.1f}" if c["snr"] else "",
         c["verdict"], f"{c['stated']:.2f}", f"{c['p_gap']:.3f}")
        for c in order if c["stratum"] not in NOT_TOLD
    ]  # fmt: skip


def asked_for() -> list[tuple[str, ...]]:
    """What was asked for in each case of the loop."""
    rows = sorted(
        result("further_tests").get("cases", []), key=lambda r: (r["kind"], r["hidden"], r["snr"])
    )
    return [
        (row["hidden"] or "nothing", f"{row['snr']:.1f}" if row["snr"] else "",
         row["asked"][0]["verdict"],
         ", then ".join(f"{a['test']}: {a['verdict']}" for a in row["asked"][1:]) or "none asked")
        for row in rows
    ]  # fmt: skip


def main() -> None:
    reporting.no_options(__doc__)
    parts: tuple[Callable[[], Iterator[Row]], ...] = (
        of_sealed, of_open, of_sound, of_infill, of_further, of_references, of_codes, of_real_soil,
        of_time,
    )  # fmt: skip
    rows = [row for part in parts for row in part()]
    text = "\n".join([
        "# The diagnosis today", "", reporting.table(HEADER, rows), NOTES, "",
        "## Open cases above 2 that are answered wrongly", "", reporting.table(OF_WRONG, wrong()),
        "## Further tests that were asked for", "", reporting.table(OF_FURTHER, asked_for()),
    ])  # fmt: skip
    reporting.write_page("diagnosis", text + reporting.footer(reporting.provenance()))


if __name__ == "__main__":
    main()
