"""One withheld case through the diagnosis and its rivals: a verdict file, and nothing of the seal.

The verdict holds all that scoring needs, so that scoring can neither change it nor repeat it.
"""

import json
import multiprocessing
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from calibrate.core import runtime
from calibrate.core.errors import InputError
from calibrate.core.files import write_json
from calibrate.discrepancy.comparison.classes import JOINED, TOGETHER
from calibrate.discrepancy.comparison.compare import Comparison, Prepared, compare, label
from calibrate.discrepancy.comparison.generated import plan_of
from calibrate.discrepancy.comparison.lack_of_fit import NullDistributions
from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.probability_calibration import (
    NONE,
    UNKNOWN,
    ProbabilityCalibration,
    bundled_calibration,
    hypotheses,
)
from calibrate.discrepancy.comparison.reduction import Reduction, feature_weights
from calibrate.discrepancy.comparison.repeats import Measured
from calibrate.discrepancy.diagnosis import answered, described, prepared_diagnosis
from calibrate.discrepancy.library.description import EmulatedLibrary, ModelDiscrepancy
from calibrate.discrepancy.library.measurements import read_measurements
from calibrate.io.lab import load_lab
from calibrate.simulation.executors import cores
from studies.sealed import baselines
from studies.sealed.baselines import KINDS, generated_case

DRAWS = 1200  # of null distributions, whose noise all cases share
TRAINING = 1200
SAMPLED = 9  # cases among which a typical one is sought
_of_worker: list[Callable[[Path], None]] = []  # in a worker, the one thing that it does


@dataclass(frozen=True, eq=False)
class InferenceSetup:
    """The calibration of probabilities, and null distributions by plan of measurement
    (specimens, features), to be shared by labs that have the same plan."""

    calibration: ProbabilityCalibration = field(default_factory=bundled_calibration)
    nulls: dict[tuple[int, ...], NullDistributions] = field(default_factory=dict)

    def prepared(self, d: Linearised, measured: Measured, seed: int = 0) -> Prepared:
        """A diagnosis by these; null distributions of another plan are simulated and kept."""
        known = self.nulls.get(plan_of(measured).shape)
        found = prepared_diagnosis(d, measured, seed, self.calibration, null=known)
        self.nulls[found.generator.plan.shape] = found.null
        return found


@dataclass(frozen=True, eq=False)
class TrainedBaselines:
    """The diagnosis' manner and its rivals, made about one case's curves and no label."""

    setup: InferenceSetup
    features: tuple[str, ...]
    least_template: float
    majority: str
    classifier: baselines.Classifier


def train_baselines(prepared: Prepared, seed: int) -> TrainedBaselines:
    """The diagnosis' manner, and the rivals fitted to generated cases, on one typical case."""
    linear = replace(prepared.description, emulator=None)
    generator = replace(prepared.generator, description=linear)
    linear_only = replace(prepared, generator=generator)
    rng = np.random.default_rng(seed + 1)  # seed drew the nulls
    inputs, labels, null = [], [], []
    covariance = generator.mean_covariance
    for number in range(TRAINING):
        case = generated_case(linear_only, rng, KINDS[number % len(KINDS)])
        truth = label(linear_only.classes, case.truth)
        labels.append("pair" if len(case.truth) == 2 else truth)
        inputs.append(baselines.classifier_inputs(linear, case.measured, covariance))
        if case.truth == (NONE,):
            null.append(baselines.template_scores(linear, case.measured).max())
    return TrainedBaselines(
        InferenceSetup(nulls={prepared.generator.plan.shape: prepared.null}),
        tuple(f.name for f in linear.features),
        float(np.quantile(null, 0.95)),
        baselines.majority(labels),
        baselines.train(np.array(inputs), labels),
    )


def typical(cases: Sequence[Path], emulated: EmulatedLibrary) -> Path:
    """The first of a few cases whose curves show what most of these show: rivals that are trained
    about a case with a feature less could judge hardly any other."""
    features_of = {case: _features_shown(case, emulated) for case in cases[:SAMPLED]}
    often = Counter(shown for shown in features_of.values() if shown).most_common(1)
    return next(case for case, shown in features_of.items() if not often or shown == often[0][0])


def _features_shown(case: Path, emulated: EmulatedLibrary) -> tuple[int, ...]:
    """The library's features that a case shows; none where it cannot be read."""
    try:
        lab = load_lab(case / "lab.toml")
        return tuple(read_measurements(lab, emulated.for_lab(lab).size.features).chosen.tolist())
    except InputError:
        return ()


def typical_case(
    folder: Path, emulated: EmulatedLibrary, seed: int, discrepancy: ModelDiscrepancy | None = None
) -> Prepared:
    """The description and null distributions of one case, by which all of its kind are judged."""
    _, d, measured = described(load_lab(folder / "lab.toml"), emulated, seed, discrepancy)
    return prepared_diagnosis(d, measured, seed, ProbabilityCalibration(), draws=DRAWS)


def verdict_of(
    folder: Path,
    emulated: EmulatedLibrary,
    trained: TrainedBaselines,
    seed: int,
    discrepancy: ModelDiscrepancy | None = None,
) -> dict:
    """The verdict on the case in a folder."""
    lab = load_lab(folder / "lab.toml")
    found, d, measured = described(lab, emulated, seed, discrepancy)
    prepared = trained.setup.prepared(d, measured, seed)
    first = compare(prepared, measured)
    comparison, reduction = answered(lab, emulated, found, d, measured, first, seed)
    return {
        "case": folder.name,
        "verdict": comparison.verdict,
        "stated": comparison.stated,
        "reason": comparison.reason,
        "by_class": comparison.by_class,
        "probability_calibration": asdict(prepared.calibration),
        "ln_evidence": ln_evidence(comparison),
        "likely_set": comparison.likely_set,
        "classes": [list(members) for members in prepared.classes.members],
        "p_before": comparison.summary.p_before,
        "p_after": comparison.summary.p_after,
        "scores": dict(zip(d.effect_names, comparison.scores.z.tolist(), strict=True)),
        "base_shift": dict(zip(d.base_names, comparison.base.delta.tolist(), strict=True)),
        **_shrinkage(d, comparison, reduction),
        "rivals": _rivals(d, measured, trained, prepared),
    }


def ln_evidence(comparison: Comparison) -> dict[str, float]:
    """ln evidence of each explanation over that of none: what a calibration is fitted to."""
    found = comparison.summary.evidence
    values = [0.0, *found.singles.tolist(), *found.pairs.tolist(), found.unknown]
    names = (TOGETHER.join(h) for h in hypotheses(comparison.summary))
    return dict(zip(names, values, strict=True))


def _shrinkage(d: Linearised, comparison: Comparison, reduction: Reduction | None) -> dict:
    """What is claimed to shrink, and the fits by which fresh specimens can check it."""
    if reduction is None or comparison.verdict in (NONE, UNKNOWN):
        return {"claimed": None}
    fit = comparison.refits[comparison.best]
    return {
        "claimed": {"shrinkage": reduction.shrinkage, "low": reduction.low, "high": reduction.high,
                    "left_out": reduction.cross_validated},
        "fits": {
            "features": [f.name for f in d.features],
            "base": comparison.base.values.tolist(),
            "best": fit.values.tolist(),
            "weight": feature_weights(d, comparison.noise).tolist(),
            "strengths": {
                d.effect_names[k]: float(fit.strengths[k] * d.effects[k].typical)
                for k in comparison.best
            },
        },
    }  # fmt: skip


def _rivals(
    d: Linearised, measured: Measured, trained: TrainedBaselines, prepared: Prepared
) -> dict[str, str]:
    """What is usually done, on the same case, as labels of classes."""
    template = baselines.template(d, measured, trained.least_template)
    names = [f.name for f in d.features]
    classified = UNKNOWN
    if tuple(names) == trained.features:
        inputs = baselines.classifier_inputs(d, measured, prepared.generator.mean_covariance)
        classified = trained.classifier.best(inputs)
    return {
        "majority": _relabelled(prepared, trained.majority),
        "template": label(prepared.classes, (template,)),
        "bic": label(prepared.classes, (baselines.bic(d, measured),)),
        "classifier": _relabelled(prepared, classified),
    }


def _relabelled(prepared: Prepared, name: str) -> str:
    """A class named by the classifier, in this case's classes: that of its first member."""
    first = name.split(JOINED)[0]
    of_this_case = first in prepared.classes.names
    return label(prepared.classes, (first,)) if of_this_case else name


def diagnose_all(
    cases: list[Path],
    out: Path,
    emulated: EmulatedLibrary,
    trained: TrainedBaselines,
    seed: int,
    progress,
    discrepancy: ModelDiscrepancy | None = None,
) -> None:
    """Verdicts of all cases into `out`, a case a core; those that are there already stay."""
    waiting = [case for case in cases if not (out / f"{case.name}.json").exists()]
    one = partial(_judge, out, emulated, trained, seed, discrepancy)
    progress.start("diagnosing", len(waiting))
    for _ in _in_processes(one, waiting):
        progress.advance()
    progress.finish()


def _judge(
    out: Path, emulated: EmulatedLibrary, trained: TrainedBaselines, seed: int,
    discrepancy: ModelDiscrepancy | None, case: Path,
) -> None:  # fmt: skip
    """The verdict on a case, written."""
    try:
        verdict = verdict_of(case, emulated, trained, seed, discrepancy)
    except (InputError, ValueError, np.linalg.LinAlgError) as error:  # wrong, not absent
        verdict = {"case": case.name, "failed": str(error), "verdict": "failed", "stated": 0.0}
    write_json(out / f"{case.name}.json", verdict)


def _in_processes(one: Callable[[Path], None], cases: Sequence[Path]) -> Iterator[None]:
    """one(case) of all, one process a core: threads would wait for one interpreter.  Each is given
    `one`, which holds hundreds of megabytes, as it begins and not with every case; what cannot be
    handed over is an error here, before any begins."""
    workers = min(cores(), len(cases))
    if workers < 2:
        yield from map(one, cases)
        return
    apart = multiprocessing.get_context("spawn")  # threads of JAX do not survive a fork
    with ProcessPoolExecutor(workers, apart, _begin, (one,)) as pool:
        try:
            for done in as_completed([pool.submit(_go_on, case) for case in cases]):
                yield done.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _begin(one: Callable[[Path], None]) -> None:
    """What a worker does first: it keeps what it is to do with each case."""
    runtime.configure()
    _of_worker.append(one)


def _go_on(case: Path) -> None:
    _of_worker[0](case)


def read_verdicts(out: Path) -> dict[str, dict]:
    """All verdicts by case."""
    return {path.stem: json.loads(path.read_text()) for path in sorted(out.glob("*.json"))}
