"""Withheld cases for tests: specimens by formula, labels, verdicts."""

import hashlib

import numpy as np

from calibrate.validation.laboratory import SpecimenRecords, recorded

CLASSES = [["seating_gap", "load_frame_compliance"], ["wall_friction"], ["acquisition_lag"]]
SEAT = "seating_gap / load_frame_compliance"


def there_and_back() -> np.ndarray:
    """A confined test as a formula: 100 N/mm up to 4 mm, and 400 N/mm back to no force."""
    up = np.column_stack([np.linspace(0, 4, 201), np.linspace(0, 400, 201)])
    down = np.column_stack([np.linspace(4, 3, 101), np.linspace(400, 0, 101)])
    return np.vstack([up, down[1:]])


def specimens(seed: int, stiff: float = 1.0, count: int = 4) -> list[SpecimenRecords]:
    """Specimens by formula; the second test rises to a peak at 4 mm and softens."""
    random = np.random.default_rng(seed)
    way = np.linspace(0, 12, 300)
    crushed = np.column_stack([way, 200 * stiff * way / 4 * np.exp(1 - way / 4)])
    return [
        SpecimenRecords(
            {
                "confined": recorded(there_and_back() * np.array([1 / stiff, 1.0]), 0.0, random),
                "unconfined": recorded(crushed, 0.0, random),
            },
            1830 * (1 + 0.004 * random.standard_normal()),
        )
        for _ in range(count)
    ]


def label(case: str, kind: str = "single", *hidden: str, snr: float = 7.0) -> dict:
    """What a generator seals of a case."""
    effects = [{"name": name, "strength": 1.0} for name in hidden]
    nonce = hashlib.sha256(case.encode()).hexdigest()
    return {"case": case, "kind": kind, "hidden": effects, "snr": snr, "nonce": nonce}


def verdict(case: str, said: str, stated: float = 0.9, **more) -> dict:
    """What a diagnosis writes of a case."""
    return {
        "case": case, "verdict": said, "stated": stated, "by_class": {said: stated},
        "likely_set": [said], "classes": CLASSES, "p_before": 0.01,
        "rivals": {name: "none" for name in ("majority", "template", "bic", "classifier")}, **more,
    }  # fmt: skip
