"""What a diagnosis says, in sentences that a laboratory engineer reads without a glossary.

    verdict and probability. Where the gap lies. How far it shrinks. What to do next.

Nothing is claimed that the record does not hold: a weak verdict is called weak, a shrinkage whose
interval reaches zero is not called one, and numbers without curves are said to be mute.
"""

from collections.abc import Sequence

from calibrate.discrepancy.comparison.classes import TOGETHER
from calibrate.discrepancy.comparison.naming import BEYOND, FEW, FEWEST
from calibrate.discrepancy.comparison.probability_calibration import ALPHA, NONE, UNKNOWN
from calibrate.labtests.diagnosis.curves import TEST_FEATURES, TESTS
from calibrate.records.diagnosis import DiagnosisRecord, NextTestRecord, ReductionRecord, SegmentRow
from calibrate.reports.effects import members, plain, title
from calibrate.reports.html import number

SURE, LIKELY = 0.8, 0.5
ODD = 0.6  # weight of a specimen below which the reader is told
MORE_SCATTER = 1.7  # times the assumed one; normal scatter of four exceeds it in 3 % of tests
ENOUGH = 8  # packings on which leading explanations are simulated where the library ends


def label_of(test: str) -> str:
    """A test in words."""
    return TEST_FEATURES[test].label


def sentence(found: DiagnosisRecord) -> str:
    """The whole answer in one paragraph."""
    parts = [
        verdict(found), further(found), localisation(found), shrinkage(found), todo(found),
        caution(found),
    ]  # fmt: skip
    return " ".join(part for part in parts if part)


def verdict(found: DiagnosisRecord) -> str:
    """What is left out, and how likely that is."""
    which = found.which
    if which.reason:
        return _withheld(found)
    if which.verdict == NONE:
        return _no_gap(found)
    stated = percent(which.probability_by_class.get(which.verdict, 0.0))
    if which.verdict == UNKNOWN:
        return _not_in_library(found, stated)
    what = f"{_sureness(found)} “{title(which.verdict)}” (stated probability {stated})"
    groups = members(which.verdict)
    sentences = [plain(group[0]).sentence for group in groups if len(group) == 1]
    alike = any(len(group) > 1 for group in groups)
    alternatives = " These data cannot tell the alternatives apart." if alike else ""
    return f"{what}. {' '.join(sentences)}".strip().rstrip(".") + "." + alternatives


def _withheld(found: DiagnosisRecord) -> str:
    """Why the likeliest explanation is not named."""
    if found.targets_only:
        return _no_gap(found)
    if found.which.reason == FEW:
        few = ", ".join(
            f"{count} of the {label_of(test)}"
            for test, count in found.settings.repeats.items()
            if 0 < count < FEWEST
        )
        return (
            f"No cause is named: with one or two specimens of a test ({few}) nobody knows by how "
            "much specimens scatter, so they cannot show a gap. Probabilities below take the "
            "scatter from simulations alone."
        )
    if found.which.reason == BEYOND:
        return f"No cause is named: the library does not reach this soil. {_unreached(found)}"
    first = found.explanations[0]
    return (
        f"No cause is named: “{title(first.label)}” would be the likeliest one (stated probability "
        f"{percent(first.probability)}), but the data cannot show that adding it to the model "
        "shrinks the gap."
    )


def _unreached(found: DiagnosisRecord) -> str:
    """Why the library does not reach a soil, and what to do."""
    names = ", ".join(name.replace("_", " ") for name in found.beyond_library)
    why = f"the soil that fits best lies beyond its runs ({names})" if names else (
        "at the soil that fits best it states an error "
        f"{number(found.library_error, 2)} times as large as among its runs"
    )  # fmt: skip
    return (
        f"{why[0].upper()}{why[1:]}, so that what is left may be an error of the library. Add runs "
        f"there: calibrate diagnose LAB.toml --simulate {ENOUGH}."
    )


def beginnings(found: DiagnosisRecord) -> str:
    """What records that begin at contact or at a preload leave open, and what to record."""
    if not found.records_begin:
        return ""
    where = " and ".join(
        f"of the {label_of(test)} at {number(force, 2)} N"
        for test, force in found.records_begin.items()
    )
    return (
        f"Records begin {where}, without a reading before contact: an untared load cell, a loose "
        "seat and first touch are left free there, so nothing is concluded from them. To judge "
        "them, start recording half a millimetre before the platen touches."
    )


def _not_in_library(found: DiagnosisRecord, stated: str) -> str:
    """No effect explains the gap; said with care where stated probabilities do not agree."""
    text = (
        "The calibrated model lacks something that is not in the library of effects: there is a "
        "gap, and no effect or pair of effects explains all of it"
    )
    first = found.explanations[0]
    if first.label == UNKNOWN:
        return f"{text} (stated probability {stated})."
    chance = percent(found.which.p_left_after_best)
    return (
        f"{text} (what is left after the best one would be scatter in {chance} of such "
        f"laboratories). The explanation that comes nearest is “{title(first.label)}”."
    )


def _sureness(found: DiagnosisRecord) -> str:
    stated = found.which.probability_by_class.get(found.which.verdict, 0.0)
    count = " two things at once:" if TOGETHER in found.which.verdict else ""
    if stated >= SURE:
        return f"What the calibrated model leaves out is most likely{count}"
    if stated >= LIKELY:
        return f"What the calibrated model leaves out is probably{count}"
    return (
        "The calibrated model leaves something out; what it is stays open, and the first candidate "
        f"is{count}"
    )


def _no_gap(found: DiagnosisRecord) -> str:
    stated = percent(found.which.probability_by_class.get(NONE, 0.0))
    if found.targets_only:
        count = len(found.features)
        return (
            f"{_count(count)} without curves cannot show a gap: calibration can meet them whatever "
            "the model leaves out."
        )
    chance = percent(found.which.p_gap)
    first = found.explanations[0].label
    if first != NONE or found.which.p_gap <= ALPHA:
        return _not_named(found, first, stated, chance)
    return (
        "No gap was found: the calibrated model fits these curves as well as repeats agree with "
        f"each other (stated probability of no gap {stated}; scatter alone would give a misfit "
        f"like this in {chance} of such laboratories)."
    )


def _not_named(found: DiagnosisRecord, first: str, stated: str, chance: str) -> str:
    """There may be a gap, but that there is none is not unlikely enough to name its cause."""
    scatter = f"scatter alone would give a misfit like this in {chance} of such laboratories"
    if first == NONE:
        return (
            f"No cause is named: {scatter}, yet that nothing is left out is likelier than any "
            f"explanation (stated probability {stated}). More repeats would tell."
        )
    likeliest = percent(found.which.probability_by_class.get(first, 0.0))
    what = (
        "something that the library of effects does not hold"
        if first == UNKNOWN
        else f"“{title(first)}”"
    )
    return (
        f"No cause is named: {what} would be the likeliest one (stated probability {likeliest}), "
        f"but the model may as well lack nothing ({stated}; {scatter}). More repeats would tell."
    )


def _count(count: int) -> str:
    return {1: "One number", 2: "Two numbers"}.get(count, f"{count} numbers")


def localisation(found: DiagnosisRecord) -> str:
    """The segments that leave the band, largest score first."""
    if found.which.verdict == NONE:
        return ""
    flagged = sorted((s for s in found.where if s.outside_band), key=lambda s: -abs(s.z))
    if not flagged:
        return "No single stretch of the curves stands out; the gap is spread over them."
    return f"The gap shows most at the {'; then at the '.join(_lies(s) for s in flagged[:2])}."


def _lies(segment: SegmentRow) -> str:
    """Where a segment's measured curve runs, seen from the model's."""
    name = TEST_FEATURES[segment.test].in_words(segment.segment)
    words = ("right of", "left of") if segment.unit == "mm" else ("above", "below")
    side = words[0] if segment.gap > 0 else words[1]
    by = amount(abs(segment.gap), segment.unit)
    return f"{name}, where the measured curve runs {by} {side} the model's"


def shrinkage(found: DiagnosisRecord) -> str:
    """How much of the gap goes with the best effect, only if the data can show it."""
    if found.how_far is None or not found.best:
        if found.which.verdict in (NONE, UNKNOWN):
            return ""
        return (
            "Place by place the gap is no larger than the library's own error, so how far it "
            "shrinks cannot be told; runs about it would: calibrate diagnose LAB.toml --simulate "
            f"{ENOUGH}."
        )
    far, name = found.how_far, " and ".join(plain(n).name for n in found.best)
    if far.shrinkage <= 0:
        return f"Adding “{name}” to the model does not shrink the gap."
    ends = _why_outside(found)
    if far.interval is not None:
        low, high = far.interval
        ends = f"90 % interval {percent(low)} to {percent(high)}"
    if far.interval is not None and far.interval[0] <= 0:
        return f"The data cannot show that adding “{name}” shrinks the gap ({ends})."
    elif not far.shown:
        found_here = f"{percent(far.shrinkage)} here, {ends}{_fresh(far)}"
        return f"How much of the gap goes with “{name}” the data cannot show ({found_here})."
    share = f"{percent(far.shrinkage)} of the gap ({ends}{_fresh(far)})"
    text = f"Adding “{name}” to the model removes {share}"
    alone = TOGETHER in found.which.verdict and len(found.best) == 1
    return text + ("; the second effect is not counted in this." if alone else ".")


def _why_outside(found: DiagnosisRecord) -> str:
    """What it means that the interval does not hold its estimate."""
    if found.which.p_left_after_best < ALPHA:
        return "its interval does not hold, as the effect is not all that is left out"
    return "no interval: the gap is hardly larger than the scatter of specimens"


def _fresh(far: ReductionRecord) -> str:
    if far.shrinkage_left_out != far.shrinkage_left_out:
        return ""
    return f"; {percent(far.shrinkage_left_out)} on specimens left out of the fit"


def todo(found: DiagnosisRecord) -> str:
    """The next step."""
    if found.targets_only:
        return (
            "Next: record force and displacement of both tests, on at least three specimens each."
        )
    if found.which.reason == FEW:
        return f"Next: record at least {FEWEST} specimens of each test."
    if found.which.reason:
        return ""
    if found.which.verdict == NONE:
        return _undetectable(found)
    if found.next_test is None:
        return ""
    if found.which.verdict == UNKNOWN and found.next_test.stop:
        return (
            "Next: look at the places above for what acts there; no further test on the list names "
            "what the library does not hold."
        )
    if found.which.verdict == UNKNOWN:
        return (
            f"Next: look at the places above for what acts there; {found.next_test.name} would "
            "tell the library's nearest effects apart, though the right one may be none of them."
        )
    return _proposed(found.next_test)


def _proposed(test: NextTestRecord) -> str:
    cost = next((offer.cost for offer in test.all if offer.name == test.name), float("nan"))
    what = f"{test.name} (about {number(cost, 2)} h)"
    pair = [plain(name).name for name in test.hardest_pair]
    between = f"“{pair[0]}” from “{pair[1]}”"
    if test.stop == "sure":
        return f"Nothing more need be measured to name it; to confirm it: {what}."
    if test.stop:
        return f"No further test on the list would tell {between} better than these data do."
    now, then = percent(test.chance_now), percent(test.chance)
    return (
        f"Next: {what}; with it the chance to name the right cause goes from {now} to {then}. "
        "`calibrate next` lists all tests and writes a lab file for the answer."
    )


def further(found: DiagnosisRecord) -> str:
    """What further tests have changed."""
    made = found.further_tests
    if made is None:
        return ""
    names = ", ".join(made.tests)
    if not made.foreseen:
        return f"Further tests ({names}) showed what no explanation foresees."
    name = max(made.before, key=lambda one: found.which.probability.get(one, 0.0))
    then, now = made.before[name], found.which.probability.get(name, 0.0)
    return f"Further tests ({names}) took “{title(name)}” from {percent(then)} to {percent(now)}."


def _undetectable(found: DiagnosisRecord) -> str:
    """Effects that could hide in data without a gap."""
    hidden = [plain(e.name).name for e in found.which.effects if e.status == "inconclusive"]
    if not hidden:
        return "Every effect of the library would have shown at its typical strength."
    return (
        f"Not excluded, as these data could not show them at typical strength: {', '.join(hidden)}."
    )


def caution(found: DiagnosisRecord) -> str:
    """What weakens the answer: few repeats, odd ones, more scatter than assumed, a soil beyond the
    library, an effect that calibration mimics."""
    absent = [label_of(test) for test in TESTS
              if found.settings.repeats.get(test, 0) == 0]  # fmt: skip
    parts = [*_odd(found.specimen_weights)]
    parts += [told] if (told := beginnings(found)) else []
    if absent:
        parts.append(f"Nothing of the {' and the '.join(absent)} was given.")
    if found.unused_tests:
        parts.append(
            f"Not used, without curves or not in the library: {', '.join(found.unused_tests)}."
        )
    parts += [
        f"Repeats of the {label_of(test)} scatter {number(ratio, 2)} times as much as the "
        "diagnosis assumes: take its probabilities for too sure."
        for test, ratio in found.scatter_over_assumed.items()
        if ratio > MORE_SCATTER
    ]
    if found.beyond_library and found.which.reason != BEYOND:
        names = ", ".join(name.replace("_", " ") for name in found.beyond_library)
        parts.append(f"The soil that fits best lies beyond those of the library ({names}): part of "
                     "the gap may be an error of the library there.")  # fmt: skip
    absorbed = {n for group in members(found.which.verdict) for n in group}
    absorbed &= set(found.which.absorbed_by_calibration)
    if absorbed:
        names = ", ".join(sorted(plain(n).name for n in absorbed))
        parts.append(f"Calibration can imitate {names} almost wholly.")
    return " ".join(parts)


def _odd(weights: Sequence[float]) -> list[str]:
    """Specimens that count for less, because they lie far from the others."""
    return [
        f"Specimen {number_} lies far from the others and counts for {percent(weight)} of one."
        for number_, weight in enumerate(weights, 1)
        if weight < ODD
    ]


def amount(value: float, unit: str) -> str:
    """A size with its unit, two digits."""
    return f"{number(value, 2)} {unit}"


def percent(value: float) -> str:
    """A share as whole per cent; below one, as such."""
    if value != value:
        return "–"
    if 0 < value < 0.005:
        return "under 1 %"
    if 0.995 < value < 1:
        return "over 99 %"
    return f"{100 * value:.0f} %".replace("-0 %", "0 %").replace("-", "−")
