"""withheld.json of `python -m studies.sealed`: scores of cases whose effect was withheld.

Only the shape is checked; a score without cases is null.
"""

from typing import Annotated

from pydantic import Field

from calibrate.records.base import Record
from studies.sealed.scores import Row

Count = Annotated[int, Field(ge=0)]


class Share(Record):
    """A share of `n` cases and its 95 % interval."""

    value: float | None
    low: float | None
    high: float | None
    n: Count


class Bin(Record):
    """Cases whose stated probability lies in one tenth, and how many of them were right."""

    begin: Annotated[float, Field(alias="from")]
    stated: float
    right: Share


class Calibration(Share):
    """Error of stated probabilities; `high` is what 95 % of perfect forecasters stay below."""

    brier: float | None
    log_score: float | None
    bins: list[Bin]


class Rival(Record):
    """A simpler method on the same cases; gains are in percentage points, ours minus theirs."""

    right_of_clear: Share
    ours_of_clear: Share
    right_of_all: Share
    ours_of_all: Share
    gain_in_points: float | None
    gain_in_points_clear: float | None
    mcnemar_p: float
    false_alarm: Share


class Canary(Record):
    """What a classifier that sees only files' metadata gets right."""

    right: float | None
    shuffled: float | None
    p_value: float | None


class Hidden(Record):
    """An effect that a case had, with its strength in SI units."""

    name: str
    strength: float


class WithheldRecord(Record):
    """All scores, all cases, and what made them (empty in files of earlier versions)."""

    command: str = ""
    versions: dict[str, str] = Field(default_factory=dict)
    physics: int = 0
    seed: int | None = None
    cases: Count
    accuracy: Share
    accuracy_by_snr: dict[str, Share]
    first_two_by_snr: dict[str, Share]
    gate_detects_by_snr: dict[str, Share]
    false_alarm: Share
    detection_auc: Share
    gate_rejects_null: Share
    unknown_recall: Share
    visible_unknown_recall: Share | None = None
    outside_noticed: Share
    outside_by_snr: dict[str, dict[str, Share]] = Field(default_factory=dict)
    outside_taken_for_an_effect: Share
    known_called_unknown: Share
    two_both_named: Share
    two_one_named: Share
    wrong_and_confident: Share
    set_coverage: Share
    mean_set_size: float | None
    calibration_error: Calibration
    shrinkage_within_10: Share
    shrinkage_shown: Share | None = None
    rivals: dict[str, Rival]
    other_code: bool
    given_up: Count
    canary: Canary
    rows: list[Row]
    hidden: dict[str, list[Hidden]]

    def plain(self) -> dict:
        """The result as `studies.sealed.run.opened` returns it."""
        return self.model_dump(by_alias=True)
