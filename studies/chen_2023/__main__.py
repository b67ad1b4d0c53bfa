"""Puts the paper's published figures beside what its own printed tables give.

python -m studies.chen_2023        a few seconds
"""

import sys
from pathlib import Path

import typer

from calibrate import cli
from calibrate.verbs.command import typed
from calibrate.verbs.options import Json, Out

NAME = "python -m studies.chen_2023"
app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
@typed
def reproduce_command(out: Out = Path("results/reproduce"), json: Json = None) -> None:
    """Put the paper's published figures beside what its own printed tables give."""
    from rich.console import Console

    from calibrate.core.files import check_writable, make_folder
    from studies.chen_2023 import paper, report

    check_writable(json)
    folder = Path(out)
    make_folder(folder)
    result = paper.reproduce()
    report.write(result, folder, json)
    report.show(result, Console())
    print(f"page and JSON in {folder}")


if __name__ == "__main__":
    cli.run(app, NAME, sys.argv[1:])
