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
# Test workers share what any of them, now or in an earlier run, has compiled.
jax.config.update("jax_compilation_cache_dir", str(Path(__file__).parents[1] / ".jax_cache"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)

# Modules that take longer than some eight seconds on one core; `make check` leaves them out.
THOROUGH = {
    *("abuse", "campaign", "cluster", "diagnose_verb", "effects", "engine", "fit"),
    *("lab", "laws", "laws_contract", "machine_abuse", "notebooks", "report", "sensitivity"),
    *("smooth", "study", "view", "virtual_power"),
}


def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.stem.removeprefix("test_") in THOROUGH:
            item.add_marker(pytest.mark.thorough)


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
    monkeypatch.setattr(cli, "_configure_jax", lambda: None)
    return command_line
