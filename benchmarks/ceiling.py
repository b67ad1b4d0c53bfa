"""How often would an observer name the effect who knows what no diagnosis can know?

    mkdir own && tar xf benchmarks/results/withheld_own_cases.tar.xz -C own
    python benchmarks/ceiling.py own                  resumes

For every single effect of an opened set, at its own signal-to-noise, about its own curves, data
are drawn in a linear world, and judged by an observer who knows this world: the scatter of
specimens exactly, every effect's signature exactly, and that there are no pairs and nothing from
outside.  All effects are equally likely to it, strengths have the prior of `evidence`.  It names
the likeliest class where its odds against none exceed what they do in one of twenty draws with
nothing hidden.  No strict bound (who knows how often each effect is drawn may do better), but a
diagnosis that has to learn all this from four specimens and a bank will hardly come near.  What the
diagnosis named is that of the day when the set was opened.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import opinion
import reporting

from calibrate.core.files import write_json
from calibrate.discrepancy import mismatch
from calibrate.discrepancy.comparison.compare import design_classes, label
from calibrate.discrepancy.comparison.evidence import singles
from calibrate.discrepancy.comparison.generated import World, plan_of
from calibrate.discrepancy.comparison.noise import packing_covariance
from calibrate.discrepancy.comparison.probability_calibration import NONE
from calibrate.discrepancy.comparison.projection import project
from calibrate.discrepancy.comparison.score import lengths
from calibrate.discrepancy.diagnosis import described
from calibrate.discrepancy.library import store
from calibrate.discrepancy.library.description import MEASURING, Ready
from calibrate.io.lab import load_lab
from calibrate.simulation import engine_hash
from calibrate.validation.plan import COUNTS, STRATA

DRAWS = 200  # of each case, with its effect and without
ALARMS = 0.05
NAMED = sum(COUNTS[stratum] for stratum in STRATA)  # cases with one effect, in a set


def drawn(folder: Path, hidden: dict, snr: float, ready: Ready, known) -> dict:
    """Of each draw with nothing hidden, ln odds of the likeliest effect against none; of each with
    the effect, these odds and whether the likeliest class is that of the effect."""
    _, d, measured = described(load_lab(folder / "lab.toml"), ready, 0, known)
    world = World(d, plan_of(measured), packing_covariance(d))
    nothing, covariance = np.zeros(len(d.mean)), world.mean_covariance
    design = project(nothing, d.base_slopes, d.prior_sd, d.effect_slopes, covariance)
    k, classes = d.effect_names.index(hidden["name"]), design_classes(world)
    labels = np.array([label(classes, (name,)) for name in d.effect_names])
    signature = design.effects[:, k] * np.sign(hidden["strength"]) * snr
    signature = signature / lengths(design.effects)[k]
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((2, DRAWS, len(signature)))
    prior = np.log(NAMED / len(labels) / COUNTS["none"])

    def odds(residual: np.ndarray) -> np.ndarray:
        return prior + singles(design.with_residual(residual), d.one_sided)

    seen = [odds(signature + one) for one in noise[1]]
    return {
        "nothing": [_likeliest(odds(one), labels)[0] for one in noise[0]],
        "odds": [_likeliest(one, labels)[0] for one in seen],
        "right": [_likeliest(one, labels)[1] == labels[k] for one in seen],
    }


def _likeliest(odds: np.ndarray, labels: np.ndarray) -> tuple[float, str]:
    """ln odds (k,) of the likeliest class, and its name."""
    by_class = {name: np.logaddexp.reduce(odds[labels == name]) for name in labels}
    best = max(by_class, key=lambda name: by_class[name])
    return float(by_class[best]), str(best)


def shares(cases: list[dict], limit: float) -> dict:
    """Mean shares noticed and named over cases, and how often the diagnosis was right on them."""
    seen = np.array([case["odds"] for case in cases]) > limit
    right = np.array([case["right"] for case in cases], dtype=bool)
    return {
        "cases": len(cases),
        "noticed": float(seen.mean()),
        "named": float((seen & right).mean()),
        "diagnosis": float(np.mean([case["diagnosed"] for case in cases])),
    }


def groups(cases: list[dict]) -> dict[str, list[dict]]:
    """The strata of the targets, whole and by what is hidden."""
    machine = [case for case in cases if case["hidden"] in MEASURING]
    soil = [case for case in cases if case["hidden"] not in MEASURING]
    return {
        f"{name}, {kind}": [case for case in some if low <= case["snr"] < high]
        for name, low, high in (("2 to 6", 2, 6), ("above 6", 6, np.inf))
        for kind, some in (("all", cases), ("machine", machine), ("soil and walls", soil))
    }


def markdown(found: dict[str, dict], which: str, origin: dict) -> str:
    head = ["signal-to-noise", "cases", "noticed", "right class named", "the diagnosis named"]
    lines = [
        [name, str(s["cases"]), *(f"{100 * s[k]:.0f} %" for k in ("noticed", "named", "diagnosis"))]
        for name, s in found.items()
    ]
    text = (
        "# What an observer who knows the noise and every signature would name\n\n"
        f"Single effects of an own set ({which}), at their own signal-to-noise, in a linear world; "
        f"one alarm in twenty where nothing is hidden; {DRAWS} draws a case.\n\n"
    )
    return text + reporting.table(head, lines) + reporting.footer(origin)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="an opened set, named as in results")
    given = parser.parse_args()
    reporting.configure()
    ready = Ready.of(store.load(store.bundled_bank()))
    which = f"withheld_{given.folder.name}"
    known = mismatch.load(reporting.RESULTS / f"{which}_mismatch.json", ready)
    true = opinion.truths(which)
    kept = reporting.CACHE / f"ceiling_{given.folder.name}_{engine_hash()}"

    def of(row: dict, hidden: dict) -> dict:
        path = kept / f"{row['case']}_{row['snr']:.3f}.json"
        if not path.exists():
            kept.mkdir(parents=True, exist_ok=True)
            folder = given.folder / "cases" / row["case"]
            write_json(path, drawn(folder, hidden, row["snr"], ready, known))
        diagnosed = row["verdict"] == row["truth"] != NONE
        more = {"snr": row["snr"], "hidden": hidden["name"], "diagnosed": diagnosed}
        return {**json.loads(path.read_text()), **more}

    single = [(row, hidden[0]) for row, hidden in true.values() if row["kind"] == "single"]
    cases = [of(row, hidden) for row, hidden in single if row["snr"] >= 2]
    limit = float(np.quantile(np.concatenate([case["nothing"] for case in cases]), 1 - ALARMS))
    found = {name: shares(some, limit) for name, some in groups(cases).items() if some}
    origin = reporting.provenance()
    content = {**origin, "limit": limit, "draws": DRAWS, "shares": found}
    reporting.write("ceiling", content, markdown(found, given.folder.name, origin))


if __name__ == "__main__":
    main()
