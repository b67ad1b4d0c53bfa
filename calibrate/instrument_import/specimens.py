"""From a recording to the clean curve of one specimen, with everything that was noticed.

    order in time -> sizes that cannot be -> clipped top -> contact -> test -> the part that counts

A curve that stiffens keeps its unloading; one that softens ends where the platen turns back.
Displacement counts from contact, force from its reading before contact.
"""

from dataclasses import dataclass, field

import numpy as np

from calibrate.core.errors import BadValue
from calibrate.instrument_import import signals
from calibrate.instrument_import.recordings import Recording
from calibrate.instrument_import.tables import FEWEST_ROWS
from calibrate.instrument_import.tools import Tool
from calibrate.instrument_import.vocabulary import LOAD_STEPS, SOFTENS, STIFFENS, Quantity
from calibrate.labtests.unconfined import still_rises

DIAMETER, HEIGHT = 0.05, 0.10  # m; assumed where the file does not say
LEAD_SHARE = 0.1  # of the travel from contact to the peak; kept before contact
CHECKED = {
    Quantity.FORCE: "kN",
    Quantity.STRESS: "MPa",
    Quantity.DISPLACEMENT: "m",
}  # columns whose size is looked at
COARSE = 20  # points on loading below which a curve is called coarse


@dataclass(frozen=True)
class Finding:
    """Something noticed about a record: its kind, one sentence, and whether it is a fault."""

    kind: str
    text: str
    fault: bool = False


@dataclass(frozen=True)
class Findings:
    """What is noticed of one specimen on the way, and refusals that name it."""

    label: str
    found: list[Finding]

    @staticmethod
    def of(recording: Recording, label: str) -> "Findings":
        """What was noticed while it was read."""
        found = [Finding("assumed", text) for text in recording.assumed]
        found += [Finding("missing values", text, True) for text in recording.warnings]
        return Findings(label, found)

    def note(self, kind: str, text: str) -> None:
        self.found.append(Finding(kind, text))

    def warn(self, kind: str, text: str) -> None:
        self.found.append(Finding(kind, text, True))

    def refusal(self, problem: str, repair: str) -> BadValue:
        return BadValue(f"specimen '{self.label}': {problem}", repair)


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
    unloading_mm: float | None
    begins_n: float  # the recorded force at the first row
    findings: tuple[Finding, ...]
    raw: Recording = field(repr=False)
    rate: float | None = None
    clipped: bool = False
    contact_mm: float = 0.0  # of the recorded displacement
    zero_n: float = 0.0  # of the recorded force
    approach: bool = False  # whether the record shows the platen before contact

    @property
    def points(self) -> bool:
        return self.raw.points

    @property
    def place(self) -> str:
        return self.raw.place

    @property
    def diameter(self) -> float | None:
        return self.raw.size.diameter

    @property
    def height(self) -> float | None:
        return self.raw.size.height

    @property
    def density(self) -> float | None:
        """Bulk density (kg/m^3) as stated, or from mass, diameter and height."""
        stated = self.raw.stated.quantities
        if "density" in stated or not {"mass", "diameter", "height"} <= stated.keys():
            return stated.get("density")
        density = stated["mass"] / (np.pi / 4 * stated["diameter"] ** 2 * stated["height"])
        return float(density) if 300 < density < 4000 else None


def specimen_from(recording: Recording, test: str | None, label: str) -> Specimen:
    """The clean specimen; `test` as the user gave it, or None to find out.

    Raises `BadValue` where the record is no compression test or its kind cannot be told.
    """
    findings = Findings.of(recording, label)
    recording = _in_order(recording, findings)
    _check_curve(recording, findings)
    _check_sizes(recording, findings)
    top = signals.clipped_run(recording.displacement_mm, recording.force_n)
    start = signals.start_of_contact(recording.force_n, recording.displacement_mm)
    if recording.force_n.max() <= _threshold(recording, start):
        problem = "its force does not rise above its noise"
        raise findings.refusal(problem, "check which columns were exported")
    contact = float(recording.displacement_mm[start.row])
    _tell_start(recording, start, findings)
    kind = _test(recording, test, start.row, findings)
    rows = _counted(recording, start, top, kind, findings)
    travel, force, time = _cleaned(recording.of(rows), start, contact, kind, findings)
    _tell_gaps(time, travel, force, findings)
    turn = signals.turning_row(travel)
    return Specimen(
        label=label,
        test=kind,
        time_s=time,
        displacement_mm=travel,
        force_n=force,
        rate=_rate(time, travel, force, recording),
        unloading_mm=None if turn is None else float(travel[turn]),
        clipped=top is not None,
        contact_mm=contact,
        zero_n=start.zero,
        begins_n=begins_at(recording),
        approach=start.approach,
        findings=tuple(findings.found),
        raw=recording,
    )


def tool_specimen(recording: Recording, test: str | None, label: str) -> Specimen:
    """The clean curve of a test with a tool, up to where the tool turns back.

    Raises `BadValue` for a record in which nothing is moved or loaded.
    """
    tool = recording.tool
    assert tool is not None and test is not None  # of such a test
    findings = Findings.of(recording, label)
    recording = _in_order(recording, findings)
    _check_curve(recording, findings)
    stiffens = tool.test.shape == "stiffens"
    curve = recording.displacement_mm, recording.force_n
    top = signals.clipped_run(*curve) if stiffens else None
    start, zero = _tool_start(recording, tool, findings)
    part = recording.of(_counted(recording, start, top, SOFTENS, findings))
    travel, force, time = _cleaned(part, start, zero, SOFTENS, findings)
    _tell_gaps(time, travel, force, findings)
    if not stiffens and still_rises(travel, force):
        text = f"the {recording.load} still rises at the end of the record: there is no peak"
        findings.warn("no peak", f"{text}, the number is where the record stops")
    return Specimen(
        label=label,
        test=test,
        time_s=time,
        displacement_mm=travel,
        force_n=force,
        rate=_rate(time, travel, force, recording),
        unloading_mm=None,
        clipped=top is not None,
        contact_mm=zero,
        zero_n=start.zero,
        begins_n=begins_at(recording),
        approach=start.approach,
        findings=tuple(findings.found),
        raw=recording,
    )


def _tool_start(
    recording: Recording, tool: Tool, findings: Findings
) -> tuple[signals.Start, float]:
    """Where the curve begins, and the recorded travel (mm) from which it counts."""
    travel = recording.displacement_mm
    column = tool.travel(recording.travel)
    datum = column.datum(tool.test)
    if column.counts == "contact":
        start = signals.start_of_contact(recording.force_n, travel)
        _tell_start(recording, start, findings)
        return start, float(travel[start.row]) + datum
    first = float(travel[0]) if column.counts == "first row" else 0.0
    return signals.Start(0, 0.0, 0.0, False), first + datum


def _in_order(recording: Recording, findings: Findings) -> Recording:
    """The record sorted by time where the clock ran backwards."""
    time = recording.time_s
    back = 0 if time is None else len(signals.backward_rows(time))
    if time is None or not back:
        return recording
    text = f"{back} rows lie before the row above them in time: sorted by time"
    findings.warn("time order", text)
    return recording.of(np.argsort(time, kind="stable"))


def _check_sizes(recording: Recording, findings: Findings) -> None:
    """A warning where pressure or strain cannot be; refused where that rests on a unit which
    nobody wrote.  What the file writes is never overruled."""
    size = recording.size
    diameter, height = size.diameter or DIAMETER, size.height or HEIGHT
    force = float(np.ptp(recording.force_n))
    travel = 1e-3 * float(np.ptp(recording.displacement_mm))
    pressure, strain = force / (np.pi / 4 * diameter**2), travel / height
    for kind, value, (low, high), words, name, used, possible in (
        (recording.load, pressure, signals.PRESSURE, f"a pressure of {pressure / 1e3:.3g} kPa",
         "diameter", diameter, lambda pressure: np.sqrt(4 * force / np.pi / pressure)),
        (recording.travel, strain, signals.STRAIN, f"a strain of {strain:.2g}",
         "height", height, lambda strain: travel / strain),
    ):  # fmt: skip
        if kind not in CHECKED or low <= value <= high:
            continue
        means = f"{kind} as written means {words} on a {name} of {1e3 * used:.4g} mm"
        if kind in recording.units_assumed:
            problem = f"{recording.place}: {kind} has no unit, and {means}"
            raise BadValue(problem, f"give --{kind}-unit, such as --{kind}-unit {CHECKED[kind]}")
        assumed = "" if getattr(size, name) is not None else ", which is ASSUMED"
        text = (
            f"{means}{assumed}: possible with {1e3 * possible(high if value > high else low):.3g} "
            f"mm (--{name}), or in another unit (--{kind}-unit)"
        )
        findings.warn("size of the numbers", text)


def _check_curve(recording: Recording, findings: Findings) -> None:
    """Refuses a record in which nothing is compressed."""
    force, travel = recording.force_n, recording.displacement_mm
    if len(force) < FEWEST_ROWS:
        raise findings.refusal(f"only {len(force)} complete points", "export the whole record")
    for still, values in (("force", force), ("displacement", travel)):
        if not np.ptp(values) > 0:
            problem = f"its {still} never changes"
            raise findings.refusal(problem, "check which columns were exported")
    peak = int(np.argmax(force))
    if np.ptp(travel[: peak + 1]) < 0.02 * np.ptp(travel) or peak < 3:
        problem = "the largest force stands at its very start"
        raise findings.refusal(problem, "export the record from before contact on")


def _tell_start(recording: Recording, start: signals.Start, findings: Findings) -> None:
    """Where the record begins, and what was found about contact and the zero of force."""
    peak = float(recording.force_n.max())
    travel, first = recording.displacement_mm, begins_at(recording)
    ran = travel[start.row] - travel[0]
    kind, ran_in = "start of contact", f"contact {ran:.3g} mm after the start of the record"
    as_written = "the zero of the force is as the file writes it"
    if start.approach:
        findings.note(kind, f"{ran_in}: displacement counts from there")
    elif ran > 0:
        counts = "displacement counts from there"
        findings.note(kind, f"{ran_in}, by few readings: {counts}, {as_written}")
    else:
        begins = "at contact" if abs(first) < 2e-3 * peak else f"under {first:.3g} N"
        text = f"the record begins {begins} and holds no reading before contact: {as_written}, "
        text += "travel counts from its first row"
        if first > 0.02 * peak:
            findings.warn(kind, f"{text}; the first contact is missing")
        else:
            findings.note(kind, text)
    if start.zero != 0:
        text = f"the force reads {start.zero:.3g} N before contact: subtracted"
        findings.note("zero of force", text)


def begins_at(recording: Recording) -> float:
    """The force (N) under which a record begins, as recorded."""
    return float(min(np.median(recording.force_n[:5]), recording.force_n[0]))


def _test(recording: Recording, given: str | None, row: int, findings: Findings) -> str:
    """Which test this is: as given, as the file says, or as the shape of the curve says."""
    if given is not None:
        return given
    curve = recording.displacement_mm[row:], recording.force_n[row:]
    softens = signals.has_softening(*curve)
    shape = SOFTENS if softens else STIFFENS if signals.is_stiffening(*curve) else None
    named = recording.stated.test
    if named == LOAD_STEPS and not recording.is_converted:
        named = STIFFENS  # an oedometer that a machine loads at a speed
    if named is not None:
        if shape is not None and (shape == SOFTENS) != (named == SOFTENS):
            text = f"the file says {named}, but the curve looks {shape}: taken as {named}"
            findings.warn("kind of test", text)
        return named
    if shape is None:
        problem = "neither the file nor the curve tells which test it is"
        raise findings.refusal(problem, f"give --test {STIFFENS}, {SOFTENS} or {LOAD_STEPS}")
    why = "softens after a peak" if softens else "stiffens up to its peak"
    findings.note("assumed", f"{shape} test, because the curve {why}")
    return shape


def _counted(
    recording: Recording,
    start: signals.Start,
    top: tuple[int, int] | None,
    kind: str,
    findings: Findings,
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
        findings.warn("cycles", text)
    if turn is not None:
        then = "left out" if kind == SOFTENS else "kept"
        begins = travel[turn] - travel[start.row]
        findings.note("unloading", f"unloading from {begins:.4g} mm on: {then}")
        loaded = np.flatnonzero(force > _threshold(recording, start))
        last = turn + 1 if kind == SOFTENS else min(int(loaded[-1]) + 2, len(force))
    if top is not None and top[0] - first >= FEWEST_ROWS:
        limit = force[top[0]] - start.zero
        text = (
            f"the force stays at {limit:.4g} N while the platen moves on: the load cell's limit; "
            "only the rise up to it is kept, and the true peak is unknown"
        )
        findings.warn("saturation", text)
        last = min(last, top[0] + 1)
    return slice(first, last)


def _threshold(recording: Recording, start: signals.Start) -> float:
    """The force (N, as recorded) above which the specimen is surely loaded."""
    rise = float(recording.force_n.max()) - start.zero
    return start.zero + max(signals.NOISE_WIDTHS * start.noise, 2e-3 * rise)


def _cleaned(
    recording: Recording, start: signals.Start, contact: float, kind: str, findings: Findings
):
    """Displacement from contact (mm), force from its zero, time, without standstills."""
    travel, force = recording.displacement_mm - contact, recording.force_n - start.zero
    time = recording.time_s
    if kind == SOFTENS:
        further = np.diff(np.maximum.accumulate(travel), prepend=-np.inf) > 0
        travel, force = travel[further], force[further]
        time = None if time is None else time[further]
        lost = int((~further).sum())
        if lost > 0.02 * len(further):
            text = f"{lost} rows in which the platen does not advance were left out"
            findings.note("standstill", text)
    if len(force) < FEWEST_ROWS:
        problem = f"only {len(force)} points from contact to the end of the test"
        raise findings.refusal(problem, "export the record with more points")
    loading = int(np.argmax(force))
    if loading < COARSE:
        text = f"only {loading} points up to the largest force: a coarse curve"
        findings.warn("sampling", text)
    return travel, force, time


def _tell_gaps(time, travel, force, findings: Findings) -> None:
    rows = signals.gaps(time, travel, force)
    if not rows:
        return
    widest = max(rows, key=lambda row: abs(travel[row + 1] - travel[row]))
    ends = f"{travel[widest]:.3g} to {travel[widest + 1]:.3g} mm"
    held = f", {time[widest + 1] - time[widest]:.3g} s" if time is not None else ""
    text = f"{len(rows)} gap(s) in the sampling, the widest from {ends}{held}"
    findings.warn("sampling gap", text)


def _rate(time, travel, force, recording: Recording) -> float | None:
    """Platen speed on loading (m/s), measured where time was recorded, else as stated."""
    stated = recording.stated.quantities.get("speed")
    found = None if time is None else signals.speed(time, travel, force)
    return stated if found is None else 1e-3 * found
