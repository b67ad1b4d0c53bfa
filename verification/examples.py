"""The gallery of `calibrate example`: each one run, its numbers beside its reference, a picture.

    python -m verification.examples                   some two hours of a core
    python -m verification.examples vane_shear jkr    these alone; the others as they were

Runs are kept in results/benchmarks, and a second call goes on.  Writes verification/results/
examples.md and docs/images/examples.png after each.
"""

import argparse
import io
import json
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from PIL import Image

from calibrate.core.files import write_bytes, write_text
from calibrate.figures.style import DARK, LIGHT, MIDDLE
from calibrate.labtests.composite import label, names_of
from calibrate.simulation.specimens import measured_json
from calibrate.verbs.example import ExampleResult, example, examples
from verification import reporting

COLUMNS, PANEL = 3, (3.6, 2.7)  # of the picture; inches
COLOURS = 64  # of the picture's file
SHADES = (DARK, MIDDLE, LIGHT)  # of an example's tests
POINTS = 150  # of a curve that is drawn
OF_HEAPS = "repose_angle"  # what is drawn of a heap in place of a curve
INTRODUCTION = """# Examples

`calibrate example` lists ready lab files of laboratory tests, and `calibrate example NAME` writes
one of them and simulates it. Below stand all of them: what was simulated, with the scatter of one
packing, beside what the lab file states as measured. The parameters are a start that a fit moves:
`calibrate fit results/example/NAME/lab.toml`.

![A panel for each example: curves of all packings, or angles of heaps](../../docs/images/examples.png)

In the panels of heaps, circles are simulated angles by each definition, and bars beside them are
what was measured.

"""  # noqa: E501


def run(name: str, folder: Path) -> dict:
    """What the page says of one example, simulated or read."""
    kept = folder / f"{name}.json"
    if kept.exists():
        return json.loads(kept.read_text(encoding="utf-8"))
    row = _shown(example(name, out=folder / name))
    write_text(kept, json.dumps(row))
    return row


def _shown(found: ExampleResult) -> dict:
    """Numbers, curves and axes of an example that was run."""
    simulated = found.simulated
    assert simulated is not None
    runs = [run for run in simulated.runs if not run.failure]
    measured = measured_json(simulated.lab)
    called = names_of(simulated.lab.tests)
    return {
        "observables": found.observables,
        "spread": found.content["spread"],
        "packings": len(simulated.runs),
        "failed": len(simulated.failures),
        "warnings": list(simulated.content["observable_warnings"].values()),
        "together": simulated.content["together"],
        "targets": measured["targets"],
        "test_of": {name: test for (test, _), (name, _) in called.items()},
        "tests": measured["tests"],
        "curves": {
            test: [_thinned(run.curves[test]) for run in runs] for test in runs[0].curves
        } if runs else {},
    }  # fmt: skip


def _thinned(curve: np.ndarray) -> list[list[float]]:
    rows = np.unique(np.linspace(0, len(curve) - 1, min(POINTS, len(curve))).astype(int))
    return np.round(curve[rows], 5).tolist()


# ---------------------------------------------------------------- the picture


def picture(found: dict[str, dict], path: Path) -> None:
    """A panel for each example: curves of all packings, or angles of a heap."""
    rows = -(-len(found) // COLUMNS)
    size = (COLUMNS * PANEL[0], rows * PANEL[1])
    figure, axes = plt.subplots(rows, COLUMNS, figsize=size, layout="constrained", squeeze=False)
    for axis in axes.flat[len(found) :]:
        axis.set_axis_off()
    for axis, (name, row) in zip(axes.flat, found.items(), strict=False):
        axis.set_title(name, fontsize=9)
        axis.tick_params(labelsize=7)
        heaps = [each for each in row["observables"] if OF_HEAPS in each]
        (_angles if heaps else _curves)(axis, row)
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=110, format="png")
    plt.close(figure)
    small = io.BytesIO()
    Image.open(drawn).convert("RGB").quantize(COLOURS).save(small, "PNG", optimize=True)
    write_bytes(path, small.getvalue())


def _curves(axis: Axes, row: dict) -> None:
    """Curves of all packings of up to three tests."""
    for colour, (test, curves) in zip(SHADES, row["curves"].items(), strict=False):
        for number, curve in enumerate(curves):
            named = {} if number or len(row["curves"]) == 1 else {"label": test}
            axis.plot(*np.array(curve).T, color=colour, lw=0.8, **named)
    across, up = next(iter(row["tests"].values()))["axes"]
    axis.set_xlabel(across, fontsize=7)
    axis.set_ylabel(up, fontsize=7)
    if len(row["curves"]) > 1:
        axis.legend(fontsize=6, frameon=False)


def _angles(axis: Axes, row: dict) -> None:
    """Angles of repose by each definition, with the scatter of packings, and what was measured."""
    names = [name for name in row["observables"] if OF_HEAPS in name]
    for place, name in enumerate(names):
        low_high = row["observables"][name], row["spread"][name]
        axis.errorbar(place, low_high[0], low_high[1], fmt="o", ms=4, capsize=3, color=DARK)
        if name in row["targets"]:
            target = row["targets"][name]
            span = {"yerr": target["scatter"], "fmt": "_", "ms": 12, "color": MIDDLE}
            axis.errorbar(place + 0.25, target["mean"], **span)
    axis.set_xticks(range(len(names)), [_short(name) for name in names], fontsize=6, rotation=30)
    axis.set_ylabel("angle (deg)", fontsize=7)


def _short(name: str) -> str:
    test, _, plain = name.rpartition(".")
    said = plain.removesuffix("_deg").replace(OF_HEAPS, "").replace("_", " ").strip() or "profile"
    return f"{test} {said}".strip()


# ---------------------------------------------------------------- the page


def markdown(found: dict[str, dict], origin: dict) -> str:
    return (
        INTRODUCTION
        + "\n".join(_section(name, row) for name, row in found.items())
        + reporting.footer(origin)
    )  # fmt: skip


def _section(name: str, row: dict) -> str:
    known = examples()[name]
    rows = [
        [label(each), _number(value, row["spread"][each]), _measured(row["targets"].get(each))]
        for each, value in row["observables"].items()
    ]
    rows += [[label(each), f"{x:.4g}", ""] for each, x in row["together"].items()]
    failed = f", of which {row['failed']} failed" if row["failed"] else ""
    warned = "".join(f"\nWarning: {each}.\n" for each in dict.fromkeys(row["warnings"]))
    return (
        f"## {name}\n\n{known.what[0].upper()}{known.what[1:]}: `calibrate example {name}`.\n"
        f"{row['packings']} packings{failed}; some {known.minutes} minutes on two cores (estimate)."
        "\n\n"
        + reporting.table(("number", "simulated ± one packing", "measured ± one repeat"), rows)
        + warned
        + f"\n{' '.join(known.reference.split())}\n\n```toml\n{known.lab.strip()}\n```\n"
    )


def _number(value: float, scatter: float) -> str:
    return "-" if value is None or np.isnan(value) else f"{value:.4g} ± {scatter:.2g}"


def _measured(target: dict | None) -> str:
    return "" if target is None else f"{target['mean']:.4g} ± {target['scatter']:.2g}"


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("names", nargs="*", choices=[*examples(), []], metavar="NAME")
    chosen = parser.parse_args().names or list(examples())
    reporting.configure()
    folder = reporting.kept("examples")
    found = dict(reporting.earlier("examples", "examples"))
    for name in chosen:
        found[name] = run(name, folder)
        found = {each: found[each] for each in examples() if each in found}
        origin = {**reporting.provenance(), "command": "python -m verification.examples"}
        reporting.write_content("examples", {**origin, "examples": found})
        picture(found, reporting.IMAGES / "examples.png")
        reporting.write_page("examples", markdown(found, origin))


if __name__ == "__main__":
    main()
