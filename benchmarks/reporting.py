"""What all benchmarks share: JAX's settings, provenance, JSON and Markdown files."""

import argparse
import json
import os
import platform
import shlex
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

import jax

from calibrate.core.files import write_json, write_text
from jdem.physics import PHYSICS

CACHE = Path("results/benchmarks")  # campaigns: packings and runs
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
IMAGES = Path(__file__).parents[1] / "docs" / "images"  # of pages
FIRST = "cd59c67cb0da6576"  # engine in files that have the numbers of physics 1
PACKAGES = ("jax", "jaxlib", "equinox", "optimistix", "numpy")


def configure(compilation_cache: bool = True) -> None:
    """Double precision, and compiled programs kept between calls."""
    jax.config.update("jax_enable_x64", True)
    if compilation_cache:
        jax.config.update("jax_compilation_cache_dir", str((CACHE / "compiled").resolve()))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


def no_options(what: str | None) -> None:
    """Reads the command line of a script that has no options: so that `--help` says what it is, and
    begins nothing that rewrites results."""
    plain = argparse.RawDescriptionHelpFormatter
    argparse.ArgumentParser(description=what, formatter_class=plain).parse_args()


def provenance() -> dict:
    """Command, machine and versions; no date, so that equal results are equal files."""
    return {
        "command": shlex.join(["python", _relative(sys.argv[0]), *_arguments()]),
        "machine": {"cores": os.cpu_count(), "cpu": _cpu_model(), "system": platform.system()},
        "versions": {
            "python": platform.python_version(),
            **{name: metadata.version(name) for name in PACKAGES},
        },
        "physics": PHYSICS,
    }


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
    """The result's JSON alone, for a page that shows several; in one line, as many are large."""
    write_json(file_of(name), content, indent=None)
    print(f"written: {file_of(name)}", file=sys.stderr)


def write_page(name: str, markdown: str) -> None:
    """benchmarks/results/<name>.md alone, where it says all that was measured."""
    write_text(RESULTS / f"{name}.md", markdown)
    print(markdown)
    print(f"written: {RESULTS / name}.md", file=sys.stderr)


def earlier(name: str, key: str) -> dict:
    """Entry `key` of results written before with the same physics, or an empty dict."""
    path = file_of(name)
    if not path.exists():
        return {}
    content = json.loads(path.read_text(encoding="utf-8"))
    return content[key] if physics_of(content) == str(PHYSICS) and key in content else {}


def physics_of(content: dict) -> str:
    """Version of the physics that made a result.  Files from before it had one name an engine, a
    hash of the source; one of these hashes is that of the first version."""
    engine = content.get("engine", FIRST)
    return str(content.get("physics", 1 if engine == FIRST else f"before 1, engine {engine}"))


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def footer(origin: dict) -> str:
    """One line of provenance for a Markdown file."""
    machine, versions = origin["machine"], origin["versions"]
    listed = ", ".join(f"{name} {version}" for name, version in versions.items())
    return (
        f"\nMade by `{origin['command']}` on {machine['cores']} cores of {machine['cpu']}; "
        f"{listed}; physics {physics_of(origin)}.\n"
    )


def _arguments() -> list[str]:
    """The command's options without the folder of what is kept, which changes no number."""
    options = sys.argv[1:]
    for name in ("--folder", "--work"):
        if name in options:
            place = options.index(name)
            del options[place : place + 2]
    return options


def _relative(path: str) -> str:
    resolved = Path(path).resolve()
    root = Path(__file__).resolve().parent.parent
    return str(resolved.relative_to(root)) if resolved.is_relative_to(root) else resolved.name


def _cpu_model() -> str:
    """The processor's name where the system tells it, else its architecture."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
