"""What was asked of withheld cases before any was made, beside what the scores say.

Two sets of bounds: for cases of this project's own simulator, and for those of another code,
where every case also has a difference of contact law and walls.  A target is met or missed by
the value itself; a target met by a value whose 95 % interval reaches past the bound is said to
be met within chance.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

AT_LEAST, AT_MOST, BELOW = "≥", "≤", "<"
GAIN, SIGNIFICANT = 10.0, 0.05  # points over each rival, and McNemar's level
CASES, CASES_OF_OTHER, CASES_OF_SIZES = 200, 40, 30
RIVALS = {
    "majority": "always giving the commonest answer",
    "template": "a template match without projection",
    "bic": "a refit of each effect with BIC and independent noise",
    "classifier": "a classifier trained on the library of runs",
}


class Standing(StrEnum):
    """How a target stands."""

    MET = "met"
    WITHIN_CHANCE = "met within chance"
    MISSED = "missed"
    NO_CASES = "no such cases"


@dataclass(frozen=True)
class Criterion:
    """One bound and what was found; `unit` is "share", "cases", "points" or "" (a plain number);
    `low` and `high` are a 95 % interval if there is one; `clause` must hold besides."""

    words: str
    sense: str
    bound: float
    unit: str
    value: float | None
    low: float | None = None
    high: float | None = None
    n: int | None = None
    clause: bool = True

    @property
    def standing(self) -> Standing:
        if self.value is None or self.n == 0:
            return Standing.NO_CASES
        if not (self._holds(self.value) and self.clause):
            return Standing.MISSED
        end = self.low if self.sense == AT_LEAST else self.high
        return Standing.MET if end is None or self._holds(end) else Standing.WITHIN_CHANCE

    def _holds(self, value: float) -> bool:
        if self.sense == AT_LEAST:
            return value >= self.bound
        return value < self.bound if self.sense == BELOW else value <= self.bound


def other_code(result: dict) -> bool:
    """Whether another code computed the cases: `other_code` of the result if it says so, else
    whether single effects have no signal-to-noise, which only our own generator states."""
    single = [row for row in result["rows"] if row["kind"] == "single"]
    return bool(result.get("other_code", single and not any(row["snr"] for row in single)))


def criteria(result: dict) -> list[Criterion]:
    """Every target with what `studies.sealed.run.opened` returned."""
    other = other_code(result)
    return [*_counts(result, other), *_shares(result, other), _calibration(result), *_gains(result)]


def _counts(result: dict, other: bool) -> Iterator[Criterion]:
    of_sizes = result.get("other_sizes", False)
    wanted = CASES_OF_OTHER if other else CASES_OF_SIZES if of_sizes else CASES
    yield Criterion("cases", AT_LEAST, wanted, "cases", result["cases"])


def _shares(result: dict, other: bool) -> Iterator[Criterion]:
    by_snr = result["accuracy_by_snr"]
    strong, alarms = (0.80, 0.10) if other else (0.90, 0.05)
    yield _share(
        "right class first at a signal-to-noise above 6", AT_LEAST, strong, by_snr["above 6"]
    )
    yield _share("right class first at a signal-to-noise of 2 to 6", AT_LEAST, 0.60, by_snr["2-6"])
    yield _share("false alarms where nothing is hidden", AT_MOST, alarms, result["false_alarm"])
    yield _share(
        "causes outside the library of effects called unknown, of those above 2",
        AT_LEAST, 0.70, result["visible_unknown_recall"],
    )  # fmt: skip
    yield _share(
        "effects of the library (signal-to-noise above 2, or two) called unknown",
        AT_MOST, 0.10, result["known_called_unknown"],
    )  # fmt: skip
    yield _share("wrong and sure of it (stated 0.8 or more)", BELOW, 0.05,
                 result["wrong_and_confident"])  # fmt: skip
    yield _share(
        "claimed shrinkage within 10 points of that on fresh specimens",
        AT_LEAST, 0.80, result["shrinkage_within_10"],
    )  # fmt: skip


def _share(words: str, sense: str, bound: float, found: dict) -> Criterion:
    found_share = (found[key] for key in ("value", "low", "high", "n"))
    return Criterion(words, sense, bound, "share", *found_share)


def _calibration(result: dict) -> Criterion:
    found = result["calibration_error"]
    words = "calibration error of stated probabilities (bound: 95 % of perfect forecasters)"
    return Criterion(words, AT_MOST, found["high"], "", found["value"], n=found["n"])


def _gains(result: dict) -> Iterator[Criterion]:
    for name, words in RIVALS.items():
        found = result["rivals"][name]
        significant = found["mcnemar_p"] < SIGNIFICANT
        text = f"better on all cases than {words}"
        yield Criterion(text, AT_LEAST, GAIN, "points", found["gain_in_points"],
                     n=result["cases"], clause=significant)  # fmt: skip
