"""What scripts that measure speed share: provenance, tables, and where their results are kept."""

from pathlib import Path

from studies.reporting import (
    CACHE,
    configure,
    footer,
    keep_content,
    keep_page,
    kept_entry,
    provenance,
    table,
)

__all__ = ["CACHE", "configure", "earlier", "footer", "provenance", "table", "write", "write_page"]
RESULTS = Path(__file__).parent / "results"  # what is committed


def write(name: str, content: dict, markdown: str) -> None:
    """The result's JSON in CACHE and benchmarks/results/<name>.md; says where they are."""
    keep_content(CACHE / f"{name}.json", content)
    write_page(name, markdown)


def write_page(name: str, markdown: str) -> None:
    """benchmarks/results/<name>.md alone, where it says all that was measured."""
    keep_page(RESULTS / f"{name}.md", markdown)


def earlier(name: str, key: str) -> dict:
    """Entry `key` of results written before with the same physics, or an empty dict."""
    return kept_entry(CACHE / f"{name}.json", key)
