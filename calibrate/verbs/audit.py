"""Compare gradients with the slope of the response over +-20 %, parameter by parameter."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import RenderableType
from rich.table import Table

from calibrate.core.errors import COMMAND_LINE, InputError
from calibrate.core.files import write_json
from calibrate.discrepancy.library.stand_in import served
from calibrate.inference.audit import RESPONSE, Audit, audit_json, checked_strategies, traces
from calibrate.inference.audit import audit as slopes_of
from calibrate.inference.on_response import OnResponse
from calibrate.inference.parameters import candidates_of, space
from calibrate.records.audit import AuditRecord
from calibrate.reports.audit import passed
from calibrate.simulation.joint import AbstractCampaign
from calibrate.simulation.session import Session, origin_of
from calibrate.simulation.specimens import soil_json
from calibrate.verbs import options
from calibrate.verbs.base import AbstractRecordedResult, line, listed, verb
from jdem.materials.soil import SoilParameters


@dataclass(frozen=True, eq=False, repr=False)
class AuditResult(AbstractRecordedResult[AuditRecord]):
    """Slopes of observables and curves in every parameter, and how far from the reference they are.

    Attributes:
        slopes: the estimates and the reference.
        folder: where audit.json, audit.png and audit_curves.png are.
    """

    verb, kind = "audit", AuditRecord
    files = ("audit.json",)
    slopes: Audit
    folder: Path
    content: dict

    def words(self) -> Iterator[RenderableType]:
        for name in self.slopes.estimates:
            yield self._table(name)
            yield line(f"{name}: {passed(self.record.strategies[name])}")
            yield from (line(f"{name}: {sentence}") for sentence in self._refusals(name))

    def _table(self, strategy: str) -> Table:
        title = f"{strategy}, {self.slopes.packings} packings"
        columns = ("parameter", "observable", "estimate per ln p", "reference per ln p", "verdict")
        table = Table(*columns, title=title, title_justify="left")
        for row in self.slopes.rows(strategy):
            cells = [f"{row[k]:.3g} ± {row[k + '_se']:.2g}" for k in ("estimate", "reference")]
            table.add_row(row["parameter"], row["observable"], *cells, _word(row))
        return table

    def _refusals(self, strategy: str) -> Iterator[str]:
        """Which tests have slopes that their strategy does not believe, on how many packings, and
        why on the first of them."""
        certificates = self.slopes.certificates.get(strategy, [])
        for test, reading in enumerate(self.slopes.points.readings):
            why = [reason for each in certificates for reason in each.refused[test] if reason]
            packings = sum(any(each.refused[test]) for each in certificates)
            if why:
                share = f"{packings} of {len(certificates)} packings"
                yield f"no derivative of {reading.test} on {share}: {why[0]}"


def _word(row: dict) -> str:
    if not np.isfinite(row["estimate"]):
        return "no derivative"
    if not row["judged"]:
        return "too small to judge"
    return "passed" if row["passed"] else "FAILED"


@verb
def audit(
    lab: options.LabFile = None,
    *,
    strategies: Annotated[
        str | Sequence[str],
        typer.Option(
            "--strategy",
            help="fit (pairs of runs; default), response, ensemble, regression, pathwise, blend, "
            "overdamped, overdamped_blend, virtual_power, virtual_power_blend; may be given "
            "several times.",
        ),
        options.Typed(list[str] | None),
    ] = ("fit",),
    values: options.Changes = None,
    spheres: Annotated[int, typer.Option("--spheres", min=30, help="Spheres a packing.")] = 300,
    packings: Annotated[int, typer.Option("--packings", min=2, help="Packings.")] = 8,
    preset: options.PresetName = "quick",
    seed: options.Seed = 0,
    out: options.Out = "results/audit",
    dask: options.Dask = None,
    batch: options.Batch = None,
) -> AuditResult:
    """Compares derivatives with the slope of the response over ±20 %, parameter by parameter.

    Args:
        lab: a lab file's path, or what `load_lab` returned; None: the bundled soil.
        strategies: ways to a derivative, by name ("fit": pairs of runs as fits take them;
            "response": JAX's derivative of the bundled library of runs, with which fits explore;
            it takes a preset that the library serves, "standard" or "fine").
        values: parameters in place of the lab file's, by name, in SI units or with a unit.
        spheres: number of spheres of a packing.
        packings: number of packings.
        preset: "quick", "standard" or "fine": all other settings.
        seed: choice of packings, from 0.
        out: folder for results.
        dask: address of a Dask cluster that simulates; None: this machine.
        batch: specimens to simulate at once on an accelerator; None: on processor cores.

    Returns:
        Slopes with standard errors and what passes; audit.json and two figures in `out`.

    Raises:
        InputError: the lab file or an argument is wrong.

    Example:
        >>> found = calibrate.audit(strategies=["fit", "regression"])
        >>> found.plot()
    """
    folder, names = Path(out), checked_strategies(listed(strategies))
    session = Session.open(lab, preset, folder, dask, batch=batch).resized(spheres)
    base = session.soil(values)
    audited = space(session.lab, candidates_of(session.lab), base)
    seeds = range(100 * seed, 100 * seed + packings)
    campaign = session.campaign_of_one if traces(names) else session.on_soil().campaign
    work = campaign(folder)
    slopes = slopes_of(audited, work, seeds, names, _library(session, base, work, names))
    settings = {"spheres": spheres, "seeds": list(seeds), "parameters": soil_json(base)}
    found = AuditResult(slopes, folder, {**origin_of(session), **settings, **audit_json(slopes)})
    write_json(folder / "audit.json", found.content)
    found.save_figures()
    return found


def _library(
    session: Session, base: SoilParameters, work: AbstractCampaign, names: Sequence[str]
) -> OnResponse | None:
    """What stands behind the strategy "response", where it is asked for."""
    if RESPONSE not in names:
        return None
    found, why = served(session.lab, session.preset, None, base, work)
    if found is None:
        problem = f"the library of runs does not serve: {why}"
        repair = "give --preset standard, or leave this strategy out"
        raise InputError(COMMAND_LINE, f"--strategy {RESPONSE}", problem, repair)
    return found
