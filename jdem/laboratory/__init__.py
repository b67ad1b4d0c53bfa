"""The virtual laboratory: tests, effects and numerics around one specimen."""
