"""From a recording of load steps to its clean specimen: every row counts, nothing is shifted.

Displacement is that of the file's strain or void ratio, force that of its stress: the first
step is the first point, under the load that the file states.
"""

import numpy as np

from calibrate.instrument_import.recordings import Recording
from calibrate.instrument_import.specimens import HEIGHT, Findings, Specimen
from calibrate.instrument_import.steps import MOST_STEPS, ends_of_steps, turning_rows
from calibrate.instrument_import.tables import FEWEST_STEPS
from calibrate.instrument_import.vocabulary import LOAD_STEPS


def step_specimen(recording: Recording, test: str | None, label: str) -> Specimen:
    """The specimen of these load steps; `test` as the user gave it, or None to find out.

    Raises `BadValue` for too few steps or a load that never changes.
    """
    findings = Findings.of(recording, label)
    _check(recording, findings)
    kind = test or recording.stated.test or LOAD_STEPS
    if test is None and recording.stated.test is None:
        findings.note("assumed", f"{kind} test, because its rows are load steps")
    rows = _rows(recording, findings)
    force, travel = recording.force_n[rows], recording.displacement_mm[rows]
    turn = turning_rows(force)[0]
    _tell(recording, force, travel, findings)
    return Specimen(
        label=label,
        test=kind,
        time_s=_times(recording, rows, findings),
        displacement_mm=travel,
        force_n=force,
        unloading_mm=float(travel[turn]) if turn < len(force) - 1 else None,
        begins_n=float(force[0]),
        findings=tuple(findings.found),
        raw=recording,
    )


def _rows(recording: Recording, findings: Findings) -> np.ndarray:
    """All rows, or the last reading of each step where there are many."""
    count = len(recording.force_n)
    if count <= MOST_STEPS:
        return np.arange(count)
    rows = ends_of_steps(recording.force_n)
    text = f"{len(rows)} steps of {count} readings: the last reading of each is kept"
    findings.note("load steps", text)
    return rows


def _times(recording: Recording, rows: np.ndarray, findings: Findings) -> np.ndarray | None:
    """The times of these rows, None where the clock starts again."""
    if recording.time_s is None:
        return None
    if np.all(np.diff(recording.time_s) >= 0):
        return recording.time_s[rows]
    findings.note("time order", "the clock starts again: times are left out")
    return None


def _tell(recording: Recording, force, travel, findings: Findings) -> None:
    """The course of the load in words, and steps in which the soil moves against it."""
    area, unit = np.pi / 4 * (recording.size.diameter or 0.0) ** 2, "kPa"
    loads = 1e-3 * force / area if area else force
    unit = unit if area else "N"
    turns = ", then ".join(f"to {loads[row]:.4g}" for row in turning_rows(force))
    text = f"{len(force)} readings of load steps: from {loads[0]:.4g} {turns} {unit}"
    findings.note("load steps", text)
    rows = _against_the_load(force, travel, 1e3 * (recording.size.height or HEIGHT))
    if rows:
        text = f"the soil swells under a rising load in step {rows[0] + 1}"
        findings.warn("load steps", text)


def _against_the_load(load: np.ndarray, travel: np.ndarray, height: float) -> list[int]:
    """Rows whose load is the largest so far and whose travel falls by 0.2 % of the height."""
    highest = np.maximum.accumulate(load)
    rises = (np.diff(load) > 0) & (load[1:] >= highest[1:])
    return [int(row) + 1 for row in np.flatnonzero(rises & (np.diff(travel) < -2e-3 * height))]


def _check(recording: Recording, findings: Findings) -> None:
    """Refuses what cannot be load steps: too few rows, or load or travel that never change."""
    load = recording.force_n
    if len(load) < FEWEST_STEPS:
        raise findings.refusal(f"only {len(load)} load steps", f"give at least {FEWEST_STEPS}")
    for what, values in (("load", load), ("travel", recording.displacement_mm)):
        if not np.ptp(values) > 0:
            problem = f"its {what} never changes"
            raise findings.refusal(problem, "check which columns were exported")
