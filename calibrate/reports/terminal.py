"""Tables and sentences that several verbs show on the terminal, and in notebooks."""

import csv
import io
from collections.abc import Iterator
from math import isnan

from rich.table import Table
from rich.text import Text

from calibrate.io.lab import Lab
from calibrate.labtests.composite import label
from calibrate.simulation.specimens import reservations

ACROSS = 2  # observables that stand beside each other in a narrow window


def course(result: dict) -> str:
    """How the runs went: how finely the specimen is resolved, how quasi-static and how fast they
    were."""
    quality = result["quality"]
    if not quality["spheres"]:
        return "no test has soil in it"
    speed, inertia = result["particle_steps_per_s"] / 1e6, quality["inertial_number"]
    return (
        f"{quality['spheres_across']:.1f} spheres across, porosity {quality['porosity']:.2f}, "
        + ("" if inertia is None or isnan(inertia) else f"inertial number {inertia:.1e}, ")
        + f"{speed:.2f} M particle-steps/s per run"
    )


def warned_of_reservations(result: dict) -> Iterator[Text]:
    """Why the numbers are not to be trusted."""
    for reason in reservations(result["quality"]):
        yield Text(f"warning: {reason}")


def warned_of_observables(result: dict) -> Iterator[Text]:
    """Numbers that are not what they are called."""
    for name, why in result.get("observable_warnings", {}).items():
        yield Text(f"warning: {label(name)}: {why}")


def observables_table(lab: Lab, groups: dict[str, dict]) -> Table:
    """Observables of groups of runs beside what was measured, each with its scatter; the groups in
    rows, or, where observables are too many for columns, in columns."""
    names = list(next(iter(groups.values()))["observables"])
    cells = {
        "measured (± one repeat)": [
            f"{lab.targets[n].mean:.4g} ± {lab.targets[n].scatter:.2g}" if n in lab.targets else "-"
            for n in names
        ]
    }
    for which, group in groups.items():
        cells[f"{which} (± one packing)"] = [
            f"{group['observables'][n]:.4g} ± {group['spread'][n]:.2g}" for n in names
        ]
    labels = [label(name) for name in names]
    if len(names) <= ACROSS:
        rows, columns = [[which, *row] for which, row in cells.items()], labels
    else:
        rows, columns = list(zip(labels, *cells.values(), strict=True)), list(cells)
    table = Table("", *columns, title=lab.name, title_justify="left")
    for row in rows:
        table.add_row(*row)
    return table


def history_table(history: list[dict]) -> str:
    """The evaluations of a fit as CSV, one row each."""
    rows = [
        {k: v for k, v in row.items() if k not in ("parameters", "features")}
        | row["parameters"]
        | row["features"]
        for row in history
    ]
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
