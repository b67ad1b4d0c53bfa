"""One withheld case through the diagnosis and its rivals: a verdict file, and nothing of the seal.

The verdict holds all that scoring needs, so that scoring can neither change it nor repeat it.
"""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from calibrate.core.errors import InputError
from calibrate.core.files import write_json
from calibrate.discrepancy.comparison import baselines
from calibrate.discrepancy.comparison.classes import JOINED, TOGETHER
from calibrate.discrepancy.comparison.compare import Prepared, Which, diagnose, label
from calibrate.discrepancy.comparison.examples import KINDS, generated_case
from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.probability_calibration import NONE, UNKNOWN, hypotheses
from calibrate.discrepancy.comparison.reduction import feature_weights, how_far
from calibrate.discrepancy.comparison.repeats import Measured
from calibrate.discrepancy.diagnosis import Manner, described, ready_to_diagnose
from calibrate.discrepancy.library.description import Discrepancy, Ready
from calibrate.discrepancy.library.lab import read
from calibrate.io.lab import load_lab

DRAWS, TRAINING = 300, 1200
SAMPLED = 9  # cases among which a typical one is sought


@dataclass(frozen=True, eq=False)
class Judges:
    """The diagnosis' manner and its rivals, made about one case's curves and no label."""

    manner: Manner
    features: tuple[str, ...]
    least_template: float
    majority: str
    classifier: baselines.Classifier


def judges(prepared: Prepared, seed: int) -> Judges:
    """The diagnosis' manner, and the rivals fitted to generated cases, on one typical case."""
    linear = replace(prepared.description, emulator=None)
    world = replace(prepared.world, description=linear)
    ready = replace(prepared, world=world)
    rng = np.random.default_rng(seed + 1)  # seed drew the nulls
    inputs, labels, null = [], [], []
    covariance = world.mean_covariance
    for number in range(TRAINING):
        case = generated_case(ready, rng, KINDS[number % len(KINDS)])
        truth = label(ready.classes, case.truth)
        labels.append("pair" if len(case.truth) == 2 else truth)
        inputs.append(baselines.classifier_inputs(linear, case.measured, covariance))
        if case.truth == (NONE,):
            null.append(baselines.template_scores(linear, case.measured).max())
    return Judges(
        Manner(nulls={prepared.world.plan.shape: prepared.null}),
        tuple(f.name for f in linear.features),
        float(np.quantile(null, 0.95)),
        baselines.majority(labels),
        baselines.train(np.array(inputs), labels),
    )


def typical(cases: Sequence[Path], ready: Ready) -> Path:
    """The first of a few cases whose curves show what most of these show: rivals that are trained
    about a case with a feature less could judge hardly any other."""
    seen = {case: _shown(case, ready) for case in cases[:SAMPLED]}
    often = Counter(shown for shown in seen.values() if shown).most_common(1)
    return next(case for case, shown in seen.items() if not often or shown == often[0][0])


def _shown(case: Path, ready: Ready) -> tuple[int, ...]:
    """The bank's features that a case shows; none where it cannot be read."""
    try:
        return tuple(read(load_lab(case / "lab.toml"), ready.bank).chosen.tolist())
    except InputError:
        return ()


def typical_case(
    folder: Path, ready: Ready, seed: int, discrepancy: Discrepancy | None = None
) -> Prepared:
    """The description and null distributions of one case, by which all of its kind are judged."""
    _, d, measured = described(load_lab(folder / "lab.toml"), ready, seed, discrepancy)
    return ready_to_diagnose(d, measured, seed, Manner.neutral(), DRAWS)


def verdict_of(
    folder: Path, ready: Ready, judge: Judges, seed: int, discrepancy: Discrepancy | None = None
) -> dict:
    """The verdict on the case in a folder."""
    _, d, measured = described(load_lab(folder / "lab.toml"), ready, seed, discrepancy)
    prepared = ready_to_diagnose(d, measured, seed, judge.manner)
    which = diagnose(prepared, measured)
    return {
        "case": folder.name,
        "verdict": which.verdict,
        "stated": which.stated,
        "by_class": which.by_class,
        "opinion": asdict(prepared.opinion),
        "ln_evidence": _ln_evidence(which),
        "likely_set": which.likely_set,
        "classes": [list(members) for members in prepared.classes.members],
        "p_before": which.facts.p_before,
        "p_after": which.facts.p_after,
        "scores": dict(zip(d.effect_names, which.scores.z.tolist(), strict=True)),
        "base_shift": dict(zip(d.base_names, which.base.delta.tolist(), strict=True)),
        **_shrinkage(d, measured, which, seed),
        "rivals": _rivals(d, measured, judge, prepared),
    }


def _ln_evidence(which: Which) -> dict[str, float]:
    """ln evidence of each explanation over that of none, from which an opinion can be learned."""
    found = which.facts.evidence
    values = [0.0, *found.singles.tolist(), *found.pairs.tolist(), found.unknown]
    names = (TOGETHER.join(h) for h in hypotheses(which.facts))
    return dict(zip(names, values, strict=True))


def _shrinkage(d: Linearised, measured: Measured, which: Which, seed: int) -> dict:
    """What is claimed to shrink, and the fits by which fresh specimens can check it."""
    if not which.best or which.verdict in (NONE, UNKNOWN):
        return {"claimed": None}
    fit = which.refits[which.best]
    far = how_far(d, measured, which.noise, which.base, fit, seed)
    return {
        "claimed": {"shrinkage": far.shrinkage, "low": far.low, "high": far.high,
                    "left_out": far.left_out},
        "fits": {
            "features": [f.name for f in d.features],
            "base": which.base.values.tolist(),
            "best": fit.values.tolist(),
            "weight": feature_weights(d, which.noise).tolist(),
            "strengths": {
                d.effect_names[k]: float(fit.strengths[k] * d.effects[k].typical)
                for k in which.best
            },
        },
    }  # fmt: skip


def _rivals(d: Linearised, measured: Measured, judge: Judges, prepared: Prepared) -> dict[str, str]:
    """What is usually done, on the same case, as labels of classes."""
    template = baselines.template(d, measured, judge.least_template)
    names = [f.name for f in d.features]
    classified = UNKNOWN
    if tuple(names) == judge.features:
        inputs = baselines.classifier_inputs(d, measured, prepared.world.mean_covariance)
        classified = judge.classifier.best(inputs)
    return {
        "majority": _relabelled(prepared, judge.majority),
        "template": label(prepared.classes, (template,)),
        "bic": label(prepared.classes, (baselines.bic(d, measured),)),
        "classifier": _relabelled(prepared, classified),
    }


def _relabelled(prepared: Prepared, name: str) -> str:
    """A class named by the classifier, in this case's classes: that of its first member."""
    first = name.split(JOINED)[0]
    known = first in prepared.classes.names
    return label(prepared.classes, (first,)) if known else name


def diagnose_all(
    cases: list[Path],
    out: Path,
    ready: Ready,
    judge: Judges,
    seed: int,
    progress,
    discrepancy: Discrepancy | None = None,
) -> None:
    """Verdicts of all cases into `out`; those that are there already stay."""
    waiting = [case for case in cases if not (out / f"{case.name}.json").exists()]
    progress.start("diagnosing", len(waiting))
    for case in waiting:
        try:
            verdict = verdict_of(case, ready, judge, seed, discrepancy)
        except (InputError, ValueError, np.linalg.LinAlgError) as error:  # wrong, not absent
            verdict = {"case": case.name, "failed": str(error), "verdict": "failed", "stated": 0.0}
        write_json(out / f"{case.name}.json", verdict)
        progress.advance()
    progress.finish()


def read_verdicts(out: Path) -> dict[str, dict]:
    """All verdicts by case."""
    return {path.stem: json.loads(path.read_text()) for path in sorted(out.glob("*.json"))}
