"""Verbs of the command line, one per file.

Each file has `register(app)`, which adds its command to the program in `calibrate.cli`; what a
verb needs is imported when it runs, so that `--help` is quick.
"""

import typer

from calibrate.commands import (
    audit,
    contact,
    convert,
    diagnose,
    discrepancy,
    doe,
    export,
    fit,
    library,
    next_test,
    report,
    simulate,
    view,
)

VERBS = (
    simulate,
    fit,
    contact,
    audit,
    doe,
    convert,
    diagnose,
    next_test,
    library,
    discrepancy,
    report,
    export,
    view,
)


def register(app: typer.Typer) -> None:
    """Adds all verbs of this folder to the program."""
    for verb in VERBS:
        verb.register(app)
