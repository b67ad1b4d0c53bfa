"""Signal-to-noise of opened sets, told anew.

    mkdir fifth && tar xf benchmarks/results/withheld_fifth_cases.tar.xz -C fifth
    mkdir sixth && tar xf benchmarks/results/withheld_sixth_cases.tar.xz -C sixth
    python benchmarks/retold.py fifth sixth          three minutes

In the fourth to the sixth set each case's simulated change c was drawn towards the predicted one p
by a share 1 - V/|c - p|^2 of its own, where V is what packings scatter c by.  Of four packings that
share is mostly chance, so the largest signals were those with the luckiest packings
(`visibility.py`).  Here the signals are told as they are today (`Visibility.told`), and verdicts,
which do not depend on them, are counted again.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import reporting

from calibrate.bank import mismatch, store
from calibrate.bank.description import MEASURING, Ready
from calibrate.withheld.elsewhere import in_our_words, with_visibility
from calibrate.withheld.seal import open_seal

STRATA = {"below 2": (0.0, 2.0), "2 to 6": (2.0, 6.0), "above 6": (6.0, np.inf)}
HEADER = ["set", "what is hidden", "signal-to-noise", "right, as scored", "right, told anew"]


def told(folder: Path, ready: Ready) -> dict[str, float]:
    """Signal-to-noise of each case of a set that hides something."""
    known = mismatch.load(reporting.RESULTS / f"withheld_{folder.name}_mismatch.json", ready)
    labels = {name: in_our_words(label) for name, label in open_seal(folder).items()}
    told = with_visibility(labels, ready, known)
    return {name: label["snr"] for name, label in told.items() if label["hidden"]}


def counted(scored: dict, snr: dict[str, float], machine: bool) -> dict[str, list[int]]:
    """By stratum: single effects right and all of them, as scored, then as told anew."""
    rows = [
        row for row in scored["rows"] if row["kind"] == "single"
        and (scored["hidden"][row["case"]][0]["name"] in MEASURING) == machine
    ]  # fmt: skip
    found = {}
    for stratum, (low, high) in STRATA.items():
        found[stratum] = []
        for of in (lambda row: row["snr"], lambda row: snr[row["case"]]):
            some = [row for row in rows if low <= of(row) < high]
            found[stratum] += [sum(r["verdict"] == r["truth"] for r in some), len(some)]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", type=Path, nargs="+", help="opened sets, named as in results")
    folders = parser.parse_args().folders
    reporting.configure()
    ready, snr, lines = Ready.of(store.load(store.bundled_bank())), {}, []
    for folder in folders:
        name = f"withheld_{folder.name}.json"
        scored = json.loads((reporting.RESULTS / name).read_text())
        snr[name] = told(folder, ready)
        for words, machine in (("faults of the machine", True), ("soil and walls", False)):
            for stratum, (was, all_, now, every) in counted(scored, snr[name], machine).items():
                lines.append([folder.name, words, stratum, f"{was} of {all_}", f"{now} of {every}"])
    origin = reporting.provenance()
    text = (
        "# Signal-to-noise of opened sets, told anew\n\n"
        "Single effects. As scored: each case by the share that its own four packings told; anew: "
        "by how wrong predictions of the same effect are in all cases.\n\n"
    ) + reporting.table(HEADER, lines)
    reporting.write("retold", {**origin, "snr": snr}, text + reporting.footer(origin))


if __name__ == "__main__":
    main()
