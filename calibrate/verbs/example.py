"""List examples of laboratory tests, or run one: its lab file, numbers beside its reference."""

import time
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Annotated

import typer
from rich.console import RenderableType
from rich.table import Table

from calibrate.core.errors import COMMAND_LINE, CalibrationError, InputError, shown, suggestion
from calibrate.core.files import write_json, write_text
from calibrate.verbs import options
from calibrate.verbs.base import AbstractDrawnResult, line, verb
from calibrate.verbs.simulate import SimulationResult, simulate


@dataclass(frozen=True)
class Example:
    """What it shows, an estimate of its minutes on two cores, the preset that it is run at, what is
    public of the study that it follows, and the text of its lab file."""

    what: str
    minutes: float
    preset: str
    reference: str
    lab: str


@cache
def examples() -> Mapping[str, Example]:
    """All of them, by name."""
    text = (resources.files("calibrate") / "examples.toml").read_text(encoding="utf-8")
    return {name: Example(**table) for name, table in tomllib.loads(text).items()}


@dataclass(frozen=True, eq=False, repr=False)
class ExampleResult(AbstractDrawnResult):
    """One example, run; or the list of all.

    Attributes:
        folder: where its lab file, result.json and pictures are.
        content: name, reference, observables, seconds; or the list of examples.
        simulated: what `calibrate simulate` found; None for the list.
    """

    verb = "simulate"
    files = ("lab.toml", "result.json")
    folder: Path
    content: dict
    simulated: SimulationResult | None = None

    @property
    def observables(self) -> dict[str, float]:
        """Means over packings by name; empty for the list."""
        return self.content.get("observables", {})

    def words(self) -> Iterator[RenderableType]:
        if self.simulated is None:
            yield _listed(self.content["examples"])
            return
        yield from self.simulated.words()
        yield line(f"reference: {self.content['reference']}")

    @property
    def drawn(self) -> tuple:
        """That of the simulation."""
        if self.simulated is None:
            raise CalibrationError("a list of examples has no picture")
        return self.simulated.drawn

    def written(self) -> tuple[str, ...]:
        return () if self.simulated is None else (*self.files, "curves.png")


def _listed(rows: list[dict]) -> Table:
    table = Table("example", "what it shows", "minutes, about")
    for row in rows:
        table.add_row(row["name"], row["what"], f"{row['minutes']:g}")
    return table


@verb
def example(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="The one to run; default: list them.")
    ] = None,
    *,
    preset: Annotated[
        str | None, typer.Option("--preset", help="quick, standard or fine; default: its own.")
    ] = None,
    seed: options.Seed = 0,
    out: Annotated[
        str | Path | None,
        typer.Option("--out", help="Folder for results; default: results/example/NAME."),
        options.Typed(Path | None),
    ] = None,
) -> ExampleResult:
    """Lists examples of laboratory tests, or runs one of them.

    An example writes its lab file, which is a start for one of your own, and simulates its tests.

    Args:
        name: of the example to run; None: they are listed.
        preset: "quick", "standard" or "fine": how many spheres and packings; None: its own.
        seed: choice of packings, from 0.
        out: folder for results; None: results/example/NAME.

    Returns:
        The numbers of the example beside its reference; or the list.

    Raises:
        InputError: no example has this name.
        CalibrationError: every packing failed.

    Example:
        >>> [row["name"] for row in calibrate.example().content["examples"]]
    """
    known = examples()
    if name is None:
        rows = [{"name": n, "what": e.what, "minutes": e.minutes} for n, e in known.items()]
        return ExampleResult(Path("."), {"examples": rows})
    if name not in known:
        problem = f"no example is called {shown(name)}"
        raise InputError(COMMAND_LINE, "NAME", problem, suggestion(name, known))
    chosen = known[name]
    folder = Path(f"results/example/{name}" if out is None else out)
    write_text(folder / "lab.toml", chosen.lab.lstrip())
    begun = time.monotonic()
    found = simulate(folder / "lab.toml", preset=preset or chosen.preset, seed=seed, out=folder)
    content = {
        "name": name,
        "reference": chosen.reference,
        "observables": found.observables,
        "spread": found.spread,
        "seconds": time.monotonic() - begun,
    }
    write_json(folder / "example.json", content)
    return ExampleResult(folder, content, found)
