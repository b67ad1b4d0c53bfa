"""From a recording of load steps to its clean specimen: every row counts, nothing is shifted.

Displacement is that of the file's strain or void ratio, force that of its stress: the first
step is the first point, under the load that the file states.
"""

import numpy as np

from calibrate.instrument_import.recordings import Recording
from calibrate.instrument_import.specimens import HEIGHT, Finding, Specimen, density_of
from calibrate.instrument_import.steps import (
    MOST_STEPS,
    against_the_load,
    check_steps,
    ends_of_steps,
    turning_rows,
)
from calibrate.instrument_import.tables import FEWEST_STEPS
from calibrate.instrument_import.vocabulary import LOAD_STEPS


def step_specimen(recording: Recording, test: str | None, label: str) -> Specimen:
    """The specimen of these load steps; `test` as the user gave it, or None to find out.

    Raises `BadValue` for too few steps or a load that never changes.
    """
    findings = [Finding("assumed", text) for text in recording.assumed]
    findings += [Finding("missing values", text, True) for text in recording.warnings]
    check_steps(recording.force_n, recording.displacement_mm, FEWEST_STEPS, label)
    kind = test or recording.stated.test or LOAD_STEPS
    if test is None and recording.stated.test is None:
        text = f"{kind} test, because its rows are load steps"
        findings.append(Finding("assumed", text))
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
        rate=None,
        diameter=recording.size.diameter,
        height=recording.size.height,
        density=density_of(recording),
        unloading_mm=float(travel[turn]) if turn < len(force) - 1 else None,
        clipped=False,
        contact_mm=0.0,
        zero_n=0.0,
        begins_n=float(force[0]),
        approach=False,
        place=recording.place,
        findings=tuple(findings),
        raw=recording,
        points=True,
    )


def _rows(recording: Recording, findings: list[Finding]) -> np.ndarray:
    """All rows, or the last reading of each step where there are many."""
    count = len(recording.force_n)
    if count <= MOST_STEPS:
        return np.arange(count)
    rows = ends_of_steps(recording.force_n)
    text = f"{len(rows)} steps of {count} readings: the last reading of each is kept"
    findings.append(Finding("load steps", text))
    return rows


def _times(recording: Recording, rows: np.ndarray, findings: list[Finding]) -> np.ndarray | None:
    """The times of these rows, None where the clock starts again."""
    if recording.time_s is None:
        return None
    if np.all(np.diff(recording.time_s) >= 0):
        return recording.time_s[rows]
    findings.append(Finding("time order", "the clock starts again: times are left out"))
    return None


def _tell(recording: Recording, force, travel, findings: list[Finding]) -> None:
    """The course of the load in words, and steps in which the soil moves against it."""
    area, unit = np.pi / 4 * (recording.size.diameter or 0.0) ** 2, "kPa"
    loads = 1e-3 * force / area if area else force
    unit = unit if area else "N"
    turns = ", then ".join(f"to {loads[row]:.4g}" for row in turning_rows(force))
    text = f"{len(force)} readings of load steps: from {loads[0]:.4g} {turns} {unit}"
    findings.append(Finding("load steps", text))
    rows = against_the_load(force, travel, 1e3 * (recording.size.height or HEIGHT))
    if rows:
        text = f"the soil swells under a rising load in step {rows[0] + 1}"
        findings.append(Finding("load steps", text, True))
