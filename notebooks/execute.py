"""Runs notebooks from top to bottom and keeps what they show: `python notebooks/execute.py`.

Executed in place, all or those named.  A cell that fails ends its notebook, which then stays as it
was; the others go on.  How long each took is printed, and the processor's time (other work on the
machine lengthens only the first).  Timings, and all metadata that differ from
machine to machine, are left out of the files, so that equal results are equal files.
"""

import argparse
import base64
import io
import os
import resource
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from nbformat import NotebookNode
from PIL import Image

FOLDER = Path(__file__).parent
COLOURS = 96  # of a picture
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
    """The notebook with cells and outputs, the metadata that every notebook here has, and pictures
    in few colours."""
    notebook.metadata = nbformat.from_dict(METADATA)
    for cell in notebook.cells:
        cell.metadata = nbformat.from_dict({})
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data:
                data["image/png"] = in_few_colours(data["image/png"])
    return notebook


def in_few_colours(png: str) -> str:
    """A picture (base64) with COLOURS of its own, which takes a third of the room."""
    picture = Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB")
    written = io.BytesIO()
    picture.quantize(COLOURS, dither=Image.Dither.NONE).save(written, "PNG", optimize=True)
    smaller = base64.b64encode(written.getvalue()).decode()
    return min(smaller, png, key=len)


def processor_time() -> float:
    """Seconds of processor time of all kernels that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("notebooks", nargs="*", type=Path, help="default: all")
    failed = []
    for path in parser.parse_args().notebooks or notebooks():
        begun, used, ending = time.perf_counter(), processor_time(), "runs"
        try:
            nbformat.write(executed(path, path.parent), path)
        except CellExecutionError as error:
            print(error, flush=True)
            failed.append(path.name)
            ending = "FAILS"
        taken, used = time.perf_counter() - begun, processor_time() - used
        print(f"{path.name:28s} {ending:5s} {taken:5.0f} s, processor {used:5.0f} s", flush=True)
    raise SystemExit(f"these notebooks fail: {', '.join(failed)}" if failed else 0)


if __name__ == "__main__":
    main()
