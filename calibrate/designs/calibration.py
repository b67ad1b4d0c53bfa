"""Calibration by designed experiments: `calibrate doe`, from a lab file to a comparison.

lab file -> packings -> screening -> surfaces -> refinement -> fresh packings
                    \\-> gradients at the same centres, gradient fit -> comparison
"""

from dataclasses import dataclass

from calibrate.core.errors import InputError
from calibrate.designs.comparison import Comparison, compare
from calibrate.designs.study import Bench, Study, study
from calibrate.inference.calibration import CANDIDATES
from calibrate.inference.parameters import space
from calibrate.io.lab import Lab
from calibrate.io.soil import base_soil, with_values
from calibrate.labtests.composite import names_of
from calibrate.simulation.joint import AbstractCampaign
from calibrate.simulation.resolution import Preset
from calibrate.simulation.specimens import Seeds


@dataclass(frozen=True, eq=False)
class Designed:
    """A finished study with its comparison, and the packings that were used."""

    study: Study
    comparison: Comparison
    seeds: tuple[int, ...]
    fresh: tuple[int, ...]


def design(
    lab: Lab, preset: Preset, changes: dict[str, float], seed: int, work: AbstractCampaign
) -> Designed:
    """The whole sequence around the lab file's soil; resumes from what `work.folder` holds.

    Verified on all packings from which the fit takes its scatter and that no design has seen.
    """
    lab = lab.on_soil()
    _check_targets(lab)
    seeds = Seeds.of(seed, preset.packings)
    fresh = tuple(number for number in seeds.scatter if number not in seeds.fitted)
    held = {name for name, choice in lab.parameters.items() if choice.free is False}
    factors = tuple(name for name in CANDIDATES if name not in held)
    base = with_values(base_soil(lab), changes)
    bench = Bench(space(lab, factors, base), work, seeds.fitted)
    done = study(bench, lab.targets, fresh)
    return Designed(done, compare(lab, bench, done, fresh, seeds.scatter), seeds.fitted, fresh)


def _check_targets(lab: Lab) -> None:
    """Refuses a lab without any scalar target: curves alone are no response of a surface."""
    if not lab.targets:
        known = ", ".join(name for name, _ in names_of(lab.tests).values())
        problem = "no scalar target, and designs are calibrated to targets, not to curves"
        raise InputError(lab.file, "targets", problem, f"give one or more of {known}, or fit")
