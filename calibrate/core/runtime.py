"""How JAX is set up before anything is simulated, and what was typed to start it."""

import os
import sys
from contextvars import ContextVar
from pathlib import Path

COMMAND: ContextVar[str] = ContextVar("command", default="")  # the command line, where there is one


def command() -> str:
    """What was typed, for results: the command line, or the Python program that called."""
    return COMMAND.get() or f"python {Path(sys.argv[0]).name}".rstrip()


def configure() -> None:
    """Double precision, and a compilation cache so that the second start is quick.

    Compiled programs are kept in `differentiable-soil` in the user's cache folder.
    """
    import jax  # a second, which what only asks for help does without

    cache = os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache"))
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_compilation_cache_dir", str(Path(cache) / "differentiable-soil"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)  # dozens of small ones
