"""The reference of modules: public names first, then one page a folder, from the docstrings."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("jdem", "calibrate")


def folders() -> list[Path]:
    """Folders with modules of both packages, the packages themselves first."""
    found = [path.parent for p in PACKAGES for path in sorted((ROOT / p).rglob("__init__.py"))]
    return [folder for folder in found if modules(folder)]


def modules(folder: Path) -> list[Path]:
    """Public modules of a folder; the folder's own docstring comes first."""
    return [p for p in sorted(folder.glob("*.py")) if not p.name.startswith("_")]


def dotted(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


def pages() -> dict[str, str]:
    """One page a folder: what the folder is, then every module in it."""
    made = {f"reference/api/{dotted(folder)}.md": _page(folder) for folder in folders()}
    return {f"reference/api/names_{p}.md": names_page(p) for p in PACKAGES} | made


def public(package: str) -> dict[str, str]:
    """The public names of a package, each with the module that defines it."""
    stub = ast.parse((ROOT / package / "__init__.pyi").read_text(encoding="utf-8"))
    return {
        alias.name: f"{package}.{node.module}.{alias.name}"
        for node in stub.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }


def names_page(package: str) -> str:
    """Everything that `import package` offers, by name."""
    lines = [f"# import {package}", "", first_paragraph(ROOT / package / "__init__.py"), ""]
    for name, place in sorted(public(package).items(), key=lambda item: item[0].lower()):
        lines += [f"## {package}.{name}", "", f"::: {place}", *OPTIONS, ""]
    return "\n".join(lines)


OPTIONS = (
    "    options:",
    "      docstring_style: google",
    "      show_root_heading: false",
    "      heading_level: 3",
)


def _page(folder: Path) -> str:
    lines = [f"# {dotted(folder)}", "", first_paragraph(folder / "__init__.py"), ""]
    for module in modules(folder):
        lines += [f"::: {dotted(module)}", ""]
    return "\n".join(lines)


def index() -> str:
    """All folders with what each is, in one line."""
    rows = [f"| [{dotted(f)}]({dotted(f)}.md) | {first_line(f)} |" for f in folders()]
    rules = "tests/project/test_architecture.py"
    head = f"# Modules\n\nImports run downward only: see `ORDER` in {rules}.\n"
    return "\n".join([head, "| folder | holds |", "| --- | --- |", *rows, ""])


def first_paragraph(path: Path) -> str:
    doc = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return doc.split("\n\n")[0].replace("|", "\\|")


def first_line(folder: Path) -> str:
    return first_paragraph(folder / "__init__.py").split("\n")[0]
