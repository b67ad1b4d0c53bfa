"""What a fit meets and what it misses, number by number.

off = (simulated - measured) / sd,   sd of their difference over the packings of the fit
"""

from textwrap import shorten

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from calibrate.figures.style import DARK, LIGHT, MIDDLE
from calibrate.inference.misfit import WARNED
from calibrate.labtests.composite import label
from calibrate.records.fit import FitRecord

NEAR = 2.0  # deviations within which 19 of 20 numbers lie, where scatter alone is at work
ROW = 0.24  # inches
LONGEST = 60  # characters of a name


def misfit_figure(found: FitRecord) -> Figure:
    """How far each simulated number is from what was measured, in standard deviations of their
    difference; orange where it is more than three, which the fit warns of.

    A number that was not simulated, or whose deviation is not known, is left out.
    """
    every = {n: (f.simulated - f.measured) / f.sd for n, f in found.features.items() if f.sd > 0}
    rows = {name: each for name, each in every.items() if np.isfinite(each)}
    off = np.array(list(rows.values()))
    size = (6.2, 1.6 + ROW * len(rows))
    figure, axis = plt.subplots(figsize=size, layout="constrained")
    axis.axvspan(-NEAR, NEAR, color=LIGHT, alpha=0.4, lw=0, label=f"within {NEAR:g} deviations")
    axis.axvline(0, color="0.6", lw=0.8)
    places = np.arange(len(rows))
    far = np.abs(off) > WARNED
    for those, colour, said in ((~far, DARK, None), (far, MIDDLE, f"beyond {WARNED:g}")):
        axis.hlines(places[those], 0, off[those], color=colour, lw=1.5)
        axis.plot(off[those], places[those], "o", color=colour, label=said if any(those) else None)
    called = [label(name) if name in found.observables else name for name in rows]
    axis.set_yticks(places, [shorten(name, LONGEST).replace("$", r"\$") for name in called])
    axis.set_ylim(len(rows) - 0.4, -0.6)
    axis.set(xlabel="(simulated - measured) / standard deviation of the difference")
    axis.legend(frameon=False, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure
