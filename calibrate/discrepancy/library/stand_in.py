"""The library of runs in the place of simulations at a preset: what a fit explores with.

A lab is served if its tests on soil are the library's two, its specimen is among the shapes that
the library has, and the preset's beds grow, as the library's do.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import jax.numpy as jnp
import numpy as np

from calibrate.core.errors import InputError
from calibrate.discrepancy.library.description import EmulatedLibrary
from calibrate.discrepancy.library.design import POROSITIES, SETTINGS, SHAPE, SOIL, SPEEDS
from calibrate.discrepancy.library.lab_size import (
    SoilPrior,
    parameters_beyond,
    reach,
    soil_sd,
)
from calibrate.discrepancy.library.store import bundled_library, load
from calibrate.inference.on_response import (
    OnResponse,
    Reach,
    ResponseCampaign,
    UnderEffects,
)
from calibrate.inference.parameters import Acting
from calibrate.inference.problem import pose
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.io.soil import base_soil
from calibrate.labtests.diagnosis.curves import TARGETS
from calibrate.response.beds import Beds
from calibrate.simulation.joint import AbstractCampaign
from calibrate.simulation.resolution import Preset, specimen
from calibrate.simulation.specimens import soil_json
from jdem.materials.catalogue import WHOLE
from jdem.materials.soil import SoilParameters

POROUS = 0.005  # of porosity beyond its beds, up to which they still carry


def why_not(lab: Lab, preset: Preset, free: Sequence[str] | None, base: SoilParameters) -> str:
    """Why the library cannot stand for a lab's simulations when these parameters are free (None:
    those of the lab file) and the others as in `base`, before it is read; "" where it can."""
    law = lab.particles.conventions
    if law in WHOLE:
        return f"its runs are of the law 'eepa', and this lab's law is '{law}'"
    if not preset.grown:
        return f"the preset {preset.name} has coarse beds that fall, and the library's grow"
    stated = [name for name, choice in lab.parameters.items() if choice.free]
    others = [name for name in free or stated if name not in SOIL]
    if others:
        return f"no run of the library varies {', '.join(others)}"
    held = [name for name, value in _held(base).items() if not np.isclose(*value, atol=0)]
    if held:
        return f"no run of the library has this value of {', '.join(held)}"
    called = [test.called for test in lab.tests]
    features = pose(lab).features
    lacking = [f.name for f in features if f.is_target and f.name not in TARGETS]
    if lacking:
        return f"the library does not have the number {', '.join(lacking)}"
    if len(called) > len(TARGETS):
        return f"no run of the library has the test {', '.join(called[len(TARGETS) :])}"
    return ""


def _held(base: SoilParameters) -> dict[str, tuple[float, float]]:
    """Parameters that all runs of the library have in common: a soil's value, and theirs."""
    own, theirs = soil_json(base), soil_json(base_soil(load_lab(bundled_lab())))
    return {name: (own[name], theirs[name]) for name in theirs if name not in SOIL}


def stands_in(
    lab: Lab, preset: Preset, emulated: EmulatedLibrary, work: AbstractCampaign
) -> OnResponse:
    """The library in the place of a lab's beds at a preset; `InputError` where it has not the lab's
    tests on soil, a shape near its own, or runs that follow its conventions."""
    emulated = emulated.for_lab(lab)
    library, design = emulated.library, emulated.library.design
    emulated.emulator.factors.begin()
    pair, settings = lab.pair(), _settings(lab, preset, emulated)
    centre = np.log([design.centre[name] for name in design.soil_names])
    beds = Beds(
        soil=emulated.emulator.response,
        centre=jnp.asarray(centre),
        settings=jnp.asarray(settings),
        spread=jnp.asarray(design.spread()),
        none=jnp.zeros(len(design.limits)),
        units=jnp.asarray(emulated.units),
        names=design.soil_names,
        features=emulated.size.features,
        called=(pair.compression.called, pair.crushing.called),
    )

    def too_far(soil: SoilParameters) -> tuple[str, ...]:
        logs = np.log([float(getattr(soil, name)) for name in design.soil_names])
        return parameters_beyond(library, logs - centre)

    campaign = ResponseCampaign(beds.holding(), too_far, work.folder, work.progress, work.apparatus)
    low, high = reach(library)
    known = Reach(design.soil_names, centre + low, centre + high, soil_sd(library))
    about = AboutBeds(emulated, beds, preset.spheres)
    return OnResponse(
        campaign, about.specimens, about.errors, about.slope_errors, preset.spheres, known,
        _acting(emulated), partial(_under, emulated, settings), about.errors_under,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class AboutBeds:
    """How single packings of beds with so many spheres scatter, and how far the library may be off:
    rows (n, l) of deviations of the beds' features, as of `OnResponse`."""

    emulated: EmulatedLibrary
    beds: Beds
    spheres: int

    def specimens(self, soil: SoilParameters) -> np.ndarray:
        # Scatter of means over independent parts goes with one over the root of their number.
        smaller = np.sqrt(self.emulated.library.design.spheres / self.spheres)
        x = self._at(soil)
        return smaller * self._steep(x, self._none) * self.emulated.specimens(x)

    def errors(self, soil: SoilParameters) -> np.ndarray:
        return self._errors(self._at(soil), self._none)

    def errors_under(
        self, soil: SoilParameters, under: UnderEffects, strengths: np.ndarray
    ) -> np.ndarray:
        point = under.point(self.beds, soil, jnp.asarray(strengths))
        return self._errors(*map(np.asarray, under.response.scaled(*point)))

    def slope_errors(self, soil: SoilParameters) -> np.ndarray:
        emulator, design = self.emulated.emulator, self.emulated.library.design
        x = self._at(soil)
        widening = self.emulated.emulator_errors.widening[:, None]
        stated = widening * emulator.slope_variances(x, self._none)
        count = len(design.soil_names)  # the first coordinates are those of the soil
        sd = np.sqrt(stated[:, :count]) / design.spread()[:count]
        carried = self._steep(x, self._none)[:, None] * emulator.basis.carried
        return carried.T[:, :, None] * sd[:, None, :]

    @property
    def _none(self) -> np.ndarray:
        """No effect's strength (k,)."""
        return np.zeros(len(self.emulated.library.design.limits))

    def _at(self, soil: SoilParameters) -> np.ndarray:
        return np.asarray(self.beds.scaled(soil))

    def _steep(self, x: np.ndarray, s: np.ndarray) -> np.ndarray:
        return self.emulated.units * self.emulated.emulator.steepness(x, s)

    def _errors(self, x: np.ndarray, s: np.ndarray) -> np.ndarray:
        known = self.emulated.emulator_errors.of_values(self.emulated.emulator, x, s)
        return self._steep(x, s) * known.T


def _acting(emulated: EmulatedLibrary) -> tuple[Acting, ...]:
    """The effects that runs of the library have."""
    design = emulated.library.design
    rows = zip(emulated.candidates(), design.limits.values(), design.typical(), strict=True)
    return tuple(
        Acting(each.name, each.typical, each.unit, 0.0 if each.one_sided else low / typical,
               high / typical)
        for each, (low, high), typical in rows
    )  # fmt: skip


def _under(
    emulated: EmulatedLibrary, settings: list[float], names: Sequence[str]
) -> UnderEffects | None:
    """What beds of these settings show under the named effects; None where there are none."""
    if not names:
        return None
    design = emulated.library.design
    offset = np.array([*np.zeros(len(design.soil_names)), *settings])
    response = emulated.at(SoilPrior(offset, np.ones_like(offset))).response
    return UnderEffects(response, tuple(design.effect_names.index(name) for name in names))


def _settings(lab: Lab, preset: Preset, emulated: EmulatedLibrary) -> list[float]:
    """Base coordinates of the beds of a preset, in the order of SETTINGS."""
    shape = dict(zip(SHAPE, emulated.size.shape.tolist(), strict=True))
    found = {
        "smoothing": 0.0,
        "porosity": _looser(lab, preset),
        "pace": preset.rate_in_mould / SPEEDS[0],
        "sphere_size": emulated.library.design.sphere_size(
            round(preset.spheres / np.exp(shape["slenderness"]))
        ),
        **shape,
    }
    return [found[name] for name in SETTINGS]


def _looser(lab: Lab, preset: Preset) -> float:
    """Porosity of a lab's beds over the usual one; `InputError` where no bed of the library is as
    dense or as loose."""
    own = specimen(lab, preset).porosity
    usual = specimen(replace(lab, particles=replace(lab.particles, porosity=None)), preset).porosity
    looser = 0.0 if own is None or usual is None else own - usual
    if not min(POROSITIES) - POROUS <= looser <= max(POROSITIES) + POROUS:
        problem = f"{own:.3g} is {looser:+.3f} from the usual porosity, beyond the library's beds"
        raise InputError(lab.file, "particles.porosity", problem, "leave it out for the usual one")
    return looser


def served(
    lab: Lab,
    preset: Preset,
    free: Sequence[str] | None,
    base: SoilParameters,
    work: AbstractCampaign,
) -> tuple[OnResponse | None, str]:
    """The bundled library in the place of a lab's beds, or why it cannot be."""
    try:
        lab.pair()
        reason = why_not(lab, preset, free, base)
        if reason:
            return None, reason
        return stands_in(lab, preset, EmulatedLibrary.of(load(bundled_library())), work), ""
    except InputError as refused:
        return None, str(refused)
