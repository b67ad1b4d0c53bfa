"""How JAX is set up before anything is simulated: by the command line and in a notebook."""

import os
from pathlib import Path

import jax


def configure() -> None:
    """Double precision, and a compilation cache so that the second start is quick.

    Compiled programs are kept in `differentiable-soil` in the user's cache folder.
    """
    cache = os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache"))
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_compilation_cache_dir", str(Path(cache) / "differentiable-soil"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)  # dozens of small ones
