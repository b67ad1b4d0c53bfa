"""Every figure that this package draws; the only place, with reports, that knows matplotlib.

One file for each kind of work, such as `fit` (simulations, calibrations, audits, contacts), `doe`
(designed experiments) and `bed` (a look inside); all share `style`.
"""

from calibrate.plotting.fit import (
    MARKS,
    RATIOS,
    UNITS,
    audit_figure,
    contact_figure,
    curve_slopes_figure,
    fit_figure,
    simulation_figure,
)
from calibrate.plotting.style import DARK, LIGHT, MIDDLE

__all__ = [
    "DARK",
    "LIGHT",
    "MARKS",
    "MIDDLE",
    "RATIOS",
    "UNITS",
    "audit_figure",
    "contact_figure",
    "curve_slopes_figure",
    "fit_figure",
    "simulation_figure",
]
