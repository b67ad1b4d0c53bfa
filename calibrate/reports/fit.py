"""The report of a calibration."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from calibrate.figures import panels
from calibrate.figures.style import above, panel_svg
from calibrate.labtests.composite import described
from calibrate.labtests.composite import label as label_of
from calibrate.records.base import Observable, Test, read
from calibrate.records.fit import FitRecord, Packing, Summary
from calibrate.reports.html import (
    Page,
    Picture,
    Table,
    number,
    pictures_of,
    plus_minus,
    quantity,
    render,
    words,
)

SMALL = (4.6, 2.9)  # inches
FAR = 2.0  # deviations within which a fitted number is counted as near


def page(path: Path) -> Page:
    """The report of the result.json at `path`; `InputError` where it cannot be read."""
    found = read(path, FitRecord)
    content = {
        "sentence": sentence(found),
        "warnings": [f"{sentence}." for sentence in found.all_warnings()],
        "targets": _targets(found),
        "features": _features(found),
        "curves": [
            *(_curves(found, test) for test in found.measured.tests),
            *pictures_of("fit", found, skipped=1).values(),
        ],
        "free": _free(found),
        "pictures": list(_pictures(found)),
        "directions": _directions(found),
        "correlation": _correlation(found),
        "screening": _screening(found),
        "held": _held(found),
        "course": [_course(found)],
        "history": _history(found),
        "checks": _checks(found),
        "settings": _settings(found),
    }
    return Page(content["sentence"], render("fit.html", found=found, **content))


def sentence(found: FitRecord) -> str:
    """What was found, how well it fits, and what the data fix."""
    values = [
        f"{words(name)} {quantity(name, found.parameters[name])} ({_interval(found, name)})"
        for name in found.free
    ]
    fixed = sum(direction.fixed_by_data for direction in found.identifiability.directions)
    verdict = f"The data fix {fixed} of {len(found.free)} combinations of the free parameters."
    if not found.met:
        verdict = "The fit missed its data: they fix none of its parameters."
    return f"Fitted with 95 % intervals: {', '.join(values)}. {_met(found)} {verdict}"


def _met(found: FitRecord) -> str:
    """How many targets are met, and how many of the numbers read from curves."""
    targets, parts = found.measured.targets, []
    if targets:
        here, fresh = (
            sum(abs(group.observables[name] - t.mean) <= t.scatter for name, t in targets.items())
            for group in (found, found.fresh_packings)
        )
        parts.append(
            f"{here} of {len(targets)} targets are met within the scatter of one repeat on the "
            f"packings of the fit, {fresh} on fresh packings."
        )
    curve = [feature for name, feature in found.features.items() if name not in found.observables]
    if curve:
        near = sum(abs(f.measured - f.simulated) <= FAR * f.sd for f in curve)
        parts.append(f"{near} of {len(curve)} numbers read from curves lie within {FAR:g} s.d.")
    return " ".join(parts)


def _interval(found: FitRecord, name: str) -> str:
    ends = found.identifiability.interval_95[name]
    return " to ".join(quantity(name, end, 3) for end in ends)


def _weights(weights: dict[str, float]) -> str:
    return ", ".join(f"{w:+.2f} {words(name)}".replace("-", "−") for name, w in weights.items())


# ---------------------------------------------------------------- tables


def _targets(found: FitRecord) -> Table:
    """All observables: measured, on the packings of the fit, on fresh ones, of named sets."""
    groups = {
        "fitted packings": found,
        "fresh packings": found.fresh_packings,
        **{f"set '{name}'": group for name, group in found.named_sets.items()},
    }
    rows = [["measured", *(_measured(found, name) for name in found.observables)]]
    rows += [[label, *_observed(group, found)] for label, group in groups.items()]
    return Table(["", *(label_of(name) for name in found.observables)], rows)


def _measured(found: FitRecord, name: Observable) -> str:
    target = found.measured.targets.get(name)
    if target is None:
        return "–"
    return f"{plus_minus(target.mean, target.scatter)} ({target.repeats} repeats)"


def _observed(group: Summary, found: FitRecord) -> list[str]:
    nan = float("nan")
    return [
        plus_minus(group.observables.get(name, nan), group.spread.get(name, nan))
        for name in found.observables
    ]


def _features(found: FitRecord) -> Table | None:
    """Every number that was fitted; nothing where these are observables."""
    if set(found.features) <= set(found.observables):
        return None
    rows = [
        [
            words(name) if name in found.observables else name,
            number(f.measured, 4),
            number(f.simulated, 4),
            number((f.simulated - f.measured) / f.sd if f.sd else float("nan"), 2),
        ]
        for name, f in found.features.items()
    ]
    of_observables = (described(name).unit for name in found.features if name in found.observables)
    units = " or ".join(dict.fromkeys(["mm", "N", *of_observables]))
    return Table([f"number ({units})", "measured", "simulated", "difference in s.d."], rows)


def _column(found: FitRecord, name: str) -> str:
    """An observable's label, a feature's own name."""
    return label_of(name) if name in found.observables else name


def _free(found: FitRecord) -> Table:
    rows = [
        [
            words(name),
            quantity(name, found.start(name)),
            quantity(name, found.parameters[name]),
            _interval(found, name),
        ]
        for name in found.free
    ]
    return Table(["parameter", "start", "fitted", "95 % interval"], rows)


def _directions(found: FitRecord) -> Table:
    rows = [
        [
            _weights(direction.weights),
            number(direction.signal_to_noise, 3),
            f"{'●' if direction.fixed_by_data else '○'} {direction.verdict}",
        ]
        for direction in found.identifiability.directions
    ]
    return Table(["combination", "signal/noise", "by the data"], rows)


def _correlation(found: FitRecord) -> Table | None:
    if len(found.free) < 2:
        return None
    names = [words(name) for name in found.free]
    rows = [
        [name, *(number(x, 2) for x in row)]
        for name, row in zip(names, found.identifiability.correlation, strict=True)
    ]
    return Table(["", *names], rows)


def _screening(found: FitRecord) -> Table | None:
    slopes = found.screening.slopes_per_ln
    if not slopes:
        return None
    names = list(dict.fromkeys(name for row in slopes.values() for name in row))
    rows = [[words(name), *(number(row.get(name), 3) for row in slopes.values())] for name in names]
    columns = [_column(found, name) for name in slopes]
    note = " ".join(["Slopes per unit of ln p.", *_alike(found)])
    return Table(["candidate", *columns], rows, note)


def _alike(found: FitRecord) -> Iterator[str]:
    """What would have served as well as a parameter that was chosen."""
    for name, others in found.screening.alike.items():
        if others:
            seen = " and ".join(map(words, others))
            yield (
                f"The data see {seen} about as well as {words(name)}, which was freed; --free "
                "chooses otherwise."
            )


def _held(found: FitRecord) -> Table:
    held = {name: value for name, value in found.parameters.items() if name not in found.free}
    rows = [[words(name), quantity(name, value)] for name, value in held.items()]
    return Table(["parameter", "value"], rows)


def _history(found: FitRecord) -> Table:
    first = found.history[0]
    rows = [
        [
            f"{step.evaluation}, {step.status}",
            number(step.forward_runs, 4),
            number(step.cost, 3),
            *(quantity(name, step.parameters.get(name)) for name in first.parameters),
            *(number(step.features.get(name), 4) for name in first.features),
        ]
        for step in found.history
    ]
    names = [*first.parameters, *(_column(found, name) for name in first.features)]
    columns = ["evaluation", "forward runs a packing", "objective", *map(words, names)]
    return Table(columns, rows)


def _checks(found: FitRecord) -> Table:
    """What says whether to believe the simulations: the worst of the fitted packings."""
    rows = [[_with_unit(name), _checked(value)] for name, value in found.quality.items()]
    for test, rate in found.rates.items():
        speeds = f"{number(rate.simulated_mm_s, 3)} for {number(rate.nominal_mm_s, 3)} mm/s"
        rows.append([f"{test} platen speed, simulated for nominal", speeds])
    return Table(["check", "worst of the fitted packings"], rows)


def _with_unit(name: str) -> str:
    """A check's name, its unit in brackets where the name ends in one."""
    for ending, unit in (("_j", "J"), ("_s", "s")):
        if name.endswith(ending):
            return f"{words(name.removesuffix(ending))} ({unit})"
    return words(name)


def _checked(value: float | bool) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return number(value, 3)


def _settings(found: FitRecord) -> dict[str, str]:
    return {
        "spheres": str(found.spheres),
        "packings of the fit": ", ".join(map(str, found.seeds)),
        "fresh packings": ", ".join(map(str, found.fresh_seeds)),
        "slopes": found.strategy,
        "simulations": f"{found.simulations} in the last start; finished ones are never repeated",
    }


# ---------------------------------------------------------------- pictures


def _curves(found: FitRecord, test: Test) -> Picture:
    packings = (*found.packings.fitted, *found.packings.fresh)
    shown = found.measured.tests[test]
    alt = f"Force against displacement, {shown.title}: {_reach(packings, test)}"
    caption = (
        "Solid: packings of the fit. Dashed: fresh packings. "
        + ("Dotted: measured. " if any(c.test == test for c in found.measured.curves) else "")
        + ("Grey lines: the forces between which depression depth counts. "
           if shown.guides_n else "")
        + "".join(f"Band: measured {described(name).label} ± scatter of one repeat. "
                  for name in shown.drawn if name in found.measured.targets)
    )  # fmt: skip
    groups = panels.fit_groups(found, test)
    drawing = _untitled(lambda axis: panels.compression(axis, test, groups, found.measured))
    return Picture(drawing, alt, f"{shown.title.capitalize()}. {caption.strip()}")


def _untitled(draw: Callable[[Axes], None]) -> str:
    """A panel whose title stands in its caption, as SVG."""

    def drawn(axis: Axes) -> None:
        draw(axis)
        axis.set_title("")
        above(axis)

    return panel_svg(drawn)


def _reach(packings: Sequence[Packing], test: Test) -> str:
    """Number of curves, their largest forces and displacements, in words."""
    curves = [p.curves[test] for p in packings if test in p.curves and p.curves[test].force_n]
    if not curves:
        return "no curves"
    force = [max(curve.force_n) for curve in curves]
    travel = [max(curve.displacement_mm) for curve in curves]
    return (
        f"{len(curves)} packings reach {number(min(force), 3)} to {number(max(force), 3)} N "
        f"and {number(min(travel), 3)} to {number(max(travel), 3)} mm."
    )


def _pictures(found: FitRecord) -> Iterator[Picture]:
    if found.measured.targets:
        targets = found.measured.targets
        spread = "; ".join(f"{words(name)}: {_ratios(found, name)}" for name in targets)
        alt = f"Simulated over measured, packing by packing. {spread}."
        drawing = _untitled(lambda axis: panels.observables(axis, found))
        caption = "Points: packings. Bars: their means. Grey: measured ± scatter."
        yield Picture(drawing, alt, caption)
    values = "; ".join(
        f"{words(name)} {quantity(name, found.parameters[name])}, {_interval(found, name)}"
        for name in found.free
    )
    yield Picture(
        panel_svg(lambda axis: panels.parameters(axis, found)),
        f"Free parameters with their 95 % intervals: {values}.",
        "Fitted values over starting values, with 95 % intervals.",
    )
    for name in found.profiles:
        if name in found.free:
            yield _profile(found, name)


def _ratios(found: FitRecord, name: Observable) -> str:
    mean = found.measured.targets[name].mean
    parts = []
    for label, group in (("fitted", found.packings.fitted), ("fresh", found.packings.fresh)):
        ratios = [number(packing.observable(name) / mean, 3) for packing in group]
        parts.append(f"{label} {', '.join(ratios)}")
    return ", ".join(parts)


def _profile(found: FitRecord, name: str) -> Picture:
    points = found.profiles[name]
    costs = ", ".join(number(point.simulated, 2) for point in points)
    return Picture(
        panel_svg(lambda axis: panels.profile(axis, found, name), SMALL),
        f"Objective along {words(name)}: {costs} by simulation.",
        "Others are where the slopes put them. Where points leave the line, so does the interval.",
    )


def _course(found: FitRecord) -> Picture:
    costs = [step.cost for step in found.history]
    alt = f"Objective over {len(costs)} evaluations: from {number(costs[0], 2)} to "
    best = number(float(np.nanmin(costs)), 2)
    drawing = panel_svg(lambda axis: panels.descent(axis, found), SMALL)
    return Picture(drawing, f"{alt}{best}.", "The line follows the best so far.")
