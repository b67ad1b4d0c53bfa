"""calibrate: from laboratory measurements to DEM parameters to an explanation.

Reads lab files, fits the parameters of `jdem`'s virtual tests to them, states which
of them the data can fix, and asks where and why simulation and reality still differ.
"""
