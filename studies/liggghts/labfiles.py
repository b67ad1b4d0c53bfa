"""A case as the files that a laboratory would hand over: lab.toml, curves, a table of specimens.

Every case has the same files, columns, numbers of rows and digits, whatever it hides.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from studies.liggghts.instrument import (
    CONFINED_SPEED,
    UNCONFINED_SPEED,
    Instrument,
    Record,
    approach,
    record,
)
from studies.liggghts.soil import PRIOR, TENSILE_EXPONENT, Soil
from studies.liggghts.specimen import LOADING, Run
from studies.sealed.laboratory import CURVE, TOML
from studies.sealed.plan import USUAL

ZERO = 0.5e-3  # m; the displacement's zero is anywhere within
CONVENTIONS = 'conventions = "liggghts"\n'  # of friction and rolling, which every user knows
GIVEN = ("wall_friction", "platen_friction")  # what the laboratory believes of its apparatus
GAP = (0.3e-3, 1.0e-3)  # m, the platen's way before it touches

# As the project's own withheld cases, but for the title and a height that is measured.
LAB = (
    TOML.replace("withheld {name}", "soil {name}")
    .replace("{height:g}", "{height:.1f}")
    .replace("[particles]\n", "[particles]\n" + CONVENTIONS)
)


@dataclass(frozen=True)
class Specimen:
    """What the laboratory has of one specimen: mass g, height in the mould mm, two records."""

    mass: float
    height: float
    confined: Record
    unconfined: Record


def measured(run: Run, instrument: Instrument, random: np.random.Generator) -> Specimen:
    """The specimen as weighed, measured and recorded; `random` makes noise and zeros."""
    records = []
    for curve, speed in (
        (run.confined, CONFINED_SPEED),
        (run.unconfined, UNCONFINED_SPEED),
    ):
        way, force = approach(curve[:, 0], curve[:, 1], random.uniform(*GAP))
        zero = random.uniform(-ZERO, ZERO)
        records.append(record(way, force, speed, instrument, zero, random))
    mass = 1e3 * run.mass + 0.1 * random.standard_normal()
    height = 1e3 * run.height + 0.2 * random.standard_normal()
    return Specimen(round(mass, 1), round(height, 1), records[0], records[1])


def write_case(name: str, specimens: list[Specimen], folder: Path) -> None:
    """All files of case `name` into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, specimen in enumerate(specimens, 1):
        _write_curve(folder / f"confined_{number}.csv", specimen.confined)
        _write_curve(folder / f"unconfined_{number}.csv", specimen.unconfined)
    rows = [f"{n},{s.mass:.1f},{s.height:.1f}" for n, s in enumerate(specimens, 1)]
    table = "\n".join(["specimen,mass_g,height_mm", *rows]) + "\n"
    (folder / "specimens.csv").write_text(table)
    (folder / "lab.toml").write_text(_lab_text(name, specimens))


def _write_curve(path: Path, curve: Record) -> None:
    columns = zip(curve.time, curve.displacement, curve.force, strict=True)
    rows = [f"{time:.4f},{way:.3f},{force:.1f}" for time, way, force in columns]
    path.write_text("\n".join(["time,displacement,force", *rows]) + "\n")


def _lab_text(name: str, specimens: list[Specimen]) -> str:
    area = np.pi * 25.0**2  # mm2
    densities = [1e6 * s.mass / (area * s.height) for s in specimens]  # g/mm3 -> kg/m3
    tests = ("confined", "unconfined")
    numbers = range(1, len(specimens) + 1)
    return LAB.format(
        name=name,
        first=tests[0],
        second=tests[1],
        speed=1e3 * LOADING,
        diameter=1e3 * USUAL.diameter,
        low=USUAL.force_high / 2,
        high=USUAL.force_high,
        density=", ".join(f'"{density:.0f} kg/m^3"' for density in densities),
        height=np.mean([s.height for s in specimens]),
        parameters=_parameters(),
        curves="".join(CURVE.format(test=t, number=n) for t in tests for n in numbers),
    )


def _parameters() -> str:
    """Where a fit may start, the same in every case: centres of the prior, no scatter claimed."""
    rows = [f"{name} = {getattr(Soil(), name):g}" for name in (*PRIOR, *GIVEN)]
    return "\n".join([*rows, f"tensile_exponent = {TENSILE_EXPONENT:g}"]) + "\n"
