"""`calibrate convert`: the export of a testing machine becomes curves and a lab file."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calibrate.core.errors import COMMAND_LINE, BadValue, InputError

if TYPE_CHECKING:
    from calibrate.core.units import Kind
    from calibrate.instrument_import.convert import Export
    from calibrate.instrument_import.specimens import Specimen

TESTS = ("confined", "unconfined")


def register(app: typer.Typer) -> None:
    """Adds `convert` to the program."""
    app.command("convert")(convert_command)


def convert_command(
    export: Annotated[Path, typer.Argument(metavar="EXPORT", help=".csv, .txt or .xlsx file.")],
    test: Annotated[
        str | None, typer.Option("--test", help="confined or unconfined; default: found out.")
    ] = None,
    force_unit: Annotated[
        str | None, typer.Option("--force-unit", help="Unit of force, against the file: kN.")
    ] = None,
    displacement_unit: Annotated[
        str | None, typer.Option("--displacement-unit", help="Unit of travel, against the file.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path(
        "results/convert"
    ),
    json: Annotated[Path | None, typer.Option("--json", help="Write what was found here.")] = None,
) -> None:
    """Turn a testing machine's export into clean curves and a lab file for `calibrate fit`."""
    from calibrate.core.files import check_writable, make_folder, write_json, write_text
    from calibrate.core.units import FORCE, MILLIMETRES
    from calibrate.figures.lab import preview_figure
    from calibrate.instrument_import import labtext
    from calibrate.instrument_import.convert import file_stem, read_export
    from calibrate.instrument_import.recordings import Units

    check_writable(json)
    if test is not None and test not in TESTS:
        raise InputError(COMMAND_LINE, "--test", f"no test '{test}'", "give confined or unconfined")
    units = Units(
        _checked(force_unit, FORCE, "--force-unit"),
        _checked(displacement_unit, MILLIMETRES, "--displacement-unit"),
    )
    read = read_export(export, test, units)
    if not labtext.fitted(read):
        problem = "no specimen carries more than 2 N"
        raise InputError(str(export), "", problem, "check the unit of force, or give --force-unit")
    make_folder(out)
    lab = out / f"{file_stem(export.stem)}.toml"
    for name, specimen in labtext.curve_files(read).items():
        write_text(out / name, labtext.curve_text(specimen))
    write_text(lab, labtext.lab_text(read))
    preview_figure(read, out / "preview.png")
    result = summary(read, lab)
    write_json(out / "convert.json", result)
    if json is not None:
        write_json(json, result)
    _tell(read, lab)


def summary(read: "Export", lab: Path) -> dict:
    """What was read and assumed, as plain data."""
    from calibrate.instrument_import import labtext

    files = {id(specimen): name for name, specimen in labtext.curve_files(read).items()}
    return {
        "file": read.file,
        "layout": read.layout,
        "lab": str(lab),
        "specimens": [_row(specimen, files[id(specimen)]) for specimen in read.specimens],
        "left_out": list(read.skipped),
        "observables": labtext.observables(read),
    }


def _row(specimen: "Specimen", file: str) -> dict:
    return {
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
        "unloading_mm": specimen.unloading_mm,
        "saturated": specimen.clipped,
        "assumed": [f.text for f in specimen.findings if not f.fault],
        "warnings": [f"{f.kind}: {f.text}" for f in specimen.findings if f.fault],
    }


def _checked(unit: str | None, kind: "Kind", option: str) -> str | None:
    """A unit from the command line, refused if it is none of this kind."""
    from calibrate.core.units import unit_factor

    if unit is None:
        return None
    try:
        unit_factor(unit, kind)
    except BadValue as bad:
        raise bad.at(COMMAND_LINE, option) from None
    return unit


def _tell(read: "Export", lab: Path) -> None:
    """One line a specimen, then what was assumed, warnings last."""
    print(f"{read.file}: {read.layout}")
    for specimen in read.specimens:
        print(
            f"{specimen.label}: {specimen.test}, {len(specimen.force_n)} points, "
            f"up to {specimen.force_n.max():.4g} N and {specimen.displacement_mm.max():.4g} mm"
        )
        for finding in sorted(specimen.findings, key=lambda f: f.fault):
            print(f"  {'WARNING: ' if finding.fault else ''}{finding.text}")
    for sentence in read.skipped:
        print(f"WARNING: {sentence}")
    print(f"look at {lab.parent / 'preview.png'}, then: calibrate fit {lab}")
