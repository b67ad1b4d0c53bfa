"""Does anything but the curves give a case away?  A classifier that sees only metadata.

Nearest neighbours vote on densities, file sizes and numbers of lines; with leak-proof files
they do no better than with shuffled labels.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibrate.io.lab import load_lab

NEIGHBOURS = 5
SHUFFLES = 500


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
