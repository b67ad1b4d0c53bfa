"""The file of a library of runs: one NetCDF of about a megabyte, read in seconds.

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
from typing import NamedTuple

import h5py
import numpy as np

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

EARLIER = 0  # the physics of files that were made before it had a version
ROWS = ("base", "packing", "values")  # of the file, of each kind of rows
REPEATS = ("repeats_base", "repeats_soil", "repeats_values")
STORED = {"soil_block": "twin"}  # names of kernels' fields in the file, where they differ
MOST_LENGTH = 3.0  # logarithm of a length over which nothing changes
TURN = "by what it shows"  # how the machine of a file presses; earlier files do not say
ONLY_LAG = json.dumps([LAG])  # what earlier files tell of a machine in closed form


def save(library: RunLibrary, path: Path) -> None:
    """Writes the library whole or not at all."""
    data = _row_variables(library.rows)
    data["strengths"] = (("row", "effect"), library.rows.strengths.astype(np.float32))
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
        data |= _row_variables(library.repeats, "repeat", REPEATS)
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
    _write(path, data, names, attributes)


def _row_variables(rows: Rows, of: str = "row", names: Sequence[str] = ROWS) -> dict:
    """The variables of a file that hold base coordinates, packings and values of rows."""
    base, packing, values = names
    return {
        base: ((of, "coordinate"), rows.base.astype(np.float32)),
        packing: ((of,), rows.packing.astype(np.int32)),
        values: ((of, "feature"), rows.values.astype(np.float32)),
    }


def _write(path: Path, data: dict, names: dict, attributes: dict) -> None:
    from xarray import Dataset  # a second, which reading does without

    dataset = Dataset(data, coords=names, attrs=attributes)
    tight = {"zlib": True, "complevel": 9, "shuffle": True}
    packed = {name: tight for name in dataset.data_vars}
    with whole(path) as part:
        dataset.to_netcdf(part, engine="h5netcdf", encoding=packed)


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
        **_row_variables(other.rows),
        "axes": (("axis", "feature"), other.axes),
        "deviation": (("axis",), other.deviation),
        "columns": (("component", "hyperparameter"), np.array(other.columns)),
        "widening": (("component",), other.widening),
        **_kernel_variables(other.kernels, "axis"),
    }
    attributes = {"physics": PHYSICS, "beside": _fingerprint(library)}
    names = {"hyperparameter": list(Column._fields)}
    _write(path, data, names, attributes)


def _fingerprint(library: RunLibrary) -> str:
    """Of rows and kernels, on which columns rest."""
    parts = [library.rows.values, *(part for kernel in library.kernels for part in kernel)]
    digest = hashlib.sha256()
    for part in parts:
        digest.update(np.asarray(part, np.float32).tobytes())
    return digest.hexdigest()


def _other_laws(path: Path, library: RunLibrary) -> dict[str, OtherLaw]:
    """What lies beside a library's file, by conventions."""
    files = {name: of_law(path, name) for name in CONVENTIONS}
    return {name: _read_law(file, library) for name, file in files.items() if file.exists()}


class Stored(NamedTuple):
    """A file's arrays by name, and its attributes."""

    arrays: dict[str, np.ndarray]
    attrs: dict

    @staticmethod
    def of(path: Path) -> "Stored":
        """By HDF5 itself, which takes 0.1 s; xarray takes 3 s to load and read."""
        with h5py.File(path) as file:
            arrays = {name: each[()] for name, each in file.items()}
            attrs = {name: v[0] if np.shape(v) else v for name, v in file.attrs.items()}
            return Stored(arrays, attrs)

    def names(self, of: str) -> list[str]:
        """The texts that are stored under a name."""
        return [each.decode("utf-8") for each in self.arrays[of]]

    def columns(self, of: str, names: Sequence[str]) -> np.ndarray:
        """An array's columns (n, p) by the names of coordinates."""
        known = self.names("coordinate")
        return self.arrays[of][:, [known.index(name) for name in names]].astype(float)


def _read_law(path: Path, library: RunLibrary) -> OtherLaw:
    stored = Stored.of(path)
    if stored.attrs.get("beside") != _fingerprint(library):
        problem = "it was fitted beside another library, or an earlier state of this one"
        repair = "delete it, then make it anew with calibrate library --conventions"
        raise InputError(str(path), "beside", problem, repair)
    known = stored.arrays
    base, values = known["base"].astype(float), known["values"].astype(float)
    none = np.zeros((len(base), len(library.design.limits)))
    rows = Rows(base, none, known["packing"], values)
    columns = tuple(Column(*row) for row in known["columns"].tolist())
    along = known["axes"], known["deviation"]
    return OtherLaw(rows, *along, _kernels(known), columns, known["widening"])


def bundled_library() -> Path:
    """The file that comes with the package: the bundled soil's tests, resolved beds."""
    return Path(str(resources.files("calibrate.discrepancy.library") / "data" / "resolved.nc"))


def load(path: Path) -> RunLibrary:
    """Reads a library; `InputError` for anything else."""
    try:
        stored = Stored.of(path)
        lacking = set(SETTINGS) - set(SHAPE) - set(stored.names("coordinate"))
        if lacking:
            problem = f"an earlier version made it: its runs do not state {', '.join(lacking)}"
            raise InputError(str(path), "coordinate", problem, "make it anew")
        if "late" in stored.arrays and stored.attrs.get("turn") != TURN:
            problem = "an earlier version fitted it, whose machines all pressed alike"
            raise InputError(str(path), "turn", problem, "make it anew")
        library = _read(_with_shape(stored))
        return replace(library, other_laws=_other_laws(path, library))
    except (OSError, KeyError, ValueError, TypeError) as error:
        problem = f"this is no library of runs ({type(error).__name__})"
        raise InputError(
            str(path), "", problem, "give a file that `calibrate library` wrote"
        ) from None


def _with_shape(stored: Stored) -> Stored:
    """A file with the coordinates of shape; in earlier ones, whose specimens have one shape, these
    are 0, and kernels do not look at them."""
    known = stored.names("coordinate")
    if set(SHAPE) <= set(known):
        return stored
    place = known.index(SETTINGS[-1])
    names = [*known[:place], *SHAPE, *known[place:]]
    filled = {
        "base": 0.0, "repeats_base": 0.0, "kernel_linear": NOTHING,
        "kernel_length": MOST_LENGTH, "kernel_scattering": 0.0,
    }  # fmt: skip
    widened = {
        name: np.insert(stored.arrays[name], [place] * len(SHAPE), value, 1)
        for name, value in filled.items()
        if name in stored.arrays
    }
    coordinate = np.array([name.encode("utf-8") for name in names], object)
    return Stored({**stored.arrays, **widened, "coordinate": coordinate}, stored.attrs)


def _read(stored: Stored) -> RunLibrary:
    known, attrs = stored
    design = json.loads(attrs["design"])
    design["limits"] = {name: tuple(pair) for name, pair in design["limits"].items()}
    design = Design(**design)
    filling = attrs.get("filling")
    return RunLibrary(
        design=design,
        cylinder=Cylinder(**json.loads(attrs["cylinder"])),
        physics=int(attrs.get("physics", EARLIER)),
        rows=replace(_rows(stored, design, ROWS), strengths=known["strengths"].astype(float)),
        reference={test: tuple(known[f"reference_{test}"].T) for test in TESTS},
        kernels=_kernels(known),
        emulator_errors=_emulator_errors(known),
        machine_shift=known["late"].astype(float) if "late" in known else None,
        told=tuple(json.loads(attrs.get("told", ONLY_LAG))),
        filling=None if filling is None else Filling(*json.loads(filling)),
        speed=float(attrs.get("speed", RunLibrary.speed)),
        crushing_speed=float(attrs.get("crushing_speed", RunLibrary.crushing_speed)),
        repeats=_rows(stored, design, REPEATS) if REPEATS[0] in known else None,  # else earlier
    )


def _rows(stored: Stored, design: Design, names: Sequence[str]) -> Rows:
    """Rows of a file, without effects."""
    base, (_, packing, values) = stored.columns(names[0], design.base_names), names
    none = np.zeros((len(base), len(design.limits)))
    return Rows(base, none, stored.arrays[packing], stored.arrays[values].astype(float))


def _emulator_errors(known: dict[str, np.ndarray]) -> EmulatorErrors | None:
    """The emulator's errors of a file, if any; earlier ones have no misfit, or no directions."""
    if "widening" not in known:
        return None
    widening, scatter = known["widening"], known["scatter"]
    found = EmulatorErrors.nothing(len(widening), len(known["feature"]))
    found = replace(found, widening=widening, scatter=scatter)
    if "misfit" in known:
        dropped = Split(*known["dropped"].tolist())
        found = replace(found, misfit=known["misfit"], dropped=dropped)
    if "missed_effect" in known:
        directions, effect = known["missed_directions"], known["missed_effect"]
        found = replace(found, directions=directions, effect=effect)
    return found


def _kernels(known: dict[str, np.ndarray]) -> tuple[Kernel, ...]:
    """The fitted kernels of a file; none if it was not fitted."""
    names = {field: f"kernel_{STORED.get(field, field)}" for field in Kernel._fields}
    parts = {field: known[name] for field, name in names.items() if name in known}
    if not parts:
        return ()
    parts.setdefault("soil_block", np.full_like(parts["rest"], NOTHING))
    if "local" not in parts:
        parts["local"] = np.full_like(parts["effect"], NOTHING)
        parts["local_length"] = np.full_like(parts["linear"], MOST_LENGTH)
    if "scattering" not in parts:  # earlier files: with the size of spheres alone
        by_size = np.zeros((len(parts["rest"]), parts["linear"].shape[1]))
        by_size[:, -1:] = known["kernel_coarse"]
        parts["scattering"] = by_size
    scalars = ("curved", "packing", "soil_block", "rest")
    return tuple(
        Kernel(**{n: v[c, 0] if n in scalars else v[c] for n, v in parts.items()})
        for c in range(len(parts["linear"]))
    )
