"""The file of a library of runs: one NetCDF of about a megabyte, read in seconds.

It says which physics made the runs, for which cylinder and forces, and how far its points reach.
Variables keep the names of the first files: `late` is what the machine adds to the rows, `twin`
the variance of soil blocks, `widening`, `scatter`, `misfit`, `dropped` and `missed_*` the
emulator's errors.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, astuple, replace
from importlib import resources
from pathlib import Path

import numpy as np
import xarray as xr

from calibrate.core.errors import InputError
from calibrate.core.files import whole
from calibrate.discrepancy.library.cross_validation import EmulatorErrors, Split
from calibrate.discrepancy.library.design import SETTINGS, SHAPE, Design
from calibrate.discrepancy.library.kernel import NOTHING, Column
from calibrate.discrepancy.library.run_library import Cylinder, OtherLaw, Rows, RunLibrary
from calibrate.labtests.diagnosis.curves import TESTS
from calibrate.response.machine import LAG
from calibrate.response.mould import Filling
from calibrate.response.process import Kernel
from jdem.materials.conventions import CONVENTIONS
from jdem.physics import PHYSICS

NETCDF = "h5netcdf"
EARLIER = 0  # the physics of files that were made before it had a version
STORED = {"soil_block": "twin"}  # names of kernels' fields in the file, where they differ
MOST_LENGTH = 3.0  # logarithm of a length over which nothing changes
TURN = "by what it shows"  # how the machine of a file presses; earlier files do not say
ONLY_LAG = json.dumps([LAG])  # what earlier files tell of a machine in closed form


def save(library: RunLibrary, path: Path) -> None:
    """Writes the library whole or not at all."""
    data = {
        "base": (("row", "coordinate"), library.base.astype(np.float32)),
        "strengths": (("row", "effect"), library.strengths.astype(np.float32)),
        "packing": (("row",), library.packing.astype(np.int32)),
        "values": (("row", "feature"), library.values.astype(np.float32)),
    }
    for test, curve in library.reference.items():
        data[f"reference_{test}"] = ((f"{test}_point", "column"), np.array(curve).T)
    data.update(_kernel_variables(library.kernels, "component"))
    if library.machine_shift is not None:
        data["late"] = (("row", "feature"), library.machine_shift.astype(np.float32))
    if library.emulator_errors is not None:
        data["widening"] = (("component",), library.emulator_errors.widening)
        data["scatter"] = (("component",), library.emulator_errors.scatter)
        data["misfit"] = (("component",), library.emulator_errors.misfit)
        data["dropped"] = (("split",), np.array(library.emulator_errors.dropped))
        data["missed_directions"] = (("feature", "missed"), library.emulator_errors.directions)
        data["missed_effect"] = (("missed",), library.emulator_errors.effect)
    if library.repeats is not None:
        data["repeats_base"] = (("repeat", "coordinate"), library.repeats.base.astype(np.float32))
        data["repeats_soil"] = (("repeat",), library.repeats.packing.astype(np.int32))
        values = library.repeats.values.astype(np.float32)
        data["repeats_values"] = (("repeat", "feature"), values)
    names = {
        "coordinate": list(library.design.base_names),
        "effect": list(library.design.effect_names),
        "feature": [f.name for f in library.features],
    }
    about = {"design": asdict(library.design), "cylinder": asdict(library.cylinder)}
    attributes = {
        "physics": library.physics,
        "speed": library.speed,
        "crushing_speed": library.crushing_speed,
        "told": json.dumps(library.told),
        "turn": TURN,
        **({"filling": json.dumps(astuple(library.filling))} if library.filling else {}),
        **{k: json.dumps(v) for k, v in about.items()},
    }
    _write(xr.Dataset(data, coords=names, attrs=attributes), path)


def _write(dataset: xr.Dataset, path: Path) -> None:
    packed = {name: {"zlib": True, "complevel": 6} for name in dataset.data_vars}
    with whole(path) as part:
        dataset.to_netcdf(part, engine=NETCDF, encoding=packed)


def _kernel_variables(kernels: Sequence[Kernel], dimension: str) -> dict:
    """The variables of a file that hold kernels; none where there are none."""
    found = {}
    for field in Kernel._fields if kernels else ():
        rows = np.array([np.atleast_1d(getattr(k, field)) for k in kernels])
        name = STORED.get(field, field)
        found[f"kernel_{name}"] = ((dimension, f"kernel_{name}_n"), rows)
    return found


def of_law(library: Path, conventions: str) -> Path:
    """The file beside a library's whose rows follow other conventions."""
    return library.with_suffix(f".{conventions}{library.suffix}")


def save_law(other: OtherLaw, library: RunLibrary, path: Path) -> None:
    """Writes rows that follow other conventions than a library, whole or not at all."""
    data = {
        "base": (("row", "coordinate"), other.rows.base.astype(np.float32)),
        "packing": (("row",), other.rows.packing.astype(np.int32)),
        "values": (("row", "feature"), other.rows.values.astype(np.float32)),
        "axes": (("axis", "feature"), other.axes),
        "deviation": (("axis",), other.deviation),
        "columns": (("component", "hyperparameter"), np.array(other.columns)),
        "widening": (("component",), other.widening),
        **_kernel_variables(other.kernels, "axis"),
    }
    attributes = {"physics": PHYSICS, "beside": _fingerprint(library)}
    names = {"hyperparameter": list(Column._fields)}
    _write(xr.Dataset(data, coords=names, attrs=attributes), path)


def _fingerprint(library: RunLibrary) -> str:
    """Of rows and kernels, on which columns rest."""
    parts = [library.values, *(part for kernel in library.kernels for part in kernel)]
    digest = hashlib.sha256()
    for part in parts:
        digest.update(np.asarray(part, np.float32).tobytes())
    return digest.hexdigest()


def _other_laws(path: Path, library: RunLibrary) -> dict[str, OtherLaw]:
    """What lies beside a library's file, by conventions."""
    files = {name: of_law(path, name) for name in CONVENTIONS}
    return {name: _read_law(file, library) for name, file in files.items() if file.exists()}


def _read_law(path: Path, library: RunLibrary) -> OtherLaw:
    with xr.open_dataset(path, engine=NETCDF) as stored:
        if stored.attrs.get("beside") != _fingerprint(library):
            problem = "it was fitted beside another library, or an earlier state of this one"
            raise InputError(
                str(path),
                "beside",
                problem,
                "delete it, then make it anew with calibrate library --conventions",
            )
        base = stored["base"].values.astype(float)
        none = np.zeros((len(base), len(library.design.limits)))
        values = stored["values"].values.astype(float)
        rows = Rows(base, none, stored["packing"].values, values)
        columns = tuple(Column(*row) for row in stored["columns"].values.tolist())
        along = stored["axes"].values, stored["deviation"].values
        return OtherLaw(rows, *along, _kernels(stored), columns, stored["widening"].values)


def bundled_library() -> Path:
    """The file that comes with the package: the bundled soil's tests, resolved beds."""
    return Path(str(resources.files("calibrate.discrepancy.library") / "data" / "resolved.nc"))


def load(path: Path) -> RunLibrary:
    """Reads a library; `InputError` for anything else."""
    try:
        with xr.open_dataset(path, engine=NETCDF) as stored:
            lacking = set(SETTINGS) - set(SHAPE) - set(stored["coordinate"].values.tolist())
            if lacking:
                problem = f"an earlier version made it: its runs do not state {', '.join(lacking)}"
                raise InputError(str(path), "coordinate", problem, "make it anew")
            if "late" in stored and stored.attrs.get("turn") != TURN:
                problem = "an earlier version fitted it, whose machines all pressed alike"
                raise InputError(str(path), "turn", problem, "make it anew")
            library = _read(_with_shape(stored.load()))
        return replace(library, other_laws=_other_laws(path, library))
    except (OSError, KeyError, ValueError, TypeError) as error:
        problem = f"this is no library of runs ({type(error).__name__})"
        raise InputError(
            str(path), "", problem, "give a file that `calibrate library` wrote"
        ) from None


def _with_shape(stored: xr.Dataset) -> xr.Dataset:
    """A file with the coordinates of shape.  Earlier ones hold specimens of one shape: theirs are
    0, and kernels do not look at them."""
    known = stored["coordinate"].values.tolist()
    if set(SHAPE) <= set(known):
        return stored
    place = known.index(SETTINGS[-1])
    names = [*known[:place], *SHAPE, *known[place:]]
    unseen = {"kernel_linear": NOTHING, "kernel_length": MOST_LENGTH}
    widened = {}
    for name, part in stored.data_vars.items():
        if "coordinate" in part.dims:
            widened[name] = part.reindex(coordinate=names).fillna(0.0)
        elif str(name) in ("kernel_linear", "kernel_length", "kernel_scattering"):
            filled = np.insert(part.values, [place] * len(SHAPE), unseen.get(str(name), 0.0), 1)
            widened[name] = (part.dims, filled)
    return stored.drop_vars([*widened, "coordinate"]).assign(widened)


def _read(stored: xr.Dataset) -> RunLibrary:
    design = json.loads(stored.attrs["design"])
    design["limits"] = {name: tuple(pair) for name, pair in design["limits"].items()}
    design = Design(**design)
    reference = {test: tuple(stored[f"reference_{test}"].values.T) for test in TESTS}
    return RunLibrary(
        design=design,
        cylinder=Cylinder(**json.loads(stored.attrs["cylinder"])),
        physics=int(stored.attrs.get("physics", EARLIER)),
        base=stored["base"].sel(coordinate=list(design.base_names)).values.astype(float),
        strengths=stored["strengths"].values.astype(float),
        packing=stored["packing"].values,
        values=stored["values"].values.astype(float),
        reference=reference,
        kernels=_kernels(stored),
        emulator_errors=_emulator_errors(stored),
        machine_shift=stored["late"].values.astype(float) if "late" in stored else None,
        told=tuple(json.loads(stored.attrs.get("told", ONLY_LAG))),
        filling=_filling(stored),
        speed=float(stored.attrs.get("speed", RunLibrary.speed)),
        crushing_speed=float(stored.attrs.get("crushing_speed", RunLibrary.crushing_speed)),
        repeats=_repeats(stored, design),
    )


def _filling(stored: xr.Dataset) -> Filling | None:
    """How moulds fill, of a file; None where its rows did not tell."""
    known = stored.attrs.get("filling")
    return None if known is None else Filling(*json.loads(known))


def _repeats(stored: xr.Dataset, design: Design) -> Rows | None:
    """Repeats of a file; None in earlier ones."""
    if "repeats_base" not in stored:
        return None
    base = stored["repeats_base"].sel(coordinate=list(design.base_names)).values.astype(float)
    none = np.zeros((len(base), len(design.limits)))
    values = stored["repeats_values"].values.astype(float)
    return Rows(base, none, stored["repeats_soil"].values, values)


def _emulator_errors(stored: xr.Dataset) -> EmulatorErrors | None:
    """The emulator's errors of a file; None if it was not cross-validated.  Earlier files have no
    misfit, or no directions by effect."""
    if "widening" not in stored:
        return None
    widening, scatter = stored["widening"].values, stored["scatter"].values
    found = EmulatorErrors.nothing(len(widening), stored.sizes["feature"])
    found = replace(found, widening=widening, scatter=scatter)
    if "misfit" in stored:
        dropped = Split(*stored["dropped"].values.tolist())
        found = replace(found, misfit=stored["misfit"].values, dropped=dropped)
    if "missed_effect" in stored:
        directions, effect = stored["missed_directions"].values, stored["missed_effect"].values
        found = replace(found, directions=directions, effect=effect)
    return found


def _kernels(stored: xr.Dataset) -> tuple[Kernel, ...]:
    """The fitted kernels of a file; none if it was not fitted."""
    names = {field: f"kernel_{STORED.get(field, field)}" for field in Kernel._fields}
    parts = {field: stored[name].values for field, name in names.items() if name in stored}
    if not parts:
        return ()
    parts.setdefault("soil_block", np.full_like(parts["rest"], NOTHING))
    if "local" not in parts:
        parts["local"] = np.full_like(parts["effect"], NOTHING)
        parts["local_length"] = np.full_like(parts["linear"], MOST_LENGTH)
    if "scattering" not in parts:  # earlier files: with the size of spheres alone
        known = np.zeros((len(parts["rest"]), parts["linear"].shape[1]))
        known[:, -1:] = stored["kernel_coarse"].values
        parts["scattering"] = known
    scalars = ("curved", "packing", "soil_block", "rest")
    return tuple(
        Kernel(**{n: v[c, 0] if n in scalars else v[c] for n, v in parts.items()})
        for c in range(len(parts["linear"]))
    )
