"""What a verb works with: lab, preset, folder of results, progress, and where simulations run."""

import platform
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import cast

from calibrate.core import runtime
from calibrate.core.errors import COMMAND_LINE, InputError
from calibrate.core.files import make_folder
from calibrate.core.progress import AbstractProgress, for_terminal
from calibrate.io.choices import plain
from calibrate.io.conventions import check_values, origin
from calibrate.io.lab import Lab, LabLike, lab_of
from calibrate.io.labfile import check_parameter
from calibrate.io.soil import base_soil, with_values
from calibrate.simulation import specimens
from calibrate.simulation.batches import InBatches
from calibrate.simulation.campaign import Campaign
from calibrate.simulation.executors import HERE, AbstractPlace
from calibrate.simulation.joint import AbstractCampaign
from calibrate.simulation.resolution import PRESETS, Preset
from jdem.materials.soil import SoilParameters
from jdem.physics import PHYSICS


@dataclass(frozen=True)
class Session:
    """What a verb works with: the lab, the preset, where results go, who hears of progress,
    and where simulations run."""

    lab: Lab
    preset: Preset
    out: Path
    progress: AbstractProgress
    place: AbstractPlace = HERE

    @staticmethod
    def open(
        lab: LabLike, preset: str, out: Path, dask: str | None = None,
        conventions: str | None = None, batch: int | None = None,
    ) -> "Session":  # fmt: skip
        """`conventions` stand in for those that the lab file states."""
        if preset not in PRESETS:
            known = ", ".join(PRESETS)
            raise InputError(COMMAND_LINE, "--preset", f"no preset '{preset}'", f"give {known}")
        loaded = lab_of(lab)
        if conventions is not None:
            loaded = loaded.following(conventions)
        make_folder(out)
        return Session(loaded, PRESETS[preset], out, for_terminal(), place_of(dask, batch))

    def resized(self, spheres: int) -> "Session":
        """The same session with another number of spheres in the preset."""
        return replace(self, preset=replace(self.preset, spheres=spheres))

    def in_single_precision(self) -> "Session":
        """The same session in single precision (float32)."""
        return replace(self, preset=replace(self.preset, dtype="float32"))

    def soil(self, values: Mapping[str, float | str] | None) -> SoilParameters:
        """The soil that the lab file describes with these values (SI, or with a unit) in place of
        its own; `InputError` where the lab's law does not have them, or leaves others."""
        law, own = self.lab.particles.conventions, self.lab.differing()
        given = {n: x for name, x in (values or {}).items() for n in own.get(name, [name])}
        known = [name for every in own.values() for name in every]
        numbers = {
            name: check_parameter(
                plain(name) if name in known else name, value, COMMAND_LINE, f"--set {name}", law
            )
            for name, value in given.items()
        }
        check_values(law, numbers, COMMAND_LINE, "--set ")
        return with_values(base_soil(self.lab), numbers)

    def campaign(self, out: Path, preparation: SoilParameters | None = None) -> AbstractCampaign:
        """Simulations of this session; beds settle with the soil of `preparation`, or with a
        neutral one."""
        return specimens.campaign(
            self.lab, self.preset, out, self.progress, preparation, self.place
        )

    def campaign_of_one(self, out: Path) -> Campaign:
        """The same where only tests on one specimen will do; those without soil are left out."""
        self.lab.check_same_soil()
        if len(self.lab.specimens()) > 1:
            problem = "the tests are made on several specimens, this command takes one"
            repair = "keep the tests of one specimen, in a lab file of their own"
            raise InputError(self.lab.file, "tests", problem, repair)
        return cast(Campaign, self.on_soil().campaign(out))

    def on_soil(self) -> "Session":
        """The same session with the lab's tests with soil alone."""
        return replace(self, lab=self.lab.on_soil())


def place_of(dask: str | None = None, batch: int | None = None) -> AbstractPlace:
    """The cluster at the address of `--dask`, an accelerator for `--batch`, or the cores of this
    machine."""
    if dask is not None and batch is not None:
        problem = "a cluster's workers simulate one specimen at a time"
        raise InputError(COMMAND_LINE, "--batch", problem, "leave out --batch or --dask")
    if batch is not None:
        return InBatches(batch)
    if dask is None:
        return HERE
    from calibrate.simulation.cluster import DaskCluster  # loads Dask, which takes a second

    return DaskCluster(dask)


def made_by() -> dict:
    """What made a result: command, versions of programs, version of the physics."""
    packages = ("differentiable-soil", "jax", "equinox", "optimistix", "numpy")
    return {
        "command": runtime.command(),
        "versions": {
            "python": platform.python_version(),
            **{name: metadata.version(name) for name in packages},
        },
        "physics": PHYSICS,
    }


def origin_of(session: Session) -> dict:
    """What made a result from a laboratory's data: `made_by`, soil, law or conventions, preset
    and precision."""
    preset, lab = session.preset, session.lab
    return {
        "soil": lab.name,
        **origin(lab.particles.conventions),
        "preset": preset.name,
        "dtype": preset.dtype,
        **made_by(),
    }
