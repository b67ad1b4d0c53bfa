"""What every part of the simulator stands on: vectors, quantities, rounding, compiled kernels."""
