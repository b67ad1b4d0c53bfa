"""Calibration by designed experiments: `calibrate doe`, from a lab file to a comparison.

lab file -> packings -> screening -> depth -> force -> refinement -> fresh packings
                    \\-> gradients at the same centres, gradient fit -> comparison
"""

from dataclasses import dataclass

from calibrate.core.errors import InputError
from calibrate.designs.comparison import Comparison, compare
from calibrate.designs.study import OBSERVABLES, Bench, Study, study
from calibrate.inference.calibration import CANDIDATES
from calibrate.inference.parameters import space
from calibrate.io.lab import Lab
from calibrate.io.soil import base_soil, with_values
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
    for name in OBSERVABLES:
        if name not in lab.targets:
            field = "targets." + name.rpartition("_")[0]
            raise InputError(
                lab.file, field, "missing: designs are calibrated to both targets", "add it"
            )
