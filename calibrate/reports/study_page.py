"""The report of a study by designed experiments, from its result.json."""

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from calibrate.designs.anova import Anova, anova
from calibrate.designs.comparison import Comparison, MethodResult
from calibrate.designs.diagnostics import box_cox, diagnose, without_profile
from calibrate.designs.screening import Screening
from calibrate.designs.study import SIGNIFICANT
from calibrate.designs.surface import Surface
from calibrate.figures import doe as drawing
from calibrate.figures.style import panel_svg
from calibrate.labtests.composite import described
from calibrate.labtests.composite import label as label_of
from calibrate.records.base import Observable, read
from calibrate.records.study import StudyRecord
from calibrate.reports.html import (
    Page,
    Picture,
    Table,
    number,
    pictures_of,
    quantity,
    render,
    words,
)

RELIEF = (4.6, 4.2)  # inches
ROUNDING = 1e-9  # of the response; smaller residuals are the computer's, and no picture shows them


@dataclass(frozen=True)
class Stage:
    """One designed experiment as the page shows it; pictures stand under their titles."""

    title: str
    sentence: str
    tables: dict[str, Anova]
    pictures: dict[str, list[Picture]]


def page(path: Path) -> Page:
    """The report of the result.json at `path`; `InputError` where it cannot be read."""
    return of(read(path, StudyRecord))


def of(found: StudyRecord) -> Page:
    """The report of a study."""
    compared = found.compared()
    summary = sentence(compared)
    html = render(
        "study.html",
        found=found,
        compared=compared,
        sentence=summary,
        labels={name: label_of(name) for name in found.observables},
        enhanced_of=described(found.goals[-1]),
        last=list(found.stages)[1],
        significant=SIGNIFICANT,
        reached=_reached(found, compared),
        values=_values(found, compared),
        enhanced=_enhanced(compared),
        slopes=[_slopes(compared, name) for name in found.observables],
        endings=[
            *(_endings(found, compared, name) for name in found.goals),
            *pictures_of("doe", found, skipped=1).values(),
        ],
        stages=[
            _screening(found),
            *(_surfaces(found, title) for title in found.stages),
        ],
        settings={
            "packings": ", ".join(map(str, found.seeds)),
            "fresh packings": ", ".join(map(str, found.fresh_seeds)),
        },
    )
    return Page(summary, html)


def sentence(compared: Comparison) -> str:
    """What the comparison says, in words."""
    judged = [pair for pair in compared.slopes if pair.matters]
    agreeing = sum(pair.agree for pair in judged)
    designs, gradients = compared.endings
    return (
        f"Of {len(judged)} slopes that matter, {agreeing} agree between surface and gradient "
        "within their joint 95 % intervals. The designs took "
        f"{designs.simulations} simulations, the gradient fit {gradients.simulations} to its best "
        "point (its slopes and evaluations alone, without the scatter of packings, a choice of "
        "parameters, slopes at the end, profiles and checks of a whole fit)."
    )


def cell(values: np.ndarray, m: int) -> str:
    """Mean of one response over the packings, with the scatter of one."""
    column = values[:, m]
    return f"{np.nanmean(column):.4g} ± {np.nanstd(column, ddof=1):.2g}"


# ---------------------------------------------------------------- tables


def _reached(found: StudyRecord, compared: Comparison) -> Table:
    columns = ["method", "simulations"]
    for name in found.observables:
        columns += [f"{label_of(name)}, fitted packings", f"{label_of(name)}, fresh"]
    rows = [["measured", ""]]
    for name in found.observables:
        target = found.measured.targets.get(name)
        given = f"{number(target.mean, 4)} ± {number(target.scatter, 2)}" if target else "–"
        rows[0] += [given, ""]
    rows += [_ending(ending) for ending in compared.endings]
    return Table(columns, rows)


def _ending(ending: MethodResult) -> list[str]:
    cells = [
        cell(v, m) for m in range(ending.fitted.shape[1]) for v in (ending.fitted, ending.fresh)
    ]
    return [ending.method, str(ending.simulations), *cells]


def _values(found: StudyRecord, compared: Comparison) -> Table:
    rows = [
        [words(name), *(quantity(name, ending.values[name]) for ending in compared.endings)]
        for name in found.optimum
    ]
    return Table(["parameter", *(ending.method for ending in compared.endings)], rows)


def _enhanced(compared: Comparison) -> Table:
    rows = [
        [f"{row.points} points", *map(_error, (row.values_only, row.with_gradient))]
        for row in compared.enhanced
    ]
    return Table(["", "values alone", "with the gradient at the centre"], rows)


def _error(value: float) -> str:
    return "not fixed" if np.isnan(value) else number(value, 3)


# ---------------------------------------------------------------- pictures


def _slopes(compared: Comparison, observable: Observable) -> Picture:
    pairs = [pair for pair in compared.slopes if pair.observable == observable]
    judged = [pair for pair in pairs if pair.matters]
    agreeing = sum(pair.agree for pair in judged)
    label = label_of(observable)
    return Picture(
        panel_svg(lambda axis: drawing.slopes(axis, pairs, label)),
        f"Slopes of {label} by surface against gradient: {agreeing} of {len(judged)} that matter "
        "agree.",
        f"Slopes of {label} with 95 % intervals. Filled: matters at 5 %. Crossed: the joint "
        "interval excludes equality.",
    )


def _endings(found: StudyRecord, compared: Comparison, observable: Observable) -> Picture:
    column, label = found.observables.index(observable), label_of(observable)
    target = found.measured.targets[observable]
    ends = "; ".join(
        f"{e.method}: {cell(e.fitted, column)} fitted, {cell(e.fresh, column)} fresh"
        for e in compared.endings
    )
    return Picture(
        panel_svg(lambda axis: drawing.endings(axis, compared.endings, target, column, label)),
        f"{label} where each method ended. {ends}.",
        "Points: packings. Bars: their means. Band: measured ± scatter.",
    )


def _screening(found: StudyRecord) -> Stage:
    screens = found.screens()
    pictures = {
        f"Effects on {label_of(name)}": _effects(s, label_of(name)) for name, s in screens.items()
    }
    ranked = {name: _ranked(screened) for name, screened in screens.items()}
    listed = "; ".join(f"{label_of(name)}: {text}" for name, text in ranked.items())
    return Stage("screening", f"Largest contributions. {listed}.", {}, pictures)


def _ranked(found: Screening) -> str:
    return ", ".join(
        f"{words(e.name)} {e.contribution:.0f} %"
        + ("" if e.p < SIGNIFICANT else " (not significant)")
        for e in found.ranked()[:4]
    )


def _effects(found: Screening, label: str) -> list[Picture]:
    return [
        Picture(
            panel_svg(lambda axis: drawing.pareto(axis, found, label)),
            f"Pareto chart of effects on {label}. Largest: {_ranked(found)}.",
            "Shares of the total variation.",
        ),
        Picture(
            panel_svg(lambda axis: drawing.half_normal(axis, found, label)),
            f"Half-normal plot of effects on {label}.",
            "Squares: significant at 5 % one at a time. Hollow: dummies.",
        ),
    ]


def _surfaces(found: StudyRecord, title: str) -> Stage:
    stage, experiment = found.stages[title], found.experiment(title)
    whole = found.surfaces(title)
    pictures: dict[str, list[Picture]] = {}
    for name, surface in whole.items():
        if len(experiment.design.factors) > 1:
            pictures[f"Surface of {label_of(name)}"] = _surface(surface, experiment, label_of(name))
        if np.std(surface.y - surface(surface.X)) > ROUNDING * np.abs(surface.y).max():
            pictures[f"Residuals of {label_of(name)}"] = _residuals(surface, label_of(name))
    best = ", ".join(f"{words(name)} {quantity(name, v)}" for name, v in stage.optimum.items())
    text = (
        f"{experiment.design.kind}, {len(experiment.design)} points on {experiment.packings} "
        f"packings. Optimum: {best} (desirability {stage.desirability:.2f})."
    )
    return Stage(title, text, {label_of(n): anova(s) for n, s in whole.items()}, pictures)


def _surface(surface: Surface, experiment, label: str) -> list[Picture]:
    """Contours and relief over every pair of factors."""
    factors, pictures = experiment.design.factors, []
    for pair in combinations(range(len(factors)), 2):
        view = drawing.View(surface, factors, label, pair)
        names = " and ".join(words(factors[j].name) for j in pair)
        height = view.grid()[2]
        reach = f"{number(height.min(), 3)} to {number(height.max(), 3)}"
        pictures += [
            Picture(
                panel_svg(lambda axis, view=view: drawing.contour(axis, view)),
                f"Contours of {label} over {names}: {reach}.",
                "Dots: points of the design, other factors at any level.",
            ),
            Picture(
                panel_svg(lambda axis, view=view: drawing.relief(axis, view), RELIEF, "3d"),
                f"The same surface in three dimensions over {names}.",
                f"{label} over {names}.",
            ),
        ]
    return pictures


def _residuals(surface: Surface, label: str) -> list[Picture]:
    found = diagnose(surface)
    drawn = [
        (lambda axis: drawing.normal_plot(axis, found), "Normal plot of residuals"),
        (
            lambda axis: drawing.residuals_against_predicted(axis, found, label),
            "Residuals against predictions",
        ),
        (lambda axis: drawing.cooks_distances(axis, found), "Cook's distances"),
    ]
    if not without_profile(surface):
        profile = box_cox(surface)
        drawn.append((lambda axis: drawing.box_cox_profile(axis, profile), "Box-Cox profile"))
    return [Picture(panel_svg(draw), f"{name}, {label}.", name) for draw, name in drawn]
