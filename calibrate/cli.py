"""The command line: `calibrate simulate`, `fit`, `contact`, `audit`, `doe` and `reproduce`.

Exit status 0 done, 2 the input is wrong (one line on standard error that names file,
field and repair), 1 anything else.
"""

import atexit
import gc
import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from calibrate import verbs
from calibrate.errors import CalibrationError, InputError, one_line

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Calibrate a virtual soil against laboratory tests, by gradient.",
)

LabFile = Annotated[
    Path | None, typer.Argument(metavar="[LAB.toml]", help="Lab file; default: the bundled soil.")
]
Json = Annotated[Path | None, typer.Option("--json", help="Write the result to this file.")]
Out = Annotated[Path, typer.Option("--out", help="Folder for results; a second run resumes.")]
Seed = Annotated[int, typer.Option("--seed", min=0, max=10_000_000, help="Choice of packings.")]
PresetName = Annotated[str, typer.Option("--preset", help="quick, standard or fine.")]
Preparation = Annotated[
    bool, typer.Option("--prepare-with-soil", help="Settle beds with the soil under test.")
]
Dask = Annotated[
    str | None, typer.Option("--dask", metavar="ADDRESS", help="Simulate on this Dask cluster.")
]
Changes = Annotated[
    list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Change a parameter.")
]


@app.command("simulate")
def simulate_command(
    lab: LabFile = None,
    changes: Changes = None,
    preset: PresetName = "quick",
    seed: Seed = 0,
    prepare_with_soil: Preparation = False,
    out: Out = Path("results/simulate"),
    dask: Dask = None,
    json: Json = None,
) -> None:
    """Run both virtual tests on several packings: curves, observables, scatter."""
    from calibrate import output, workflow

    output.check_writable(json)
    session = output.Session.open(lab, preset, out, dask)
    values = output.parse_changes(changes or [])
    work = session.campaign(out, values if prepare_with_soil else None)
    result, runs = workflow.simulate(session.lab, session.preset, values, seed, work)
    output.write_simulation(session, result, runs, json)


@app.command("fit")
def fit_command(
    lab: LabFile = None,
    free: Annotated[
        str | None, typer.Option("--free", help="Names, comma-separated; default: chosen by data.")
    ] = None,
    changes: Changes = None,
    preset: PresetName = "quick",
    seed: Seed = 0,
    prepare_with_soil: Preparation = False,
    out: Out = Path("results/fit"),
    dask: Dask = None,
    json: Json = None,
) -> None:
    """Calibrate the parameters that the data can fix; say which those are."""
    from calibrate import output, workflow

    output.check_writable(json)
    session = output.Session.open(lab, preset, out, dask)
    values = output.parse_changes(changes or [])
    names = output.parse_free(free)
    work = session.campaign(out, values if prepare_with_soil else None)
    done = workflow.calibrate(session.lab, session.preset, names, values, seed, work)
    output.write_fit(session, done, json)


@app.command("contact")
def contact_command(
    path_um: Annotated[
        str, typer.Option("--path-um", help="Turning points of the overlap, micrometres.")
    ],
    changes: Changes = None,
    radius_mm: Annotated[float, typer.Option("--radius-mm", help="Radius of both spheres.")] = 2.5,
    young_mpa: Annotated[float, typer.Option("--young-mpa", help="Young's modulus.")] = 5.0,
    poisson: Annotated[float, typer.Option("--poisson", help="Poisson's ratio.")] = 0.3,
    smooth: Annotated[
        bool, typer.Option("--smooth/--sharp", help="Default roundings, or the law as printed.")
    ] = False,
    out: Out = Path("results/contact"),
    json: Json = None,
) -> None:
    """Drive two equal spheres through overlaps, quasi-statically: force-overlap loop."""
    from calibrate import output, single_contact

    output.check_writable(json)
    points = output.parse_path(path_um)
    values = output.parse_changes(changes or [])
    pair = output.parse_pair(radius_mm, young_mpa, poisson)
    result = single_contact.drive(pair, values, points, smooth)
    output.write_contact(result, out, json)


@app.command("audit")
def audit_command(
    lab: LabFile = None,
    strategy: Annotated[
        list[str] | None,
        typer.Option(
            "--strategy",
            help="fit (what fits use; default), ensemble, regression, pathwise, blend, "
            "virtual_power, virtual_power_blend; may be given several times.",
        ),
    ] = None,
    changes: Changes = None,
    spheres: Annotated[int, typer.Option("--spheres", min=30, help="Spheres a packing.")] = 300,
    packings: Annotated[int, typer.Option("--packings", min=2, help="Packings.")] = 8,
    preset: PresetName = "quick",
    seed: Seed = 0,
    out: Out = Path("results/audit"),
    dask: Dask = None,
    json: Json = None,
) -> None:
    """Compare gradients with the slope of the response over +-20 %, parameter by parameter."""
    from calibrate import output

    output.check_writable(json)
    session = output.Session.open(lab, preset, out, dask).resized(spheres)
    values = output.parse_changes(changes or [])
    names = output.parse_strategies(strategy or ["fit"])
    output.run_audit(session, names, values, packings, seed, json)


@app.command("doe")
def doe_command(
    lab: LabFile = None,
    changes: Changes = None,
    preset: PresetName = "quick",
    seed: Seed = 0,
    out: Out = Path("results/doe"),
    dask: Dask = None,
    json: Json = None,
) -> None:
    """Calibrate by designed experiments, the paper's way, and lay gradients beside them."""
    from rich.console import Console

    from calibrate import output
    from calibrate.designed import design
    from calibrate.report import study as report

    output.check_writable(json)
    session = output.Session.open(lab, preset, out, dask)
    values = output.parse_changes(changes or [])
    work = session.campaign(out, None)
    done = design(session.lab, session.preset, values, seed, work)
    report.write(session, done, json)
    report.show(done, Console())
    print(f"result.json, {report.PAGE} and run sheets are in {out}")


@app.command("reproduce")
def reproduce_command(out: Out = Path("results/reproduce"), json: Json = None) -> None:
    """Put the paper's published figures beside what its own printed tables give."""
    from rich.console import Console

    from calibrate import output
    from calibrate.report import reproduction as report
    from calibrate.reproduction import paper

    output.check_writable(json)
    output.make_folder(out)
    result = paper.reproduce()
    report.write(result, out, json)
    report.show(result, Console())
    print(f"page and JSON in {out}")


verbs.register(app)


def main() -> None:
    """Entry point: turns wrong input into one line and exit status 2."""
    _spare_collections()
    _configure_jax()
    try:
        status = app(sys.argv[1:] or ["--help"], standalone_mode=False)
    except InputError as error:
        _leave(2, f"error: {error}")
    except CalibrationError as error:
        _leave(1, f"error: {error}")
    except OSError as error:
        _leave(1, f"error: {one_line(str(error))}; {STOPPED}")
    except (KeyboardInterrupt, typer.Abort):
        _leave(1, STOPPED)
    except typer.exceptions.TyperException as error:
        _leave(2, f"error: command line: {one_line(error.format_message())}; see calibrate --help")
    if status == INTERRUPTED:
        _leave(1, STOPPED)


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


def _configure_jax() -> None:
    from calibrate import runtime

    runtime.configure()


if __name__ == "__main__":
    main()
