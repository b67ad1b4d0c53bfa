"""Verbs of the command line that bring data in and parameters out, one per file.

Each file has `register(app)`, which adds its command to the program in `calibrate.cli`.
"""

import typer

from calibrate.verbs import bank, convert, diagnose, export, report, view, withheld

VERBS = (convert, diagnose, withheld, bank, report, export, view)


def register(app: typer.Typer) -> None:
    """Adds all verbs of this folder to the program."""
    for verb in VERBS:
        verb.register(app)
