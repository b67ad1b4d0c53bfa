"""The hook of `mkdocs build`: pages made from the code, notebooks, and links out of docs/.

    code      -> reference/lab-file.md, reference/commands.md, reference/json.md, reference/api/
    notebooks -> tutorials/           (formulas become MathML, so no script is fetched)
    root      -> changelog.md, contributing.md, results/

A page in docs/ links to files of the repository as GitHub shows them; `on_page_markdown` leads
these links to the site's own copy, and keeps the bare text where the site has none.
"""

import json
import posixpath
import re
from pathlib import Path

import api
import commands_page
import json_page
import lab_file_page
from latex2mathml.converter import convert as mathml
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File

ROOT = Path(__file__).parents[2]
RESULTS = ("benchmarks/results", "verification/results", "studies/results")
FORMULA = re.compile(r"\$\$(.+?)\$\$|(?<![\\$\w])\$([^$\n]+?)\$(?!\w)", re.DOTALL)
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")
FENCE = re.compile(r"(^ *```.*?^ *```|`[^`\n]*`)", re.MULTILINE | re.DOTALL)


@event_priority(100)  # before the plugin that renders notebooks looks for them
def on_files(files, config):
    """Adds the pages that are made from code, notebooks and files of the root."""
    for uri, text in made().items():
        files.append(File.generated(config, uri, content=text))
    folder = ROOT / "build" / "notebooks"
    (folder / "tutorials").mkdir(parents=True, exist_ok=True)
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        uri = f"tutorials/{path.name}"
        (folder / uri).write_text(rendered(path), encoding="utf-8")
        files.append(File(uri, str(folder), config.site_dir, config.use_directory_urls))
    return files


def on_config(config):
    """Fills the two sections of the navigation whose pages are made: modules and results."""
    for entry in config.nav:
        for section in entry.values():
            if isinstance(section, list):
                section[:] = [filled(item) for item in section]
    return config


def filled(item):
    """A section of the navigation with its made pages listed."""
    if item == {"Modules": "reference/api/"}:
        return {"Modules": ["reference/api/index.md", *sorted(api.pages())]}
    if item == {"Results": "results/"}:
        return {"Results": ["results/index.md", *[f"results/{p.name}" for p in results()]]}
    return item


def made() -> dict[str, str]:
    """Every page that is made, by its place in the site."""
    pages = {
        "reference/lab-file.md": lab_file_page.page(),
        "reference/commands.md": commands_page.page(),
        "reference/json.md": json_page.page(),
        "changelog.md": (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"),
        "contributing.md": (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"),
        "results/index.md": results_index(),
        **api.pages(),
        "reference/api/index.md": api.index(),
    }
    return pages | {f"results/{p.name}": p.read_text(encoding="utf-8") for p in results()}


def results() -> list[Path]:
    pages = [path for folder in RESULTS for path in (ROOT / folder).glob("*.md")]
    return sorted((p for p in pages if p.name != "README.md"), key=lambda path: path.name)


def results_index() -> str:
    """The list of committed results, before what the folder of speed says of itself."""
    speed = (ROOT / RESULTS[0] / "README.md").read_text(encoding="utf-8")
    rows = [f"- [{p.stem}]({p.name})" for p in results()]
    intro = "Each page names the command that made it. [States](status.md) has every sentence with"
    head = ["# Results", "", f"{intro} measured numbers.", "", *rows, ""]
    return "\n".join([*head, speed.replace("# Speed", "## Speed", 1)])


# ---------------------------------------------------------------- notebooks


def rendered(path: Path) -> str:
    """A notebook whose formulas are MathML; its outputs stay as they are."""
    book = json.loads(path.read_text(encoding="utf-8"))
    for cell in book["cells"]:
        if cell["cell_type"] == "markdown":
            cell["source"] = with_mathml("".join(cell["source"]))
    return json.dumps(book)


def with_mathml(text: str) -> str:
    return FORMULA.sub(_formula, text)


def _formula(found: re.Match) -> str:
    block = found[1] is not None
    made_of = mathml((found[1] or found[2]).strip(), display="block" if block else "inline")
    return " ".join(made_of.split())


def on_page_content(html, page, config, files):
    """Takes out the script that would fetch MathJax."""
    if page.file.src_uri.endswith(".ipynb"):
        html = re.sub(r"<script[^>]*>.*?</script>", "", html, flags=re.DOTALL)
    return html


# ---------------------------------------------------------------- links


def on_page_markdown(markdown, page, config, files):
    """Leads links to files of the repository to the site's copy of them."""
    uri = page.file.src_uri
    home = Path("docs") / uri if (Path(config.docs_dir) / uri).exists() else source_of(uri)
    if home is None:
        return markdown
    parts = FENCE.split(markdown)
    parts[::2] = [LINK.sub(lambda m: led(m, home, uri), part) for part in parts[::2]]
    return "".join(parts)


def source_of(uri: str) -> Path | None:
    """Where a copied page stands in the repository."""
    known = {"changelog.md": Path("CHANGELOG.md"), "contributing.md": Path("CONTRIBUTING.md")}
    if uri.startswith("results/"):
        name = uri.removeprefix("results/").replace("index.md", "README.md")
        return next(p for f in RESULTS if (ROOT / (p := Path(f) / name)).exists())
    return known.get(uri)


def led(found: re.Match, home: Path, uri: str) -> str:
    """One link as the site needs it."""
    mark, text, target = found.groups()
    place, hash_, anchor = target.partition("#")
    if "://" in target or not place:
        return found[0]
    there = posixpath.normpath((home.parent / place).as_posix())
    known = place_on_site(there)
    if known is None:
        return text
    return (
        f"{mark}[{text}]({posixpath.relpath(known, posixpath.dirname(uri) or '.')}{hash_}{anchor})"
    )


def place_on_site(path: str) -> str | None:
    """Where the site keeps a file of the repository; None if nowhere."""
    special = {
        "README.md": "index.md",
        "CHANGELOG.md": "changelog.md",
        "CONTRIBUTING.md": "contributing.md",
        "notebooks": "tutorials/01_one_contact.ipynb",
        "benchmarks/results": "results/index.md",
        "benchmarks/results/README.md": "results/index.md",
        "verification/results": "results/status.md",
    }
    if path in special:
        return special[path]
    if path.startswith("docs/"):
        return path.removeprefix("docs/")
    if path.startswith(RESULTS) and path.endswith(".md"):
        return path.partition("/")[2]
    if path.startswith("notebooks/") and path.endswith(".ipynb"):
        return path.replace("notebooks/", "tutorials/", 1)
    return None
