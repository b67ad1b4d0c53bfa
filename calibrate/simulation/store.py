"""The cache on disk: packings/ and runs/ by content, every entry whole, checked and written once.

Runs are NetCDF, packings .npz, both with a seal at the end, so that damage is noticed before
anything parses the bytes:

    content, newline, "sha256 ", 64 hexadecimal digits, newline

HDF5 and zip files may be followed by further bytes, so a sealed file opens as it is.  An entry is
written beside its place and renamed into it.  While an entry is made its lock in claims/ is
held; the operating system frees it when the process dies, so no claim outlives its owner.

Beds of the bundled soils ship with the package, so that a first simulation need not settle
its own, and so that everybody's are the same.
"""

import errno
import hashlib
import io
import time
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import h5py
import numpy as np
from filelock import BaseFileLock, FileLock, Timeout

from calibrate.core.errors import CalibrationError
from calibrate.core.files import whole, write_bytes
from calibrate.simulation.run import Run
from jdem.packing.specimen import Packing, load, save

NETCDF = "h5netcdf"
BESIDE = "|"  # between the names of a test and of what it records; no name of a test has it
OBSERVED = "observable "  # before the names of observables among an entry's attributes
POLL = 0.2  # s between looks at a lock that another process holds
ABANDONED = 3600.0  # s; a part file older than this has no writer any more
MARK = b"\nsha256 "
LENGTH = len(MARK) + 64 + 1  # of a seal


def sealed(content: bytes) -> bytes:
    """The content with its seal."""
    return content + MARK + hashlib.sha256(content).hexdigest().encode() + b"\n"


def unsealed(data: bytes) -> tuple[bytes, bool]:
    """The content, and whether a seal was there; ValueError where it is broken."""
    content, seal = data[:-LENGTH], data[-LENGTH:]
    if not seal.startswith(MARK):
        return data, False
    if sealed(content) != data:
        raise ValueError("the checksum does not fit the content")
    return content, True


@dataclass(frozen=True)
class Store:
    """The entries below one folder; nothing is created before something is kept."""

    folder: Path

    def packing_path(self, name: str) -> Path:
        return self.folder / "packings" / f"{name}.npz"

    def run_path(self, key: str) -> Path:
        return self.folder / "runs" / f"{key}.nc"

    def packing(self, name: str) -> Packing | None:
        """The packing of this name; None where there is none or its file is damaged."""
        try:
            return _packing_of(self.packing_path(name).read_bytes())
        except OSError:
            return None

    def run(self, key: str) -> Run | None:
        """The run of this key; None where there is none or its file is damaged."""
        path = self.run_path(key)
        if not path.exists():
            return None
        try:
            return _run_of(*unsealed(path.read_bytes()))
        except Exception:  # nor is what an HDF5 reader raises
            return None

    def keep_packing(self, name: str, packing: Packing) -> None:
        path = self.packing_path(name)
        with _explained(self.folder), whole(path) as part:
            save(packing, part)
            part.write_bytes(sealed(part.read_bytes()))

    def keep_run(self, key: str, run: Run) -> None:
        with _explained(self.folder):
            write_bytes(self.run_path(key), sealed(_bytes_of(run)))

    @contextmanager
    def claim(self, name: str, patient: bool) -> Iterator[bool]:
        """Whether the entry `name` is ours to make; with `patient`, waits until it is.

        While it is, nobody else in this or another process makes it, unless the file system
        has no locks: then it is made twice at worst, and both are whole.
        """
        path = self.folder / "claims" / f"{name}.lock"
        lock = FileLock(path, timeout=-1 if patient else 0, thread_local=False)
        with _explained(self.folder):
            path.parent.mkdir(parents=True, exist_ok=True)
            ours = _acquired(lock)
        try:
            yield ours
        finally:
            if lock.is_locked:
                path.unlink(missing_ok=True)  # while it is held: who waits opens a new one
                lock.release()

    def sweep(self) -> None:
        """Removes part files that a killed process left behind."""
        for path in self.folder.glob("*/*.part*"):
            try:
                if time.time() - path.stat().st_mtime > ABANDONED:
                    path.unlink()
            except OSError:  # somebody else was quicker, or may not
                continue


@dataclass(frozen=True)
class Archive:
    """Packings in one file, each sealed as in a folder."""

    path: Path

    def names(self) -> list[str]:
        return list(self.content())

    def packing(self, name: str) -> Packing | None:
        """The packing of this name; None where there is none or it is damaged."""
        try:
            with zipfile.ZipFile(self.path) as every:
                return _packing_of(every.read(name))
        except (KeyError, OSError, zipfile.BadZipFile):
            return None

    def content(self) -> dict[str, bytes]:
        """Sealed packings by name."""
        with zipfile.ZipFile(self.path) as every:
            return {name: every.read(name) for name in every.namelist()}

    def keep(self, content: Mapping[str, bytes]) -> None:
        """Writes these packings and no other; equal content is an equal file."""
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w") as file:
            for name, data in sorted(content.items()):
                file.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_LZMA)
        write_bytes(self.path, packed.getvalue())


SHIPPED = Archive(Path(str(resources.files("calibrate.simulation"))) / "beds.zip")


def _packing_of(data: bytes) -> Packing | None:
    """The packing of an entry; None where it is damaged."""
    try:
        return load(io.BytesIO(unsealed(data)[0]))
    except Exception:  # what a zip reader raises on damaged bytes is not a closed list
        return None


def _acquired(lock: BaseFileLock) -> bool:
    """Whether nobody else holds the lock; True too where there are no locks."""
    try:
        lock.acquire(poll_interval=POLL)
    except Timeout:
        return False
    except OSError as error:
        if error.errno not in (errno.ENOLCK, errno.EOPNOTSUPP):
            raise
    return True


@contextmanager
def _explained(folder: Path) -> Iterator[None]:
    """Turns what the file system refuses into one sentence."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise CalibrationError(
            f"{folder}: {reason}; make room or give another --out, then the same command goes on "
            "from what is kept"
        ) from None


def _bytes_of(run: Run) -> bytes:
    import xarray as xr  # a second, which what simulates nothing does without

    curves = {name: ((f"{name}_point", "column"), curve) for name, curve in run.curves.items()}
    beside = {
        f"{name}{BESIDE}{channel}": ((f"{name}_point",), values)
        for name, found in run.channels.items()
        for channel, values in found.items()
    }
    data = xr.Dataset(
        curves | beside,
        coords={"column": ["displacement_mm", "force_n"]},
        attrs={
            **{f"{OBSERVED}{name}": value for name, value in run.observables.items()},
            **run.quality,
            "failure": run.failure,
            "sealed": 1.0,
        },
    )
    return bytes(data.to_netcdf(engine=NETCDF))


def _run_of(content: bytes, had_seal: bool) -> Run:
    """What `_bytes_of` wrote.  Entries made before there were seals do not ask for one."""
    import xarray as xr

    with h5py.File(io.BytesIO(content)):
        pass  # what HDF5 cannot open makes h5netcdf complain on standard error
    with xr.open_dataset(io.BytesIO(content), engine=NETCDF) as data:
        attributes = {str(k): v for k, v in data.attrs.items()}
        stored = {str(name): np.array(values.values) for name, values in data.items()}
    if attributes.pop("sealed", 0.0) and not had_seal:
        raise ValueError("the seal is gone")
    failure = str(attributes.pop("failure"))
    observed = [name for name in attributes if name.startswith(OBSERVED)]
    observables = {n.removeprefix(OBSERVED): float(attributes.pop(n)) for n in observed}
    quality = {name: float(value) for name, value in attributes.items()}
    curves = {name: values for name, values in stored.items() if BESIDE not in name}
    channels: dict[str, dict[str, np.ndarray]] = {}
    for name, values in stored.items():
        test, there, channel = name.partition(BESIDE)
        if there:
            channels.setdefault(test, {})[channel] = values
    return Run(observables, curves, quality, failure, channels)
