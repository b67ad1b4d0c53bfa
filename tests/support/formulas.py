"""A soil of formulas: H, F and both curves in closed form, with the scatter of packings.

It has the interface of a campaign, so that it is statistics and not DEM that is tested.  Where
simulations themselves are needed there is a real campaign, of 48 spheres in a low mould.
"""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from calibrate.core.progress import Silent
from calibrate.inference.on_response import OnResponse, Reach, ResponseCampaign
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.io.soil import base_soil
from calibrate.labtests.diagnosis.curves import TARGETS
from calibrate.simulation import Campaign
from calibrate.simulation.executors import Here
from calibrate.simulation.resolution import PRESETS, Preset, virtual_lab
from calibrate.simulation.run import Run
from calibrate.simulation.specimens import campaign
from jdem.bodies.spheres import Spheres
from jdem.core.vector import Vector
from jdem.laboratory.virtual_lab import VirtualLab
from jdem.packing.specimen import Packing

LAB = load_lab(bundled_lab())
BASE = base_soil(LAB)
NAMES = ("shear_modulus", "surface_energy")
QUALITY = {  # what a sound run of 150 spheres reports of itself (that of the bundled soil, rounded)
    "inertial_number": 9e-4,
    "overflow": 0.0,
    "energy_balance": 8e-4,
    "kinetic_energy_after_rest_j": 4e-9,
    "platen_work_j": 3.3,
    "time_step_s": 2e-5,
    "steps": 31e3,
    "spheres": 150.0,
    "runtime_s": 8.3,
    "spheres_across": 4.7,
    "repeats": 0.0,
    "porosity": 0.49,
}


def two_tests(
    depth: float,
    force: float,
    confined: np.ndarray,
    crushing: np.ndarray,
    quality: dict[str, float],
    failure: str = "",
) -> Run:
    """A run with these observables (mm, N), curves (points, 2) and checks."""
    observables = {"depression_depth_mm": depth, "crushing_force_n": force}
    return Run(observables, {"confined": confined, "unconfined": crushing}, quality, failure)


def pressed_lightly(lab: Lab, height: float = 0.05) -> Lab:
    """The lab with a specimen of this height (m), pressed with 50 N."""
    compression = lab.tests[0].model_copy(update={"force_low": 25.0, "force_high": 50.0})
    return replace(
        lab,
        specimen=replace(lab.specimen, height=height),
        tests=(compression, *lab.tests[1:]),
    )


TINY = Preset("tiny", 48, 0.1, 0.2, 2)


def tiny_lab() -> Lab:
    """The bundled soil in a low mould, pressed with 50 N."""
    return pressed_lightly(LAB)


def tiny_campaign(folder: Path) -> Campaign:
    """Its real simulations; all tests that use it share two compiled programs."""
    return replace(campaign(tiny_lab(), TINY, folder, Silent()), workers=1)


def shift(soil, name):
    """ln of a parameter over its starting value."""
    return math.log(float(getattr(soil, name)) / float(getattr(BASE, name)))


def shape(soil, seed):
    """Depth D (mm), exponent m, rebound r, strength P (N), scale d (mm) of one specimen.

    The factors' sizes are those of the quick preset; a packing scatters them by 2 to 5 %.
    """
    stiff, plastic = shift(soil, "shear_modulus"), shift(soil, "plasticity_ratio")
    adhesion, friction = shift(soil, "surface_energy"), shift(soil, "static_friction")
    luck = np.random.default_rng(seed).normal(size=5) * [0.03, 0.02, 0.03, 0.05, 0.03]
    shifts = [
        -0.8 * stiff + 0.3 * plastic,
        0.4 * friction,
        -0.6 * plastic,
        0.6 * adhesion + 0.2 * friction + 0.1 * adhesion**2,
        -0.3 * stiff,
    ]
    return np.array([6.0, 0.7, 0.3, 200.0, 1.0]) * np.exp(np.array(shifts) + luck)


def specimen(soil, seed):
    """Confined: (D (F/400)^m up, a straight line down); unconfined: P (1 - exp(-x/d))."""
    depth, exponent, rebound, strength, scale = shape(soil, seed)
    force = np.linspace(0, 400, 201)
    up = depth * (force / 400) ** exponent
    down = depth * (1 - rebound * (1 - force[::-1] / 400))
    travel = np.linspace(0, 12, 241)
    confined = np.stack([np.append(up, down[1:]), np.append(force, force[-2::-1])], axis=1)
    crushing = np.stack([travel, strength * -np.expm1(-travel / scale)], axis=1)
    return two_tests(
        depth * (1 - 0.5**exponent), float(crushing[-1, 1]), confined, crushing, QUALITY
    )


@dataclass
class Formulas:
    """Stands in for `Campaign`; soils for which `fails` is true cannot be simulated."""

    fails: object = lambda soil: False
    progress: Silent = field(default_factory=Silent)
    simulated: int = 0
    lab: VirtualLab = field(default_factory=lambda: virtual_lab(LAB, PRESETS["quick"]))

    folder: Path = Path()

    @property
    def apparatus(self):
        return self.lab.tests.apparatus

    def runs(self, soils, seeds, what):
        return self.each([[soil] * len(seeds) for soil in soils], seeds, what)

    def each(self, soils, seeds, what):
        return [[self._run(s, seed) for s, seed in zip(row, seeds, strict=True)] for row in soils]

    def _run(self, soil, seed):
        self.simulated += 1
        run = specimen(soil, seed)
        return replace(run, failure="the bed exploded") if self.fails(soil) else run


@dataclass
class Capped(Formulas):
    """Strength grows with surface energy by a tenth at most, then with plasticity ratio, rolling
    friction and softness; packings scatter `luck` times as much in strength."""

    luck: float = 1.0

    def _run(self, soil, seed):
        self.simulated += 1
        run = specimen(soil, seed)
        held = 0.6 * shift(soil, "surface_energy") + 0.1 * shift(soil, "surface_energy") ** 2
        held += 0.2 * shift(soil, "static_friction")
        cap = 0.1 + 1.5 * shift(soil, "plasticity_ratio")
        strength = np.minimum(0.6 * shift(soil, "surface_energy"), cap)
        strength += 0.8 * shift(soil, "rolling_friction") - 0.3 * shift(soil, "shear_modulus")
        alone = (
            np.log(run.observables["crushing_force_n"]) - held - np.log(200.0)
        )  # of this packing
        factor = np.exp(strength - held + (self.luck - 1) * alone)
        curves = {
            **run.curves,
            "unconfined": run.curves["unconfined"] * [1.0, factor],
        }
        values = {
            **run.observables,
            "crushing_force_n": factor * run.observables["crushing_force_n"],
        }
        return replace(run, observables=values, curves=curves)


def in_place_of_spheres(monkeypatch) -> None:
    """Whatever this process simulates from now on is a formula, of any number of spheres."""

    def simulate(place, lab, bed, packing, soil):
        return specimen(soil, round(1e6 * float(packing.height)))

    def prepare(place, bed, seed, soil):
        ones = jnp.ones(bed.count)
        return Packing(Vector(ones, ones, ones), Spheres(ones, ones), 1.0 + seed, 1.0)

    monkeypatch.setattr(Here, "warm_up", lambda place, lab, packing, soil, say: None)
    monkeypatch.setattr(Here, "simulate", simulate)
    monkeypatch.setattr(Here, "prepare", prepare)


# ------------------------------------------------------------------ a response of formulas


class FormulaBeds(eqx.Module):
    """`formulas.shape` without the luck of packings, in JAX."""

    names: tuple[str, ...] = eqx.field(static=True, default=NAMES)

    def values(self, soil):
        def shift(name):
            return jnp.log(getattr(soil, name) / getattr(BASE, name))

        stiff, plastic, adhesion, friction = map(
            shift, ("shear_modulus", "plasticity_ratio", "surface_energy", "static_friction")
        )
        shifts = [
            -0.8 * stiff + 0.3 * plastic,
            0.4 * friction,
            0.6 * adhesion + 0.2 * friction + 0.1 * adhesion**2,
            -0.3 * stiff,
        ]
        return jnp.array([6.0, 0.7, 200.0, 1.0]) * jnp.exp(jnp.stack(shifts))

    def shown(self, values):
        depth, exponent, strength, scale = values
        force = jnp.linspace(0, 400, 201)
        confined = jnp.column_stack([depth * (force / 400) ** exponent, force])
        observables = depth * (1 - 0.5**exponent), strength * -jnp.expm1(-12 / scale)
        return dict(zip(TARGETS, observables, strict=True)), {"confined": confined}

    def continued(self, curves):
        return {test: np.asarray(curve) for test, curve in curves.items()}  # formulas have no end


def response_campaign(beyond=lambda soil: ()):
    return ResponseCampaign(FormulaBeds(), beyond, Path(), Silent(), ())


def on_response(spread=(0.03, 0.02, 0.05, 0.03), **options):
    """Packings deviate by these shares of the four values."""
    luck = np.random.default_rng(0).normal(size=(40, 4)) * spread

    def specimens(soil):
        return luck * np.asarray(FormulaBeds().values(soil))

    def errors(soil):
        return np.diag(0.01 * np.asarray(FormulaBeds().values(soil)))

    def slope_errors(soil):  # of the strength alone, with the second of NAMES: 0.02 of it
        return np.zeros((1, 4, 2)) + np.outer([0, 0, 4.0, 0], [0, 1])

    centre, sd = np.log([float(getattr(BASE, name)) for name in NAMES]), np.full(2, 0.4)
    reach = Reach(NAMES, centre - 1.0, centre + 1.0, sd)
    work = response_campaign(**options)
    return OnResponse(work, specimens, errors, slope_errors, 2000, reach)
