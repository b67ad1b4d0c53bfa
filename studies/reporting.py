"""What scripts share that measure something: JAX's settings, provenance, JSON and Markdown files.

Results of studies lie in studies/results.  Scripts in `verification` and in benchmarks have files
like this one that say where theirs are.
"""

import argparse
import json
import lzma
import os
import platform
import shlex
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

import jax

from calibrate.core.files import as_json, write_bytes, write_json, write_text
from jdem.physics import PHYSICS

ROOT = Path(__file__).resolve().parents[1]
CACHE = Path("results/benchmarks")  # campaigns: packings and runs
RESULTS = Path(__file__).parent / "results"  # what is committed
IMAGES = ROOT / "docs" / "images"  # of pages
FIRST = "cd59c67cb0da6576"  # engine in files that have the numbers of physics 1
MODULES = ("studies", "verification")  # folders whose files run as `python -m`
COMPRESSED = (
    "further_tests", "open_cases", "sound_cases", "withheld_liggghts", "withheld_own",
    "withheld_second",
)  # fmt: skip
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
        "command": shlex.join(["python", *_program(sys.argv[0]), *_arguments()]),
        "machine": {"cores": os.cpu_count(), "cpu": _cpu_model(), "system": platform.system()},
        "versions": {
            "python": platform.python_version(),
            **{name: metadata.version(name) for name in PACKAGES},
        },
        "physics": PHYSICS,
    }


def file_of(name: str) -> Path:
    """Where a result's JSON is kept; compressed where it has a row for each of many cases."""
    return RESULTS / (f"{name}.json.xz" if name in COMPRESSED else f"{name}.json")


def content_of(path: Path) -> dict:
    """What a result's JSON file holds, compressed or not."""
    opened = lzma.open if path.suffix == ".xz" else open
    with opened(path, "rt", encoding="utf-8") as file:
        return json.load(file)


def write(name: str, content: dict, markdown: str) -> None:
    """The result's JSON and studies/results/<name>.md; says where they are."""
    write_content(name, content)
    write_page(name, markdown)


def write_content(name: str, content: dict) -> None:
    """The result's JSON alone, for a page that shows several."""
    keep_content(file_of(name), content)


def write_page(name: str, markdown: str) -> None:
    """studies/results/<name>.md alone, where it says all that was measured."""
    keep_page(RESULTS / f"{name}.md", markdown)


def keep_content(path: Path, content: dict) -> None:
    """A JSON file in one line, as many are large; says where it is."""
    if path.suffix == ".xz":
        write_bytes(path, lzma.compress(as_json(content, None).encode("utf-8")))
    else:
        write_json(path, content, indent=None)
    print(f"written: {path}", file=sys.stderr)


def earlier(name: str, key: str) -> dict:
    """Entry `key` of results written before with the same physics, or an empty dict."""
    return kept_entry(file_of(name), key)


def kept_entry(path: Path, key: str) -> dict:
    """An entry of a result's JSON file, or an empty dict where it has another physics."""
    if not path.exists():
        return {}
    content = content_of(path)
    return content[key] if physics_of(content) == str(PHYSICS) and key in content else {}


def physics_of(content: dict) -> str:
    """Version of the physics that made a result.  Files from before it had one name an engine, a
    hash of the source; one of these hashes is that of the first version."""
    engine = content.get("engine", FIRST)
    return str(content.get("physics", 1 if engine == FIRST else f"before 1, engine {engine}"))


def keep_page(path: Path, markdown: str) -> None:
    """A Markdown file, shown; says where it is."""
    write_text(path, markdown)
    print(markdown)
    print(f"written: {path}", file=sys.stderr)


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def footer(origin: dict) -> str:
    """One line of provenance for a Markdown file."""
    machine, versions = origin["machine"], origin["versions"]
    listed = ", ".join(f"{name} {version}" for name, version in versions.items())
    day = f" on {origin['date']}" if "date" in origin else ""
    return (
        f"\nMade{day} by `{origin['command']}` on {machine['cores']} cores of {machine['cpu']}; "
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


def _program(path: str) -> list[str]:
    """What `python` is given to run a file: a module, else a script."""
    resolved = Path(path).resolve()
    if not resolved.is_relative_to(ROOT):
        return [resolved.name]
    place = resolved.relative_to(ROOT)
    if place.parts[0] not in MODULES:
        return [str(place)]
    parts = place.with_suffix("").parts
    return ["-m", ".".join(parts[:-1] if parts[-1] == "__main__" else parts)]


def _cpu_model() -> str:
    """The processor's name where the system tells it, else its architecture."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
