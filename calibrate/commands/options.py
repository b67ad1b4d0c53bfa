"""Options of the command line that several verbs share, and what they mean.

Options that are wrong raise `InputError` with the option's name as the field.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calibrate.core.errors import COMMAND_LINE, CalibrationError, InputError

if TYPE_CHECKING:
    from calibrate.verbs.base import AbstractResult

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
    typer.Option("--library", help="Library of runs; default: the bundled one."),
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
    typer.Option("--discrepancy", help="What `calibrate discrepancy` wrote."),
]


def parse_changes(changes: Sequence[str] | None) -> dict[str, str]:
    """`--set name=value` options by name; the verb reads the values."""
    values = {}
    for change in changes or ():
        name, equals, value = change.partition("=")
        if not equals:
            raise InputError(COMMAND_LINE, f"--set {change}", "no '='", "write name=value")
        values[name.strip()] = value.strip()
    return values


def answer(
    json: Path | None, files: str, verb: Callable[..., "AbstractResult"], /, *arguments: Any,
    **options: Any,
) -> None:  # fmt: skip
    """Does what a verb does, writes `--json`, and shows what was found and where its `files` are;
    also where it then could not go on."""
    from rich.console import Console
    from rich.text import Text

    from calibrate.core.files import check_writable

    check_writable(json)
    try:
        found, error = verb(*arguments, **options), None
    except CalibrationError as stopped:
        found, error = stopped.result, stopped
    if found is not None:
        if json is not None:
            found.to_json(json)
        console = Console()
        for part in found.words():
            console.print(part, soft_wrap=not console.is_terminal and isinstance(part, Text))
        if files:
            print(f"{files} are in {found.folder}")
    if error is not None:
        raise error
