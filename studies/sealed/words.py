"""Scores of withheld cases in words: the sentences, cells and the Markdown file of a report."""

from collections.abc import Mapping, Sequence

from calibrate.reports.html import number
from studies.sealed.confusion import ConfusionMatrix, confusion_matrix, plain
from studies.sealed.criteria import RIVALS, Criterion, Standing, criteria
from studies.sealed.scores import Row

MARKS = {
    Standing.MET: "●", Standing.WITHIN_CHANCE: "◐", Standing.MISSED: "○", Standing.NO_CASES: "–",
}  # fmt: skip
SCORES = {
    "accuracy": "single effects, right class first, all strengths",
    "two_both_named": "two effects, both named",
    "two_one_named": "two effects, at least one named",
    "gate_rejects_null": "nothing hidden, gate rejects at 5 %",
    "visible_unknown_recall": "outside the library, signal-to-noise above 2, called unknown",
    "outside_noticed": "outside the library, something noticed",
    "outside_taken_for_an_effect": "outside the library, taken for an effect of it",
    "detection_auc": "smaller p-value where something is hidden (area under the ROC curve)",
    "set_coverage": "truth within the stated set of explanations",
    "shrinkage_shown": "an effect named, and the data show how far the gap shrinks",
}
OUTSIDE = {"unknown": "called unknown", "noticed": "gap detected at 5 %"}
PERCENT = "\u00a0%"  # no line ends before the sign
RIVAL_COLUMNS = (
    "rival", "right, all cases", "right, signal-to-noise above 2", "ours minus theirs, points",
    "the same above 2", "McNemar p", "false alarms",
)  # fmt: skip


def markdown(result: dict, title: str) -> str:
    """The whole report as a Markdown file, tables for figures."""
    rows = [Row(**row) for row in result["rows"]]
    aims = [
        [t.words, asked(t), found(t), interval(t), of_cases(t), f"{MARKS[t.standing]} {t.standing}"]
        for t in criteria(result)
    ]
    parts = [
        f"# {title}", sentence(result), standing_sentence(result),
        _table(["", "asked", "found", "95 % interval", "of", ""], aims),
        "## By signal-to-noise", _table(
            ["single effects", "right class first", "among the first two", "gap detected at 5 %"],
            [[name, *(shown(result[key][name]) for key in
                      ("accuracy_by_snr", "first_two_by_snr", "gate_detects_by_snr"))]
             for name in result["accuracy_by_snr"]]),
        *outside_table(result),
        "## Other shares",
        _table(["", "share"], other_shares(result)),
        f"Mean number of explanations in a set: {number(result['mean_set_size'], 3)}.",
        "## Rivals on the same cases", _table(
            RIVAL_COLUMNS, rival_rows(result)),
        "## What was named for what was hidden", _named_table(confusion_matrix(result, rows)),
        "## Stated probabilities", calibration_sentence(result), _bins_table(result),
        "## Seal", canary_sentence(result),
    ]  # fmt: skip
    return "\n\n".join(part.rstrip("\n") for part in parts) + "\n"


def other_shares(result: dict) -> list[list[str]]:
    """Words and value of each further score; files of earlier versions lack some."""
    return [[words, shown(result[key])] for key, words in SCORES.items() if result.get(key)]


# ---------------------------------------------------------------- sentences


def sentence(result: dict) -> str:
    """How often the right class is named, false alarms, and what is unknown, in one sentence."""
    by_snr, alarm = result["accuracy_by_snr"], result["false_alarm"]
    strong, hard, unknown = by_snr["above 6"], by_snr["2-6"], result["unknown_recall"]
    if strong["n"] + hard["n"]:
        right = (
            f"{_counted(strong)} single effects with a signal-to-noise above 6 and in "
            f"{_counted(hard)} between 2 and 6"
        )
    else:
        right = f"{_counted(result['accuracy'])} single effects of any strength"
    return (
        f"The class of the hidden effect was named first in {right}; something was named in "
        f"{_counted(alarm)} cases with nothing hidden; {_counted(unknown)} effects that the "
        "library does not have were called unknown (brackets: 95 % intervals)."
    )


def standing_sentence(result: dict) -> str:
    """How many targets are met, and the names of those that are not."""
    found = criteria(result)
    judged = [criterion for criterion in found if criterion.standing != Standing.NO_CASES]
    missed = [criterion.words for criterion in judged if criterion.standing == Standing.MISSED]
    chance = sum(criterion.standing == Standing.WITHIN_CHANCE for criterion in judged)
    text = f"Of {len(judged)} targets {len(judged) - len(missed)} are met"
    text += f", {chance} of them within chance." if chance else "."
    if missed:
        text += f" Missed: {'; '.join(missed)}."
    without = [criterion.words for criterion in found if criterion.standing == Standing.NO_CASES]
    return text + (f" Without cases to judge by: {'; '.join(without)}." if without else "")


def canary_sentence(result: dict) -> str:
    """Whether files give cases away."""
    found = result["canary"]
    if found["right"] is None:
        return "Too few cases to tell whether their files give them away."
    verdict = "give nothing away" if found["p_value"] > 0.05 else "GIVE SOMETHING AWAY"
    return (
        "From file sizes, numbers of lines, densities and names alone a vote of neighbours finds "
        f"the kind of {percent(found['right'])} of cases, with shuffled labels of "
        f"{percent(found['shuffled'])} (p {p_value(found['p_value'])}): the files {verdict}."
    )


def outside_table(result: dict) -> list[str]:
    """What became of effects that the library does not have, by how visible they are; nothing
    for results that do not say it."""
    by_snr = result.get("outside_by_snr", {})
    rows = [[name, *(shown(found[key]) for key in OUTSIDE)] for name, found in by_snr.items()]
    return [_table(["effects outside the library", *OUTSIDE.values()], rows)] if rows else []


# ---------------------------------------------------------------- words and cells


def percent(value: float | None) -> str:
    """A share for reading: "92 %", with a decimal where it would else read 0 or 100."""
    if value is None:
        return "–"
    digits = 1 if 0 < value < 0.005 or 0.995 <= value < 1 else 0
    return f"{100 * value:.{digits}f}{PERCENT}"


def p_value(value: float) -> str:
    """A p-value: two digits, or an upper bound."""
    return "< 0.001" if value < 0.001 else number(value, 2)


def hidden_words(hidden: Sequence[Mapping]) -> str:
    """What was hidden, with strengths as they are sealed."""
    found = [f"{plain(h['name'])} {number(h['strength'], 3)}" for h in hidden]
    return ", ".join(found) or "nothing"


def _counted(found: Mapping) -> str:
    """A share with its interval and its number of cases."""
    if not found["n"]:
        return "none of 0"
    low, high = (percent(found[key]) for key in ("low", "high"))
    return f"{percent(found['value'])} ({low.removesuffix(PERCENT)}–{high}) of {found['n']}"


def shown(found: Mapping) -> str:
    return "–" if not found["n"] else _counted(found)


def asked(criterion: Criterion) -> str:
    return f"{criterion.sense} {_value(criterion, criterion.bound)}"


def found(criterion: Criterion) -> str:
    """What was found, with a decimal where it would else read as the bound that it is not."""
    text = _value(criterion, criterion.value)
    if (
        criterion.unit == "share"
        and criterion.value != criterion.bound
        and text == asked(criterion)[2:]
    ):
        return f"{100 * (criterion.value or 0.0):.1f}{PERCENT}"
    return text


def _value(criterion: Criterion, value: float | None) -> str:
    if criterion.unit == "share":
        return percent(value)
    if criterion.unit == "points":
        return "–" if value is None else f"{number(round(value, 1), 4)} points"
    return number(value, 3)


def interval(criterion: Criterion) -> str:
    if criterion.low is None or criterion.high is None or not criterion.n:
        return ""
    return f"{percent(criterion.low).removesuffix(PERCENT)}–{percent(criterion.high)}"


def of_cases(criterion: Criterion) -> str:
    return "" if criterion.n is None else str(criterion.n)


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def rival_rows(result: dict) -> list[list[str]]:
    rows = []
    for name, words in RIVALS.items():
        found = result["rivals"][name]
        gains = [found["gain_in_points"], found["gain_in_points_clear"]]
        rows.append(
            [words, *(shown(found[key]) for key in ("right_of_all", "right_of_clear")),
             *("–" if gain is None else number(round(gain, 1), 4) for gain in gains),
             p_value(found["mcnemar_p"]), shown(found["false_alarm"])]
        )  # fmt: skip
    return rows


def _named_table(table: ConfusionMatrix) -> str:
    """Counts, empty for none, the right answers in bold."""
    body = [
        [name, *(f"**{count}**" if right else str(count or "")
                 for count, right in zip(counts, marks, strict=True))]
        for name, counts, marks in zip(table.rows, table.counts, table.right, strict=True)
    ]  # fmt: skip
    return _table(["hidden", *table.columns], body)


def calibration_sentence(result: dict) -> str:
    found = result["calibration_error"]
    return (
        f"Calibration error {number(found['value'], 2)}; a perfect forecaster of {found['n']} such "
        f"cases stays below {number(found['high'], 2)} in 95 % of sets. Brier score "
        f"{number(found['brier'], 3)}, mean log probability of the truth "
        f"{number(found['log_score'], 3)}."
    )


def _bins_table(result: dict) -> str:
    bins = result["calibration_error"]["bins"]
    return _table(
        ["stated (mean)", "right"], [[number(b["stated"], 2), shown(b["right"])] for b in bins]
    )
