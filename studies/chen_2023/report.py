"""The reproduction of the paper as an HTML page, as JSON, and as tables on the terminal."""

from collections.abc import Iterable
from itertools import groupby
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from calibrate.core.files import write_json, write_text
from calibrate.reports.html import Picture, number, render
from studies.chen_2023 import depth, force, screening
from studies.chen_2023.figures import Agreement, agreement_svg, bars_svg
from studies.chen_2023.levels import FACTORS
from studies.chen_2023.paper import SOURCE, Reproduction
from studies.chen_2023.tables import Range, in_text, printed, table
from studies.chen_2023.verdict import Figure, Verdict

MARKS = {Verdict.REPRODUCED: "●", Verdict.CORRECTED: "◐", Verdict.NOT_REPRODUCED: "○"}
SHORT = {**{verdict: str(verdict) for verdict in Verdict}, Verdict.CORRECTED: "corrected"}
PAGE = "reproduction.html"
TEMPLATE = Path(__file__).with_name(PAGE)


def write(result: Reproduction, out: Path, path: Path | None) -> None:
    """reproduction.json (and `--json`) and the page, in a folder that exists."""
    content = result.as_json()
    write_json(out / "reproduction.json", content)
    if path is not None:
        write_json(path, content)
    write_text(out / PAGE, page(result))


def page(result: Reproduction) -> str:
    """The whole page as HTML."""
    total = result.total()
    return render(
        TEMPLATE,
        result=result,
        source=SOURCE,
        verdicts=list(Verdict),
        MARKS=MARKS,
        SHORT=SHORT,
        total=[total[verdict] for verdict in Verdict],
        without_data=sum(figure.computed is None for figure in result.figures),
        by_table=_by_table(result.figures),
        inside_by_table=_by_table(result.inside),
        inside_holds=sum(check.verdict is Verdict.REPRODUCED for check in result.inside),
        equations=[_depth_equation(), _force_equation()],
        contributions=[_contributions("depression_depth"), _contributions("crushing_force")],
    )


def show(result: Reproduction, console: Console) -> None:
    """Counts by table, what this means, then every figure that is not reproduced."""
    console.print(_counts(result))
    for finding in result.findings:
        console.print(Padding(Text(finding.statement), (1, 0, 0, 2)))
    console.print("\nNot reproduced: published, then from the data")
    for source, figures in _by_table(result.not_reproduced()).items():
        console.print(Text(f"\n{source}", style="bold"))
        for remark, alike in groupby(figures, lambda figure: figure.correction):
            for figure in alike:
                console.print(Padding(Text(_line(figure)), (0, 0, 0, 2)))
            words = Text(remark.replace("_", " "), style="dim")
            console.print(Padding(words, (0, 0, 0, 4)))


def _counts(result: Reproduction) -> Table:
    total = result.total()
    title = f"{len(result.figures)} published figures against the paper's own data"
    shown = Table(title=title, title_justify="left", show_footer=True)
    shown.add_column("", footer="all")
    for verdict in Verdict:
        words = str(verdict).replace("reproduced after", "reproduced\nafter")
        shown.add_column(words, footer=str(total[verdict]), justify="right")
    for source, counts in result.counts().items():
        shown.add_row(source, *(str(counts[verdict] or "") for verdict in Verdict))
    return shown


def _line(figure: Figure) -> str:
    """Name, published and computed; numbers in columns where the name leaves room."""
    published = figure.printed_as.replace("-", "−")
    if isinstance(figure.published, str):
        words = f"{figure.name}: {published}; from the data: {figure.computed}"
        return words.replace("_", " ")
    computed = "no data" if figure.computed is None else number(float(figure.computed))
    return f"{figure.name:<46} {published:>11} {computed:>11} {figure.unit}".rstrip()


def _by_table(figures: Iterable[Figure]) -> dict[str, list[Figure]]:
    return {source: list(rows) for source, rows in groupby(figures, lambda f: f.table)}


def _depth_equation() -> Picture:
    """The printed depth equation at its nine design points against three times Table 3."""
    values, measured = depth.equation_values(), depth.depth_at_points()
    rows = np.all(depth.points() == [0.5, 0.6], axis=1)
    centre = next(value.value for name, value in values.items() if name.startswith("centre"))
    repeats = np.column_stack([3 * depth.depths()[rows], np.full(rows.sum(), centre)])
    x, y, reach = _arrays(measured, values, 3.0, 1.0)
    drawing = agreement_svg(
        Agreement(x, y, reach, "3 × depth of Table 3 (mm)", "printed equation", repeats=repeats)
    )
    off = 100 * np.max(np.abs(y / x - 1))
    caption = (
        "The depth equation gives three times the printed depth at all nine design points, within "
        f"{off:.2f} %; the centre is the mean of five runs."
    )
    return Picture(drawing, "Depth equation against three times Table 3: all on the line", caption)


def _force_equation() -> Picture:
    """The printed force equation, brought to newtons, against Table 4."""
    factor, agreeing = force.unit_of_equation()
    values, measured = force.equation_values(), force.force_at_points(force.forces())
    rows = np.all(force.points() == [12, 0.5, 0.65], axis=1)
    centre = next(value.value for name, value in values.items() if name.startswith("centre"))
    at_centre = np.full(rows.sum(), factor.value * centre)
    repeats = np.column_stack([force.forces()[rows], at_centre])
    x, y, reach = _arrays(measured, values, 1.0, factor.value)
    named = {place: name for place, name in enumerate(values) if name not in agreeing}
    ylabel = f"{factor.value:.2f} N × printed equation (N)"
    drawing = agreement_svg(
        Agreement(x, y, reach, "force of Table 4 (N)", ylabel, repeats=repeats, named=named)
    )
    caption = (
        f"The force equation times {factor.value:.2f} N. Bars: rounding of its coefficients. It "
        f"misses {', '.join(named.values())}. The five runs at the centre lie in two groups."
    )
    return Picture(drawing, "Force equation against Table 4: one point off the line", caption)


def _contributions(response: str) -> Picture:
    """Printed contributions beside those of Table 2."""
    source = table(screening.PRINTED_IN[response])
    found = screening.screening(response)
    series = {
        f"printed in {source.title}": source.values("contribution_percent"),
        "from Table 2": np.array([found[name].contribution for name in FACTORS]),
    }
    threshold = printed(in_text("threshold.contribution")).value
    drawing = bars_svg(FACTORS, series, "contribution (%)", threshold)
    words = response.replace("_", " ")
    caption = (
        f"Contributions to the {words}. Dashed: the {threshold:g} % above which the paper calls a "
        "contribution large."
    )
    return Picture(drawing, f"Contributions to the {words}, printed and from Table 2", caption)


def _arrays(
    x: dict[str, Range], y: dict[str, Range], x_scale: float, y_scale: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values of both and the reach of the second, in the order of their names."""
    return (
        x_scale * np.array([x[name].value for name in y]),
        y_scale * np.array([number.value for number in y.values()]),
        y_scale * np.array([number.reach for number in y.values()]),
    )
