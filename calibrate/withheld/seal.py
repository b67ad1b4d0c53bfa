"""Sealed labels: what each case hides, in canonical JSON with a nonce, and its SHA-256.

The hashes stand open beside the cases; the labels lie in a folder of their own that a diagnosis
never opens.  A nonce keeps anyone from guessing a label by hashing the few possible ones.
"""

import hashlib
import json
from pathlib import Path

LABELS = "sealed/labels.json"
HASHES = "labels.sha256"


def canonical(label: dict) -> str:
    """The one way of writing a label: sorted keys, no spaces, ASCII."""
    return json.dumps(label, sort_keys=True, separators=(",", ":"), ensure_ascii=True)


def digest(label: dict) -> str:
    """SHA-256 of the canonical label, hexadecimal."""
    return hashlib.sha256(canonical(label).encode()).hexdigest()


def write_seal(labels: list[dict], folder: Path) -> None:
    """Labels into `folder`/sealed, their hashes beside the cases, both in the order of case ids."""
    ordered = sorted(labels, key=lambda label: label["case"])
    (folder / LABELS).parent.mkdir(exist_ok=True)
    rows = ",\n".join(canonical(label) for label in ordered)
    (folder / LABELS).write_text(f"[\n{rows}\n]\n")
    hashes = "".join(f"{digest(label)}  {label['case']}\n" for label in ordered)
    (folder / HASHES).write_text(hashes)


def open_seal(folder: Path) -> dict[str, dict]:
    """The labels by case id, each checked against its published hash; ValueError if one differs.

    Only for scoring, after the verdicts are written.
    """
    published = dict(line.split()[::-1] for line in (folder / HASHES).read_text().splitlines())
    labels = {label["case"]: label for label in json.loads((folder / LABELS).read_text())}
    if published != {case: digest(label) for case, label in labels.items()}:
        raise ValueError(f"{folder}: labels do not match the published hashes")
    return labels
