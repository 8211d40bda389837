"""The notebooks: every script runs at small size and finds what theory or experience asks for; pairs are in step."""

import ast
import json
import math
import os
import subprocess
import sys
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

# What each notebook's `results` must lie between, at small size.
BOUNDS = {
    "01_first_slope": {
        "stress_error": (0.0, 0.02),  # of the weight above, behind the crest
        "standing_displacement": (1e-3, 0.1),
        "stable": (1.15, 1.2501),  # 1.22 and 1.23 in steps of 0.01
        "fails": (1.2, 1.3001),
        "runout": (14.0, 21.0),
        "speed_at_end": (0.0, 0.2),
        "gif_bytes": (1e4, 1e6),
    },
    "02_batched_screening": {
        "same_in_any_batch": (1, 1),
        "failed": (1, 10),  # of 24, at a probability of 0.155 with 1000 samples
        "broke_off": (0, 0),
        "settled_share_of_steps": (0.03, 0.3),
        "rank_correlation_overall": (-1.0, -0.6),
        "rank_correlation_band": (-1.0, -0.8),
        "rank_correlation_own": (-1.0, -0.8),
        "deepest_correlation_at": (0.0, 4.0),  # in the foundation
        "worst_over_best": (50.0, 1e6),
    },
    "03_random_fields": {
        "modes": (40, 56),
        "lost_at_worst_of_95": (0.15, 0.4),  # in the corners
        "lost_at_worst_of_999": (0.001, 0.05),
        "correlation_error": (0.0, 0.15),  # three standard errors of 400 samples
        "mean_error": (0.0, 0.02),
        "cov_error": (0.0, 0.02),
        "same_field": (0.0, 1e-5),
        "borehole_misfit_over_error": (0.1, 1.1),
        "derivative_error": (0.0, 5e-3),
    },
    "04_campaign": {
        "probability": (0.02, 0.5),
        "interval_holds": (1, 1),
        "refined_runs": (10, 10),
        "rough_share": (0.05, 0.4),  # cells of 4 m hold some of what cells of 2 m let go
        "rank_correlation": (0.7, 1.0),
        "mode_ratios": (0.999, 1.001),
        "same_after_damage": (1, 1),
    },
    "07_your_own_material_and_scene": {
        "flow_error": (0.0, 1e-4),
        "wave_error": (0.0, 0.03),
        "wave_order": (1.0, 2.2),
        "own_kernel_error": (0.0, 0.06),
        "dimensions_differ": (0.0, 1e-4),
        "front_plane": (0.85, 1.1),  # of a closed form without inertia
        "front_round": (0.85, 1.1),
        "own_estimator_runs": (4, 4),
        "own_estimator_probability": (0.25, 1.0),
    },
    "05_sensitivity_and_back_analysis": {
        "derivative_over_difference": (0.95, 1.05),
        "share_of_map_in_a_tenth": (0.15, 0.6),
        "predicted_over_true": (0.9, 1.1),
        "elsewhere_over_where_it_matters": (0.0, 0.7),
        "loss_per_reading": (0.2, 0.8),  # a half, if readings are explained to their noise
        "strength_error": (0.0, 0.06),
    },
    "06_rare_events": {
        "beta": (1.7, 2.7),
        "converged": (1, 1),
        "gradients": (3, 25),
        "failing_share": (0.3, 0.95),
        "probability_over_form": (0.5, 10.0),  # other slip surfaces fail too
        "cov_over_monte_carlo": (0.1, 1.0),
        "weakest_layer_ratio": (0.4, 0.9),
    },
    "08_hazard_maps": {
        "probability": (0.1, 0.9),
        "curve_starts_at_probability": (1 - 1e-12, 1 + 1e-12),
        "mapped_over_counted": (1 - 1e-6, 1 + 1e-6),
        "road_reached": (0.1, 0.9),
        "hill_probability": (0.1, 0.95),
        "hill_reached": (0.1, 0.95),
        "read_back_error": (0.0, 1e-8),
        "corner_east": (0.5, 1.5),  # half a cell from the origin
    },
    "09_campaign_with_your_own_law": {
        "probability": (0.05, 0.7),
        "interval_holds": (1, 1),
        "refined_runs": (10, 12),
        "same_again": (1, 1),
    },
}


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
