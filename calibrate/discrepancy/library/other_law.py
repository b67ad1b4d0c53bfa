"""What another code's conventions change in the features that a library of runs predicts.

Beside the rows of a library lie rows of soils that follow other conventions
(`calibrate.io.conventions`).  Their coordinates are taken about a centre of their own, as a
parameter may mean another thing there; what the conventions hold is held at that centre.  A column
of strengths tells the emulator which rows are which (`kernel.Column`): what conventions change is
smoother than what soils do (Kennedy and O'Hagan 2000, Biometrika 87, 1).  Effects are taken to
change warped features as they do in the library's conventions.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibrate.core.errors import InputError
from calibrate.core.progress import AbstractProgress
from calibrate.discrepancy.library.cross_validation import (
    FOLDS,
    EmulatorErrors,
    likeliest_widening,
)
from calibrate.discrepancy.library.design import Design
from calibrate.discrepancy.library.emulator import MOST_ROWS, FeatureEmulator, leading, spread
from calibrate.discrepancy.library.kernel import fit_column, fit_kernel
from calibrate.discrepancy.library.run_library import Cylinder, OtherLaw, Rows, RunLibrary
from calibrate.discrepancy.library.simulate import Simulator, run_points
from calibrate.io.conventions import HELD, held_by
from calibrate.io.lab import Lab
from calibrate.simulation import HERE, AbstractPlace
from jdem.materials.conventions import DEFAULT

# Centres of soils, SI, where they differ from those of the library.
CENTRES: dict[str, dict[str, float]] = {
    "liggghts": {"rolling_friction": 0.3, "tangential_multiplier": 1.0},
    "liggghts_history": {"rolling_friction": 0.3},
}
PACKINGS, EACH = 96, 5  # and soils of each
FURTHER = 4  # axes beside the library's components
FIRST = 1000  # number of the first packing


def centre_of(conventions: str, design: Design) -> dict[str, float]:
    """The soil (SI) about which coordinates under these conventions are taken."""
    own = {**design.centre, **CENTRES.get(conventions, {}), **HELD.get(conventions, {})}
    return {name: own[name] for name in design.centre}


def check(conventions: str, file: str, field: str) -> None:
    """Refuses conventions that are unknown, or a library's own."""
    held_by(conventions, file, field)
    if conventions == DEFAULT:
        raise InputError(file, field, f"every library follows '{DEFAULT}'", "give others")


def simulate(
    conventions: str, design: Design, lab: Lab, folder: Path, progress: AbstractProgress,
    place: AbstractPlace = HERE, packings: int = PACKINGS,
) -> Rows:  # fmt: skip
    """Rows under other conventions in the cylinder and with the sizes of a library's design."""
    under = replace(design, centre=centre_of(conventions, design))
    points = under.plain_rows(packings, EACH)
    points = replace(points, seeds=points.seeds + FIRST)
    held = [i for i, name in enumerate(under.soil_names) if name in HELD.get(conventions, {})]
    points.base[:, held] = 0.0
    simulator = Simulator(lab.following(conventions), folder, place=place)
    runs = run_points(under, points, simulator, progress)
    return Rows.of(Cylinder.of(lab), points, runs)


def fitted(rows: Rows, library: RunLibrary) -> OtherLaw:
    """Rows under other conventions with the axes and columns that make them likeliest beside the
    plain rows of a library, and what held-out packings say of the emulator's errors."""
    own = library.emulator()
    axes, deviation = _further_axes(rows, own, library)
    basis, joined = own.basis.longer(axes, deviation), _joined(rows, library)
    x, s = joined.scaled()
    scores = basis.components(np.arcsinh(joined.of_soils / own.scale))
    known, few = joined.law == 0, spread(library.rows.packing, MOST_ROWS)
    further = scores[known, len(own.components) :][few].T
    at = (x[known][few], s[known, :-1][few], library.rows.packing[few])
    kernels = tuple(fit_kernel(*at, y) for y in further)
    plain = (s[:, :-1] == 0).all(axis=1)
    columns = tuple(
        fit_column(kernel, x[plain], s[plain], joined.rows.packing[plain], y)
        for kernel, y in zip((*library.kernels, *kernels), scores[plain].T, strict=True)
    )
    found = OtherLaw(rows, axes, deviation, kernels, columns, np.ones(len(columns)))
    return replace(found, widening=_widening(found, library))


def _further_axes(
    rows: Rows, emulator: FeatureEmulator, library: RunLibrary
) -> tuple[np.ndarray, np.ndarray]:
    """The leading directions (e, m) along which rows leave the components of a library, in units of
    scatter, and how far its own rows and these vary along them (e,)."""
    basis, none = emulator.basis, np.zeros(len(library.design.limits))
    scaled = rows.base / library.design.spread()
    warped = np.arcsinh(rows.values / emulator.scale)
    away = warped - np.array([emulator.warped(x, none) for x in scaled])
    standard = basis.standard(basis.mean + away)
    outside = standard - (standard @ basis.axes.T) @ basis.axes
    axes = np.linalg.svd(outside, full_matrices=False)[2][:FURTHER]
    every = np.vstack([np.arcsinh(library.of_soils / emulator.scale), warped])
    return axes, np.maximum((basis.standard(every) @ axes.T).std(axis=0), 1e-9)


def following(library: RunLibrary, conventions: str) -> RunLibrary:
    """A library with the rows of other conventions joined, as one who follows these asks it."""
    joined, known = _with(library.other_laws[conventions], library), library.emulator_errors
    if known is not None:
        errors = known.longer(len(joined.kernels) - len(known.widening))
        widening = np.maximum(errors.widening, library.other_laws[conventions].widening)
        joined = replace(joined, emulator_errors=replace(errors, widening=widening))
    return replace(
        joined, design=replace(library.design, centre=centre_of(conventions, library.design))
    )


def _with(other: OtherLaw, library: RunLibrary) -> RunLibrary:
    kernels = zip(other.columns, (*library.kernels, *other.kernels), strict=True)
    (x, s), warped = library.scaled(), np.arcsinh(library.of_soils / library.scale())
    return replace(
        _joined(other.rows, library),
        kernels=tuple(column.joined(kernel) for column, kernel in kernels),
        basis=leading(warped, x, s).longer(other.axes, other.deviation),
    )


def _joined(rows: Rows, library: RunLibrary) -> RunLibrary:
    """The library with these rows, whose machines have no errors, behind its own."""
    marked = replace(library, law=np.zeros(len(library.rows.base)))
    shift = library.machine_shift
    none = np.zeros_like(rows.values)
    return replace(
        marked.joined(rows), machine_shift=None if shift is None else np.vstack([shift, none])
    )


def _widening(other: OtherLaw, library: RunLibrary) -> np.ndarray:
    """The factors (c,) on the stated variances of values that make held-out rows likeliest."""
    errors, stated, scatter = [], [], []
    for emulator, x, value in _held_out(other, library):
        none = np.zeros(len(library.design.limits))
        warped = np.arcsinh(value / emulator.scale)
        errors.append(emulator.basis.components(warped) - emulator.of_components(x, none))
        stated.append(emulator.variances(x, none))
        noise = np.array([c.kernel.scatter for c in emulator.components]) * emulator.larger(x) ** 2
        known = library.emulator_errors or EmulatorErrors.nothing(0, 0)
        known = known.longer(len(noise) - len(known.widening))
        scatter.append(noise * (known.scatter + known.misfit))
    return likeliest_widening(*map(np.array, (errors, stated, scatter)))


def _held_out(
    other: OtherLaw, library: RunLibrary
) -> Iterator[tuple[FeatureEmulator, np.ndarray, np.ndarray]]:
    """Each row with an emulator that has not seen its packing."""
    rows = other.rows
    for fold in range(FOLDS):
        out = rows.packing % FOLDS == fold
        emulator = _with(replace(other, rows=rows.some(~out)), library).emulator()
        for base, value in zip(rows.base[out], rows.values[out], strict=True):
            yield emulator, base / library.design.spread(), value
