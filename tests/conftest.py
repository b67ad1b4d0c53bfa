"""Settings that every test shares: float64, the CPU, and one cache of compiled programs."""

import os
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")  # read when jax is imported

import jax

jax.config.update("jax_enable_x64", True)
# Test workers share what any of them, now or in an earlier run, has compiled.
jax.config.update("jax_compilation_cache_dir", str(Path(__file__).parents[1] / ".jax_cache"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
