"""Table 5, the single-factor test, and the verification of the final parameters."""

from collections.abc import Iterator

import numpy as np

from calibrate.labtests.pair import KINDS
from studies.chen_2023.tables import Range, in_text, place, printed, table
from studies.chen_2023.verdict import (
    Attempt,
    Figure,
    Verdict,
    judge,
    judge_value,
    rounded,
    without_data,
)

COLUMNS = {"depression_depth": "depression_depth_mm", "crushing_force": "crushing_force_n"}
TESTS = dict(zip(KINDS, COLUMNS, strict=True))


def figures() -> Iterator[Figure]:
    """The choice of the multiplier, then errors and mismatch of the verification."""
    yield best_multiplier()
    yield from verification()
    yield from conclusions()


def relative_errors(response: str, target: float) -> np.ndarray:
    """Errors (8,) of Table 5's rows against a target, in percent of it."""
    return 100 * (table(5).values(COLUMNS[response]) / target - 1)


def best_multiplier() -> Figure:
    """The multiplier whose relative errors in depth and force have the least sum."""
    total = sum(np.abs(relative_errors(name, target(name))) for name in COLUMNS)
    multipliers = table(5).values("tangential_multiplier")
    best = float(multipliers[int(np.argmin(total))])
    text = in_text("sweep.best_multiplier")
    exact = Range(printed(text).value)
    title = "multiplier of least error in both responses"
    return judge_value("Table 5", title, exact, text, [Attempt(Range(best))])


def target(response: str) -> float:
    """The measured mean in the paper's body, mm or N."""
    return printed(in_text(f"measured.{response}")).value


def final_row(response: str) -> Range:
    """Table 5's depth (mm) or force (N) at the final multiplier."""
    final = in_text("final.tangential_multiplier")
    rows = table(5).rows.items()
    run = next(run for run, row in rows if row["tangential_multiplier"] == final)
    return table(5).cell(run, COLUMNS[response])


def verification() -> Iterator[Figure]:
    """Errors against Table 5's row with the final parameters; mismatch has no printed data."""
    for test, response in TESTS.items():
        numbers = (final_row(response), printed(in_text(f"measured.{response}")))
        error = rounded(
            lambda x: {"percent": 100 * abs(float(x[0] / x[1]) - 1)},
            np.array([number.value for number in numbers]),
            np.array([number.reach for number in numbers]),
        )["percent"]
        title, text = f"error of the {test} test", in_text(f"verification.error_{test}")
        final = in_text("final.tangential_multiplier")
        remark = f"by Table 5's row of multiplier {final}; the verification run is not printed"
        yield judge("Verification", title, text, [Attempt(error)], remark, "%")
        for name in (f"verification.mismatch_{test}", f"abstract.mismatch_{test}"):
            title = f"R² of curves, {test} ({place(name)})"
            remark = "the two curves are a picture without numbers"
            yield without_data("Verification", title, in_text(name), remark, "%")


def conclusions() -> Iterator[Figure]:
    """Bounds that the conclusions state, against the errors and R2 printed before."""
    errors = [printed(in_text(f"verification.error_{test}")).value for test in TESTS]
    matches = [printed(in_text(f"verification.mismatch_{test}")).value for test in TESTS]
    below, above = in_text("conclusion.error_below"), in_text("conclusion.mismatch_above")
    largest, least = max(errors), min(matches)
    yield _bound("both errors are below", below, largest, largest < printed(below).value)
    yield _bound("both R² are above", above, least, least > printed(above).value)


def _bound(name: str, text: str, worst: float, holds: bool) -> Figure:
    """A published bound in percent and the printed number that comes nearest to it."""
    verdict = Verdict.REPRODUCED if holds else Verdict.NOT_REPRODUCED
    bound = printed(text).value
    return Figure("Verification", name, bound, text, worst, None, verdict, "", "%")
