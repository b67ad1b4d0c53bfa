"""Every figure that this package draws; the only place, with reports, that knows matplotlib.

`panels` fills one axis from a record; `fit`, `audit` and `doe` lay panels out in a file;
`bed` looks inside a specimen; all share `style`.  `FIGURES` has the pictures of each verb:
a new one is a function in a file of this folder and its line there.
"""

from collections.abc import Callable

from calibrate.figures.audit import MARKS, audit_figure, curve_slopes_figure
from calibrate.figures.fit import contact_figure, export_figure, fit_figure, simulation_figure
from calibrate.figures.lab import preview_figure
from calibrate.figures.misfit import misfit_figure
from calibrate.figures.panels import RATIOS
from calibrate.figures.style import DARK, LIGHT, MIDDLE, Figure, closed, save

# By verb and by name, the one that `plot()` draws first.  Each is drawn from what the verb's result
# has as `drawn`, and lies in the result's folder as NAME.png.  The page of a fit or an audit shows
# it below the first paragraph of its docstring.
FIGURES: dict[str, dict[str, Callable[..., Figure]]] = {
    "simulate": {
        "curves": simulation_figure,
    },
    "fit": {
        "fit": fit_figure,
        "misfit": misfit_figure,
    },
    "contact": {
        "contact": contact_figure,
    },
    "audit": {
        "audit": audit_figure,
        "audit_curves": curve_slopes_figure,
    },
    "convert": {
        "preview": preview_figure,
    },
}

__all__ = [
    "DARK",
    "FIGURES",
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
