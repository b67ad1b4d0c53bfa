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
PAGE = Path(__file__).parent / "results" / "README.md"  # what is committed


def write(name: str, content: dict, section: str) -> None:
    """The result's JSON in CACHE and a section of the page of speed; says where they are."""
    keep_content(CACHE / f"{name}.json", content)
    write_page(section)


def write_page(section: str) -> None:
    """A section of benchmarks/results/README.md, in the place of the one with the same title."""
    page = PAGE.read_text(encoding="utf-8")
    title = section.partition("\n")[0]
    before, found, rest = page.partition(f"{title}\n")
    _, _, after = rest.partition("\n## ")
    kept = f"\n## {after}" if after else ""
    keep_page(
        PAGE, f"{before if found else before.rstrip() + 2 * chr(10)}{section.rstrip()}\n{kept}"
    )


def earlier(name: str, key: str) -> dict:
    """Entry `key` of results written before with the same physics, or an empty dict."""
    return kept_entry(CACHE / f"{name}.json", key)
