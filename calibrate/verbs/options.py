"""Options that several verbs share: what a Python program gives, and what is typed for it.

The signature of a verb is its command.  An argument is `Annotated` with its type in Python, then
with Typer's option or argument (name, help, limits), and with `Typed` where what is typed has
another type.  Options that are wrong raise `InputError` with the option's name as the field.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calibrate.core.errors import COMMAND_LINE, InputError

if TYPE_CHECKING:
    from calibrate.io.lab import LabLike


@dataclass(frozen=True)
class Typed:
    """What is typed for an argument.

    Attributes:
        kind: its type on the command line; a list is of an option that may be given several times.
        read: makes the argument of it.
    """

    kind: Any
    read: Callable[[Any], Any] = lambda value: value


def parse_changes(changes: Sequence[str]) -> dict[str, str]:
    """`--set name=value` options by name; the verb reads the values."""
    values = {}
    for change in changes:
        name, equals, value = change.partition("=")
        if not equals:
            raise InputError(COMMAND_LINE, f"--set {change}", "no '='", "write name=value")
        values[name.strip()] = value.strip()
    return values


LabFile = Annotated[
    "LabLike",
    typer.Argument(metavar="[LAB.toml]", help="Lab file; default: the bundled soil."),
    Typed(Path | None),
]
LabWithCurves = Annotated[
    "LabLike", typer.Argument(metavar="LAB.toml", help="Lab file with curves."), Typed(Path)
]
Json = Annotated[Path | None, typer.Option("--json", help="Write the result to this file.")]
Folder = Annotated[str | Path, typer.Option("--out", help="Folder for results."), Typed(Path)]
Out = Annotated[
    str | Path,
    typer.Option("--out", help="Folder for results; a second run resumes."),
    Typed(Path),
]
Tests = Annotated[
    str | Sequence[str] | None,
    typer.Option("--tests", help="Tests to fit, comma-separated; default: all not verified."),
    Typed(str | None),
]
Verified = Annotated[
    str | Sequence[str] | None,
    typer.Option("--verify", help="Tests to leave out and predict, comma-separated."),
    Typed(str | None),
]
Seed = Annotated[int, typer.Option("--seed", min=0, max=10_000_000, help="Choice of packings.")]
PresetName = Annotated[str, typer.Option("--preset", help="quick, standard or fine.")]
Preparation = Annotated[
    bool, typer.Option("--prepare-with-soil", help="Settle beds with the soil under test.")
]
Dask = Annotated[
    str | None, typer.Option("--dask", metavar="ADDRESS", help="Simulate on this Dask cluster.")
]
Batch = Annotated[
    int | None,
    typer.Option(
        "--batch", min=2, metavar="N", help="Simulate N specimens at once on an accelerator."
    ),
]
Changes = Annotated[
    Mapping[str, float | str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Change a parameter."),
    Typed(list[str] | None, parse_changes),
]
Conventions = Annotated[
    str | None,
    typer.Option("--conventions", help="Of the contact law: eepa, liggghts, liggghts_history."),
]
LibraryFile = Annotated[
    str | Path | None,
    typer.Option("--library", help="Library of runs; default: the bundled one."),
    Typed(Path | None),
]
FurtherLabs = Annotated[
    str | Path | Sequence[str | Path],
    typer.Option("--further", metavar="LAB.toml", help="Lab file of further tests; repeatable."),
    Typed(list[Path] | None),
]
StatisticsSeed = Annotated[
    int, typer.Option("--seed", min=0, max=10_000_000, help="Of simulated statistics.")
]
DiscrepancyFile = Annotated[
    str | Path | None,
    typer.Option("--discrepancy", help="What `calibrate discrepancy` wrote."),
    Typed(Path | None),
]
InfillPackings = Annotated[
    int,
    typer.Option(
        "--simulate",
        min=0,
        max=400,
        metavar="N",
        help="Simulate the leading explanations on N more packings; 0: none.",
    ),
]
