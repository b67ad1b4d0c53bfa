"""A study by designed experiments as JSON, run sheets, an HTML page, and a summary."""

import csv
from collections.abc import Iterator
from dataclasses import asdict
from itertools import chain
from pathlib import Path

from rich.console import RenderableType
from rich.table import Column, Table
from rich.text import Text

from calibrate.core.files import whole, write_json, write_text
from calibrate.designs.anova import anova
from calibrate.designs.comparison import Comparison, Designed, MethodResult
from calibrate.designs.study import Experiment, Study, Surfaces
from calibrate.labtests.composite import described
from calibrate.records.base import record
from calibrate.records.study import StudyRecord
from calibrate.reports import study_page
from calibrate.reports.html import number
from calibrate.reports.study_page import cell, sentence
from calibrate.simulation.session import Session, origin_of
from calibrate.simulation.specimens import measured_json

PAGE = "study.html"


def write(session: Session, found: Designed) -> dict:
    """result.json, one CSV a design, and study.html in `session.out`; what result.json holds."""
    out = session.out
    content = {
        **origin_of(session),
        "spheres": session.preset.spheres,
        "seeds": list(found.seeds),
        "fresh_seeds": list(found.fresh),
        "measured": measured_json(session.lab),
        **as_json(found.study, found.comparison),
    }
    write_json(out / "result.json", content)
    for experiment in found.study.experiments:
        _write_sheet(experiment, out / f"{experiment.title}.csv")
    write_text(out / PAGE, study_page.of(record(StudyRecord, content)).html)
    return content


def as_json(done: Study, compared: Comparison) -> dict:
    """Designs with responses, effects, surfaces, the optimum, and the comparison."""
    return {
        "screening": {
            "effects": {name: [asdict(e) for e in found.effects]
                        for name, found in done.screens.items()},
        },
        **{stage.experiment.title: _stage_json(stage)
           for stage in done.stages},
        "optimum": done.values,
        "simulations": done.simulations,
        "comparison": {
            "slopes": [{**asdict(pair), "agree": pair.agree, "reach": pair.reach, "why": pair.why()}
                       for pair in compared.slopes],
            "endings": [_ending_json(ending, done) for ending in compared.endings],
            "enhanced": [asdict(row) for row in compared.enhanced],
            "gradient_runs": compared.gradient_runs,
        },
        "designs": {
            experiment.title: {
                "kind": experiment.design.kind,
                "factors": [asdict(factor) for factor in experiment.design.factors],
                "coded": experiment.design.coded.tolist(),
                "dummies": experiment.design.dummies.tolist(),
                "held": experiment.held,
                "responses": {
                    name: experiment.responses[:, :, m].tolist()
                    for m, name in enumerate(done.observables)
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


def _ending_json(ending: MethodResult, done: Study) -> dict:
    return {
        "method": ending.method,
        "values": ending.values,
        "simulations": ending.simulations,
        "stopped": ending.stopped,
        **{f"{where}_{name}": values[:, m].tolist()
           for where, values in (("fitted", ending.fitted), ("fresh", ending.fresh))
           for m, name in enumerate(done.observables)},
    }  # fmt: skip


def _write_sheet(experiment: Experiment, path: Path) -> None:
    """Natural values and every packing's responses, one row a point."""
    packings = range(1, experiment.packings + 1)
    header = [*experiment.design.names]
    header += [f"{name} packing {k}" for name in experiment.observables for k in packings]
    with whole(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        for natural, found in zip(experiment.design.natural(), experiment.responses, strict=True):
            numbers = [*natural, *found.T.ravel()]
            writer.writerow([f"{number:.8g}" for number in numbers])


def words(found: Designed) -> Iterator[RenderableType]:
    """Endings and slopes as tables."""
    compared = found.comparison
    goals = [(found.study.observables.index(name), described(name)) for name in found.study.goals]
    columns = [(f"{short(o.name)} fitted ({o.unit})", f"{short(o.name)} fresh") for _, o in goals]
    title = "where each method ended (mean ± one packing)"
    table = _plain(title, "", "runs", *chain.from_iterable(columns))
    for ending in compared.endings:
        cells = [cell(values, m) for m, _ in goals for values in (ending.fitted, ending.fresh)]
        table.add_row(ending.method, str(ending.simulations), *cells)
    yield table
    units = ", ".join(f"{short(n)} in {described(n).unit}" for n in found.study.observables)
    title = f"slopes per ln p of factors that matter ({units})"
    table = _plain(title, "design", "factor", "of", "surface", "gradient", "intervals")
    for pair in compared.slopes:
        if pair.matters:
            cells = [f"{pair.surface:.3g} ± {number(pair.surface_se, 1)}"]
            cells += [f"{pair.gradient:.3g} ± {number(pair.gradient_se, 1)}"]
            word = "agree" if pair.agree else "DISAGREE"
            table.add_row(pair.design, pair.factor, short(pair.observable), *cells, word)
    yield table
    yield Text(sentence(compared))


def short(name: str) -> str:
    """An observable's symbol: H of a depression depth; its label where it has none."""
    known = described(name)
    return known.symbol or known.label


def _plain(title: str, *columns: str) -> Table:
    """A table narrow enough for 80 columns."""
    unwrapped = (Column(column, no_wrap=True) for column in columns)
    return Table(*unwrapped, title=title, title_justify="left", box=None, pad_edge=False)
