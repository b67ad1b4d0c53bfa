"""Does the diagnosis hold its rates?  Its statistics on laboratories of formulas.

No DEM runs here: reality and simulator are the toy soil (`toy_soil`), so that hundreds of
cases with a known truth cost a minute of processor time.  What is checked is statistics: the
gate's rate of false alarms with a covariance estimated from sixty simulated specimens, how
often the right class is named over signal-to-noise, gaps outside the library, stated
probabilities, sets, all beside what is usually done.  It says nothing about soil.

    python benchmarks/diagnosis_statistics.py               about 2 minutes of processor time

Development was done with --seed 1000 and above; the committed numbers are of the default
seed, which nothing was tuned on.  Writes benchmarks/results/diagnosis_statistics.json, .md.
"""

import argparse
import json
from dataclasses import asdict, dataclass

import numpy as np
import reporting
import toy_bank as bank
from scipy import stats
from toy_reality import STRATA, Case, Reality, plan

from calibrate.diagnosis import baselines
from calibrate.diagnosis.how_far import feature_weights, fresh_gap, how_far, shrinkage
from calibrate.diagnosis.opinion import NONE, UNKNOWN
from calibrate.diagnosis.rehearsal import KINDS, generated_case, rehearsed
from calibrate.diagnosis.which import Prepared, Which, diagnose, label, prepare

TIERS = ("linear", "curves")
DRAWS = 400  # of the null distributions
REHEARSED = 500
TRAINING = 1500  # generated cases for the classifier
PLAN = (
    [("null", "", 120)]
    + [("single", stratum, 60) for stratum in STRATA]
    + [("pair", "above 6", 60), ("outside", "", 60)]
)
CONFIDENT = 0.8
BINS = 10
METHODS = ("ours", "majority", "template", "bic", "classifier")


@dataclass(frozen=True)
class Row:
    """One case: its truth and what each method said of it, all as labels of classes."""

    kind: str
    stratum: str
    snr: float
    truth: str
    ours: str
    stated: float
    of_truth: float
    second: str
    in_set: bool
    set_size: int
    p_before: float
    p_after: float
    claimed: float | None
    claimed_low: float | None
    claimed_high: float | None
    realised: float | None
    majority: str
    template: str
    bic: str
    classifier: str


@dataclass(frozen=True, eq=False)
class Methods:
    """The diagnosis and the baselines, ready."""

    prepared: Prepared
    least_template: float
    majority: str
    classifier: baselines.Classifier


def methods(tier: str, seed: int, scale: float) -> Methods:
    """Everything that is fitted before a case is seen, from the description alone."""
    description = bank.description(seed, linear=tier == "linear")
    prepared = prepare(description, plan(), seed, int(DRAWS * scale))
    prepared = rehearsed(prepared, seed + 1, int(REHEARSED * scale))
    rng = np.random.default_rng(seed + 2)
    inputs, labels, null = [], [], []
    for number in range(int(TRAINING * scale)):
        case = generated_case(prepared, rng, KINDS[number % len(KINDS)])
        truth = label(prepared.classes, case.truth)
        labels.append("pair" if len(case.truth) == 2 else truth)
        inputs.append(_inputs(prepared, case.measured))
        if case.truth == (NONE,):
            null.append(baselines.template_scores(description, case.measured).max())
    return Methods(
        prepared,
        float(np.quantile(null, 0.95)),
        baselines.majority(labels),
        baselines.train(np.array(inputs), labels),
    )


def _inputs(prepared: Prepared, measured) -> np.ndarray:
    return baselines.classifier_inputs(
        prepared.description, measured, prepared.world.mean_covariance
    )


def row(ready: Methods, case: Case, reality: Reality) -> Row:
    """One case through all methods."""
    prepared, measured = ready.prepared, case.measured
    found = diagnose(prepared, measured)
    names = prepared.classes
    truth = label(names, case.truth)
    ranked = sorted(found.by_class, key=lambda n: -found.by_class[n])
    second = next(n for n in ranked if n != found.verdict)
    description = prepared.description
    template = baselines.template(description, measured, ready.least_template)
    return Row(
        kind=case.kind,
        stratum=case.stratum,
        snr=case.snr,
        truth=truth,
        ours=found.verdict,
        stated=found.stated,
        of_truth=found.by_class.get(truth, 0.0),
        second=second,
        in_set=truth in found.likely_set,
        set_size=len(found.likely_set),
        p_before=found.facts.p_before,
        p_after=found.facts.p_after,
        **shrinkage_row(description, case, found, reality),
        majority=ready.majority,
        template=label(names, (template,)),
        bic=label(names, (baselines.bic(description, measured),)),
        classifier=ready.classifier.best(_inputs(prepared, measured)),
    )


def shrinkage_row(description, case: Case, found: Which, reality: Reality) -> dict:
    """The shrinkage claimed for the best effect and that on fresh specimens, where one effect
    was named at a signal-to-noise above 6."""
    if case.stratum != "above 6" or case.kind != "single" or found.verdict in (NONE, UNKNOWN):
        return dict.fromkeys(("claimed", "claimed_low", "claimed_high", "realised"))
    fit = found.refits[found.best]
    far = how_far(description, case.measured, found.noise, found.base, fit, seed=0)
    fresh, weight = reality.fresh(case), feature_weights(description, found.noise)
    gaps = [fresh_gap(f.values, fresh, weight) for f in (found.base, fit)]
    realised = shrinkage(*gaps)
    return {
        "claimed": far.shrinkage,
        "claimed_low": far.low,
        "claimed_high": far.high,
        "realised": realised,
    }


def share(values) -> dict:
    """A share with its 95 % Clopper-Pearson interval."""
    values = np.asarray(list(values), bool)
    if not len(values):
        return {"value": None, "low": None, "high": None, "n": 0}
    interval = stats.binomtest(int(values.sum()), len(values)).proportion_ci(0.95, "exact")
    return {
        "value": float(values.mean()),
        "low": float(interval.low),
        "high": float(interval.high),
        "n": len(values),
    }


def scored(rows: list[Row], seed: int) -> dict:
    """All scores of one tier."""
    of = {
        kind: [r for r in rows if r.kind == kind] for kind in ("null", "single", "pair", "outside")
    }
    clear = [r for r in of["single"] if r.stratum != "0.5-2"]
    claims = [r for r in rows if r.claimed is not None]
    return {
        "false_alarm": share(r.ours != NONE for r in of["null"]),
        "gate_rejects_null": share(r.p_before <= 0.05 for r in of["null"]),
        "gate_detects": {
            s: share(r.p_before <= 0.05 for r in of["single"] if r.stratum == s) for s in STRATA
        },
        "class_first": {
            s: share(r.ours == r.truth for r in of["single"] if r.stratum == s) for s in STRATA
        },
        "class_in_first_two": {
            s: share(r.truth in (r.ours, r.second) for r in of["single"] if r.stratum == s)
            for s in STRATA
        },
        "pair_named": share(r.ours == r.truth for r in of["pair"]),
        "pair_or_a_member": share(_a_member(r) for r in of["pair"]),
        "unknown_recall": share(r.ours == UNKNOWN for r in of["outside"]),
        "unknown_recall_above_6": share(r.ours == UNKNOWN for r in of["outside"] if r.snr > 6),
        "outside_taken_for_one_effect": share(
            r.ours not in (UNKNOWN, NONE) and " + " not in r.ours for r in of["outside"]
        ),
        "known_called_unknown": share(r.ours == UNKNOWN for r in clear),
        "wrong_and_confident": share(r.stated >= CONFIDENT and r.ours != r.truth for r in rows),
        "wrong_and_confident_by_kind": {
            k: share(r.stated >= CONFIDENT and r.ours != r.truth for r in v) for k, v in of.items()
        },
        "set_coverage": share(r.in_set for r in rows),
        "mean_set_size": float(np.mean([r.set_size for r in rows])),
        "shrinkage_within_10": share(abs(r.claimed - r.realised) <= 0.1 for r in claims),
        "shrinkage_in_interval": share(
            r.claimed_low <= r.realised <= r.claimed_high for r in claims
        ),
        "calibration": calibration(rows, seed),
        "log_score": float(np.mean([np.log(max(r.of_truth, 1e-6)) for r in rows])),
        "against": {name: against(clear, rows, name) for name in METHODS[1:]},
    }


def _a_member(r: Row) -> bool:
    return bool(set(r.ours.split(" + ")) & set(r.truth.split(" + ")))


def calibration(rows: list[Row], seed: int) -> dict:
    """Expected calibration error of the stated probability, and what a perfect forecaster
    who states the same probabilities would show."""
    stated = np.array([r.stated for r in rows])
    right = np.array([r.ours == r.truth for r in rows], float)
    rng = np.random.default_rng(seed)
    perfect = [_ece(stated, rng.random(len(rows)) < stated) for _ in range(2000)]
    edges = np.linspace(0, 1, BINS + 1)
    index = np.minimum((stated * BINS).astype(int), BINS - 1)
    return {
        "ece": _ece(stated, right),
        "perfect_95": float(np.quantile(perfect, 0.95)),
        "brier": float(np.mean((stated - right) ** 2)),
        "bins": [
            {
                "from": float(edges[b]),
                "stated": float(stated[index == b].mean()),
                "right": share(right[index == b]),
            }
            for b in range(BINS)
            if (index == b).any()
        ],
    }


def _ece(stated: np.ndarray, right: np.ndarray) -> float:
    index = np.minimum((stated * BINS).astype(int), BINS - 1)
    return float(
        sum(
            abs(stated[index == b].mean() - right[index == b].mean()) * (index == b).mean()
            for b in range(BINS)
            if (index == b).any()
        )
    )


def against(clear: list[Row], rows: list[Row], name: str) -> dict:
    """A baseline's share of right answers on clear single effects and on all cases, with the
    exact McNemar p-value of the difference on the clear ones."""
    ours = np.array([r.ours == r.truth for r in clear])
    theirs = np.array([getattr(r, name) == r.truth for r in clear])
    only_ours, only_theirs = int((ours & ~theirs).sum()), int((theirs & ~ours).sum())
    pairs = only_ours + only_theirs
    return {
        "right": share(theirs),
        "gain_in_points": float(100 * (ours.mean() - theirs.mean())),
        "mcnemar_p": float(stats.binomtest(only_ours, pairs).pvalue) if pairs else 1.0,
        "right_of_all": share(getattr(r, name) == r.truth for r in rows),
        "false_alarm": share(getattr(r, name) != NONE for r in rows if r.kind == "null"),
    }


def tier_results(tier: str, seed: int, scale: float) -> tuple[dict, list[Row]]:
    """One tier from nothing."""
    ready = methods(tier, seed + 10, scale)
    reality = Reality(tier, seed)
    rows = [
        row(ready, reality.case(kind, stratum), reality)
        for kind, stratum, count in PLAN
        for _ in range(max(int(count * scale), 2))
    ]
    content = scored(rows, seed)
    content["typical_snr"] = reality.typical_snr()
    content["inflation"] = ready.prepared.null.inflation
    content["opinion"] = asdict(ready.prepared.opinion)
    content["classes"] = [list(group) for group in ready.prepared.classes.members]
    return content, rows


def markdown(tiers: dict) -> str:
    """The numbers as tables."""
    text = (
        "# Statistics of the diagnosis on laboratories of formulas\n\n"
        "Toy curves, not DEM: 4 + 4 repeats, covariance from 60 simulated specimens, base "
        "parameters off-centre. Shares in per cent with 95 % Clopper-Pearson intervals.\n"
    )
    rows = []
    for name, get in _LINES:
        rows.append([name, *(_percent(get(content)) for content in tiers.values())])
    text += "\n" + reporting.table(["", *tiers], rows)
    for tier, content in tiers.items():
        c = content["calibration"]
        text += (
            f"\n{tier}: expected calibration error {c['ece']:.3f} (a perfect forecaster: below "
            f"{c['perfect_95']:.3f} in 95 %), Brier score {c['brier']:.3f}, mean size of sets "
            f"{content['mean_set_size']:.2f}, inflation of the covariance "
            f"{content['inflation']:.2f}.\n"
        )
    effects = next(iter(tiers.values()))["typical_snr"]
    rows = [
        [name, *(f"{c['typical_snr'][name][k]:.1f}" for c in tiers.values() for k in range(2))]
        for name in effects
    ]
    header = ["", *(f"{tier}, {what}" for tier in tiers for what in ("sixty", "exact"))]
    text += (
        "\n## Signal-to-noise at typical strength\n\nWith the covariance of sixty specimens, "
        "and with that of all.\n\n" + reporting.table(header, rows)
    )
    text += "\n## Against what is usually done\n\nClear single effects (signal-to-noise above 2).\n"
    for tier, content in tiers.items():
        rows = [
            [
                name,
                _percent(found["right"]),
                f"{found['gain_in_points']:+.0f}",
                f"{found['mcnemar_p']:.2g}",
                _percent(found["right_of_all"]),
                _percent(found["false_alarm"]),
            ]
            for name, found in content["against"].items()
        ]
        header = [tier, "right", "ours, points", "McNemar p", "right of all cases", "false alarms"]
        text += "\n" + reporting.table(header, rows)
    return text


_LINES = [
    ("false alarms (null)", lambda c: c["false_alarm"]),
    ("gate rejects null", lambda c: c["gate_rejects_null"]),
    *((f"gate detects, {s}", lambda c, s=s: c["gate_detects"][s]) for s in STRATA),
    *((f"class named first, {s}", lambda c, s=s: c["class_first"][s]) for s in STRATA),
    *((f"class in first two, {s}", lambda c, s=s: c["class_in_first_two"][s]) for s in STRATA),
    ("pair named", lambda c: c["pair_named"]),
    ("pair or one of it named", lambda c: c["pair_or_a_member"]),
    ("outside called unknown", lambda c: c["unknown_recall"]),
    ("the same, above 6", lambda c: c["unknown_recall_above_6"]),
    ("outside taken for one effect", lambda c: c["outside_taken_for_one_effect"]),
    ("known called unknown", lambda c: c["known_called_unknown"]),
    ("wrong and confident", lambda c: c["wrong_and_confident"]),
    ("shrinkage within 10 points", lambda c: c["shrinkage_within_10"]),
    ("shrinkage in its 90 % interval", lambda c: c["shrinkage_in_interval"]),
    ("sets hold the truth", lambda c: c["set_coverage"]),
]


def _percent(found: dict) -> str:
    if found["value"] is None:
        return "-"
    low, high = 100 * found["low"], 100 * found["high"]
    return f"{100 * found['value']:.0f} ({low:.0f}-{high:.0f}), n {found['n']}"


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--tier", choices=TIERS, action="append", help="default: both")
    parser.add_argument("--scale", type=float, default=1.0, help="share of the cases")
    parser.add_argument("--rows", help="write the rows of all cases to this file, and no results")
    return parser.parse_args()


def main() -> None:
    chosen = arguments()
    tiers, every = {}, {}
    for tier in chosen.tier or TIERS:
        tiers[tier], rows = tier_results(tier, chosen.seed, chosen.scale)
        every[tier] = [asdict(r) for r in rows]
    if chosen.rows:
        with open(chosen.rows, "w", encoding="utf-8") as file:
            json.dump({"tiers": tiers, "rows": every}, file)
        print(markdown(tiers))
        return
    origin = reporting.provenance()
    content = {**origin, "seed": chosen.seed, "tiers": tiers}
    reporting.write("diagnosis_statistics", content, markdown(tiers) + reporting.footer(origin))


if __name__ == "__main__":
    main()
