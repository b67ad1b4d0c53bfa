"""The laboratory of withheld cases: simulates specimens, measures them, writes their files.

Reality here is this project's simulator with other numbers of spheres, other packings, next to no
roundings, another porosity and another pace than any library of runs; specimens of a case differ in
packing, density and moisture.  A denser specimen is a bed of less porosity: spheres that grow in a
finished bed, as the effect `specimen_density` has them do, press on each other from the start, so
that the toe of a loading curve shortens with every denser specimen and looser ones do not make up
for it.  What leaves the laboratory are records as machines write them: a way
through the air before contact, any zero of displacement, noise, few digits.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calibrate.core.files import write_text
from calibrate.core.progress import AbstractProgress
from calibrate.discrepancy.comparison.recording import interval_means
from calibrate.discrepancy.library.design import SPEEDS
from calibrate.discrepancy.library.run_library import Cylinder, curves_of
from calibrate.discrepancy.library.simulate import COSTLY, PRESET, Simulator, switched_off
from calibrate.io.soil import base_soil, with_values
from calibrate.labtests.diagnosis.curves import TARGETS, TESTS, feature_values
from calibrate.simulation import HERE, AbstractPlace, Run, cores, side_by_side
from calibrate.simulation.resolution import specimen as bed_of
from jdem.effects.composite import EFFECTS
from studies.sealed.outside import CARRIED, AggregateCrushing, air_force
from studies.sealed.plan import (
    ACCEPTED_CRUSHING,
    ACCEPTED_DEPTH,
    PACE,
    POROSITIES,
    SMOOTHING,
    SPECIMENS,
    SPHERES,
    USUAL,
    SpecimenSize,
    WithheldCase,
)

DENSITY_SD = 0.004  # of density, from specimen to specimen
POROSITY_STEP = 0.002  # specimens of one porosity share their packings
MOISTURE_SD = 0.03  # of stiffness and surface energy together
FORCE_SD, DISPLACEMENT_SD = 0.5, 3e-3  # N, mm; of one reading
READINGS = 160  # of a curve
GAP_MM = (0.3, 1.0)  # way through the air
USUAL_HEIGHT = USUAL.height / USUAL.diameter  # diameters
ZERO_MM = 0.5  # the displacement's zero lies within

TOML = """[soil]
name = "withheld {name}"
density = [{density}]

[specimen]
diameter = "{diameter:g} mm"
height = "{height:g} mm"
mould_height = "150 mm"

[{first}]
rate = "8 mm/s"
pressed_at = "{speed:g} mm/s"
force_low = "{low:.5g} N"
force_high = "{high:.5g} N"
greased = true

[{second}]
rate = "0.01 mm/s"
rest = "1 s"

[particles]
poisson_ratio = 0.3
reference_diameter = "80 um"

[parameters]
{parameters}
{curves}"""
CURVE = """
[[curves]]
test = "{test}"
file = "{test}_{number}.csv"
displacement = {{ column = "displacement", unit = "mm" }}
force = {{ column = "force", unit = "N" }}
"""


@dataclass(frozen=True, eq=False)
class SpecimenRecords:
    """One specimen's records by test, arrays (readings, 2) in mm and N, and its density kg/m3."""

    records: dict[str, np.ndarray]
    density: float


class Laboratory:
    """Simulates and measures the specimens of cases; runs are cached in `folder`."""

    def __init__(self, folder: Path, centre: dict[str, float], place: AbstractPlace = HERE):
        self.folder, self.centre, self.place = folder, centre, place
        self._effects = {**EFFECTS, **CARRIED}
        self._simulators: dict[SpecimenSize, Simulator] = {}

    def _simulator(self, size: SpecimenSize) -> Simulator:
        if size not in self._simulators:
            costly = (*COSTLY, AggregateCrushing)
            effects = switched_off(self._effects)
            made = Simulator(size.lab(), self.folder, effects, costly, place=self.place)
            self._simulators.setdefault(size, made)
        return self._simulators[size]

    def specimens(
        self, case: WithheldCase, numbers: range = range(SPECIMENS)
    ) -> list[SpecimenRecords] | None:
        """The case's specimens, measured; None if one fails or, unless they are held back, they
        lie out of range."""
        measured, runs = [], []
        for number in numbers:
            run, density = self._specimen(case, number)
            if run is None:
                return None
            runs.append(run)
            measured.append(self._measured(case, number, run, density))
        depth = float(np.mean([r.observables["depression_depth_mm"] for r in runs]))
        force = float(np.mean([r.observables["crushing_force_n"] for r in runs]))
        inside = accepted(depth, force, case.size)
        whole = numbers.start == 0 and len(numbers) >= SPECIMENS
        return measured if inside or not whole else None

    def changes(self, case: WithheldCase, numbers: range = range(SPECIMENS)) -> np.ndarray:
        """What the hidden effects do to the features of the curves (n, m), on each of these of the
        case's packings that both simulations stand on; NaN where one of both lacks a feature."""
        features = Cylinder.of(case.size.lab()).features()[: -len(TARGETS)]
        found = []
        for number in numbers:
            runs = [self._specimen(c, number)[0] for c in (case, replace(case, hidden=()))]
            if None not in runs:
                with_, without = (feature_values(features, curves_of(run)) for run in runs if run)
                found.append(with_ - without)
        return np.array(found).reshape(-1, len(features))

    def simulate(
        self, wanted: Sequence[tuple[WithheldCase, int]], progress: AbstractProgress
    ) -> None:
        """Simulates these specimens of cases, as many at once as the place takes; what asks for
        them later finds them in the cache."""
        slots = self.place.slots(cores())
        side_by_side(
            lambda k: self._specimen(*wanted[k]), len(wanted), progress, "simulating", slots
        )

    def _specimen(self, case: WithheldCase, number: int) -> tuple[Run | None, float]:
        """The run of one specimen and its relative density error."""
        random = np.random.default_rng([case.seed, number])
        density, moisture = DENSITY_SD * random.standard_normal(), random.standard_normal()
        strengths = {h.name: h.strength for h in case.hidden}
        loose, density = self._filled(case, density)
        wet = float(np.exp(MOISTURE_SD * moisture))
        values = dict(case.soil)
        values |= {n: values[n] * wet for n in ("shear_modulus", "surface_energy")}
        run = self._run(case, number, values, strengths, loose)
        share = strengths.get("trapped_air", 0.0)
        if share and not run.failure:
            run = self._with_air(case, number, values, strengths, loose, run)
        return (None if run.failure else run), density

    def _filled(self, case: WithheldCase, density: float) -> tuple[float, float]:
        """Porosity of a specimen over its case's, in steps, and its relative density error, for a
        density that is off by a share."""
        preset = replace(PRESET, spheres=in_specimen(case))
        usual = bed_of(self._simulator(case.size).lab, preset).porosity
        assert usual is not None  # PRESET grows its beds
        solid = 1 - usual
        loose = round(-solid * density / POROSITY_STEP) * POROSITY_STEP
        return loose, -loose / solid

    def _run(self, case: WithheldCase, number: int, values, strengths, loose: float) -> Run:
        simulator = self._simulator(case.size)
        soil = with_values(base_soil(simulator.lab), {**self.centre, **values})
        usual = case.spheres in SPHERES  # of others, each number has a pool of its own too
        kind = SPHERES.index(case.spheres) if usual else case.spheres
        pool = len(POROSITIES) * kind + POROSITIES.index(case.porosity)
        seed = case.first_seed + 1000 * pool + case.packings[number]
        given = [strengths.get(name, 0.0) for name in self._effects]
        setting = (SMOOTHING, case.porosity + loose, PACE)
        return simulator.run(soil, setting, given, in_specimen(case), seed)

    def _with_air(
        self, case: WithheldCase, number: int, values, strengths, loose: float, run: Run
    ) -> Run:
        """Turned where soil and air together reach the target, air's force added."""
        share, high = strengths["trapped_air"], case.size.force_high
        top = int(run.curves[TESTS[0]][:, 0].argmax()) + 1
        way, force = run.curves[TESTS[0]][:top].T
        together = np.maximum.accumulate(force + air(case.size, way, share))
        soil_share = float(np.interp(high, together, force))
        early = {**strengths, "early_turn": high - soil_share}
        turned = self._run(case, number, values, early, loose)
        pressed = turned.curves[TESTS[0]].copy()
        pressed[:, 1] += air(case.size, pressed[:, 0], share)
        depth = np.interp([high / 2, high], together, way)
        observables = {**turned.observables, "depression_depth_mm": float(depth[1] - depth[0])}
        curves = {**turned.curves, TESTS[0]: pressed}
        return Run(observables, curves, turned.quality)

    def _measured(
        self, case: WithheldCase, number: int, run: Run, density: float
    ) -> SpecimenRecords:
        random = np.random.default_rng([case.seed, number, 1])
        at_rest = sum(h.strength for h in case.hidden if h.name == "load_cell_offset")
        records = {test: recorded(run.curves[test], at_rest, random) for test in TESTS}
        mass = 1 + 0.001 * random.standard_normal()
        usual = np.mean(self._simulator(case.size).lab.density_kg_m3)
        return SpecimenRecords(records, float(usual * (1 + density) * mass))


def in_specimen(case: WithheldCase) -> int:
    """Number of spheres of a specimen: `spheres` in one of twice its diameter, and as many in
    proportion in another."""
    return round(case.spheres * case.size.height / (USUAL_HEIGHT * case.size.diameter))


def accepted(depth: float, force: float, size: SpecimenSize) -> bool:
    """Whether mean depth (mm) and crushing force (N) lie where soils lie; the rule is for the usual
    size, others in proportion."""
    longer, wider = size.height / USUAL.height, (size.diameter / USUAL.diameter) ** 2
    inside = ACCEPTED_DEPTH[0] <= depth / longer <= ACCEPTED_DEPTH[1]
    return inside and ACCEPTED_CRUSHING[0] <= force / wider <= ACCEPTED_CRUSHING[1]


def air(size: SpecimenSize, way, share: float) -> np.ndarray:
    """Force (N) of trapped air along the platen's way (mm)."""
    return np.asarray(air_force(way, size.height, size.diameter, share))


def recorded(curve: np.ndarray, at_rest: float, random: np.random.Generator) -> np.ndarray:
    """What the machine writes of a curve (points, 2): (READINGS, 2) in mm and N; `at_rest` is
    the reading (N) before contact."""
    gap = random.uniform(*GAP_MM)
    way = np.concatenate([[0.0, gap - 1e-9], curve[:, 0] - curve[0, 0] + gap])
    force = np.concatenate([[at_rest, at_rest], curve[:, 1]])
    path = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(way)))])
    ends = np.linspace(0.0, path[-1], READINGS + 1)
    middle = (ends[1:] + ends[:-1]) / 2
    x = np.interp(middle, path, way) + random.uniform(-ZERO_MM, ZERO_MM)
    mean = interval_means(path, force, ends[:-1], ends[1:])
    x = x + DISPLACEMENT_SD * random.standard_normal(READINGS)
    mean = mean + FORCE_SD * random.standard_normal(READINGS)
    return np.column_stack([np.round(x, 3), np.round(mean, 1)])


def write_case(
    name: str, specimens: list[SpecimenRecords], centre: dict[str, float], folder: Path,
    size: SpecimenSize = USUAL,
) -> None:  # fmt: skip
    """All files of a case, with the same form whatever it hides."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, specimen in enumerate(specimens, 1):
        for test, record in specimen.records.items():
            rows = [f"{x:.3f},{f:.1f}" for x, f in record]
            text = "\n".join(["displacement,force", *rows]) + "\n"
            write_text(folder / f"{test}_{number}.csv", text)
    numbers = range(1, len(specimens) + 1)
    text = TOML.format(
        name=name,
        first=TESTS[0],
        second=TESTS[1],
        speed=1e3 * PACE * SPEEDS[0],
        diameter=1e3 * size.diameter,
        height=1e3 * size.height,
        low=size.force_high / 2,
        high=size.force_high,
        density=", ".join(f'"{s.density:.0f} kg/m^3"' for s in specimens),
        parameters="\n".join(f"{n} = {v:g}" for n, v in centre.items()),
        curves="".join(CURVE.format(test=t, number=n) for t in TESTS for n in numbers),
    )
    write_text(folder / "lab.toml", text)
