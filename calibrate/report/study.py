"""A study by designed experiments as JSON, run sheets, figures, an HTML page, and a summary."""

import csv
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from calibrate.designed import Designed
from calibrate.doe.anova import Anova, anova
from calibrate.doe.comparison import Comparison, Ending
from calibrate.doe.study import OBSERVABLES, SIGNIFICANT, Experiment, Study, Surfaces
from calibrate.measurements import Lab
from calibrate.output import Session, origin_of, write_json, write_text
from calibrate.plotting.doe import residual_figure, screening_figure, surface_figure
from calibrate.plotting.study import LABELS, endings_figure, slopes_figure
from calibrate.report.html import Picture, number, render

PAGE = "study.html"
SHORT = {"depression_depth_mm": "H", "crushing_force_n": "F"}


@dataclass(frozen=True)
class Stage:
    """One designed experiment as the page shows it."""

    title: str
    sentence: str
    tables: dict[str, Anova]
    pictures: list[Picture]


def write(session: Session, found: Designed, path: Path | None) -> None:
    """result.json (and `--json`), one CSV a design, figures/ and study.html in `session.out`."""
    lab, out, done, compared = session.lab, session.out, found.study, found.comparison
    origin = {**origin_of(session), "seeds": list(found.seeds), "fresh_seeds": list(found.fresh)}
    content = {**origin, **as_json(done, compared)}
    write_json(out / "result.json", content)
    if path is not None:
        write_json(path, content)
    for experiment in done.experiments:
        _write_sheet(experiment, out / f"{experiment.title}.csv")
    figures = out / "figures"
    figures.mkdir(exist_ok=True)
    page = render(
        PAGE,
        lab=lab,
        origin=origin,
        done=done,
        compared=compared,
        targets={name: lab.targets[name] for name in OBSERVABLES},
        labels=LABELS,
        verdict=sentence(done, compared),
        slopes=_slopes_picture(compared, figures),
        endings=_endings_picture(compared, lab, figures),
        stages=[_screening(done, figures)]
        + [_surfaces(stage, figures) for stage in (done.depth, done.force, done.refinement)],
        significant=SIGNIFICANT,
        cell=_cell,
    )
    write_text(out / PAGE, page)


def as_json(done: Study, compared: Comparison) -> dict:
    """Designs with responses, effects, surfaces, the optimum, and the comparison."""
    return {
        "screening": {
            "effects": {name: [asdict(e) for e in found.effects]
                        for name, found in done.screens.items()},
        },
        **{stage.experiment.title: _stage_json(stage)
           for stage in (done.depth, done.force, done.refinement)},
        "optimum": done.values,
        "simulations": done.simulations,
        "comparison": {
            "slopes": [{**asdict(pair), "agree": pair.agree, "reach": pair.reach, "why": pair.why()}
                       for pair in compared.slopes],
            "endings": [_ending_json(ending) for ending in compared.endings],
            "enhanced": [asdict(row) for row in compared.enhanced],
            "gradient_runs": compared.gradient_runs,
        },
        "designs": {
            experiment.title: {
                "kind": experiment.design.kind,
                "factors": [asdict(factor) for factor in experiment.design.factors],
                "coded": experiment.design.coded.tolist(),
                "held": experiment.held,
                "responses": {
                    name: experiment.responses[:, :, m].tolist()
                    for m, name in enumerate(OBSERVABLES)
                },
            }
            for experiment in done.experiments
        },
    }  # fmt: skip


def _stage_json(stage: Surfaces) -> dict:
    return {
        "optimum": stage.best(),
        "desirability": stage.optimum.desirability,
        "surfaces": {
            name: {
                "terms": surface.labels,
                "coefficients": surface.coefficients.tolist(),
                "anova": anova(surface).as_text().split("\n"),
            }
            for name, surface in stage.whole.items()
        },
    }


def _ending_json(ending: Ending) -> dict:
    return {
        "method": ending.method,
        "values": ending.values,
        "simulations": ending.simulations,
        "stopped": ending.stopped,
        **{f"{where}_{name}": values[:, m].tolist()
           for where, values in (("fitted", ending.fitted), ("fresh", ending.fresh))
           for m, name in enumerate(OBSERVABLES)},
    }  # fmt: skip


def _write_sheet(experiment: Experiment, path: Path) -> None:
    """Natural values and every packing's responses, one row a point."""
    packings = range(1, experiment.packings + 1)
    header = [*experiment.design.names]
    header += [f"{name} packing {k}" for name in OBSERVABLES for k in packings]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        for natural, found in zip(experiment.design.natural(), experiment.responses, strict=True):
            numbers = [*natural, *found.T.ravel()]
            writer.writerow([f"{number:.8g}" for number in numbers])


def sentence(done: Study, compared: Comparison) -> str:
    """What the comparison says, in words."""
    judged = [pair for pair in compared.slopes if pair.matters]
    agreeing = sum(pair.agree for pair in judged)
    designs, gradients = compared.endings
    return (
        f"Of {len(judged)} slopes that matter, {agreeing} agree between surface and gradient "
        "within their joint 95 % intervals. The designs took "
        f"{designs.simulations} simulations, the gradient fit {gradients.simulations} to its best "
        "point."
    )


def show(found: Designed, console: Console) -> None:
    """Endings and slopes as tables on the terminal."""
    done, compared = found.study, found.comparison
    table = _plain("where each method ended (mean ± one packing)")
    for column in ("", "runs", "H fitted (mm)", "H fresh", "F fitted (N)", "F fresh"):
        table.add_column(column, no_wrap=True)
    for ending in compared.endings:
        cells = [_cell(values, m) for m in (0, 1) for values in (ending.fitted, ending.fresh)]
        table.add_row(ending.method, str(ending.simulations), *cells)
    console.print(table)
    table = _plain("slopes per ln p of factors that matter (H in mm, F in N)")
    for column in ("design", "factor", "of", "surface", "gradient", "intervals"):
        table.add_column(column, no_wrap=True)
    for pair in compared.slopes:
        if pair.matters:
            cells = [f"{pair.surface:.3g} ± {number(pair.surface_se, 1)}"]
            cells += [f"{pair.gradient:.3g} ± {number(pair.gradient_se, 1)}"]
            word = "agree" if pair.agree else "DISAGREE"
            table.add_row(pair.design, pair.factor, SHORT[pair.observable], *cells, word)
    console.print(table)
    console.print(sentence(done, compared), highlight=False)


def _plain(title: str) -> Table:
    """A table narrow enough for 80 columns."""
    return Table(title=title, title_justify="left", box=None, pad_edge=False)


def _cell(values: np.ndarray, m: int) -> str:
    """Mean of one response over the packings, with the scatter of one."""
    column = values[:, m]
    return f"{np.nanmean(column):.4g} ± {np.nanstd(column, ddof=1):.2g}"


def _screening(done: Study, figures: Path) -> Stage:
    pictures = []
    for name, found in done.screens.items():
        path = figures / f"screening_{name}.svg"
        screening_figure(found, path, LABELS[name])
        pictures.append(
            Picture(_read(path), f"Pareto and half-normal plot of {LABELS[name]}",
                    f"Effects on {LABELS[name]}")
        )  # fmt: skip
    ranked = {
        name: ", ".join(
            f"{e.name} {e.contribution:.0f} %" + ("" if e.p < SIGNIFICANT else " (not significant)")
            for e in found.ranked()[:4]
        )
        for name, found in done.screens.items()
    }
    words = "; ".join(f"{LABELS[name]}: {text}" for name, text in ranked.items())
    return Stage("screening", f"Largest contributions. {words}.".replace("_", " "), {}, pictures)


def _surfaces(stage: Surfaces, figures: Path) -> Stage:
    experiment, pictures = stage.experiment, []
    factors = experiment.design.factors
    for name, surface in stage.whole.items():
        if len(factors) > 1:
            path = figures / f"{experiment.title}_{name}.svg"
            surface_figure(stage.reduced[name], factors, path, LABELS[name])
            pictures.append(Picture(_read(path), f"surface of {LABELS[name]}", LABELS[name]))
        path = figures / f"{experiment.title}_{name}_residuals.svg"
        residual_figure(surface, path, LABELS[name])
        words = f"residuals of {LABELS[name]}"
        pictures.append(Picture(_read(path), words, words))
    best = ", ".join(f"{name} {value:.4g}" for name, value in stage.best().items())
    return Stage(
        experiment.title,
        f"{experiment.design.kind}, {len(experiment.design)} points on {experiment.packings} "
        f"packings. Optimum: {best} (desirability {stage.optimum.desirability:.2f}).".replace(
            "_", " "
        ),
        {LABELS[name]: anova(surface) for name, surface in stage.whole.items()},
        pictures,
    )


def _slopes_picture(found: Comparison, figures: Path) -> Picture:
    path = figures / "slopes.svg"
    slopes_figure(found, path)
    return Picture(
        _read(path), "slopes of surfaces against gradients", "Slopes with 95 % intervals"
    )


def _endings_picture(found: Comparison, lab: Lab, figures: Path) -> Picture:
    path = figures / "endings.svg"
    endings_figure(found.endings, lab.targets, path)
    return Picture(
        _read(path), "both responses at each method's end", "Packings as points, means as bars"
    )


def _read(path: Path) -> str:
    return path.read_text(encoding="utf-8")
