"""What results have in common: JSON, one text for terminal and notebook, a picture."""

import abc
import functools
import inspect
import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from html import escape
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, ForwardRef, Generic, ParamSpec, TypeVar, get_args

from rich.console import Console, RenderableType
from rich.text import Text

from calibrate import figures
from calibrate.core import runtime
from calibrate.core.errors import COMMAND_LINE, BadValue, CalibrationError, InputError, shown
from calibrate.core.files import as_json, write_text
from calibrate.core.units import FRACTION, LENGTH, positive_quantity, unsigned_quantity
from calibrate.io.labfile import check_parameter
from calibrate.records.base import Record, record

if TYPE_CHECKING:
    from calibrate.figures import Figure

P = ParamSpec("P")
R = TypeVar("R")
Kept = TypeVar("Kept", bound="Record")
WIDTH = 110  # characters of a line in a notebook


class AbstractResult(abc.ABC):
    """What a verb found.

    Printed, it is what the command line shows; at the end of a notebook's cell it is the same in
    HTML.  `folder` holds the files that the verb wrote; `files` names those that are no pictures,
    where the words do not.  `content` is everything that was found, as plain data with the keys of
    the JSON file.
    """

    files: ClassVar[tuple[str, ...]] = ()
    folder: Path
    content: dict

    @abc.abstractmethod
    def words(self) -> Iterator[RenderableType]:
        """Tables and sentences, as the terminal shows them."""

    def written(self) -> tuple[str, ...]:
        """What lies in the folder, pictures last; empty where the words say it."""
        return self.files

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
    """A result whose pictures stand in `calibrate.figures.FIGURES`."""

    verb: ClassVar[str]  # under which they stand there
    pictures: ClassVar[str] = "{}.png"  # where they lie in the folder

    @property
    @abc.abstractmethod
    def drawn(self) -> tuple:
        """What each picture is drawn from: the arguments of its function."""

    def plot(self, name: str | None = None) -> "Figure":
        """A picture of the result.

        Args:
            name: that of its file, without .png; None: the first.

        Returns:
            A matplotlib figure: a notebook shows it, `figure.savefig("name.png")` keeps it.

        Raises:
            InputError: the verb has no picture of this name.
            CalibrationError: this result has nothing that the picture would show.
        """
        known = figures.functions(self.verb)
        if name is not None and name not in known:
            raise InputError("arguments", "name", f"no picture {shown(name)}", f"give {_or(known)}")
        for each in known if name is None else [name]:
            if (figure := known[each](*self.drawn)) is not None:
                return figures.closed(figure)
        raise CalibrationError(f"nothing was found that the picture {_or([each])} would show")

    def save_figures(self) -> None:
        """Writes all of them to the folder."""
        for name, draw in figures.functions(self.verb).items():
            if (figure := draw(*self.drawn)) is not None:
                figures.save(figure, self.folder / self.pictures.format(name))

    def written(self) -> tuple[str, ...]:
        pictures = (Path(self.pictures.format(name)) for name in figures.FIGURES[self.verb])
        names = dict.fromkeys(path.parts[0] for path in pictures)
        return (*self.files, *names) if self.files else ()


class AbstractRecordedResult(AbstractDrawnResult, Generic[Kept]):
    """A result whose content is that of a record, from which its pictures are drawn."""

    kind: ClassVar[type[Record]]  # the record's class

    @functools.cached_property
    def record(self) -> Kept:
        """The whole result with typed entries."""
        return record(self.kind, self.content)  # pyright: ignore[reportReturnType]

    @property
    def drawn(self) -> tuple:
        """The record."""
        return (self.record,)


def _or(names: Iterable[str]) -> str:
    return " or ".join(f'"{name}"' for name in names)


def verb(function: Callable[P, R]) -> Callable[P, R]:
    """A function that sets JAX up before it computes, refuses numbers outside the limits of its
    options, and calls arguments by their own names where the command line would call them options.
    """
    signature = inspect.signature(function)
    options = {name: get_args(p.annotation)[1] for name, p in signature.parameters.items()}

    @functools.wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> R:
        runtime.configure()
        try:
            _check_limits(options, kwargs)
            return function(*args, **kwargs)
        except InputError as error:
            if runtime.COMMAND.get():
                raise
            raise _in_arguments(error, options) from None

    called.__signature__ = _in_python(signature)  # pyright: ignore[reportAttributeAccessIssue]
    return called


def _in_python(signature: inspect.Signature) -> inspect.Signature:
    """A signature without what is for the command line, as `help` and notebooks show it."""
    parameters = []
    for parameter in signature.parameters.values():
        kind = get_args(parameter.annotation)[0]
        shown = kind.__forward_arg__ if isinstance(kind, ForwardRef) else kind
        parameters.append(parameter.replace(annotation=shown))
    return signature.replace(parameters=parameters)


def _check_limits(options: Mapping[str, Any], given: Mapping[str, Any]) -> None:
    """Refuses numbers that the command line would refuse; a limit of None is no end."""
    for name, option in options.items():
        value, low, high = given.get(name), option.min, option.max
        if value is None or low is None:
            continue
        if not isinstance(value, Integral) or value < low or (high and value > high):
            ends = f"from {low} on" if high is None else f"from {low} to {high}"
            problem = f"{shown(value, 20)} is no whole number {ends}"
            raise InputError(COMMAND_LINE, f"--{name}", problem, f"give one {ends}")


def listed(names: str | Sequence[str]) -> tuple[str, ...]:
    """Names, given one by one or in one text with commas."""
    given = names.split(",") if isinstance(names, str) else names
    return tuple(name.strip() for name in given if name.strip())


OPTION = re.compile(r"--([a-z][a-z-]*)")  # of the command line


def _in_arguments(error: InputError, options: Mapping[str, Any]) -> InputError:
    """The same refusal in the words of a Python program."""
    file, field = error.file, error.field
    if file == COMMAND_LINE:
        name, _, rest = _as_arguments(field).partition(" ")
        called = {_flag(option): argument for argument, option in options.items()}
        file, field = "arguments", f"{called.get(name, name)}.{rest}".rstrip(".")
    return InputError(file, field, _as_arguments(error.problem), _as_arguments(error.repair))


def _flag(option: Any) -> str:
    """The name of an option, as an argument; "" of a positional argument."""
    return _as_arguments(str(option.default)) if option.default is not ... else ""


def _as_arguments(text: str) -> str:
    """Options as arguments."""
    return OPTION.sub(lambda found: found[1].replace("-", "_"), text)


def parameter_values(values: Mapping[str, float | str] | None) -> dict[str, float]:
    """Parameters by name as numbers in SI units, checked."""
    return {
        name: check_parameter(name, value, COMMAND_LINE, f"--set {name}")
        for name, value in (values or {}).items()
    }


def understood(option: str, text: str | None, read: Callable[[str], R]) -> R | None:
    """What an option's text says; None where it is not given."""
    try:
        return None if text is None else read(text)
    except BadValue as bad:
        raise bad.at(COMMAND_LINE, option) from None


def length(text: str) -> float:
    """A length with its unit, in m."""
    return positive_quantity(text, LENGTH)


def fraction(text: str) -> float:
    """A share with its unit, such as "8 %"."""
    return unsigned_quantity(text, FRACTION)


def line(sentence: str) -> Text:
    """A sentence as it stands: brackets are no markup, numbers not coloured."""
    return Text(sentence)
