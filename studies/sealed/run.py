"""A withheld benchmark from nothing to scores; every step is kept and none is repeated.

DIR/cases/ID/         what a laboratory would hand over
DIR/labels.sha256     stated before the first diagnosis
DIR/sealed/           the labels; opened after DIR/verdicts.sha256 is written
DIR/verdicts/ID.json  one a case
DIR/withheld.json     scores
"""

import hashlib
import json
import os
import secrets
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from calibrate.core.errors import InputError
from calibrate.core.files import part_of, write_json, write_text
from calibrate.core.progress import AbstractProgress
from calibrate.discrepancy.comparison.reduction import shrinkage
from calibrate.discrepancy.library.description import EmulatedLibrary, ModelDiscrepancy
from calibrate.discrepancy.library.design import CENTRE
from calibrate.discrepancy.library.run_library import Cylinder
from calibrate.labtests.diagnosis.curves import declare_before_contact, recorded_feature_values
from calibrate.simulation import HERE, AbstractPlace, side_by_side
from studies.sealed import seal
from studies.sealed.labels import FEWEST_CHANGES, normalised, with_visibility
from studies.sealed.laboratory import Laboratory, SpecimenRecords, write_case
from studies.sealed.plan import (
    SPECIMENS,
    USUAL,
    Beds,
    Hidden,
    Planner,
    SpecimenSize,
    WithheldCase,
    without_nan,
)
from studies.sealed.scores import Realised, Row, claims_shrinkage, row, scored
from studies.sealed.trial import (
    TrainedBaselines,
    diagnose_all,
    read_verdicts,
    train_baselines,
    typical,
    typical_case,
)

PLAN = "sealed/plan.json"
VERDICTS = "verdicts"
FEWEST_FRESH = 2  # up to which a shrinkage on fresh specimens has no error
CHECKED_SNR = 2.0  # above which claimed shrinkage is checked on fresh specimens


def generate(
    out: Path, emulated: EmulatedLibrary, counts: dict[str, int] | None, seed: int | None,
    progress: AbstractProgress, beds: Beds | None = None,
    sizes: Sequence[SpecimenSize] = (USUAL,), with_changes: bool = True,
    place: AbstractPlace = HERE,
) -> None:  # fmt: skip
    """Makes and seals all cases that are not there yet; the plan itself is sealed too.  Specimens
    have one of the sizes.  Without changes, which take half as long again, a case's
    signal-to-noise stays what the library predicts.  A place that simulates many specimens at once
    is given those of all cases first."""
    attempts = _plan(out, emulated, counts, seed, beds, sizes)
    laboratory = Laboratory(out / "simulated", CENTRE, place)
    if place is not HERE:
        _simulate_ahead(out, laboratory, attempts, with_changes, progress)

    def label(number: int) -> list[dict]:
        case = _made(out, laboratory, attempts[number])
        packings = range(FEWEST_CHANGES if with_changes else 0)
        return [case.label(_changes(out, laboratory, case, packings))] if case else []

    labels = side_by_side(label, len(attempts), progress, "making cases")
    _seal(out, [one for made in labels for one in made])


def _simulate_ahead(
    out: Path, laboratory: Laboratory, attempts: Sequence[Sequence[WithheldCase]],
    with_changes: bool, progress: AbstractProgress,
) -> None:  # fmt: skip
    """All that the cases need, attempt by attempt, then the same without their effects."""
    waiting, plain = [rows for rows in attempts if not _kept(out, rows[0]).exists()], []
    for number in range(max(map(len, waiting), default=0)):
        cases = [rows[number] for rows in waiting]
        laboratory.simulate([(case, k) for case in cases for k in range(SPECIMENS)], progress)
        done = [laboratory.specimens(case) is not None for case in cases]
        plain += [replace(c, hidden=()) for c, d in zip(cases, done, strict=True) if d and c.hidden]
        waiting = [rows for rows, d in zip(waiting, done, strict=True) if not d]
    if with_changes:
        laboratory.simulate([(case, k) for case in plain for k in range(FEWEST_CHANGES)], progress)


def _kept(out: Path, case: WithheldCase) -> Path:
    """The file that tells which attempt at a case was made."""
    return out / "sealed" / f"{case.name}.attempt"


def _seal(out: Path, labels: list[dict]) -> None:
    """Seals the labels; those that are sealed already must be the same."""
    if (out / seal.HASHES).exists():
        known = seal.open_seal(out)
        if {n: seal.digest(one) for n, one in known.items()} != {
            one["case"]: seal.digest(one) for one in labels
        }:
            problem = "the cases no longer give the labels that were sealed"
            raise InputError(str(out), "sealed", problem, "make the cases in another folder")
    else:
        seal.write_seal(labels, out)


def _plan(
    out: Path, emulated: EmulatedLibrary, counts, seed: int | None, beds: Beds | None = None,
    sizes: Sequence[SpecimenSize] = (USUAL,),
) -> list[list[WithheldCase]]:  # fmt: skip
    """The plan in `out`, drawn if there is none yet."""
    path = out / PLAN
    if not path.exists():
        secret = secrets.randbits(62) if seed is None else seed
        drawn = Planner(emulated, secret, beds, sizes).cases(counts)
        write_once(path, json.dumps([[asdict(c) for c in rows] for rows in drawn]))
    return _planned(out)


def write_once(path: Path, text: str) -> None:
    """Writes a file that is not there yet; of several writers at once, the first one's stays."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = part_of(path)
    try:
        part.write_text(text, encoding="utf-8")
        os.link(part, path)
    except FileExistsError:
        return
    except OSError:  # a file system without links
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def _planned(out: Path) -> list[list[WithheldCase]]:
    written = json.loads((out / PLAN).read_text())
    return [[_case(entry) for entry in rows] for rows in written]


def _case(entry: dict) -> WithheldCase:
    read = {
        "hidden": tuple(Hidden(**h) for h in entry["hidden"]),
        "packings": tuple(entry["packings"]),
        "size": SpecimenSize(**entry.get("size", {})),
    }
    return WithheldCase(**{**entry, **read})


def planned_case(source: Path, name: str) -> WithheldCase:
    """A case as it was made; for whoever may know what it hides."""
    attempt = int((source / "sealed" / f"{name}.attempt").read_text())
    return next(rows for rows in _planned(source) if rows[0].name == name)[attempt]


def _made(
    out: Path, laboratory: Laboratory, attempts: Sequence[WithheldCase]
) -> WithheldCase | None:
    """The first attempt whose specimens stand and lie in range, written; the rule is blind to
    the effect."""
    folder = out / "cases" / attempts[0].name
    kept = _kept(out, attempts[0])
    if kept.exists() and (folder / "lab.toml").exists():
        number = int(kept.read_text())
        return attempts[number] if number >= 0 else None
    for number, case in enumerate(attempts):
        specimens = laboratory.specimens(case)
        if specimens is not None:
            write_case(case.name, specimens, CENTRE, folder, case.size)
            write_text(kept, str(number))
            return case
    write_text(kept, "-1")
    return None


def _changes(out: Path, laboratory: Laboratory, case: WithheldCase, packings: range) -> np.ndarray:
    """What the case's effects do to its features, kept beside its seal: a set that is half made
    needs none of its simulations to go on."""
    if not packings:
        return np.zeros((0, 0))
    kept = out / "sealed" / f"{case.name}.changes"
    if not kept.exists():
        write_text(kept, json.dumps(without_nan(laboratory.changes(case, packings))))
    return np.array(json.loads(kept.read_text()), float)


def case_folders(out: Path) -> list[Path]:
    """All cases, in the order of their meaningless names."""
    found = sorted(path.parent for path in (out / "cases").glob("*/lab.toml"))
    if not found:
        raise InputError(str(out), "cases", "there are no cases here", "run without --given first")
    return found


def judge(
    source: Path, out: Path, emulated: EmulatedLibrary, seed: int, progress: AbstractProgress,
    discrepancy: ModelDiscrepancy | None = None,
) -> None:  # fmt: skip
    """Verdicts of all cases in `source` into `out`, their hashes before the seal is opened."""
    cases = case_folders(source)
    progress.say("training rivals")
    judge: TrainedBaselines = train_baselines(
        typical_case(typical(cases, emulated), emulated, seed, discrepancy), seed
    )
    diagnose_all(cases, out / VERDICTS, emulated, judge, seed, progress, discrepancy)
    _state(out)


def opened(
    source: Path, out: Path, emulated: EmulatedLibrary, seed: int, progress: AbstractProgress,
    fresh: bool, discrepancy: ModelDiscrepancy | None = None,
) -> tuple[dict, list[Row]]:  # fmt: skip
    """Opens the seal, checks both lists of hashes, scores; writes withheld.json."""
    said, stated = read_verdicts(out / VERDICTS), _stated(out)
    _check_unchanged(out, stated)
    labels = {n: normalised(label) for n, label in seal.open_seal(source).items()}
    if not set(said) == set(stated) == set(labels):
        problem = f"{len(labels)} labels, {len(said)} verdicts"
        raise InputError(str(out), VERDICTS, problem, "judge all cases first")
    labels = with_visibility(labels, emulated, discrepancy)
    realised = _fresh(source, said, labels, progress) if fresh else {}
    rows = [row(said[name], labels[name], realised.get(name)) for name in sorted(said)]
    folders = [source / "cases" / r.case for r in rows]
    usual = asdict(USUAL)
    result = {
        **scored(rows, seed),
        "other_code": not (source / PLAN).exists(),
        "other_sizes": any(label.get("size", usual) != usual for label in labels.values()),
        "given_up": _given_up(source),
        "canary": seal.canary(folders, [r.kind for r in rows], seed),
        "rows": [asdict(r) for r in rows],
        "hidden": {name: labels[name]["hidden"] for name in sorted(said)},
    }
    write_json(out / "withheld.json", result)
    return result, rows


def _state(out: Path) -> None:
    """Writes the hashes of all verdicts; those that were stated before must still hold."""
    path = out / f"{VERDICTS}.sha256"
    if path.exists():
        _check_unchanged(out, _stated(out))
    lines = [f"{_digest(path)}  {path.stem}" for path in sorted((out / VERDICTS).glob("*.json"))]
    write_text(path, "\n".join(lines) + "\n")


def _stated(out: Path) -> dict[str, str]:
    """The stated hash of each verdict."""
    lines = (out / f"{VERDICTS}.sha256").read_text().splitlines()
    return dict(line.split()[::-1] for line in lines)


def _check_unchanged(out: Path, stated: dict[str, str]) -> None:
    for name, digest in stated.items():
        path = out / VERDICTS / f"{name}.json"
        if not path.exists() or _digest(path) != digest:
            problem = "the verdict was changed after it was stated"
            raise InputError(
                str(out / VERDICTS), name, problem, "judge the cases in another folder"
            )


def _given_up(source: Path) -> int:
    """How many planned cases were not made, because no attempt was acceptable."""
    kept = (source / "sealed").glob("*.attempt")
    return sum(path.read_text().strip() == "-1" for path in kept)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _fresh(
    source: Path, said: dict, labels: dict, progress: AbstractProgress
) -> dict[str, Realised]:
    """Shrinkages on fresh specimens of the same soils, where one was claimed."""
    laboratory = Laboratory(source / "simulated", CENTRE)
    plans = {rows[0].name: rows for rows in _planned(source)}
    names = [
        name for name, verdict in said.items()
        if claims_shrinkage(verdict) and labels[name]["kind"] == "single"
        and labels[name]["snr"] >= CHECKED_SNR
    ]  # fmt: skip

    def of(number: int) -> Realised | None:
        name = names[number]
        attempt = int((source / "sealed" / f"{name}.attempt").read_text())
        case = plans[name][attempt]
        specimens = [
            one for number in range(SPECIMENS, len(case.packings))
            for one in laboratory.specimens(case, range(number, number + 1)) or []
        ]  # fmt: skip
        enough = len(specimens) >= FEWEST_FRESH
        cylinder = Cylinder.of(case.size.lab())
        return realised_shrinkage(said[name]["fits"], specimens, cylinder) if enough else None

    found = side_by_side(of, len(names), progress, "simulating fresh specimens")
    return {name: one for name, one in zip(names, found, strict=True) if one}


def realised_shrinkage(
    fits: dict, specimens: Sequence[SpecimenRecords], cylinder: Cylinder
) -> Realised:
    """(E0 - E1)/(E0 - 1) of both fits on fresh specimens, their own scatter taken off; its
    standard error by leaving out one specimen after the other (jackknife)."""
    features = {f.name: f for f in (*cylinder.features(), *declare_before_contact())}
    keep = [i for i, name in enumerate(fits["features"]) if name in features]
    chosen = [features[fits["features"][i]] for i in keep]
    values = np.array([
        recorded_feature_values(chosen, {test: (r[:, 0], r[:, 1]) for test, r in s.records.items()})
        for s in specimens
    ])  # fmt: skip
    weight = np.array(fits["weight"])[keep]
    weight = weight / weight.sum() * np.sum(fits["weight"])
    models = [np.array(fits[which])[keep] for which in ("base", "best")]
    error = jackknife(values, models, weight) if len(values) > FEWEST_FRESH else None
    return Realised(_shrunk(values, models, weight), error)


def jackknife(values: np.ndarray, models: Sequence[np.ndarray], weight: np.ndarray) -> float:
    """Standard error of the shrinkage of two models (m,) on specimens (n, m)."""
    n = len(values)
    without = [_shrunk(np.delete(values, i, axis=0), models, weight) for i in range(n)]
    return float(np.sqrt((n - 1) * np.var(without)))


def _shrunk(values: np.ndarray, models: Sequence[np.ndarray], weight: np.ndarray) -> float:
    """The shrinkage of two models (m,) on specimens (n, m)."""
    mean, variance = np.nanmean(values, axis=0), np.nanvar(values, axis=0, ddof=1)
    count = np.isfinite(values).sum(axis=0)
    return shrinkage(*(float(weight @ ((mean - m) ** 2 - variance / count)) for m in models))
