"""What all benchmarks share: what every measuring script does, and where their results are kept."""

from pathlib import Path

from studies.reporting import (
    CACHE,
    IMAGES,
    configure,
    footer,
    keep_content,
    keep_page,
    kept_entry,
    no_options,
    physics_of,
    provenance,
    table,
)

__all__ = [
    "CACHE",
    "IMAGES",
    "configure",
    "earlier",
    "file_of",
    "footer",
    "no_options",
    "physics_of",
    "provenance",
    "table",
    "write",
    "write_content",
    "write_page",
]
RESULTS = Path(__file__).parent / "results"  # what is committed
SHOWN = ("audit", "calibration", "tangents")  # what notebooks draw, in a folder beside them
OWN = (
    "convergence",
    "kills",
    "pairs",
    "recovery",
    "sizes",
    "verification",
)  # only their script goes on
OF_NOTEBOOKS = Path(__file__).parents[1] / "notebooks" / "data"


def file_of(name: str) -> Path:
    """Where a result's JSON is kept."""
    if name in OWN:
        return CACHE / f"{name}.json"
    return (OF_NOTEBOOKS if name in SHOWN else RESULTS) / f"{name}.json"


def write(name: str, content: dict, markdown: str) -> None:
    """The result's JSON and benchmarks/results/<name>.md; says where they are."""
    write_content(name, content)
    write_page(name, markdown)


def write_content(name: str, content: dict) -> None:
    """The result's JSON alone, for a page that shows several."""
    keep_content(file_of(name), content)


def write_page(name: str, markdown: str) -> None:
    """benchmarks/results/<name>.md alone, where it says all that was measured."""
    keep_page(RESULTS / f"{name}.md", markdown)


def earlier(name: str, key: str) -> dict:
    """Entry `key` of results written before with the same physics, or an empty dict."""
    return kept_entry(file_of(name), key)
