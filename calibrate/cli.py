"""The command line `calibrate`: all verbs, and what becomes of errors.

Exit status 0 done, 2 the input is wrong (one line on standard error that names file,
field and repair), 1 anything else.
"""

import atexit
import gc
import os
import shlex
import sys
from collections.abc import Sequence
from typing import Annotated, NoReturn

import typer

from calibrate.core.errors import CalibrationError, InputError, one_line
from calibrate.verbs import VERBS, command

# Before numpy is loaded: its matrices here are small, and with two threads that wait for each other
# a diagnosis took 25 s instead of 17 s.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

PACKAGE = "differentiable-soil"  # under which it is installed

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

for verb in VERBS:
    app.command(verb, cls=command.VerbCommand, help=command.summary(verb))(lambda: None)


def _show_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        here = ".".join(map(str, sys.version_info[:3]))
        print(f"calibrate {version(PACKAGE)}, JAX {version('jax')}, Python {here}")
        raise typer.Exit


@app.callback()
def program(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Say it and stop."),
    ] = False,
) -> None:
    """Calibrate a virtual soil against laboratory tests, by gradient."""


def main() -> None:
    """Entry point of `calibrate`."""
    run(app, "calibrate", sys.argv[1:] or ["--help"])


def run(program: typer.Typer, name: str, arguments: Sequence[str]) -> None:
    """Runs a program of that name: wrong input becomes one line and exit status 2."""
    from calibrate.core import runtime

    _spare_collections()
    if not HELP & set(arguments):
        _configure()
    typed = runtime.COMMAND.set(shlex.join([*name.split(), *arguments]))
    try:
        status = program(list(arguments), standalone_mode=False)
    except InputError as error:
        _leave(2, f"error: {error}")
    except CalibrationError as error:
        _leave(1, f"error: {error}")
    except OSError as error:
        _leave(1, f"error: {one_line(str(error))}; {STOPPED}")
    except (KeyboardInterrupt, typer.Abort):
        _leave(1, STOPPED)
    except typer.exceptions.TyperException as error:
        _leave(2, f"error: command line: {one_line(error.format_message())}; see {name} --help")
    finally:
        runtime.COMMAND.reset(typed)
    if status == INTERRUPTED:
        _leave(1, STOPPED)


HELP = {"--help", "--version"}  # what computes nothing
STOPPED = "stopped; the same command goes on from here"
INTERRUPTED = 130  # what Typer makes of Ctrl-C


def _leave(status: int, line: str) -> NoReturn:
    print(line, file=sys.stderr)
    raise SystemExit(status)


def _spare_collections() -> None:
    """Looks for cyclic garbage seldom, and not at all on the way out: modules and traced programs
    are hundreds of thousands of objects that stay; walking them took a second of every command."""
    gc.set_threshold(50_000, 20, 20)
    atexit.register(gc.freeze)


def _configure() -> None:
    from calibrate.core import runtime

    runtime.configure()


if __name__ == "__main__":
    main()
