"""What is kept of a bank: the points, the features of their curves, fitted kernels, one curve.

One NetCDF file of about a megabyte, from which an emulator is ready in seconds.  It says which
engine made it, for which cylinder and forces, and how far its points reach.
"""

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from importlib import resources
from pathlib import Path

import numpy as np
import xarray as xr

from calibrate.core.errors import InputError
from calibrate.discrepancy.comparison.features import (
    Curves,
    Feature,
    declare,
    declare_targets,
    vector,
)
from calibrate.discrepancy.library.cross_validation import Missed, Points, missed
from calibrate.discrepancy.library.design import Design
from calibrate.discrepancy.library.emulator import FeatureEmulator, Kernel, fit_emulator
from calibrate.discrepancy.library.load_cell_lag import LAG, Late
from calibrate.io.lab import Lab
from calibrate.simulation import Run, engine_hash

PEAK_MM, PEAK_N = 4.0, 250.0  # usual place of the peak, by which crushing features are declared
TARGETS = ("depression_depth_mm", "crushing_force_n")
NETCDF = "h5netcdf"
NO_TWINS = -6.0  # their kernels' logarithm in files from before there were any


@dataclass(frozen=True)
class Cylinder:
    """Specimen and machine of a bank: m, m, N, N."""

    diameter: float
    height: float
    force_low: float
    force_high: float

    @staticmethod
    def of(lab: Lab) -> "Cylinder":
        return Cylinder(
            lab.specimen.diameter, lab.specimen.height,
            lab.confined.force_low, lab.confined.force_high,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Rows:
    """Simulations: base coordinates (n, p), strengths in SI (n, k), packing (n,), from 0 on,
    values of all features (n, m)."""

    base: np.ndarray
    strengths: np.ndarray
    packing: np.ndarray
    values: np.ndarray

    @staticmethod
    def of(
        features: Sequence[Feature], base: np.ndarray, strengths: np.ndarray, packing: np.ndarray,
        runs: Sequence[Run | None],
    ) -> "Rows":  # fmt: skip
        """The rows of runs (None: not simulated), without failed and incomplete ones."""
        values = features_of(features, runs)
        good = np.isfinite(values).all(axis=1)
        return Rows(base[good], strengths[good], packing[good], values[good])


@dataclass(frozen=True, eq=False)
class Bank:
    """Simulated rows: base coordinates (n, p), strengths in SI (n, k), packing (n,), values of
    all features (n, m), a reference specimen's curves, the platen's speed (mm/s) in the confined
    test; once fitted, kernels, what left-out packings show them to miss, and what late readings
    add to the rows (n, m)."""

    design: Design
    cylinder: Cylinder
    engine: str
    base: np.ndarray
    strengths: np.ndarray
    packing: np.ndarray
    values: np.ndarray
    reference: Curves
    kernels: tuple[Kernel, ...] = ()
    missed: Missed | None = None
    late: np.ndarray | None = None
    speed: float = 8.0

    @property
    def features(self) -> tuple[Feature, ...]:
        """Curve features, then the scalar targets."""
        return declared(self.cylinder.force_high)

    def scaled(self) -> tuple[np.ndarray, np.ndarray]:
        """Points as the emulator takes them: over their spread, over limits."""
        return self.base / self.design.spread(), self.strengths / limits(self.design)

    @property
    def in_time(self) -> np.ndarray:
        """Values (n, m) less what late readings add."""
        return self.values if self.late is None else self.values - self.late

    @property
    def lag(self) -> np.ndarray:
        """How late forces are read in each row (n,), s."""
        names = self.design.effect_names
        return self.strengths[:, names.index(LAG)] if LAG in names else np.zeros(len(self.values))

    def reader(self) -> Late:
        """What late readings do to the features."""
        return Late(self.features, self.speed)

    def emulator(self) -> FeatureEmulator:
        """The emulator of all features as they are when no reading is late."""
        x, s = self.scaled()
        return fit_emulator(x, s, self.packing, self.in_time, self.scale(), self.kernels or None)

    def grown(self, design: Design, runs: Sequence[Run | None]) -> "Bank":
        """The bank with the runs of a larger design's further packings; not fitted."""
        first = self.design.packings
        packing = np.repeat(np.arange(design.packings), design.rows_each)
        later = packing >= first
        base, strengths = (part[later] for part in design.rows())
        rows = Rows.of(self.features, base, strengths, packing[later] - first, runs)
        return replace(self.joined(rows, first), design=design, kernels=(), missed=None)

    def joined(self, rows: "Rows", first: int | None = None) -> "Bank":
        """The bank with further simulations behind its own, their packings numbered from `first`
        (after its own) on; kernels stay, what late readings add has to be told anew."""
        packing = (self.packing.max() + 1 if first is None else first) + rows.packing
        return replace(
            self,
            late=None,
            base=np.vstack([self.base, rows.base]),
            strengths=np.vstack([self.strengths, rows.strengths]),
            packing=np.concatenate([self.packing, packing]),
            values=np.vstack([self.values, rows.values]),
        )

    def late_by(self, emulator: FeatureEmulator) -> np.ndarray:
        """What late readings add to the rows (n, m), by an emulator of features without."""
        x, s = self.scaled()
        lag, late = self.lag, np.zeros_like(self.values)
        for row in np.flatnonzero(lag):
            without = np.where(np.array(self.design.effect_names) == LAG, 0.0, s[row])
            in_time = emulator(x[row], without)[0]
            late[row] = self.reader().shift(in_time[None], lag[[row]])[0]
        return late

    def _without_lag(self) -> "Bank":
        """The rows that are read in time."""
        on = self.lag == 0
        parts = {name: getattr(self, name)[on] for name in ("base", "strengths", "packing")}
        return replace(self, **parts, values=self.values[on], late=None, kernels=())

    def scale(self) -> np.ndarray:
        """By what the emulator warps features, shape (m,)."""
        return np.array([_scale(feature) for feature in self.features])

    def fitted(self) -> "Bank":
        """The bank with its kernels and what they miss; takes minutes."""
        late = self.late_by(self._without_lag().emulator()) if self.lag.any() else None
        bank = replace(self, late=late, kernels=())
        known = replace(bank, kernels=tuple(c.kernel for c in bank.emulator().components))
        points = Points(*bank.scaled(), bank.packing, bank.in_time, bank.scale(), known.kernels)
        return replace(known, missed=missed(points))


SCALES = {"largest force": 100.0, "peak displacement": 1.0}  # by kind, else by unit
SCALE_OF_UNIT = {"mm": 0.2, "N": 20.0}


def _scale(feature: Feature) -> float:
    """Size of a feature below which differences count, and above which ratios do."""
    return SCALES.get(feature.kind, SCALE_OF_UNIT[feature.unit])


def declared(force_high: float) -> tuple[Feature, ...]:
    """The features that a bank keeps."""
    return (*declare(force_high, PEAK_MM, PEAK_N), *declare_targets(TARGETS))


def limits(design: Design) -> np.ndarray:
    """Largest strength of each effect, SI, shape (k,)."""
    return np.array([max(abs(low), abs(high)) for low, high in design.limits.values()])


def curves_of(run: Run) -> Curves:
    """A run's curves as features read them."""
    return {
        "confined": tuple(run.curves["confined"].T),
        "unconfined": tuple(run.curves["unconfined"].T),
    }


def features_of(features: Sequence[Feature], runs: Sequence[Run | None]) -> np.ndarray:
    """Values (n, m) of the features of runs; NaN where one is missing, or the run."""
    values = np.full((len(runs), len(features)), np.nan)
    for row, run in enumerate(runs):
        if run is not None and not run.failure:
            values[row] = vector(features, curves_of(run), run.observables)
    return values


def collect(design: Design, lab: Lab, runs: Sequence[Run | None], reference: Run) -> Bank:
    """The bank of a design's runs (None: not simulated), without failed and incomplete ones."""
    packing = np.repeat(np.arange(design.packings), design.rows_each)
    rows = Rows.of(declared(lab.confined.force_high), *design.rows(), packing, runs)
    return Bank(
        design, Cylinder.of(lab), engine_hash(),
        rows.base, rows.strengths, rows.packing, rows.values, curves_of(reference),
        speed=1e3 * lab.confined.rate,
    )  # fmt: skip


def check_extends(design: Design, lab: Lab, smaller: Bank, file: str) -> None:
    """Refuses to grow a bank of another plan or cylinder."""
    like = replace(design, packings=smaller.design.packings)
    if like != smaller.design or Cylinder.of(lab) != smaller.cylinder:
        problem = "this bank was made for another centre, cylinder or number of spheres"
        raise InputError(file, "design", problem, "give the options that made it, or no --onto")
    if design.packings <= smaller.design.packings:
        problem = f"it has {smaller.design.packings} packings already"
        raise InputError(file, "packings", problem, "ask for more with --packings")


def save(bank: Bank, path: Path) -> None:
    """Writes the bank whole or not at all."""
    data = {
        "base": (("row", "coordinate"), bank.base.astype(np.float32)),
        "strengths": (("row", "effect"), bank.strengths.astype(np.float32)),
        "packing": (("row",), bank.packing.astype(np.int32)),
        "values": (("row", "feature"), bank.values.astype(np.float32)),
    }
    for test, curve in bank.reference.items():
        data[f"reference_{test}"] = ((f"{test}_point", "column"), np.array(curve).T)
    for name in Kernel._fields if bank.kernels else ():
        rows = np.array([np.atleast_1d(getattr(k, name)) for k in bank.kernels])
        data[f"kernel_{name}"] = (("component", f"kernel_{name}_n"), rows)
    if bank.late is not None:
        data["late"] = (("row", "feature"), bank.late.astype(np.float32))
    if bank.missed is not None:
        data["widening"] = (("component",), bank.missed.widening)
        data["scatter"] = (("component",), bank.missed.scatter)
        data["missed_directions"] = (("feature", "missed"), bank.missed.directions)
        data["missed_effect"] = (("missed",), bank.missed.effect)
    names = {
        "coordinate": list(bank.design.base_names),
        "effect": list(bank.design.effect_names),
        "feature": [f.name for f in bank.features],
    }
    about = {"design": asdict(bank.design), "cylinder": asdict(bank.cylinder)}
    attributes = {
        "engine": bank.engine,
        "speed": bank.speed,
        **{k: json.dumps(v) for k, v in about.items()},
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(f".{os.getpid()}.part")
    dataset = xr.Dataset(data, coords=names, attrs=attributes)
    packed = {name: {"zlib": True, "complevel": 6} for name in data}
    dataset.to_netcdf(part, engine=NETCDF, encoding=packed)
    part.replace(path)


def bundled_bank() -> Path:
    """The bank that comes with the package: the bundled soil's tests with 150 spheres."""
    return Path(str(resources.files("calibrate.discrepancy.library") / "data" / "quick.nc"))


def load(path: Path) -> Bank:
    """Reads a bank; `InputError` for anything else."""
    try:
        with xr.open_dataset(path, engine=NETCDF) as stored:
            return _read(stored.load())
    except (OSError, KeyError, ValueError, TypeError) as error:
        problem = f"this is no bank of simulations ({type(error).__name__})"
        raise InputError(
            str(path), "", problem, "give a file that `calibrate bank` wrote"
        ) from None


def _read(stored: xr.Dataset) -> Bank:
    design = json.loads(stored.attrs["design"])
    design["limits"] = {name: tuple(pair) for name, pair in design["limits"].items()}
    reference = {
        test: tuple(stored[f"reference_{test}"].values.T) for test in ("confined", "unconfined")
    }
    return Bank(
        design=Design(**design),
        cylinder=Cylinder(**json.loads(stored.attrs["cylinder"])),
        engine=stored.attrs["engine"],
        base=stored["base"].values.astype(float),
        strengths=stored["strengths"].values.astype(float),
        packing=stored["packing"].values,
        values=stored["values"].values.astype(float),
        reference=reference,
        kernels=_kernels(stored),
        missed=_missed(stored),
        late=stored["late"].values.astype(float) if "late" in stored else None,
        speed=float(stored.attrs.get("speed", Bank.speed)),
    )


def _missed(stored: xr.Dataset) -> Missed | None:
    """What a file says that its emulator misses; None if it was not asked.  Earlier files know
    nothing of effects."""
    if "widening" not in stored:
        return None
    widening, scatter = stored["widening"].values, stored["scatter"].values
    if "missed_effect" not in stored:
        nothing = Missed.nothing(len(widening), stored.sizes["feature"])
        return replace(nothing, widening=widening, scatter=scatter)
    directions, effect = stored["missed_directions"].values, stored["missed_effect"].values
    return Missed(widening, scatter, directions, effect)


def _kernels(stored: xr.Dataset) -> tuple[Kernel, ...]:
    """The fitted kernels of a file; none if it was not fitted."""
    names = [name for name in Kernel._fields if f"kernel_{name}" in stored]
    if not names:
        return ()
    parts = {name: stored[f"kernel_{name}"].values for name in names}
    parts.setdefault("twin", np.full_like(parts["rest"], NO_TWINS))
    scalars = ("curved", "packing", "twin", "rest")
    return tuple(
        Kernel(**{n: v[c, 0] if n in scalars else v[c] for n, v in parts.items()})
        for c in range(len(parts["linear"]))
    )
