"""What made a result: command, versions, and the hash of the simulator."""

import platform
import shlex
import sys
from importlib import metadata

from calibrate.simulation.keys import engine_hash


def made_by() -> dict:
    """What made a result: command, versions, hash of the source of the plain virtual laboratory."""
    packages = ("differentiable-soil", "jax", "equinox", "optimistix", "numpy")
    return {
        "command": shlex.join(["calibrate", *sys.argv[1:]]),
        "versions": {
            "python": platform.python_version(),
            **{name: metadata.version(name) for name in packages},
        },
        "engine": engine_hash(),
    }
