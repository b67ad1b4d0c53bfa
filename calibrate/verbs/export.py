"""Write a soil's parameters for another program, with uncertainty and scale-up note."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import RenderableType

from calibrate.core.errors import COMMAND_LINE, InputError
from calibrate.core.files import make_folder, write_text
from calibrate.exporters import notes
from calibrate.exporters.composite import EXPORTERS, NAMES
from calibrate.exporters.parameters_json import content as content_of
from calibrate.exporters.source import Found, find, find_draws
from calibrate.verbs import options
from calibrate.verbs.base import (
    AbstractDrawnResult,
    fraction,
    length,
    line,
    parameter_values,
    understood,
    verb,
)
from calibrate.verbs.fit import FitResult

FOLDER = Path("results/export")


@dataclass(frozen=True, eq=False, repr=False)
class ExportResult(AbstractDrawnResult):
    """Parameters in the words of another program.

    Attributes:
        path: the file that was written.
        text: what it holds.
        found: the parameters, their intervals, and what the fit warned of.
        folder: where the file is.
        content: every parameter with unit and interval, and the surface energy at the wanted size.
    """

    verb = "export"
    path: Path
    text: str
    found: Found
    folder: Path
    content: dict

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the fit warned of."""
        return self.found.warnings

    def words(self) -> Iterator[RenderableType]:
        yield from map(line, [*notes.heading(self.found), *notes.scale_up(self.found)])
        yield line(f"written to {self.path}")

    @property
    def drawn(self) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
        """Parameters (SI) and the 95 % intervals of those that were fitted."""
        return self.found.values, self.found.intervals


@verb
def export(
    source: Annotated[
        FitResult | str | Path,
        typer.Argument(metavar="DIR", help="Folder of a fit, or a lab file (its start)."),
        options.Typed(Path),
    ],
    *,
    to: Annotated[
        str, typer.Option("--to", help="Program or format: liggghts, ... (docs/export.md).")
    ],
    diameter: Annotated[
        str | None,
        typer.Option("--diameter", help='Of your particles: "4 mm"; default: as calibrated.'),
    ] = None,
    values: options.Changes = None,
    out: Annotated[
        str | Path | None,
        typer.Option("--out", help="File to write; default: in results/export."),
        options.Typed(Path | None),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Also of a fit that missed its data.")
    ] = False,
    moisture: Annotated[
        str | None,
        typer.Option("--moisture", help='"8 %": where parameters differ with it, which of them.'),
    ] = None,
    draws: Annotated[
        int, typer.Option("--draws", min=0, max=100, help="Soils of a posterior, a file each.")
    ] = 0,
) -> ExportResult:
    """Writes a soil's parameters for another program, with uncertainty and a note on scaling.

    Args:
        source: what `fit` returned, the folder of a fit, or a lab file (its starting values).
        to: "liggghts", "edem", "yade" or "json".
        diameter: of your particles, with its unit ("4 mm"); None: as calibrated.
        values: parameters in place of the fitted ones, by name, in SI units or with a unit.
        out: the file to write; None: in results/export.
        force: also of a fit that missed its data.
        moisture: of the soil, with its unit ("8 %"), where parameters differ with it; None: they do
            not.
        draws: so many soils of the folder of a posterior, spread along what its tests leave most
            open, each in a file of its own in the folder `out`; 0: the parameters of a fit.

    Returns:
        The text and where it was written.

    Raises:
        InputError: the source is no fit, the fit missed its data, or an argument is wrong.

    Example:
        >>> calibrate.export("results/fit", to="yade", diameter="4 mm")
    """
    if to not in EXPORTERS:
        raise InputError(COMMAND_LINE, "--to", f"no program '{to}'", f"give {NAMES}")
    place = Path(source) if isinstance(source, str | Path) else source.folder
    changed, size = parameter_values(values), understood("--diameter", diameter, length)
    if draws:
        every = find_draws(place, draws, changed, size)
        return _each_in_a_file(every, EXPORTERS[to], FOLDER / "draws" if out is None else Path(out))
    found = find(place, changed, size, understood("--moisture", moisture, fraction))
    if found.missed and not force:
        repair = "fit again, or give --force to export it all the same, with this warning"
        rest = len(found.missed) - 1
        problem = found.missed[0] + (f", and {rest} more" if rest else "")
        raise InputError(str(place), "", problem, repair)
    exporter = EXPORTERS[to]
    text = exporter.text(found)
    path = FOLDER / exporter.FILE if out is None else Path(out)
    if path.is_dir():
        raise InputError(COMMAND_LINE, "--out", f"{path} is a folder", "give the name of a file")
    make_folder(path.parent)
    write_text(path, text)
    return ExportResult(path, text, found, path.parent, content_of(found))


def _each_in_a_file(every: Sequence[Found], exporter: Any, folder: Path) -> ExportResult:
    """Soils as numbered files of a folder; the one in the middle as the result."""
    make_folder(folder)
    for number, found in enumerate(every, 1):
        write_text(folder / f"{number:02d}_{exporter.FILE}", exporter.text(found))
    found = every[len(every) // 2]
    return ExportResult(folder, exporter.text(found), found, folder, content_of(found))
