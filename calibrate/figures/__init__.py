"""Every figure that this package draws; the only place, with reports, that knows matplotlib.

`panels` fills one axis from a record; `fit`, `audit` and `doe` lay panels out in a file;
`bed` looks inside a specimen; all share `style`.
"""

from calibrate.figures.audit import MARKS, audit_figure, curve_slopes_figure
from calibrate.figures.fit import contact_figure, export_figure, fit_figure, simulation_figure
from calibrate.figures.lab import preview_figure
from calibrate.figures.panels import RATIOS
from calibrate.figures.style import DARK, LIGHT, MIDDLE, Figure, closed, save

__all__ = [
    "DARK",
    "LIGHT",
    "MARKS",
    "MIDDLE",
    "RATIOS",
    "Figure",
    "audit_figure",
    "closed",
    "contact_figure",
    "curve_slopes_figure",
    "export_figure",
    "fit_figure",
    "preview_figure",
    "save",
    "simulation_figure",
]
