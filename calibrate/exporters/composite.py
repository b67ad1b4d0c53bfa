"""All programs that parameters are exported to, by the name of `--to`.

An exporter is one module: `NAME` of the program as a user gives it, `FILE` that is written by
default, and `text(found) -> str`.  A new one is one file and one line here.
"""

from calibrate.exporters import edem, liggghts, parameters_json, table, yade

EXPORTERS = {each.NAME: each for each in (liggghts, edem, yade, table, parameters_json)}
NAMES = ", ".join(EXPORTERS)
