"""Tests: folders mirror the packages, `support` holds what tests share with each other and with
`verification`, `data` what they compare with."""

from pathlib import Path

ROOT = Path(__file__).parents[1]  # of the repository
DATA = Path(__file__).parent / "data"
