"""What every test shares: float64, the CPU, one cache of compiled programs, a command line."""

import os
import sys
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")  # read when jax is imported

import jax
import pytest
from hypothesis import settings

from calibrate import cli

jax.config.update("jax_enable_x64", True)
# The first example of a property compiles; how long that takes says nothing about the property.
settings.register_profile("compiling", deadline=None)
settings.load_profile("compiling")
# Test workers, processes that tests start and kernels of notebooks (`calibrate.core.runtime`)
# share what any of them, now or in an earlier run, has compiled, however small.
CACHE = Path(__file__).parents[1] / ".jax_cache" / "differentiable-soil"
jax.config.update("jax_compilation_cache_dir", str(CACHE))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)

# Modules that take longer than some eight seconds on one core, the longest first.  They are begun
# in this order, so that two workers end at about the same time; `make check` leaves them out.
THOROUGH = (
    *("notebooks", "overdamped", "lab", "fit", "effects", "cluster", "report", "virtual_power"),
    *("first_order", "tangent_kernel", "engine"),
    *("laws_contract", "laws", "view", "abuse", "study"),
    *("physics", "protocol", "machine_abuse", "boundaries", "beds", "diagnose_verb", "added_tests"),
    *("sphere_indenter", "neighbour_lists", "liggghts", "campaign", "laws_friction"),
    *("sensitivity", "smooth", "machine_alone"),
)

# Fixtures that take longer than ten seconds on one core, by module: what asks for one is slow.
SLOW = {"lab": "outcome", "protocol": "outcome", "beds": "grown", "report": "folders"}


def pytest_collection_modifyitems(items):
    place = {f"test_{name}": number for number, name in enumerate(THOROUGH)}
    items.sort(key=lambda item: place.get(item.path.stem, len(place)))
    for item in items:
        if item.path.stem in place:
            item.add_marker(pytest.mark.thorough)
        if SLOW.get(item.path.stem.removeprefix("test_")) in item.fixturenames:
            item.add_marker(pytest.mark.slow)


@pytest.fixture
def command_line(monkeypatch, tmp_path, capfd):
    """Runs a command line in tmp_path as the console script does, JAX's settings included;
    returns exit status, standard output and error."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["calibrate", *map(str, arguments)])
        try:
            cli.main()
            status = 0
        except SystemExit as end:
            status = end.code or 0
        return status, *capfd.readouterr()

    return call


@pytest.fixture
def calibrate(command_line, monkeypatch):
    """The same with JAX as it is set above."""
    monkeypatch.setattr(cli, "_configure", lambda: None)
    return command_line
