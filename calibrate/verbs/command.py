"""The command of a verb, made from its signature, and what becomes of its result.

`calibrate --help` loads no verb, and `calibrate VERB --help` only its signature.  That would not
need the second half of this file if Python could put off an import until it is used (PEP 810).
"""

import builtins
import importlib
import importlib.util
import inspect
import pkgutil
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_origin

import typer
import typer.core

from calibrate.core.errors import CalibrationError
from calibrate.verbs import VERBS
from calibrate.verbs.options import Json, Typed

if TYPE_CHECKING:
    from calibrate.verbs.base import AbstractResult

FIRST_PARAGRAPH = re.compile(r'"""(.+?)(?:\n\n|""")', re.DOTALL)


def summary(name: str) -> str:
    """What a verb does: the first paragraph of its file, which is not loaded for it."""
    source = pkgutil.get_data("calibrate.verbs", f"{name}.py") or b""
    found = FIRST_PARAGRAPH.match(source.decode("utf-8"))
    return " ".join(found[1].split()) if found else ""


class VerbCommand(typer.core.TyperCommand):
    """A command by name and help alone, which is built when it is called."""

    def make_context(self, info_name, args, parent=None, **extra):
        built = command_of(self.name or "", only_help="--help" in args)
        return built.make_context(info_name, args, parent, **extra)


def command_of(name: str, only_help: bool = False) -> Any:
    """The command of a verb.

    Args:
        name: of the verb, as it is typed.
        only_help: what the verb computes with is not loaded, so that it cannot run.

    Returns:
        Typer's command.
    """
    module = f"calibrate.verbs.{name}"
    light = only_help and module not in sys.modules
    found = _signature_only(module) if light else importlib.import_module(module)
    program = typer.Typer(add_completion=False)
    program.command(name, help=summary(name))(_answering(getattr(found, VERBS[name])))
    return typer.main.get_command(program)


def typed(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function whose arguments have the types that are typed for those of `function`."""
    parameters = inspect.signature(inspect.unwrap(function)).parameters

    def called(**given: Any) -> Any:
        in_order, by_name = [], {}
        for name, parameter in parameters.items():
            if given.get(name) is None:
                continue  # the function's own default holds
            value = _typed_of(parameter).read(given[name])
            if parameter.kind is parameter.VAR_POSITIONAL:
                in_order += value
            else:
                by_name[name] = value
        return function(*in_order, **by_name)

    signature = inspect.Signature([_on_command_line(each) for each in parameters.values()])
    called.__signature__ = signature  # pyright: ignore[reportFunctionMemberAccess]
    called.__name__, called.__doc__ = function.__name__, function.__doc__
    return called


def _typed_of(parameter: inspect.Parameter) -> Typed:
    """What is typed for an argument: `Typed`, or the argument as it stands."""
    kind, _, *other = get_args(parameter.annotation)
    return other[0] if other else Typed(kind)


def _on_command_line(parameter: inspect.Parameter) -> inspect.Parameter:
    """The argument as Typer reads it; options that may be repeated are not given by default."""
    kind, option = _typed_of(parameter).kind, get_args(parameter.annotation)[1]
    repeats = any(get_origin(each) is list for each in (kind, *get_args(kind)))
    needed = parameter.default is parameter.empty
    default = None if repeats and not needed else parameter.default
    return parameter.replace(
        kind=parameter.KEYWORD_ONLY, annotation=Annotated[kind, option], default=default
    )  # fmt: skip


# ---------------------------------------------------------------- from a result to the terminal


def _answering(verb: Callable[..., "AbstractResult"]) -> Callable[..., None]:
    """A verb that shows what it found, with an option --json beside its own."""
    call = typed(verb)

    def called(json: Path | None, **given: Any) -> None:
        answer(json, lambda: call(**given))

    signature = inspect.signature(call)
    last = inspect.Parameter("json", inspect.Parameter.KEYWORD_ONLY, annotation=Json, default=None)
    parameters = [*signature.parameters.values(), last]
    called.__signature__ = inspect.Signature(parameters)  # pyright: ignore[reportFunctionMemberAccess]
    return called


def answer(json: Path | None, work: Callable[[], "AbstractResult"]) -> None:
    """Does what a verb does, writes `--json`, and shows what was found and where its files are;
    also where it then could not go on."""
    from rich.console import Console
    from rich.text import Text

    from calibrate.core.files import check_writable

    check_writable(json)
    try:
        found, error = work(), None
    except CalibrationError as stopped:
        found, error = stopped.result, stopped
    if found is not None:
        if json is not None:
            found.to_json(json)
        console = Console()
        for part in found.words():
            console.print(part, soft_wrap=not console.is_terminal and isinstance(part, Text))
        if found.written():
            *first, last = found.written()
            named = f"{', '.join(first)} and {last} are" if first else f"{last} is"
            print(f"{named} in {found.folder}")
    if error is not None:
        raise error


# ---------------------------------------------------------------- a signature and nothing else

LIGHT = {*sys.stdlib_module_names, "typer", "rich"}
OURS = ("calibrate.core.errors", "calibrate.verbs", "calibrate.verbs.options")


class _StandIn(type):
    """In place of a module that a verb computes with, and of every name in it."""

    def __getattr__(cls, name: str) -> "_StandIn":
        if name.startswith("__"):
            raise AttributeError(name)
        return _StandIn(name, (), {})


def _signature_only(name: str) -> ModuleType:
    """A verb's file, run with stand-ins for what it computes with: JAX alone takes a second."""
    spec = importlib.util.find_spec(name)
    if spec is None or spec.loader is None:
        raise ModuleNotFoundError(name)
    module = importlib.util.module_from_spec(spec)
    vars(module)["__builtins__"] = {**vars(builtins), "__import__": _import}
    spec.loader.exec_module(module)
    return module


def _import(name: str, globals=None, locals=None, fromlist=(), level: int = 0) -> Any:
    """What an import statement of such a file finds."""
    if name.partition(".")[0] in LIGHT or name in OURS:
        return builtins.__import__(name, globals, locals, fromlist, level)
    if name.startswith("calibrate.verbs."):
        return _signature_only(name)
    return _StandIn(name, (), {})
