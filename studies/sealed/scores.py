"""What the verdicts are worth once the seal is open: shares with Clopper-Pearson intervals.

A case is right if the class of its effect is named first ("a + b" for two effects), one that hides
nothing, or nothing but scatter between specimens, if the verdict is none, a case from outside the
library if it is unknown.  A failed diagnosis is wrong.  Stated probabilities are judged against a
perfect forecaster of the same number of cases.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from calibrate.discrepancy.comparison.classes import JOINED, TOGETHER
from calibrate.discrepancy.comparison.probability_calibration import NONE, UNKNOWN
from calibrate.discrepancy.comparison.reduction import is_reportable

CONFIDENT = 0.8
BINS = 10
STRATA = ((0.5, 2.0), (2.0, 6.0), (6.0, np.inf))
CLOSE = 0.1  # of the claimed shrinkage to the realised one
SCATTER = "scatter"  # kind of a case that hides nothing but scatter between specimens
RIVALS = ("majority", "template", "bic", "classifier")


@dataclass(frozen=True)
class Row:
    """One case: what was true and what was said, as labels of the case's own classes."""

    case: str
    kind: str
    snr: float
    truth: str
    verdict: str
    stated: float
    of_truth: float
    second: str
    in_set: bool
    set_size: int
    p_before: float
    rivals: dict[str, str]
    claimed: float | None
    realised: float | None
    realised_error: float | None = None
    too_vague: bool = False  # an effect was named, but the data could not show any shrinkage
    spheres: int | None = None  # in a specimen, where the label says it


@dataclass(frozen=True)
class Realised:
    """Shrinkage of the gap on fresh specimens, and its standard error."""

    value: float
    error: float | None


def row(verdict: dict, label: dict, realised: Realised | None = None) -> Row:
    """A verdict beside its label."""
    truth = truth_of(label, verdict.get("classes", []))
    by_class = verdict.get("by_class", {})
    ranked = sorted(by_class, key=lambda n: -by_class[n])
    claimed = verdict.get("claimed")
    reportable = claims_shrinkage(verdict)
    likely = verdict.get("likely_set", [])
    return Row(
        case=verdict["case"],
        kind=label["kind"],
        snr=label.get("snr", 0.0),
        truth=truth,
        verdict=verdict["verdict"],
        stated=verdict["stated"],
        of_truth=by_class.get(truth, 0.0),
        second=next((n for n in ranked if n != verdict["verdict"]), ""),
        in_set=truth in likely,
        set_size=len(likely),
        p_before=verdict.get("p_before", 1.0),
        rivals=verdict.get("rivals", {}),
        claimed=claimed["shrinkage"] if claimed and reportable else None,
        realised=None if realised is None else realised.value,
        realised_error=None if realised is None else realised.error,
        too_vague=claimed is not None and not reportable,
        spheres=label.get("spheres"),
    )


def claims_shrinkage(verdict: dict) -> bool:
    """Whether a verdict claims by how much the gap shrinks."""
    claimed = verdict.get("claimed")
    return bool(claimed) and is_reportable(claimed["low"], claimed["high"])


def truth_of(label: dict, classes: Sequence[Sequence[str]]) -> str:
    """The right answer in a case's own classes; an effect in none of them is its own class."""
    if label["kind"] in (NONE, SCATTER):
        return NONE
    if label["kind"] == "outside":
        return UNKNOWN
    named = {hidden["name"] for hidden in label["hidden"]}
    joined = {JOINED.join(group) for group in classes if named & set(group)}
    alone = named - {name for group in classes for name in group}
    return TOGETHER.join(sorted(joined | alone))


def share(values: Iterable[bool]) -> dict:
    """A share with its 95 % Clopper-Pearson interval and the number of cases."""
    found = np.asarray(list(values), bool)
    if not len(found):
        return {"value": None, "low": None, "high": None, "n": 0}
    interval = stats.binomtest(int(found.sum()), len(found)).proportion_ci(0.95, "exact")
    low, high = float(interval.low), float(interval.high)
    return {"value": float(found.mean()), "low": low, "high": high, "n": len(found)}


def area(hidden: Sequence[float], nothing: Sequence[float]) -> dict:
    """How often a case that hides something has the smaller p-value of the two (ties half): the
    area under the ROC curve, with the interval of Hanley and McNeil (1982, Radiology 143)."""
    n, m = len(hidden), len(nothing)
    if not n or not m:
        return {"value": None, "low": None, "high": None, "n": 0}
    a = float(stats.mannwhitneyu(nothing, hidden).statistic / (n * m))
    first, second = a / (2 - a), 2 * a**2 / (1 + a)
    variance = a * (1 - a) + (n - 1) * (first - a**2) + (m - 1) * (second - a**2)
    reach = float(stats.norm.ppf(0.975) * np.sqrt(variance / (n * m)))
    return {"value": a, "low": max(a - reach, 0.0), "high": min(a + reach, 1.0), "n": n + m}


def scored(rows: Sequence[Row], seed: int = 0) -> dict:
    """All scores of a set of cases."""
    of = {k: [r for r in rows if r.kind == k] for k in (NONE, "single", "two", "outside")}
    clear = [r for r in of["single"] if r.snr >= STRATA[1][0]]
    claims = [r for r in rows if r.claimed is not None and r.realised is not None]
    in_library = [*clear, *of["two"]]
    return {
        "cases": len(rows),
        "accuracy": share(_right(r) for r in of["single"]),
        "accuracy_by_snr": {
            _name(s): share(_right(r) for r in _in(of["single"], s)) for s in STRATA
        },
        "first_two_by_snr": {
            _name(s): share(r.truth in (r.verdict, r.second) for r in _in(of["single"], s))
            for s in STRATA
        },
        "gate_detects_by_snr": {
            _name(s): share(r.p_before <= 0.05 for r in _in(of["single"], s)) for s in STRATA
        },
        "false_alarm": share(r.verdict != NONE for r in of[NONE]),
        "detection_auc": area(
            [r.p_before for r in rows if r.kind not in (NONE, SCATTER)],
            [r.p_before for r in of[NONE]],
        ),
        "gate_rejects_null": share(r.p_before <= 0.05 for r in of[NONE]),
        "unknown_recall": share(r.verdict == UNKNOWN for r in of["outside"]),
        "visible_unknown_recall": share(
            r.verdict == UNKNOWN for r in of["outside"] if r.snr >= STRATA[1][0]
        ),
        "outside_noticed": share(r.verdict != NONE for r in of["outside"]),
        "outside_by_snr": outside_by_snr(of["outside"]),
        "outside_taken_for_an_effect": share(
            r.verdict not in (UNKNOWN, NONE) for r in of["outside"]
        ),
        "known_called_unknown": share(r.verdict == UNKNOWN for r in in_library),
        "two_both_named": share(_right(r) for r in of["two"]),
        "two_one_named": share(bool(_parts(r.verdict) & _parts(r.truth)) for r in of["two"]),
        "wrong_and_confident": share(r.stated >= CONFIDENT and not _right(r) for r in rows),
        "set_coverage": share(r.in_set for r in rows),
        "mean_set_size": float(np.mean([r.set_size for r in rows])) if rows else None,
        "calibration_error": calibration(rows, seed),
        "shrinkage_within_10": share(abs(_claim(r)) <= CLOSE for r in claims),
        "shrinkage_shown": share(
            r.claimed is not None for r in rows if r.claimed is not None or r.too_vague
        ),
        "rivals": {name: against(clear, rows, name) for name in RIVALS},
        "confusion": confusion(rows),
    }


def outside_by_snr(outside: Sequence[Row]) -> dict[str, dict[str, dict]]:
    """Effects that the library does not have, by how visible they are: shares `unknown` and
    `noticed`; empty for labels from before their signal-to-noise was simulated."""
    if not any(r.snr for r in outside):
        return {}
    return {
        _name(stratum): {
            "unknown": share(r.verdict == UNKNOWN for r in _in(outside, stratum)),
            "noticed": share(r.p_before <= 0.05 for r in _in(outside, stratum)),
        }
        for stratum in ((0.0, STRATA[0][0]), *STRATA)
    }


def _right(r: Row) -> bool:
    return r.verdict == r.truth


def _parts(label: str) -> set[str]:
    return set(label.split(TOGETHER))


def _claim(r: Row) -> float:
    return (r.claimed or 0.0) - (r.realised or 0.0)


def _in(rows: Iterable[Row], stratum: tuple[float, float]) -> list[Row]:
    return [r for r in rows if stratum[0] <= r.snr < stratum[1]]


def _name(stratum: tuple[float, float]) -> str:
    low, high = stratum
    if not low:
        return f"below {high:g}"
    return f"{low:g}-{high:g}" if np.isfinite(high) else f"above {low:g}"


def calibration(rows: Sequence[Row], seed: int) -> dict:
    """Expected calibration error of the stated probabilities as `value`, the range below which a
    perfect forecaster's stays in 95 % of such sets as `high`, Brier and log score, bins."""
    stated = np.array([r.stated for r in rows])
    right = np.array([_right(r) for r in rows], float)
    rng = np.random.default_rng(seed)
    perfect = [
        expected_error(stated, (rng.random(len(rows)) < stated).astype(float)) for _ in range(2000)
    ]
    index = np.minimum((stated * BINS).astype(int), BINS - 1)
    bins = [
        {"from": b / BINS, "stated": float(stated[index == b].mean()),
         "right": share(right[index == b] > 0)}
        for b in range(BINS) if (index == b).any()
    ]  # fmt: skip
    return {
        "value": expected_error(stated, right),
        "low": 0.0,
        "high": float(np.quantile(perfect, 0.95)),
        "n": len(rows),
        "brier": float(np.mean((stated - right) ** 2)),
        "log_score": float(np.mean([np.log(max(r.of_truth, 1e-6)) for r in rows])),
        "bins": bins,
    }


def expected_error(stated: np.ndarray, right: np.ndarray) -> float:
    """Mean distance, over cases in bins, of stated probabilities (n,) from the share right."""
    index = np.minimum((stated * BINS).astype(int), BINS - 1)
    gaps = [
        abs(stated[index == b].mean() - right[index == b].mean()) * (index == b).mean()
        for b in range(BINS)
        if (index == b).any()
    ]
    return float(sum(gaps))


def against(clear: Sequence[Row], rows: Sequence[Row], name: str) -> dict:
    """A rival's share of right answers on clear single effects and on all cases, its false
    alarms, and the exact McNemar p-value of the difference on all cases."""
    ours = np.array([_right(r) for r in rows], bool)
    theirs = np.array([r.rivals.get(name) == r.truth for r in rows], bool)
    single = np.array([r in clear for r in rows], bool)
    only_ours, only_theirs = int((ours & ~theirs).sum()), int((theirs & ~ours).sum())
    pairs = only_ours + only_theirs
    return {
        "right_of_clear": share(theirs[single]),
        "ours_of_clear": share(ours[single]),
        "right_of_all": share(theirs),
        "ours_of_all": share(ours),
        "gain_in_points": float(100 * (ours.mean() - theirs.mean())) if len(rows) else None,
        "gain_in_points_clear": _gain(ours[single], theirs[single]),
        "mcnemar_p": float(stats.binomtest(only_ours, pairs).pvalue) if pairs else 1.0,
        "false_alarm": share(r.rivals.get(name) != NONE for r in rows if r.kind == NONE),
    }


def _gain(ours: np.ndarray, theirs: np.ndarray) -> float | None:
    return float(100 * (ours.mean() - theirs.mean())) if len(ours) else None


def confusion(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """How often each verdict was given for each truth (two effects as one kind)."""
    table: dict[str, dict[str, int]] = {}
    for r in rows:
        truth, said = (_short(label) for label in (r.truth, r.verdict))
        table.setdefault(truth, {}).setdefault(said, 0)
        table[truth][said] += 1
    return table


def _short(label: str) -> str:
    return "two effects" if " + " in label else label
