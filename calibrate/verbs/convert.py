"""Turn exports of testing machines into clean curves and a lab file for `calibrate fit`."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.console import RenderableType

from calibrate.core.errors import COMMAND_LINE, InputError, shown
from calibrate.core.files import make_folder, write_json, write_text
from calibrate.instrument_import import labtext, toollab
from calibrate.instrument_import.columns import further_kinds
from calibrate.instrument_import.convert import Export, file_stem, joined, read_export
from calibrate.instrument_import.measured import Units
from calibrate.instrument_import.sizes import (
    Size,
    initial_void_ratios,
    normal_stresses,
    settlements,
    tool_sizes,
)
from calibrate.instrument_import.specimens import Specimen
from calibrate.instrument_import.strengths import Strengths
from calibrate.instrument_import.toollab import ToolTest
from calibrate.instrument_import.unittext import Unit, doubt, unit_of
from calibrate.instrument_import.vocabulary import RECORDED, TESTS, Kinds
from calibrate.io.lab import Lab, load_lab
from calibrate.verbs import options
from calibrate.verbs.base import AbstractDrawnResult, length, line, understood, verb

EXAMPLES = {"force": "kN", "displacement": "mm", "stress": "kPa", "strain": "%", "time": "min"}


@dataclass(frozen=True, eq=False, repr=False)
class ConvertResult(AbstractDrawnResult):
    """What a testing machine's export holds.

    Attributes:
        export: specimens as read and kept, with what was assumed of each.
        lab_file: the lab file that was written.
        folder: where it is, with the curves, convert.json and preview.png.
        tests: with a tool, and the numbers that their curves hold.
    """

    verb = "convert"
    export: Export
    lab_file: Path
    folder: Path
    content: dict
    tests: tuple[ToolTest, ...] = ()

    @property
    def lab(self) -> Lab:
        """The lab file, read."""
        return load_lab(self.lab_file)

    @property
    def warnings(self) -> list[str]:
        """What to look at before the curves are used, one sentence each."""
        found = [f.text for each in self.export.specimens for f in each.findings if f.fault]
        return [*found, *self.export.skipped]

    def words(self) -> Iterator[RenderableType]:
        yield from map(line, self._sentences())

    def _sentences(self) -> Iterator[str]:
        """One line a specimen, then what was assumed, warnings last."""
        read = self.export
        yield f"{read.file}: {read.layout}"
        for specimen in read.specimens:
            yield (
                f"{specimen.label}: {specimen.test}, {len(specimen.force_n)} points, "
                f"up to {specimen.force_n.max():.4g} N and {specimen.displacement_mm.max():.4g} mm"
            )
            for finding in sorted(specimen.findings, key=lambda f: f.fault):
                yield f"  {'WARNING: ' if finding.fault else ''}{finding.text}"
        if read.strengths is not None:
            force = read.strengths.force_n
            yield f"{read.strengths.test}: {len(force)} strengths, {force.mean():.4g} N in the mean"
            yield from (f"  {note}" for note in read.strengths.notes)
        yield from toollab.sentences(self.tests)
        yield from (f"WARNING: {sentence}" for sentence in read.skipped)
        yield f"look at {self.folder / 'preview.png'}, then: calibrate fit {self.lab_file}"

    @property
    def drawn(self) -> tuple[Export]:
        """Specimens as recorded and as kept."""
        return (self.export,)


@verb
def convert(
    *exports: Annotated[
        str | Path,
        typer.Argument(metavar="EXPORT...", help=".csv, .txt or .xlsx files of one soil."),
        options.Typed(list[Path]),
    ],
    test: Annotated[
        str | None,
        typer.Option("--test", help="Its type (calibrate.labtests); default: found out."),
    ] = None,
    diameter: Annotated[
        str | None, typer.Option("--diameter", help="Of the specimen, for stresses: 50 mm.")
    ] = None,
    height: Annotated[
        str | None, typer.Option("--height", help="Of the specimen, for strains: 100 mm.")
    ] = None,
    void_ratio: Annotated[
        str | None,
        typer.Option("--void-ratio", help="Initial one (e0), or one a specimen: 1.2,1.3; first."),
    ] = None,
    settlement: Annotated[
        str | None,
        typer.Option("--settlement", help="Whole one of a degree of consolidation: 0.2 mm, 1 %."),
    ] = None,
    tool: Annotated[
        str | None,
        typer.Option("--tool", help="Width of a vane, cone, plate or box, or more: 20 x 40 mm."),
    ] = None,
    normal_stress: Annotated[
        str | None,
        typer.Option("--normal-stress", help="Of direct shear, or one a specimen: 50 kPa,100 kPa."),
    ] = None,
    points: Annotated[
        bool | None, typer.Option("--points/--curve", help="Rows are load steps, or a curve.")
    ] = None,
    force_unit: Annotated[
        str | None, typer.Option("--force-unit", help="Unit of force, against the file: kN.")
    ] = None,
    displacement_unit: Annotated[
        str | None, typer.Option("--displacement-unit", help="Unit of travel, against the file.")
    ] = None,
    stress_unit: Annotated[
        str | None, typer.Option("--stress-unit", help="Unit of stress, against the file: MPa.")
    ] = None,
    strain_unit: Annotated[
        str | None, typer.Option("--strain-unit", help="Unit of strain, against the file: % or -.")
    ] = None,
    time_unit: Annotated[
        str | None, typer.Option("--time-unit", help="Unit of time, against the file: min.")
    ] = None,
    out: options.Folder = "results/convert",
) -> ConvertResult:
    """Turns exports of testing machines into clean curves and a lab file for `fit`.

    Args:
        exports: .csv, .txt or .xlsx files of one soil.
        test: which test it is ("confined", "oedometer", ..., "vane_shear"); None: found out.
        diameter: of the specimen, with its unit ("50 mm"), for stresses.
        height: of the specimen, with its unit, for strains.
        void_ratio: the initial one, or one a specimen ("1.2,1.3"), or "first".
        settlement: the whole one of a degree of consolidation ("0.2 mm", "1 %").
        tool: width of a vane, cone, plate or box, or more ("20 x 40 mm", "36 cm^2").
        normal_stress: of direct shear ("50 kPa"), or one a specimen ("50 kPa, 100 kPa").
        points: rows are load steps (True) or a curve (False); None: found out.
        force_unit: unit of force, against the file ("kN").
        displacement_unit: unit of travel, against the file ("mm").
        stress_unit: unit of stress, against the file ("kPa").
        strain_unit: unit of strain, against the file ("%" or "-").
        time_unit: unit of time, against the file ("min").
        out: folder for results.

    Returns:
        Curves and what was assumed; lab file, curves, convert.json and preview.png in `out`.

    Raises:
        InputError: the export cannot be read without a doubt; says which option would settle it.

    Example:
        >>> read = calibrate.convert("export.csv", test="confined")
        >>> calibrate.fit(read.lab_file)
    """
    if not exports:
        raise InputError(COMMAND_LINE, "exports", "no file is given", "give an export's path")
    _check_test(test, {"--tool": tool, "--normal-stress": normal_stress}, points)
    kinds = further_kinds(RECORDED.get(test or ""))
    units = Units(
        force=_insisted("force", force_unit, kinds),
        displacement=_insisted("displacement", displacement_unit, kinds),
        stress=_insisted("stress", stress_unit),
        strain=_insisted("strain", strain_unit),
        time=_insisted("time", time_unit),
    )
    size = Size(
        diameter=understood("--diameter", diameter, length),
        height=understood("--height", height, length),
        void_ratios=understood("--void-ratio", void_ratio, initial_void_ratios),
        settlements=understood("--settlement", settlement, settlements),
        tool=understood("--tool", tool, tool_sizes) or (),
        normal_stresses=understood("--normal-stress", normal_stress, normal_stresses),
    )
    paths = [Path(export) for export in exports]
    read = joined([read_export(export, test, units, size, points) for export in paths])
    return _kept(read, Path(out))


def _check_test(test: str | None, of_tools: dict[str, str | None], points: bool | None) -> None:
    """Refuses a test that no export is read as, and options of another one."""
    known = [*sorted(TESTS), *RECORDED]
    if test is not None and test not in known:
        repair = f"give one of {', '.join(known)}"
        raise InputError(COMMAND_LINE, "--test", f"no test '{test}'", repair)
    record = RECORDED.get(test or "")
    if record is not None and points:
        problem = f"a {test} test has no load steps"
        raise InputError(COMMAND_LINE, "--points", problem, "leave it out")
    for option, given in of_tools.items():
        fits = record is not None and (option == "--tool" or record.condition)
        if given is not None and not fits:
            problem = (
                f"it says nothing of {f'a {test} test' if test else 'a test that is found out'}"
            )
            wanted = RECORDED if option == "--tool" else ["direct_shear"]
            repair = f"give --test, one of {', '.join(wanted)}, or leave it out"
            raise InputError(COMMAND_LINE, option, problem, repair)


def _kept(read: Export, out: Path) -> ConvertResult:
    """Writes curves, lab file, preview and convert.json."""
    tests = tuple(toollab.tool_tests(read))
    if read.strengths is None and not tests and not labtext.fitted(read):
        problem = "no specimen carries more than 2 N"
        option = "force" if read.is_plain else "stress"
        repair = f"check the unit of {option}, or give --{option}-unit"
        raise InputError(read.file, "", problem, repair)
    make_folder(out)
    lab = out / f"{file_stem(Path(read.file).stem)}.toml"
    for name, specimen in labtext.curve_files(read).items():
        write_text(out / name, (toollab if tests else labtext).curve_text(specimen))
    if read.strengths is not None:
        write_text(out / labtext.STRENGTHS_FILE, labtext.strengths_text(read.strengths))
    write_text(lab, toollab.lab_text(read, tests) if tests else labtext.lab_text(read))
    found = ConvertResult(read, lab, out, summary(read, lab, tests), tests)
    found.save_figures()
    write_json(out / "convert.json", found.content)
    return found


def summary(read: Export, lab: Path, tests: Sequence[ToolTest] = ()) -> dict:
    """What was read and assumed, as plain data."""
    files = {id(specimen): name for name, specimen in labtext.curve_files(read).items()}
    result = {
        "file": read.file,
        "layout": read.layout,
        "lab": str(lab),
        "specimens": [_row(specimen, files[id(specimen)]) for specimen in read.specimens],
        "left_out": list(read.skipped),
        "observables": toollab.observables(tests) if tests else labtext.observables(read),
    }
    if read.strengths is not None:
        result["strengths"] = _strengths_row(read.strengths)
    return result


def _strengths_row(strengths: Strengths) -> dict:
    return {
        "test": strengths.test,
        "place": strengths.place,
        "labels": list(strengths.labels),
        "compressive_strength_kpa": strengths.stress_kpa.tolist(),
        "diameter_m": strengths.diameter,
        "assumed": list(strengths.notes),
    }


def _row(specimen: Specimen, file: str) -> dict:
    row = {
        "label": specimen.label,
        "test": specimen.test,
        "file": file,
        "place": specimen.place,
        "points": len(specimen.force_n),
        "largest_force_n": float(specimen.force_n.max()),
        "largest_displacement_mm": float(specimen.displacement_mm.max()),
        "rate_m_s": specimen.rate,
        "contact_mm": specimen.contact_mm,
        "zero_force_n": specimen.zero_n,
        "begins_at_n": specimen.begins_n,
        "reading_before_contact": specimen.approach,
        "unloading_mm": specimen.unloading_mm,
        "saturated": specimen.clipped,
        "assumed": [f.text for f in specimen.findings if not f.fault],
        "warnings": [f"{f.kind}: {f.text}" for f in specimen.findings if f.fault],
    }
    if specimen.raw.is_converted or specimen.points:
        row["load_steps"] = specimen.points
        row["converted"] = _conversion(specimen)
    return row


def _conversion(specimen: Specimen) -> dict:
    """What was recorded, from which size it was converted, and how."""
    raw, size = specimen.raw, specimen.raw.size
    return {
        "from": [raw.load, raw.travel],
        "diameter_m": size.diameter,
        "height_m": size.height,
        "initial_void_ratio": size.void_ratio,
        "how": list(size.sentences),
    }


def _insisted(kind: str, text: str | None, kinds: Kinds = ()) -> Unit | None:
    """A unit from the command line, refused if it is none of this kind; with torque among `kinds`
    it may be one of a load, with angle of a travel."""
    unit = None if text is None else unit_of(text, kinds)
    if text is None or (unit is not None and unit.kind.option == kind):
        return unit
    problem = f"{shown(text, 20)} {doubt(text) or f'is not a unit of {kind}'}"
    raise InputError(
        COMMAND_LINE, f"--{kind}-unit", problem, f"use a unit such as {EXAMPLES[kind]}"
    )
