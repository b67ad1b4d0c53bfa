"""Every figure that this package draws; the only place, with reports, that knows matplotlib.

`panels` fills one axis from a record; `fit`, `audit` and `doe` lay panels out in a file;
`bed` looks inside a specimen; all share `style`.
"""

from calibrate.figures.audit import MARKS, audit_figure, curve_slopes_figure
from calibrate.figures.fit import contact_figure, fit_figure, simulation_figure
from calibrate.figures.panels import RATIOS
from calibrate.figures.style import DARK, LIGHT, MIDDLE

__all__ = [
    "DARK",
    "LIGHT",
    "MARKS",
    "MIDDLE",
    "RATIOS",
    "audit_figure",
    "contact_figure",
    "curve_slopes_figure",
    "fit_figure",
    "simulation_figure",
]
