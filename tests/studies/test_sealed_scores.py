"""Withheld cases: scores, criteria, report.

Verdicts and labels are written by hand.
"""

import json
import re
import sys
from dataclasses import asdict, replace

import numpy as np
import pytest
from rich.console import Console

from calibrate.core.errors import InputError
from calibrate.discrepancy.comparison.probability_calibration import NONE
from calibrate.discrepancy.library.run_library import Cylinder
from calibrate.labtests.diagnosis.curves import recorded_feature_values
from studies.sealed import report, run
from studies.sealed.confusion import BOTH, FAILED, OTHERS, confusion_matrix
from studies.sealed.criteria import AT_LEAST, AT_MOST, BELOW, Criterion, Standing, criteria
from studies.sealed.labels import normalised
from studies.sealed.scores import (
    Realised,
    Row,
    against,
    calibration,
    confusion,
    row,
    scored,
    share,
    truth_of,
)
from studies.sealed.words import found as found_words
from studies.sealed.words import percent
from tests.support.toy_library import CLASSES, SEAT, label, specimens, verdict

# ---------------------------------------------------------------- scores


CYLINDER = Cylinder(0.05, 0.1, 200.0, 400.0)
ROW = Row("a", "single", 7.0, "wall_friction", "wall_friction", 0.9, 0.9, "none", True, 2, 0.01, {},
          None, None)  # fmt: skip


def test_truth_is_said_in_the_case_s_own_classes():
    assert truth_of(label("a", "none"), CLASSES) == "none"
    assert truth_of(label("a", "outside", "trapped_air"), CLASSES) == "unknown"
    assert truth_of(label("a", "single", "load_frame_compliance"), CLASSES) == SEAT
    pair = label("a", "two", "wall_friction", "acquisition_lag")
    assert truth_of(pair, CLASSES) == "acquisition_lag + wall_friction"
    alike = label("a", "two", "seating_gap", "load_frame_compliance")
    assert truth_of(alike, CLASSES) == SEAT


def test_scatter_between_specimens_is_no_gap_and_hides_no_effect():
    scatter = {"name": "density_scatter", "strength": 1.0, "unit": "ln"}
    seat = {"name": "seating", "strength": 1.0, "unit": "mm"}
    alone = normalised({"kind": "library", "effects": [scatter]})
    beside = normalised({"kind": "two", "effects": [scatter, seat]})
    assert (alone["kind"], truth_of(alone, CLASSES)) == ("scatter", NONE)
    assert (beside["kind"], truth_of(beside, CLASSES)) == ("single", SEAT)
    said = [row(verdict("a", NONE), {**alone, "snr": 0.0})]
    assert scored(said)["rivals"]["bic"]["ours_of_all"]["value"] == 1
    assert scored(said)["detection_auc"]["n"] == 0


def test_a_failed_diagnosis_is_wrong_whatever_was_hidden():
    failed = {"case": "a", "failed": "singular", "verdict": "failed", "stated": 0.0}
    for hidden in (
        label("a", "none"),
        label("a", "single", "wall_friction"),
        label("a", "outside"),
    ):
        found = row(failed, hidden)
        assert found.verdict != found.truth and found.truth
        assert not found.in_set and found.claimed is None


def test_a_row_holds_what_was_said_of_the_truth():
    said = verdict("a", SEAT, 0.6, claimed={"shrinkage": 0.7, "low": 0.6, "high": 0.8})
    said["by_class"] = {SEAT: 0.6, "wall_friction": 0.3, "none": 0.1}
    found = row(said, label("a", "single", "wall_friction"), realised=Realised(0.5, 0.1))
    assert (found.truth, found.of_truth, found.second) == ("wall_friction", 0.3, "wall_friction")
    assert (found.claimed, found.realised, found.realised_error) == (0.7, 0.5, 0.1)
    assert not found.in_set and not found.too_vague


def test_a_wide_interval_claims_no_shrinkage():
    said = verdict("a", SEAT, 0.6, claimed={"shrinkage": 0.7, "low": 0.2, "high": 0.8})
    found = row(said, label("a", "single", "wall_friction"), realised=Realised(0.5, 0.1))
    assert found.claimed is None and found.too_vague
    shown = replace(found, claimed=0.7, too_vague=False)
    scores = scored([found, shown, replace(ROW, claimed=None)])
    assert (scores["shrinkage_shown"]["value"], scores["shrinkage_shown"]["n"]) == (0.5, 2)
    assert (scores["shrinkage_within_10"]["value"], scores["shrinkage_within_10"]["n"]) == (0.0, 1)


@pytest.mark.parametrize(
    ("right", "cases", "low", "high"),
    [
        (682, 925, 0.7076683, 0.7654066),  # binom.test of R, its documented example
        (0, 100, 0.0, 1 - 0.025 ** (1 / 100)),  # closed form at the end
        (120, 150, 0.73, 0.86),
        (42, 60, 0.57, 0.81),
    ],
)
def test_intervals_are_clopper_and_pearson_s(right, cases, low, high):
    found = share([True] * right + [False] * (cases - right))
    digits = 5e-8 if cases in (925, 100) else 5e-3
    assert (found["low"], found["high"]) == pytest.approx((low, high), abs=digits)
    assert (found["value"], found["n"]) == (right / cases, cases)


def test_a_share_of_nothing_is_no_number():
    assert share([])["value"] is None and share([])["n"] == 0


def hand_made() -> list[Row]:
    """Ten cases of every kind, counted by hand in the tests."""
    none = replace(ROW, kind="none", snr=0.0, truth="none", p_before=0.5)
    two = replace(ROW, kind="two", truth="acquisition_lag + wall_friction")
    outside = replace(ROW, kind="outside", snr=0.0, truth="unknown")
    rows = [
        ROW,
        replace(ROW, verdict=SEAT, second="wall_friction", stated=0.8, in_set=False),
        replace(ROW, snr=3.0, verdict="unknown", stated=0.5),
        replace(ROW, snr=1.0, verdict="none", stated=0.4, p_before=0.2),
        replace(none, verdict="none"),
        replace(none, verdict="wall_friction", p_before=0.04, stated=0.7),
        replace(two, verdict=two.truth, claimed=0.5, realised=0.45),
        replace(two, verdict="wall_friction", claimed=0.9, realised=0.7, stated=0.6),
        replace(outside, verdict="unknown"),
        replace(outside, verdict="acquisition_lag", stated=0.85),
    ]
    return [replace(r, case=str(number)) for number, r in enumerate(rows)]


def test_scores_of_hand_made_cases():
    found = scored(hand_made())
    values = {
        k: found[k]["value"] for k in found if isinstance(found[k], dict) and "value" in found[k]
    }
    assert values["accuracy"] == 1 / 4
    assert values["false_alarm"] == values["gate_rejects_null"] == 1 / 2
    assert values["unknown_recall"] == 1 / 2
    assert values["outside_noticed"] == 1 and values["outside_taken_for_an_effect"] == 1 / 2
    assert values["known_called_unknown"] == 1 / 5  # three clear single effects and two pairs
    assert values["two_both_named"] == 1 / 2 and values["two_one_named"] == 1
    assert values["wrong_and_confident"] == 2 / 10  # 0.8 counts
    assert values["detection_auc"] == 15 / 16  # one of 8 x 2 pairs is the wrong way round
    assert values["set_coverage"] == 9 / 10
    assert values["shrinkage_within_10"] == 1 / 2
    assert values["shrinkage_shown"] == 1
    assert found["visible_unknown_recall"]["n"] == 0
    by_snr = {name: found["accuracy_by_snr"][name]["value"] for name in found["accuracy_by_snr"]}
    assert by_snr == {"0.5-2": 0.0, "2-6": 0.0, "above 6": 1 / 2}
    assert found["first_two_by_snr"]["above 6"]["value"] == 1.0
    assert found["gate_detects_by_snr"]["0.5-2"]["value"] == 0.0
    assert found["mean_set_size"] == 2.0


def test_effects_from_outside_are_scored_by_how_visible_they_are():
    outside = replace(ROW, kind="outside", truth="unknown", verdict="none", p_before=0.3)
    said = replace(outside, verdict="unknown", p_before=0.01)
    noticed = replace(outside, verdict="seating_gap", p_before=0.01)
    rows = [replace(r, snr=snr) for r, snr in ((outside, 0.2), (said, 7.0), (noticed, 9.0))]
    found = scored([ROW, *rows])["outside_by_snr"]
    assert found["below 0.5"]["unknown"]["value"] == 0.0
    assert found["above 6"]["unknown"]["value"] == 0.5
    assert found["above 6"]["noticed"]["value"] == 1.0
    assert found["2-6"]["unknown"]["n"] == 0
    before = [replace(r, snr=0.0) for r in rows]  # labels from before it was simulated
    assert scored(before)["outside_by_snr"] == {}


def test_confusion_counts_every_case_once():
    table = confusion(hand_made())
    assert table["wall_friction"] == {"wall_friction": 1, SEAT: 1, "unknown": 1, "none": 1}
    assert table["two effects"] == {"two effects": 1, "wall_friction": 1}
    assert sum(sum(line.values()) for line in table.values()) == 10


def test_calibration_by_hand():
    """Two at 0.9 of which one is right, two at 0.6 both right: (0.4 + 0.4)/2; Brier by hand."""
    stated, right = (0.9, 0.9, 0.6, 0.6), (True, False, True, True)
    rows = [
        replace(ROW, stated=p, of_truth=p, verdict=ROW.truth if r else "none")
        for p, r in zip(stated, right, strict=True)
    ]
    found = calibration(rows, seed=0)
    assert found["value"] == pytest.approx(0.4)
    assert found["brier"] == pytest.approx((0.01 + 0.81 + 0.16 + 0.16) / 4)
    assert found["log_score"] == pytest.approx(np.mean(np.log(stated)))
    assert [b["right"]["n"] for b in found["bins"]] == [2, 2]


def test_a_perfect_forecaster_stays_within_its_range_and_a_boaster_does_not():
    """Ten cases at 0.7: |k/10 - 0.7| is at most 0.2 in 92 % and at most 0.3 in 99 % of sets."""
    perfect = [replace(ROW, stated=0.7, verdict=ROW.truth if n < 7 else "none") for n in range(10)]
    found = calibration(perfect, seed=0)
    assert found["value"] == pytest.approx(0.0) and found["high"] == pytest.approx(0.3)
    random = np.random.default_rng(2)
    stated = random.uniform(0.3, 1.0, 300)
    honest = [
        replace(ROW, stated=p, verdict=ROW.truth if random.random() < p else "none") for p in stated
    ]
    found = calibration(honest, seed=0)
    assert found["value"] <= found["high"]
    boasted = [replace(r, stated=min(1.3 * r.stated, 0.99)) for r in honest]
    found = calibration(boasted, seed=0)
    assert found["value"] > found["high"]


def test_mcnemar_on_a_textbook_table():
    """59 and 80 agree, 6 and 16 do not: exact p = 2 P(k <= 6 of 22) = 0.0525."""
    counts = {(True, True): 59, (True, False): 16, (False, True): 6, (False, False): 80}
    rows = [
        replace(
            ROW,
            verdict=ROW.truth if ours else "none",
            rivals={"bic": ROW.truth if theirs else "none"},
        )
        for (ours, theirs), count in counts.items()
        for _ in range(count)
    ]
    found = against(rows, rows, "bic")
    assert found["mcnemar_p"] == pytest.approx(2 * 110056 / 2**22)
    assert found["gain_in_points"] == pytest.approx(100 * 10 / 161)
    assert found["right_of_all"]["value"] == pytest.approx(65 / 161)


def test_shrinkage_on_fresh_specimens_by_hand():
    """Specimens all alike, so no scatter is taken off: d^2 of 3 shrinks to 5/4, E of 2 to 1.5."""
    features = CYLINDER.features()[:-2]
    fresh = specimens(3, count=1) * 2
    true = recorded_feature_values(
        features, {t: (r[:, 0], r[:, 1]) for t, r in fresh[0].records.items()}
    )
    keep = np.flatnonzero(np.isfinite(true))
    assert len(keep) > 20
    fits = {
        "features": [features[i].name for i in keep],
        "base": (true[keep] + np.sqrt(3)).tolist(),
        "best": (true[keep] + np.sqrt(5 / 4)).tolist(),
        "weight": np.full(len(keep), 1 / len(keep)).tolist(),
    }
    found = run.realised_shrinkage(fits, fresh, CYLINDER)
    assert found.value == pytest.approx(0.5) and found.error is None
    assert run.realised_shrinkage(fits, fresh * 2, CYLINDER).error == pytest.approx(0.0, abs=1e-9)


def test_an_untared_load_cell_shows_on_fresh_specimens_too():
    """What is read before contact is part of the gap that is claimed to shrink."""
    names = ["force before contact, confined", "force before contact, unconfined"]
    fits = {"features": names, "base": [20.0, 20.0], "best": [0.0, 0.0], "weight": [2.0, 2.0]}
    found = run.realised_shrinkage(fits, specimens(4), CYLINDER)
    assert found.value > 0.95 and found.error is not None and found.error < 0.05


def test_the_error_of_a_shrinkage_is_what_it_scatters_by():
    """The jackknife of twelve specimens against the scatter of many such dozens."""
    rng, models, weight = (
        np.random.default_rng(2),
        [np.full(9, 1.5), np.zeros(9)],
        np.full(9, 1 / 9),
    )
    dozens = rng.normal(size=(400, 12, 9))
    stated = [run.jackknife(values, models, weight) for values in dozens[:40]]
    scatter = np.std([run._shrunk(values, models, weight) for values in dozens])
    assert np.median(stated) == pytest.approx(scatter, rel=0.3)


# ---------------------------------------------------------------- criteria and report


@pytest.mark.parametrize(
    ("sense", "value", "low", "high", "standing"),
    [
        (AT_LEAST, 0.90, 0.80, 0.95, Standing.WITHIN_CHANCE),
        (AT_LEAST, 0.97, 0.91, 0.99, Standing.MET),
        (AT_LEAST, 0.89, 0.80, 0.95, Standing.MISSED),
        (AT_MOST, 0.90, 0.80, 0.95, Standing.WITHIN_CHANCE),
        (AT_MOST, 0.91, 0.80, 0.95, Standing.MISSED),
        (BELOW, 0.90, 0.80, 0.95, Standing.MISSED),
        (BELOW, 0.50, 0.40, 0.60, Standing.MET),
    ],
)
def test_standing_of_a_target(sense, value, low, high, standing):
    assert Criterion("", sense, 0.90, "share", value, low, high, 50).standing == standing
    assert Criterion("", sense, 0.90, "share", None, None, None, 0).standing == Standing.NO_CASES


def result_of(rows: list[Row]) -> dict:
    """What opening the seal returns."""
    names = {"single": ["wall_friction"], "two": ["wall_friction", "acquisition_lag"]}
    hidden = {
        r.case: [{"name": n, "strength": 0.3} for n in names.get(r.kind, [])]
        if r.kind != "outside" else [{"name": "trapped_air", "strength": 0.2}]
        for r in rows
    }  # fmt: skip
    return {
        **scored(rows), "canary": {"right": 0.5, "shuffled": 0.49, "p_value": 0.4},
        "rows": [asdict(r) for r in rows], "hidden": hidden, "other_code": False, "given_up": 0,
    }  # fmt: skip


def test_targets_are_those_that_were_asked():
    asked = {t.words: t for t in criteria(result_of(hand_made()))}
    bounds = [(t.sense, t.bound) for t in asked.values() if t.unit == "share"]
    assert bounds == [(AT_LEAST, 0.9), (AT_LEAST, 0.6), (AT_MOST, 0.05), (AT_LEAST, 0.7),
                      (AT_MOST, 0.1), (BELOW, 0.05), (AT_LEAST, 0.8)]  # fmt: skip
    assert all(t.standing == Standing.MISSED for t in asked.values() if t.unit == "cases")
    other = [t.bound for t in criteria({**result_of(hand_made()), "other_code": True})]
    assert other[:4] == [40, 0.8, 0.6, 0.1]
    sizes = [t.bound for t in criteria({**result_of(hand_made()), "other_sizes": True})]
    assert sizes[:2] == [30, 0.9]


def test_being_better_needs_points_and_significance():
    rows = [replace(ROW, case=str(n), rivals={"bic": "none"}) for n in range(4)]
    few = next(t for t in criteria(result_of(rows)) if "BIC" in t.words)
    assert few.value == 100.0 and few.standing == Standing.MISSED  # p = 1/8
    many = next(t for t in criteria(result_of(5 * rows)) if "BIC" in t.words)
    assert many.standing == Standing.MET


def test_what_was_named_stands_beside_what_was_hidden():
    rows = hand_made()
    rows += [replace(rows[6], case="x", verdict=f"{SEAT} + wall_friction"),
             replace(ROW, case="y", verdict="failed")]  # fmt: skip
    table = confusion_matrix(result_of(rows), rows)
    assert table.counts.sum() == len(rows)
    cell = dict(zip(table.columns, table.counts[table.rows.index("wall friction")], strict=True))
    assert cell["wall friction"] == 1 and cell["seating gap"] == 1 and cell[FAILED] == 1
    pairs = dict(zip(table.columns, table.counts[table.rows.index("two effects")], strict=True))
    assert (pairs[BOTH], pairs[OTHERS], pairs["wall friction"]) == (1, 1, 1)
    assert table.counts[table.right].sum() == sum(r.verdict == r.truth for r in rows)


@pytest.mark.parametrize(
    ("value", "text"), [(0.924, "92 %"), (0.996, "99.6 %"), (0.0, "0 %"), (1.0, "100 %"),
                        (0.004, "0.4 %"), (None, "–")],
)  # fmt: skip
def test_shares_are_not_rounded_to_certainty(value, text):
    assert percent(value).replace("\u00a0", " ") == text


def test_the_page_leads_with_the_answer_and_escapes(tmp_path):
    rows = [replace(r, case=f"<b>{r.case}") for r in hand_made()]
    result = result_of(rows)
    report.write(tmp_path, result, tmp_path / "copy.json")
    page = (tmp_path / "withheld.html").read_text()
    lead = page.split('<p class="lead">')[1].split("</p>")[0]
    assert "50\u00a0%" in lead and "above 6" in lead and "unknown" in lead
    assert "<b>" not in page and "&lt;b&gt;" in page
    assert not re.search(r'(src|href)="(?!data:)', page) and "StrictUndefined" not in page
    assert page.count('class="missed"') == sum(
        t.standing == Standing.MISSED for t in criteria(result)
    )
    figures = sorted(path.stem for path in (tmp_path / "figures").glob("*.svg"))
    assert figures == ["accuracy", "false_alarms", "named", "reliability", "shrinkage"]
    assert json.loads((tmp_path / "copy.json").read_text())["cases"] == 10
    text = (tmp_path / "withheld.md").read_text()
    assert all(target.words in text for target in criteria(result))


def remade(monkeypatch, folder) -> str:
    """The page that `python -m studies.sealed.report` makes of a folder's withheld.json."""
    line = ["report", str(folder / "withheld.json"), "--out", str(folder / "again")]
    monkeypatch.setattr(sys, "argv", line)
    report.main()
    return (folder / "again" / "withheld.html").read_text()


def test_a_page_is_made_again_from_the_file(tmp_path, monkeypatch, capsys):
    report.write(tmp_path, {**result_of(hand_made()), "command": "calibrate <x>"}, None)
    page = remade(monkeypatch, tmp_path)
    assert "50\u00a0%" in capsys.readouterr().out
    assert page == (tmp_path / "withheld.html").read_text()
    assert "calibrate &lt;x&gt;" in page


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [("rivals", {}, "cannot be shown"), ("canary", None, "canary"), ("rows", [1], "rows.0")],
)
def test_a_damaged_file_is_refused(key, value, words, tmp_path, monkeypatch):
    report.write(tmp_path, result_of(hand_made()), None)
    file = tmp_path / "withheld.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), key: value}))
    with pytest.raises(InputError, match=words):
        remade(monkeypatch, tmp_path)


def test_the_terminal_says_what_is_missed():
    console = Console(record=True, width=80, file=None, quiet=False)
    with console.capture() as said:
        report.show(result_of(hand_made()), console)
    text = " ".join(said.get().split())
    assert "Missed: cases" in text and "false alarms where nothing is hidden" in text


def test_another_code_s_cases_without_signal_to_noise_are_still_scored():
    rows = [replace(r, snr=0.0) for r in hand_made()]
    text = report.markdown(result_of(rows), "Another code")
    assert "single effects of any strength" in text and "Without cases to judge by" in text


@pytest.mark.parametrize(("value", "text"), [(35 / 39, "89.7 %"), (0.9, "90 %"), (0.86, "86 %")])
def test_a_share_that_misses_its_bound_never_reads_like_it(value, text):
    target = Criterion("right", AT_LEAST, 0.9, "share", value, n=39)
    assert found_words(target).replace("\N{NO-BREAK SPACE}", " ") == text
