"""Options of the command line that several verbs share, and what they mean.

Options that are wrong raise `InputError` with the option's name as the field.
"""

import functools
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import typer

from calibrate.core.errors import COMMAND_LINE, InputError

LabFile = Annotated[
    Path | None, typer.Argument(metavar="[LAB.toml]", help="Lab file; default: the bundled soil.")
]
Json = Annotated[Path | None, typer.Option("--json", help="Write the result to this file.")]
Out = Annotated[Path, typer.Option("--out", help="Folder for results; a second run resumes.")]
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
    list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Change a parameter.")
]
Conventions = Annotated[
    str | None,
    typer.Option("--conventions", help="Of the contact law: eepa, liggghts, liggghts_history."),
]
LibraryFile = Annotated[
    Path | None,
    typer.Option("--library", "--bank", help="Library of runs; default: the bundled one."),
]
FurtherLabs = Annotated[
    list[Path] | None,
    typer.Option("--further", metavar="LAB.toml", help="Lab file of further tests; repeatable."),
]
StatisticsSeed = Annotated[
    int, typer.Option("--seed", min=0, max=10_000_000, help="Of simulated statistics.")
]
DiscrepancyFile = Annotated[
    Path | None,
    typer.Option("--discrepancy", "--mismatch", help="What `calibrate discrepancy` wrote."),
]


def renamed(command: Callable[..., None], old: str, new: str) -> Callable[..., None]:
    """The command of the verb `new` under its `old` name, with a line that says so."""

    @functools.wraps(command)
    def with_notice(*arguments, **options) -> None:
        print(f"`calibrate {old}` is now `calibrate {new}`", file=sys.stderr)
        command(*arguments, **options)

    return with_notice


def parse_changes(changes: Sequence[str], conventions: str | None = None) -> dict[str, float]:
    """`--set name=value` options as numbers in SI units; `conventions` are those of the lab."""
    from calibrate.io.conventions import check_values
    from calibrate.io.labfile import check_parameter

    values = {}
    for change in changes:
        name, equals, value = change.partition("=")
        if not equals:
            raise InputError(COMMAND_LINE, f"--set {change}", "no '='", "write name=value")
        values[name.strip()] = check_parameter(
            name.strip(), value.strip(), COMMAND_LINE, f"--set {name.strip()}"
        )
    if conventions is not None:
        check_values(conventions, values, COMMAND_LINE, "--set ")
    return values
