"""Make the notebooks: every percent script becomes an .ipynb beside it, is run, and keeps what it showed.

`python -m notebooks` makes all of them, `python -m notebooks 01 03` those whose names begin so.
"""

from __future__ import annotations

import base64
import io
import sys
from pathlib import Path
from typing import Any

import jupytext
import nbformat
from nbclient import NotebookClient
from PIL import Image

FOLDER = Path(__file__).parent


def execute(notebook: nbformat.NotebookNode, **how: Any) -> None:
    """Run the cells of a notebook in a kernel of its own, in this folder. how: the kernel is started, such as `env`."""
    client = NotebookClient(
        notebook,
        timeout=None,
        kernel_name="python3",
        record_timing=False,
        coalesce_streams=True,
        resources={"metadata": {"path": str(FOLDER)}},
    )
    client.execute(**how)


def make(script: Path) -> Path:
    """Run a script as a notebook in its own folder, and write it with its outputs."""
    notebook = jupytext.read(script, fmt="py:percent")
    notebook.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "jupytext": {"formats": "ipynb,py:percent"},
    }
    # Cells are numbered, so that making a notebook again changes only what it shows.
    for number, cell in enumerate(notebook.cells):
        cell.id = f"cell-{number}"
    execute(notebook)
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            if "image/png" in output.get("data", ()):
                output["data"]["image/png"] = light(output["data"]["image/png"])
    notebook.metadata.pop("language_info", None)
    target = script.with_suffix(".ipynb")
    jupytext.write(notebook, target)
    return target


def light(png: str) -> str:
    """A figure (PNG in base64) with a palette of 256 colours, which is half as large and looks the same."""
    small = io.BytesIO()
    Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB").quantize(256).save(small, "PNG", optimize=True)
    return base64.b64encode(small.getvalue()).decode()


if __name__ == "__main__":
    for path in sorted(FOLDER.glob("[0-9][0-9]_*.py")):
        if len(sys.argv) == 1 or path.name.startswith(tuple(sys.argv[1:])):
            print(make(path).relative_to(FOLDER.parent), flush=True)
