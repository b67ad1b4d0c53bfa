"""From a recording to the clean curve of one specimen, with everything that was noticed.

    order in time -> sizes that cannot be -> clipped top -> contact -> test -> the part that counts

A curve that stiffens keeps its unloading; one that softens ends where the platen turns back.
Displacement counts from contact, force from its reading before contact.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from calibrate.core.errors import BadValue
from calibrate.instrument_import import signals
from calibrate.instrument_import.recordings import Recording
from calibrate.instrument_import.tables import FEWEST_ROWS
from calibrate.instrument_import.unittext import DISPLACEMENT, FORCE, STRESS
from calibrate.instrument_import.vocabulary import LOAD_STEPS, SOFTENS, STIFFENS

DIAMETER, HEIGHT = 0.05, 0.10  # m; assumed where the file does not say
LEAD_SHARE = 0.1  # of the travel from contact to the peak; kept before contact
CHECKED = {FORCE: "kN", STRESS: "MPa", DISPLACEMENT: "m"}  # columns whose size is looked at
COARSE = 20  # points on loading below which a curve is called coarse


@dataclass(frozen=True)
class Finding:
    """Something noticed about a record: its kind, one sentence, and whether it is a fault."""

    kind: str
    text: str
    fault: bool = False


@dataclass(frozen=True, eq=False)
class Specimen:
    """A clean curve: displacement (mm) and force (N) of shape (points,), time (s) if recorded.

    `test` is one of `vocabulary.TESTS`; `points` says that the rows are load steps and no
    points of a curve; `rate` is the platen's speed on loading (m/s) if
    known; diameter and height (m) are None where the file does not state them;
    `unloading_mm` is where unloading starts, None without; `clipped` says that the true
    peak is unknown.  `raw` is what was recorded, in the units of the curve.
    """

    label: str
    test: str
    time_s: np.ndarray | None
    displacement_mm: np.ndarray
    force_n: np.ndarray
    rate: float | None
    diameter: float | None
    height: float | None
    density: float | None
    unloading_mm: float | None
    clipped: bool
    contact_mm: float  # of the recorded displacement
    zero_n: float  # of the recorded force
    begins_n: float  # the recorded force at the first row
    approach: bool  # whether the record shows the platen before contact
    place: str
    findings: tuple[Finding, ...]
    raw: Recording = field(repr=False)
    points: bool = False


def specimen_from(recording: Recording, test: str | None, label: str) -> Specimen:
    """The clean specimen; `test` as the user gave it, or None to find out.

    Raises `BadValue` where the record is no compression test or its kind cannot be told.
    """
    findings = [Finding("assumed", text) for text in recording.assumed]
    findings += [Finding("missing values", text, True) for text in recording.warnings]
    recording = _in_order(recording, findings)
    _check_curve(recording, label)
    _check_sizes(recording, findings, label)
    top = signals.clipped_run(recording.displacement_mm, recording.force_n)
    start = signals.start_of_contact(recording.force_n, recording.displacement_mm)
    if recording.force_n.max() <= _threshold(recording, start):
        problem = f"specimen '{label}': its force does not rise above its noise"
        raise BadValue(problem, "check which columns were exported")
    _tell_start(recording, start, findings)
    kind = _test(recording, test, start.row, findings, label)
    kept = _counted(recording, start, top, kind, findings)
    travel, force, time = _cleaned(recording, start, kept, kind, findings, label)
    _tell_gaps(time, travel, force, findings)
    turn = signals.turning_row(travel)
    return Specimen(
        label=label,
        test=kind,
        time_s=time,
        displacement_mm=travel,
        force_n=force,
        rate=_rate(time, travel, force, recording),
        diameter=recording.size.diameter,
        height=recording.size.height,
        density=density_of(recording),
        unloading_mm=None if turn is None else float(travel[turn]),
        clipped=top is not None,
        contact_mm=float(recording.displacement_mm[start.row]),
        zero_n=start.zero,
        begins_n=begins_at(recording),
        approach=start.approach,
        place=recording.place,
        findings=tuple(findings),
        raw=recording,
    )


def _in_order(recording: Recording, findings: list[Finding]) -> Recording:
    """The record sorted by time where the clock ran backwards."""
    if recording.time_s is None:
        return recording
    back = signals.backward_rows(recording.time_s)
    if not len(back):
        return recording
    order = np.argsort(recording.time_s, kind="stable")
    text = f"{len(back)} rows lie before the row above them in time: sorted by time"
    findings.append(Finding("time order", text, True))
    return replace(
        recording,
        time_s=recording.time_s[order],
        displacement_mm=recording.displacement_mm[order],
        force_n=recording.force_n[order],
    )


def _check_sizes(recording: Recording, findings: list[Finding], label: str) -> None:
    """A warning where pressure or strain cannot be; refused where that rests on a unit which
    nobody wrote.  What the file writes is never overruled."""
    size = recording.size
    diameter, height = size.diameter or DIAMETER, size.height or HEIGHT
    force, travel = (
        float(np.ptp(recording.force_n)),
        1e-3 * float(np.ptp(recording.displacement_mm)),
    )
    pressure, strain = force / (np.pi / 4 * diameter**2), travel / height
    low, high = signals.PRESSURE
    if recording.load in CHECKED and not low <= pressure <= high:
        possible = np.sqrt(4 * force / np.pi / (high if pressure > high else low))
        words = f"a pressure of {pressure / 1e3:.3g} kPa"
        _tell_size(recording, recording.load, words, "diameter", possible, findings, label)
    low, high = signals.STRAIN
    if recording.travel in CHECKED and not low <= strain <= high:
        words = f"a strain of {strain:.2g}"
        possible = travel / (high if strain > high else low)
        _tell_size(recording, recording.travel, words, "height", possible, findings, label)


def _tell_size(
    recording: Recording,
    kind: str,
    words: str,
    name: str,
    possible: float,
    findings: list[Finding],
    label: str,
) -> None:
    """Says that a column means what cannot be, and which size or unit would make it possible."""
    given = getattr(recording.size, name)
    usual = {"diameter": DIAMETER, "height": HEIGHT}[name]
    means = f"{kind} as written means {words} on a {name} of {1e3 * (given or usual):.4g} mm"
    if kind in recording.units_assumed:
        problem = f"{recording.place}: {kind} has no unit, and {means}"
        raise BadValue(problem, f"give --{kind}-unit, such as --{kind}-unit {CHECKED[kind]}")
    assumed = "" if given is not None else ", which is ASSUMED"
    text = (
        f"{means}{assumed}: possible with {1e3 * possible:.3g} mm (--{name}), or in another unit "
        f"(--{kind}-unit)"
    )
    findings.append(Finding("size of the numbers", text, True))


def _check_curve(recording: Recording, label: str) -> None:
    """Refuses a record in which nothing is compressed."""
    force, travel = recording.force_n, recording.displacement_mm
    name = f"specimen '{label}': "
    if len(force) < FEWEST_ROWS:
        raise BadValue(f"{name}only {len(force)} complete points", "export the whole record")
    if not (np.ptp(force) > 0 and np.ptp(travel) > 0):
        still = "force" if np.ptp(force) == 0 else "displacement"
        raise BadValue(f"{name}its {still} never changes", "check which columns were exported")
    peak = int(np.argmax(force))
    if np.ptp(travel[: peak + 1]) < 0.02 * np.ptp(travel) or peak < 3:
        problem = f"{name}the largest force stands at its very start"
        raise BadValue(problem, "export the record from before contact on")


def _tell_start(recording: Recording, start: signals.Start, findings: list[Finding]) -> None:
    """Where the record begins, and what was found about contact and the zero of force."""
    peak = float(recording.force_n.max())
    travel, first = recording.displacement_mm, begins_at(recording)
    ran = travel[start.row] - travel[0]
    if not start.approach and ran > 0:
        text = f"contact {ran:.3g} mm after the start of the record, by few readings: displacement "
        text += "counts from there, the zero of the force is as the file writes it"
        findings.append(Finding("start of contact", text))
    elif not start.approach:
        begins = "at contact" if abs(first) < 2e-3 * peak else f"under {first:.3g} N"
        text = f"the record begins {begins} and holds no reading before contact: the zero of the "
        text += "force is as the file writes it, travel counts from its first row"
        if first > 0.02 * peak:
            text += "; the first contact is missing"
        findings.append(Finding("start of contact", text, first > 0.02 * peak))
    else:
        text = f"contact {ran:.3g} mm after the start of the record: displacement counts from there"
        findings.append(Finding("start of contact", text))
    if start.zero != 0:
        text = f"the force reads {start.zero:.3g} N before contact: subtracted"
        findings.append(Finding("zero of force", text))


def begins_at(recording: Recording) -> float:
    """The force (N) under which a record begins, as recorded."""
    return float(min(np.median(recording.force_n[:5]), recording.force_n[0]))


def _test(
    recording: Recording, given: str | None, row: int, findings: list[Finding], label: str
) -> str:
    """Which test this is: as given, as the file says, or as the shape of the curve says."""
    travel, force = recording.displacement_mm[row:], recording.force_n[row:]
    softens = signals.has_softening(travel, force)
    shape = SOFTENS if softens else None
    if shape is None and signals.is_stiffening(travel, force):
        shape = STIFFENS
    said = recording.stated.test
    if said == LOAD_STEPS and not recording.is_converted:
        said = STIFFENS  # an oedometer that a machine loads at a speed
    if given is not None:
        return given
    if said is not None:
        if shape is not None and (shape == SOFTENS) != (said == SOFTENS):
            text = f"the file says {said}, but the curve looks {shape}: taken as {said}"
            findings.append(Finding("kind of test", text, True))
        return said
    if shape is None:
        problem = f"specimen '{label}': neither the file nor the curve tells which test it is"
        raise BadValue(problem, f"give --test {STIFFENS}, {SOFTENS} or {LOAD_STEPS}")
    why = "softens after a peak" if softens else "stiffens up to its peak"
    findings.append(Finding("assumed", f"{shape} test, because the curve {why}"))
    return shape


def _counted(
    recording: Recording,
    start: signals.Start,
    top: tuple[int, int] | None,
    kind: str,
    findings: list[Finding],
) -> slice:
    """The rows that count: from just before contact to where the test ends."""
    travel, force = recording.displacement_mm, recording.force_n
    reach = LEAD_SHARE * (travel[int(np.argmax(force))] - travel[start.row])
    first = int(np.argmax(travel >= travel[start.row] - reach)) if start.approach else 0
    turn = signals.turning_row(travel)
    last = len(force)
    turns = signals.reversals(travel)
    if len(turns) > 1:
        text = f"the platen turns {len(turns)} times: a cyclic record"
        if kind == SOFTENS:
            turn = turns[0]
            text += f", of which the first loading counts, {turn + 1} of {len(force)} rows"
        findings.append(Finding("cycles", text, True))
    if turn is not None:
        text = f"unloading from {travel[turn] - travel[start.row]:.4g} mm on"
        kept = "left out" if kind == SOFTENS else "kept"
        findings.append(Finding("unloading", f"{text}: {kept}"))
        loaded = np.flatnonzero(force > _threshold(recording, start))
        last = turn + 1 if kind == SOFTENS else min(int(loaded[-1]) + 2, len(force))
    if top is not None and top[0] - first >= FEWEST_ROWS:
        limit = force[top[0]] - start.zero
        text = (
            f"the force stays at {limit:.4g} N while the platen moves on: the load cell's limit; "
            "only the rise up to it is kept, and the true peak is unknown"
        )
        findings.append(Finding("saturation", text, True))
        last = min(last, top[0] + 1)
    return slice(first, last)


def _threshold(recording: Recording, start: signals.Start) -> float:
    """The force (N, as recorded) above which the specimen is surely loaded."""
    rise = float(recording.force_n.max()) - start.zero
    return start.zero + max(signals.NOISE_WIDTHS * start.noise, 2e-3 * rise)


def _cleaned(
    recording: Recording,
    start: signals.Start,
    rows: slice,
    kind: str,
    findings: list[Finding],
    label: str,
):
    """Displacement from contact, force from its zero, time, of the rows that count."""
    travel = recording.displacement_mm[rows] - recording.displacement_mm[start.row]
    force = recording.force_n[rows] - start.zero
    time = None if recording.time_s is None else recording.time_s[rows]
    if kind == SOFTENS:
        further = np.concatenate([[True], travel[1:] > np.maximum.accumulate(travel)[:-1]])
        travel, force = travel[further], force[further]
        time = None if time is None else time[further]
        lost = int((~further).sum())
        if lost > 0.02 * len(further):
            text = f"{lost} rows in which the platen does not advance were left out"
            findings.append(Finding("standstill", text))
    if len(force) < FEWEST_ROWS:
        problem = (
            f"specimen '{label}': only {len(force)} points from contact to the end of the test"
        )
        raise BadValue(problem, "export the record with more points")
    loading = int(np.argmax(force))
    if loading < COARSE:
        text = f"only {loading} points up to the largest force: a coarse curve"
        findings.append(Finding("sampling", text, True))
    return travel, force, time


def _tell_gaps(time, travel, force, findings: list[Finding]) -> None:
    rows = signals.gaps(time, travel, force)
    if not rows:
        return
    widest = max(rows, key=lambda row: abs(travel[row + 1] - travel[row]))
    ends = f"{travel[widest]:.3g} to {travel[widest + 1]:.3g} mm"
    held = f", {time[widest + 1] - time[widest]:.3g} s" if time is not None else ""
    text = f"{len(rows)} gap(s) in the sampling, the widest from {ends}{held}"
    findings.append(Finding("sampling gap", text, True))


def _rate(time, travel, force, recording: Recording) -> float | None:
    """Platen speed on loading (m/s), measured where time was recorded, else as stated."""
    stated = recording.stated.quantities.get("speed")
    if time is None:
        return stated
    up = slice(0, int(np.argmax(force)) + 1)
    if np.ptp(time[up]) <= 0:
        return stated
    middle = (travel[up] > 0.1 * travel[up][-1]) & (travel[up] < 0.9 * travel[up][-1])
    if middle.sum() < 3 or np.ptp(time[up][middle]) <= 0:
        return stated
    return float(1e-3 * np.polyfit(time[up][middle], travel[up][middle], 1)[0])


def density_of(recording: Recording) -> float | None:
    """Bulk density (kg/m^3) as stated, or from mass, diameter and height."""
    stated = recording.stated.quantities
    if "density" in stated:
        return stated["density"]
    if {"mass", "diameter", "height"} <= stated.keys():
        volume = np.pi / 4 * stated["diameter"] ** 2 * stated["height"]
        density = stated["mass"] / volume
        return float(density) if 300 < density < 4000 else None
    return None
