"""What results have in common: JSON, one text for terminal and notebook, a picture."""

import abc
import functools
import io
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np
from rich.console import Console, RenderableType
from rich.text import Text

from calibrate.core import runtime
from calibrate.core.errors import COMMAND_LINE, InputError, shown
from calibrate.core.files import as_json, write_text
from calibrate.figures import Figure
from calibrate.io.conventions import check_values
from calibrate.io.labfile import check_parameter

P = ParamSpec("P")
R = TypeVar("R")
# Whole numbers and what they may be, as on the command line; None: no end.
LIMITS = {
    "seed": (0, 10_000_000),
    "spheres": (30, None),
    "packings": (2, None),
    "simulate": (0, 400),
    "batch": (2, None),
}
RENAMED = {"set": "values", "strategy": "strategies"}  # options that are called otherwise here
WIDTH = 110  # characters of a line in a notebook


class AbstractResult(abc.ABC):
    """What a verb found.

    Printed, it is what the command line shows; at the end of a notebook's cell it is the same in
    HTML.  `folder` holds the files that the verb wrote, `content` everything that was found, as
    plain data with the keys of the JSON file.
    """

    folder: Path
    content: dict

    @abc.abstractmethod
    def words(self) -> Iterator[RenderableType]:
        """Tables and sentences, as the terminal shows them."""

    def to_json(self, path: str | Path | None = None) -> str:
        """The result as JSON text.

        Args:
            path: file to write the text to; None: none.

        Returns:
            The text; numbers that are not known stand there as null.
        """
        text = as_json(self.content)
        if path is not None:
            write_text(Path(path), text)
        return text

    def __rich_console__(self, console: Console, options) -> Iterator[RenderableType]:
        yield from self.words()

    def __repr__(self) -> str:
        console = Console(file=io.StringIO(), width=WIDTH, color_system=None)
        with console.capture() as text:
            console.print(self)
        return text.get().rstrip("\n")

    def _repr_html_(self) -> str:
        return f"<pre>{escape(repr(self))}</pre>"


class AbstractDrawnResult(AbstractResult):
    """A result that has a picture."""

    @abc.abstractmethod
    def plot(self) -> Figure:
        """The picture of the result.

        Returns:
            A matplotlib figure: a notebook shows it, `figure.savefig("name.png")` keeps it.
        """


def verb(function: Callable[P, R]) -> Callable[P, R]:
    """A function that sets JAX up before it computes, and calls arguments by their own names where
    the command line would call them options."""

    @functools.wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> R:
        runtime.configure()
        try:
            _check_limits(kwargs)
            return function(*args, **kwargs)
        except InputError as error:
            if runtime.COMMAND.get():
                raise
            raise _in_arguments(error) from None

    return called


def _check_limits(options: Mapping[str, Any]) -> None:
    """Refuses numbers outside `LIMITS`."""
    for name, (low, high) in LIMITS.items():
        value = options.get(name)
        if value is None:
            continue
        if not isinstance(value, int | np.integer) or value < low or (high and value > high):
            ends = f"from {low} on" if high is None else f"from {low} to {high}"
            problem = f"{shown(value, 20)} is no whole number {ends}"
            raise InputError(COMMAND_LINE, f"--{name}", problem, f"give one {ends}")


def listed(names: str | Sequence[str]) -> tuple[str, ...]:
    """Names, given one by one or in one text with commas."""
    given = names.split(",") if isinstance(names, str) else names
    return tuple(name.strip() for name in given if name.strip())


OPTION = re.compile(r"--([a-z][a-z-]*)")  # of the command line


def _in_arguments(error: InputError) -> InputError:
    """The same refusal in the words of a Python program."""
    file, field = error.file, error.field
    if file == COMMAND_LINE:
        name, _, rest = _as_arguments(field).partition(" ")
        file, field = "arguments", f"{RENAMED.get(name, name)}.{rest}".rstrip(".")
    return InputError(file, field, _as_arguments(error.problem), _as_arguments(error.repair))


def _as_arguments(text: str) -> str:
    """Options as arguments."""
    return OPTION.sub(lambda found: found[1].replace("-", "_"), text)


def parameter_values(
    values: Mapping[str, float | str] | None, conventions: str | None = None
) -> dict[str, float]:
    """Parameters by name as numbers in SI units, checked; also against the lab's conventions."""
    found = {
        name: check_parameter(name, value, COMMAND_LINE, f"--set {name}")
        for name, value in (values or {}).items()
    }
    if conventions is not None:
        check_values(conventions, found, COMMAND_LINE, "--set ")
    return found


def line(sentence: str) -> Text:
    """A sentence as it stands: brackets are no markup, numbers not coloured."""
    return Text(sentence)
