"""The notebooks: every script runs at small size and finds what theory or experience asks for; pairs are in step."""

import ast
import json
import math
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import jupytext
import pytest

from tests import ROOT

FOLDER = ROOT / "notebooks"
SCRIPTS = sorted(FOLDER.glob("[0-9][0-9]_*.py"))
MOST_BYTES = 400_000

# These run for longer than they compile: with some optimisation of their programs they take half the time.
LONG_RUNS = ("02_batched_screening", "06_rare_events")
MORE_OPTIMISED = ("xla_backend_optimization_level=0", "xla_backend_optimization_level=1")

BOUNDS = tomllib.loads((ROOT / "tests" / "project" / "notebook_bounds.toml").read_text())


def small_run(name: str) -> dict[str, float]:
    """Run a script at small size and give back the `results` that it prints last."""
    flags = os.environ["XLA_FLAGS"].replace(*MORE_OPTIMISED) if name in LONG_RUNS else os.environ["XLA_FLAGS"]
    done = subprocess.run(
        [sys.executable, f"{name}.py"],
        cwd=FOLDER,
        env=os.environ | {"JAXMPM_SMALL": "1", "MPLBACKEND": "Agg", "XLA_FLAGS": flags},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return ast.literal_eval(done.stdout.strip().splitlines()[-1])


def outside(name: str, results: dict[str, float]) -> dict[str, float]:
    """Results that lie beyond their bounds, that have none, or that lack."""
    bounds, nothing = BOUNDS[name], (math.nan, math.nan)
    known = {key: (bounds.get(key, nothing), results.get(key, math.nan)) for key in bounds.keys() | results.keys()}
    return {key: value for key, ((low, high), value) in known.items() if not low <= value <= high}


# The first runs with every change, the others with the slow tests.
ALWAYS = ("01",)

# Its cells start worker processes, which a script does below a guard only.
IN_KERNEL = "09_campaign_with_your_own_law"


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name.startswith(ALWAYS) else pytest.mark.slow)
        for name in BOUNDS
        if name != IN_KERNEL
    ],
)
def test_results_at_small_size(name):
    assert not outside(name, small_run(name))


@pytest.mark.slow
def test_a_law_of_a_cell_goes_through_a_campaign_on_two_workers():
    for needed in ("nbclient", "ipykernel"):
        pytest.importorskip(needed, reason="needs the extra `notebooks`")
    from notebooks.__main__ import execute

    notebook = jupytext.read(FOLDER / f"{IN_KERNEL}.py", fmt="py:percent")
    own = next(cell for cell in notebook.cells if "class Tresca" in cell.source)
    law = own.source.index("class Tresca"), own.source.index("class SensitiveClay")
    changed = "".join((own.source[: law[0]], own.source[slice(*law)].replace("0.5", "0.4"), own.source[law[1] :]))
    assert len([line for line in own.source.splitlines() if line]) <= 35
    results = len(notebook.cells) - 1
    notebook.cells += [
        jupytext.reads(f"# %%\n{source}", fmt="py:percent").cells[0]
        for source in (own.source, "print(report(folder))", changed)
    ]
    notebook.cells[-1].metadata["tags"] = ["raises-exception"]
    execute(notebook, env=os.environ | {"JAXMPM_SMALL": "1"})
    assert not outside(IN_KERNEL, ast.literal_eval(printed(notebook.cells[results]).splitlines()[-1]))
    assert printed(notebook.cells[-3]) == printed(own) == printed(notebook.cells[-2])
    (refused,) = notebook.cells[-1].outputs
    assert refused.ename == "ValueError"
    assert "source of SensitiveClay is" in refused.evalue


def printed(cell) -> str:
    """What a cell printed."""
    return "".join(each.text for each in cell.outputs if each.output_type == "stream" and each.name == "stdout")


def test_every_notebook_has_bounds():
    assert {script.stem for script in SCRIPTS} == BOUNDS.keys()


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_script_and_notebook_are_one(script):
    def cells(path: Path, **how: str) -> list[tuple[str, str]]:
        return [(cell.cell_type, cell.source) for cell in jupytext.read(path, **how).cells]

    assert cells(script, fmt="py:percent") == cells(script.with_suffix(".ipynb"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_notebook_keeps_outputs_and_is_light(script):
    path = script.with_suffix(".ipynb")
    assert path.stat().st_size < MOST_BYTES
    cells = json.loads(path.read_text())["cells"]
    outputs = [output for cell in cells if cell["cell_type"] == "code" for output in cell["outputs"]]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert not any(output["output_type"] == "error" or output.get("name") == "stderr" for output in outputs)
