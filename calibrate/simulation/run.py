"""One finished simulation, and why it failed if it did.

A failure is one sentence that names the cause: a contact list that was too small, a time step
that was too large, a number that is not finite, a soil too soft to test, a machine that gave up.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from calibrate.labtests.composite import channel, names_observed
from jdem.engine.bed import reach_of
from jdem.engine.loads import boundary_overlaps
from jdem.engine.segment import CELL
from jdem.laboratory.virtual_lab import Outcome, VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.observables import Curve, inertial_number
from jdem.packing.specimen import Packing

UNSTABLE = 0.5  # of the platen's work; sound runs have integration errors of some 0.002 of it
QUALITY = (
    "inertial_number",
    "overflow",
    "energy_balance",
    "kinetic_energy_after_rest_j",
    "platen_work_j",
    "time_step_s",
    "steps",
    "spheres",
    "runtime_s",
    "repeats",
    "spheres_across",
    "tool_across",
    "tool_overlap",
    "porosity",
)
LEAST_ACROSS = 8.0  # spheres; below, the grains are a large part of the specimen (7.5 to 20 in use)
LEAST_AT_TOOL = 5.0  # spheres; below, forces are those of chains (tips slip between them below 3)
DEEPEST_AT_TOOL = 0.5  # of the radius; at 1.0 the centre crosses, and the sphere is thrown out
PRESSED_THROUGH = (
    "this happens where a sphere is pressed through a tool's surface, as the soil is too soft for "
    "the tool's force; raise shear_modulus, or end the test at a smaller depth"
)


@dataclass(frozen=True, eq=False)
class Run:
    """One finished simulation in the units of the observables.

    Curves by test are arrays (points, 2) of displacement (mm) and force (N).  `failure` is empty
    or one sentence; a failed run keeps its place and its numbers.  channels, by test and name with
    unit, are (points,): what the test records beside its curve.
    """

    observables: dict[str, float]
    curves: dict[str, np.ndarray]
    quality: dict[str, float]
    failure: str = ""
    channels: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)


Soils = Sequence[SoilParameters]
Runs = list[list[Run]]  # by soil, or row of soils, and by packing


def not_simulated(lab: VirtualLab, failure: str) -> Run:
    """The row of a run that no machine could finish: empty curves, numbers that are NaN."""
    quality = {name: np.nan for name in QUALITY} | {"overflow": 0.0}
    curves = {test.name: np.zeros((0, 2)) for test in lab.tests.apparatus}
    found = {name: np.nan for name, _ in names_observed(lab.tests.apparatus).values()}
    return Run(found, curves, quality, failure)


def summary(
    lab: VirtualLab, packing: Packing, soil: SoilParameters, outcome: Outcome, seconds: float
) -> Run:
    """A run's numbers in mm and N, with the checks that say whether to believe them."""
    record = outcome.record
    samples = int(np.sum(np.asarray(record.samples.segment) >= 0))
    time_step = float(lab.time_step(packing, soil))
    steps = samples * round(lab.numerics.sample_time / time_step)
    energy = record.state.energy
    rests = [k for k, movement in enumerate(lab.tests.movements()) if movement.resting]
    rest = np.flatnonzero(np.isin(np.asarray(record.samples.segment), rests[-1:]))
    kinetic = np.asarray(record.samples.kinetic_energy)
    quality = {
        "inertial_number": _inertial_number(lab, packing, outcome),
        "overflow": float(bool(record.overflow_of(lab.grid))),
        "energy_balance": _integration_error(outcome),
        "kinetic_energy_after_rest_j": float(kinetic[rest[-1]]) if rest.size else np.nan,
        "platen_work_j": float(energy.platen),
        "time_step_s": time_step,
        "steps": float(steps),
        "spheres": float(packing.spheres.count),
        "runtime_s": seconds,
        "repeats": 0.0,
        "tool_across": _tool_across(lab, packing),
        "tool_overlap": _tool_overlap(lab, packing, outcome),
        **resolution_of(packing),
    }
    return Run(
        observables={
            name: factor * float(outcome.observables[test][source])
            for (test, source), (name, factor) in names_observed(lab.tests.apparatus).items()
        },
        curves={name: points_of(curve) for name, curve in outcome.curves.items()},
        quality=quality,
        failure=_failure(lab, packing, soil, outcome),
        channels={
            name: _channels_of(outcome.curves[name], found)
            for name, found in outcome.channels.items()
            if found
        },
    )


def resolution_of(packing: Packing) -> dict[str, float]:
    """How finely a bed is resolved: the mould's diameter over the spheres' mean diameter, and its
    porosity before the tests."""
    across = 2 * packing.mould_radius / packing.mean_diameter()
    return {"spheres_across": float(across), "porosity": 1 - float(packing.solid_fraction())}


def completed(run: Run, packing: Packing) -> Run:
    """The run with its bed's resolution, which entries of earlier caches do not hold."""
    known = {"tool_across": np.nan, "tool_overlap": np.nan} | run.quality
    return replace(run, quality=known if "porosity" in known else known | resolution_of(packing))


def _tool_across(lab: VirtualLab, packing: Packing) -> float:
    """Width of the narrowest tool over the spheres' mean diameter; NaN without one."""
    widths = [test.width for test in lab.tests.apparatus if test.width]
    return min(widths, default=np.nan) / float(packing.mean_diameter())


def _tool_overlap(lab: VirtualLab, packing: Packing, outcome: Outcome) -> float:
    """The largest overlap of a sphere and a tool as the tests end, over the sphere's radius; NaN
    without a tool."""
    if not any(test.width for test in lab.tests.apparatus):
        return np.nan
    found = eqx.filter_jit(boundary_overlaps)(packing.spheres, outcome.record.state)
    return float(jnp.max(found[CELL:]))


def repeated(run: Run, before: Run) -> Run:
    """A run that took the place of one whose lists were too small; its time is that of both."""
    both = before.quality["runtime_s"] + run.quality["runtime_s"]
    return replace(run, quality=run.quality | {"repeats": 1.0, "runtime_s": both})


def _inertial_number(lab: VirtualLab, packing: Packing, outcome: Outcome) -> float:
    """The largest of all tests that state it: of the specimen at a force, or of the soil at a tool;
    NaN if none does."""
    area = np.pi * float(packing.mould_radius) ** 2
    density = float(packing.bulk_density() / packing.solid_fraction())
    diameter = packing.mean_diameter()
    size = (packing.height, diameter, density)
    found = [
        float(inertial_number(test.simulated_rate, *size, float(test.reference_force) / area))
        for test in lab.tests.apparatus
        if test.reference_force is not None
    ]
    for test in lab.tests.apparatus:
        at_tool = test.sheared(outcome.observables[test.name], diameter)
        if at_tool is not None and at_tool[1] > 0:
            found.append(float(inertial_number(at_tool[0], 1.0, diameter, density, at_tool[1])))
    return max(found, default=np.nan)


def _failure(lab: VirtualLab, packing: Packing, soil: SoilParameters, outcome: Outcome) -> str:
    """Why the outcome is no result; "" if it is one."""
    if lost := _lost_contacts(lab, packing, soil):
        return lost
    if not bool(outcome.failed) and _integration_error(outcome) < UNSTABLE:
        return ""
    for find in (_bad_input(packing, soil), _bad_numerics(lab, outcome), _bad_course(lab, outcome)):
        if find:
            return find
    forces = [test.required_force for test in lab.tests.apparatus]
    force = max((float(force) for force in forces if force is not None), default=np.nan)
    return f"the platen did not reach {force:.0f} N within its stroke: the soil is too soft"


def _lost_contacts(lab: VirtualLab, packing: Packing, soil: SoilParameters) -> str:
    """Whether lists may have lost contacts that still pulled; "" if they cannot have."""
    largest = float(np.max(packing.spheres.radius))
    needed, listed = reach_of(soil, float(packing.mean_diameter()), largest), lab.grid.reach
    if needed <= listed:
        return ""
    return (
        f"contacts act across gaps up to {1e6 * needed:.3g} um, but pairs were listed up to "
        f"{1e6 * listed:.3g} um: a value beyond the bounds of the lab file; give its parameters "
        "low and high that enclose it"
    )


def _bad_input(packing: Packing, soil: SoilParameters) -> str:
    """What was not a number before anything was simulated."""
    for name, value in soil.values().items():
        if not np.all(np.isfinite(value)):
            return f"{name} of the soil is not finite"
    if not all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(packing)):
        return "the packing holds numbers that are not finite"
    return ""


def _bad_numerics(lab: VirtualLab, outcome: Outcome) -> str:
    """Lists that were too small, and steps that were too large."""
    record, finds = outcome.record, []
    if bool(record.demand.exceeds(lab.grid)):
        finds.append("a contact list was too small: " + record.explain_overflow(lab.grid))
    error = _integration_error(outcome)
    position = record.state.motion.position.stack()
    if not (error < UNSTABLE and np.all(np.isfinite(position))):
        finds.append(
            "the time step is too large or a parameter is extreme: integration errors are "
            f"{error:.2g} times the machine's work"
        )
    if bool(record.overflow_of(lab.grid)) and not finds:
        finds.append("spheres outran their contact lists: " + record.explain_overflow(lab.grid))
        if any(test.width for test in lab.tests.apparatus):
            finds.append(PRESSED_THROUGH)
    return "; ".join(finds)


def _integration_error(outcome: Outcome) -> float:
    """Of the whole programme, relative to the platen's work, or to that of all boundaries and of
    gravity where there are tools; far below 1 in a sound run."""
    energy = outcome.record.state.energy
    done = abs(energy.platen)
    if energy.boundaries.shape[-1] > CELL:
        done = jnp.sum(jnp.abs(energy.boundaries)) + abs(energy.gravity)
    return float(abs(energy.integration) / done)


def _bad_course(lab: VirtualLab, outcome: Outcome) -> str:
    """Tests that did not come to their end."""
    if not bool(outcome.record.finished):
        return "the tests took longer than their capacity of samples"
    for test in lab.tests.apparatus:
        for source, value in outcome.observables[test.name].items():
            if not np.isfinite(value):
                return (
                    f"{test.name}: no number for the {source.replace('_', ' ')}: {test.no_number}"
                )
    return ""


def _channels_of(curve: Curve, found: Mapping[str, Array]) -> dict[str, np.ndarray]:
    """What was recorded at the rows that count, by name with unit."""
    rows = np.asarray(curve.valid) > 0
    called = {channel(source): values for source, values in found.items()}
    return {c.name: (c.scale * np.asarray(v))[rows].astype(float) for c, v in called.items()}


def points_of(curve: Curve) -> np.ndarray:
    """The rows that count, as an array (points, 2) in mm and N."""
    rows = np.asarray(curve.valid) > 0
    columns = (1e3 * np.asarray(curve.displacement), np.asarray(curve.force))
    return np.stack(columns, axis=1)[rows].astype(float)
