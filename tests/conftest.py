"""What every test shares: float64, the CPU, one cache of compiled programs, a command line."""

import gc
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
os.environ["XDG_CACHE_HOME"] = str(CACHE.parent)
jax.config.update("jax_compilation_cache_dir", str(CACHE))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
# As the program does (`calibrate.cli`): modules and traced programs are no garbage.
gc.set_threshold(50_000, 20, 20)


def pytest_collection_modifyitems(items):
    """Files that take long are begun first, those that run whole programs before the others, so
    that two workers end at about the same time."""
    long = {
        item.path
        for item in items
        if item.get_closest_marker("slow") or item.get_closest_marker("thorough")
    }
    items.sort(key=lambda item: (item.path not in long, "project" not in item.path.parts))


def pytest_collection_finish():
    gc.freeze()


MOST_MAPS = 30_000  # of memory, of which a system grants a process 65,530


@pytest.fixture(scope="module", autouse=True)
def few_programs():
    """Every compiled program takes maps of memory; a process that has too many ends without a
    word, so it forgets its programs before."""
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()
        gc.collect()


@pytest.fixture
def cheaply_compiled(request):
    """Programs of a quick test are compiled without optimisation, in two thirds of the time: for
    modules whose programs take longer to compile than to run."""
    cheap = not request.node.get_closest_marker("slow")
    jax.config.update("jax_disable_most_optimizations", cheap)
    yield
    jax.config.update("jax_disable_most_optimizations", False)


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
