"""The gap between simulation and reality: where it lies, what explains it, how far it shrinks."""
