"""How far scores by signal-to-noise depend on how the signal is told.

    mkdir own && tar xf benchmarks/results/withheld_own_cases.tar.xz -C own    # the others likewise
    python benchmarks/retold.py fifth sixth own           five minutes

Each case's simulated change c is known from four packings, which scatter it by V, and p is what the
bank predicts of it.  Told three ways:

own share      p + s (c - p), s = 1 - V/|c - p|^2: each case for itself, as in the fourth to the
               sixth set.  Of four packings that share is mostly chance; the largest signals are
               those with the luckiest packings (`visibility.py`)
known          p + T/(T + V) (c - p), T from all cases with the same effects (`Visibility.told`), as
               since the seventh set: what is known of the change, and no more
expected       the root of its square plus T V/(T + V): with what may be besides, in all of which
               calibration is taken to absorb nothing

Verdicts, which do not depend on any of these, are counted by each.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import reporting

from calibrate.discrepancy import mismatch
from calibrate.discrepancy.library import store
from calibrate.discrepancy.library.description import MEASURING, Ready
from calibrate.validation.elsewhere import Seen, errors_of, in_our_words
from calibrate.validation.seal import open_seal

STRATA = {"below 2": (0.0, 2.0), "2 to 6": (2.0, 6.0), "above 6": (6.0, np.inf)}
WAYS = ("own share", "known", "expected")
TODAY = "known"
HEADER = ["set", "what is hidden", "signal-to-noise", *(f"right, {way}" for way in WAYS)]


def told(folder: Path, ready: Ready) -> dict[str, dict[str, float]]:
    """Signal-to-noise of each case of a set that hides something, each way."""
    known = mismatch.load(reporting.RESULTS / f"withheld_{folder.name}_mismatch.json", ready)
    labels = {name: in_our_words(label) for name, label in open_seal(folder).items()}
    seen = {n: Seen.of(label, ready, known) for n, label in labels.items() if label["hidden"]}
    errors = errors_of([one for one in seen.values() if one.both])
    return {name: ways(one, errors) for name, one in seen.items()}


def ways(one: Seen, errors: dict[str, float]) -> dict[str, float]:
    """One case's, each way; all alike where nothing is predicted, or too little simulated."""
    known = one.snr(errors)
    if not one.both:
        return dict.fromkeys(WAYS, known)
    length, scatter, away = one.parts()
    wrong = errors[one.effects] * length
    unknown = wrong * scatter / max(wrong + scatter, 1e-300)
    share = max(1 - scatter / max(away, 1e-300), 0.0)
    predicted = np.asarray(one.predicted)
    own = one.visible.left(predicted + share * (one.changes.mean(axis=0) - predicted))
    return dict(zip(WAYS, (own, known, float(np.sqrt(known**2 + unknown))), strict=True))


def counted(scored: dict, snr: dict[str, dict[str, float]], machine: bool) -> list[list[str]]:
    """By stratum: single effects right of all of them, each way."""
    rows = [
        row for row in scored["rows"] if row["kind"] == "single"
        and (scored["hidden"][row["case"]][0]["name"] in MEASURING) == machine
    ]  # fmt: skip
    lines = []
    for stratum, (low, high) in STRATA.items():
        of = [[row for row in rows if low <= snr[row["case"]][way] < high] for way in WAYS]
        right = [sum(row["verdict"] == row["truth"] for row in some) for some in of]
        lines.append([stratum, *(f"{n} of {len(some)}" for n, some in zip(right, of, strict=True))])
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", type=Path, nargs="+", help="opened sets, named as in results")
    folders = parser.parse_args().folders
    reporting.configure()
    ready, snr, lines = Ready.of(store.load(store.bundled_bank())), {}, []
    for folder in folders:
        name = f"withheld_{folder.name}.json"
        scored, found = json.loads((reporting.RESULTS / name).read_text()), told(folder, ready)
        snr[name] = {case: each[TODAY] for case, each in found.items()}
        for words, machine in (("faults of the machine", True), ("soil and walls", False)):
            lines += [[folder.name, words, *line] for line in counted(scored, found, machine)]
    origin = reporting.provenance()
    text = (
        "# Single effects that were named, by signal-to-noise told three ways\n\n"
        "Own share: each case for itself, as in the fourth to the sixth set; known: as since the "
        "seventh; expected: with what may be besides.\n\n"
    ) + reporting.table(HEADER, lines)
    reporting.write("retold", {**origin, "snr": snr}, text + reporting.footer(origin))


if __name__ == "__main__":
    main()
