"""Every figure that this package draws; the only place, with reports, that knows matplotlib.

`FIGURES` has the pictures of each verb: a new one is a function in a file of this folder and its
line there.  `panels` fills one axis from a record; `fit`, `audit` and `doe` lay panels out in a
file; `bed` looks inside a specimen; all share `style`.
"""

from collections.abc import Callable
from pkgutil import resolve_name
from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from calibrate.figures.style import Figure, closed, save

# matplotlib takes a second to load, which what draws nothing does without
__getattr__, _, _ = lazy_loader.attach(
    __name__, submod_attrs={"style": ["Figure", "closed", "save"]}
)

# By verb and by name, file and function; the one that `plot()` draws first stands first.  Each is
# drawn from what the verb's result has as `drawn`; where that has nothing for it, the function
# returns None.  Pages show a new one below the first paragraph of its docstring.
FIGURES: dict[str, dict[str, str]] = {
    "simulate": {
        "curves": "fit:simulation_figure",
    },
    "fit": {
        "fit": "fit:fit_figure",
        "misfit": "misfit:misfit_figure",
    },
    "posterior": {
        "posterior": "posterior:posterior_figure",
    },
    "predict": {
        "prediction": "posterior:prediction_figure",
    },
    "contact": {
        "contact": "fit:contact_figure",
    },
    "audit": {
        "audit": "audit:audit_figure",
        "audit_curves": "audit:curve_slopes_figure",
    },
    "doe": {
        "study": "doe:study_figure",
    },
    "convert": {
        "preview": "lab:preview_figure",
    },
    "diagnose": {
        "where_confined": "diagnosis:confined_figure",
        "where_unconfined": "diagnosis:unconfined_figure",
        "probability": "diagnosis:probability_figure",
        "effects": "diagnosis:effects_figure",
        "next_test": "diagnosis:proposed_figure",
    },
    "next": {
        "next_test": "diagnosis:next_figure",
    },
    "export": {
        "export": "fit:export_figure",
    },
    "view": {
        "bed": "bed:bed_figure",
    },
}


def functions(verb: str) -> dict[str, Callable[..., "Figure | None"]]:
    """The functions that draw a verb's figures, by name; only their files are loaded."""
    return {name: resolve_name(f"{__name__}.{of}") for name, of in FIGURES[verb].items()}


__all__ = ["FIGURES", "Figure", "closed", "functions", "save"]
