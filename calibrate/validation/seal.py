"""Sealed labels: what each case hides, in canonical JSON with a nonce, and its SHA-256.

The hashes stand open beside the cases; the labels lie in a folder of their own that a diagnosis
never opens.  A nonce keeps anyone from guessing a label by hashing the few possible ones.
"""

import hashlib
import json
from pathlib import Path

from calibrate.core.errors import InputError
from calibrate.core.files import write_text

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
