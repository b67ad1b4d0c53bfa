"""Sealed labels: what each case hides, in canonical JSON with a nonce, and its SHA-256.

The hashes stand open beside the cases; the labels lie in a folder of their own that a diagnosis
never opens.  A nonce keeps anyone from guessing a label by hashing the few possible ones.

Does anything but the curves give a case away all the same?  A classifier that sees only metadata
says (`canary`): nearest neighbours vote on densities, file sizes and numbers of lines; with
leak-proof files they do no better than with shuffled labels.
"""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibrate.core.errors import InputError
from calibrate.core.files import write_text
from calibrate.io.lab import load_lab

LABELS = "sealed/labels.json"
HASHES = "labels.sha256"
NEIGHBOURS = 5
SHUFFLES = 500


def canonical(label: dict) -> str:
    """The one way of writing a label: sorted keys, no spaces, ASCII."""
    return json.dumps(label, sort_keys=True, separators=(",", ":"), ensure_ascii=True)


def digest(label: dict) -> str:
    """SHA-256 of the canonical label, hexadecimal."""
    return hashlib.sha256(canonical(label).encode()).hexdigest()


def write_seal(labels: list[dict], folder: Path) -> None:
    """Labels into `folder`/sealed, their hashes beside the cases, both in the order of case ids."""
    ordered = sorted(labels, key=lambda label: label["case"])
    rows = ",\n".join(canonical(label) for label in ordered)
    write_text(folder / LABELS, f"[\n{rows}\n]\n")
    hashes = "".join(f"{digest(label)}  {label['case']}\n" for label in ordered)
    write_text(folder / HASHES, hashes)


def open_seal(folder: Path) -> dict[str, dict]:
    """The labels by case id, each checked against its published hash; `InputError` if one differs
    or a file is missing.

    Only for scoring, after the verdicts are written.
    """
    try:
        lines = (folder / HASHES).read_text(encoding="utf-8").splitlines()
        labels = json.loads((folder / LABELS).read_text(encoding="utf-8"))
        published = sorted(tuple(line.split()) for line in lines)
        sealed = sorted((digest(label), label["case"]) for label in labels)
    except (OSError, ValueError, TypeError, KeyError) as error:
        problem = f"the seal cannot be read ({type(error).__name__})"
        raise InputError(str(folder), "", problem, "give a folder of sealed cases") from None
    if published != sealed:
        problem = "labels do not match the published hashes"
        raise InputError(str(folder / LABELS), "", problem, "take the labels that were sealed")
    return {label["case"]: label for label in labels}


def metadata(folder: Path) -> np.ndarray:
    """What is known of a case without its curves' numbers."""
    lab = load_lab(folder / "lab.toml")
    sizes = sorted(path.stat().st_size for path in folder.glob("*.csv"))
    lines = sorted(len(path.read_text().splitlines()) for path in folder.glob("*.csv"))
    density = np.array(lab.density_kg_m3)
    name = int(folder.name, 16) if all(c in "0123456789abcdef" for c in folder.name) else 0
    return np.array([
        density.mean(), density.std(), lab.specimen.height, len(lab.curves), np.mean(sizes),
        np.std(sizes), np.mean(lines), name,
    ])  # fmt: skip


def canary(folders: Sequence[Path], kinds: Sequence[str], seed: int) -> dict:
    """Share of kinds guessed from metadata, what shuffled labels give, and the p-value."""
    if len(folders) <= NEIGHBOURS:
        return {"right": None, "shuffled": None, "p_value": None}
    values = np.array([metadata(folder) for folder in folders])
    spread = values.std(axis=0)
    values = (values - values.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
    labels, rng = np.array(kinds), np.random.default_rng(seed)
    near = _neighbours(values)
    right = _guessed(near, labels)
    by_chance = np.array([_guessed(near, rng.permutation(labels)) for _ in range(SHUFFLES)])
    p = float((np.sum(by_chance >= right) + 1) / (SHUFFLES + 1))
    return {"right": right, "shuffled": float(by_chance.mean()), "p_value": p}


def _neighbours(values: np.ndarray) -> np.ndarray:
    distance = ((values[:, None] - values) ** 2).sum(axis=2)
    np.fill_diagonal(distance, np.inf)
    return np.argsort(distance, axis=1)[:, :NEIGHBOURS]


def _guessed(near: np.ndarray, labels: np.ndarray) -> float:
    names = np.unique(labels)
    votes = np.array([(labels[near] == name).sum(axis=1) for name in names])
    return float(np.mean(names[votes.argmax(axis=0)] == labels))
