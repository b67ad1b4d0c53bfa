"""Runs notebooks from top to bottom and keeps what they show: `python notebooks/execute.py`.

Executed in place, all or those named.  Timings, and all metadata that differ from machine
to machine, are left out, so that equal results are equal files.
"""

import os
import sys
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode

FOLDER = Path(__file__).parent
TIMEOUT = 1800  # s; of one cell, on a busy machine
METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}


def notebooks() -> list[Path]:
    """All notebooks of this folder, in order."""
    return sorted(FOLDER.glob("*.ipynb"))


def executed(path: Path, folder: Path) -> NotebookNode:
    """The notebook at `path` run in `folder` with a kernel of this Python; raises
    `CellExecutionError` where a cell fails."""
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # XLA's alarm about slow compiling
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(
        notebook,
        timeout=TIMEOUT,
        kernel_name="python3",
        record_timing=False,
        coalesce_streams=True,
        resources={"metadata": {"path": str(folder)}},
    )
    return clean(client.execute())


def clean(notebook: NotebookNode) -> NotebookNode:
    """The notebook with cells and outputs, and the metadata that every notebook here has."""
    notebook.metadata = nbformat.from_dict(METADATA)
    for cell in notebook.cells:
        cell.metadata = nbformat.from_dict({})
    return notebook


def main() -> None:
    named = [Path(name) for name in sys.argv[1:]] or notebooks()
    for path in named:
        begun = time.perf_counter()
        nbformat.write(executed(path, path.parent), path)
        print(f"{path.name}: {time.perf_counter() - begun:.0f} s", flush=True)


if __name__ == "__main__":
    main()
