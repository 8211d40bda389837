"""Figures: every one is drawn, its axes carry units, its legend tells, its marks are the data's."""

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.image import imread

from cooperative import plots

HALF = np.array([0.5, 0.5])
X, Z = (grid.ravel() for grid in np.meshgrid(np.arange(0.5, 24), np.arange(0.5, 8), indexing="ij"))
POSITION = np.stack([X, Z])
RUNS = np.arange(10, 60, 10)

FIGURES = {
    "strength_fields": lambda: plots.strength_fields(
        {"rough": (POSITION, HALF), "refined": (POSITION, HALF)}, {"rough": 4e4 + X, "refined": 4e4 + Z}
    ),
    "before_and_after": lambda: plots.before_and_after(POSITION, 0.1 * POSITION, Z / 8, HALF),
    "frames": lambda: plots.frames([0, 1, 2], POSITION, np.stack([POSITION * s for s in (0, 0.1, 0.2)]), HALF),
    "ranked_displacements": lambda: plots.ranked_displacements(
        {
            "rough": np.array([0.1, np.nan, 3.0]),
            "refined": np.array([0.2, 9.0, 8.0]),
            "audited": np.array([True, False, False]),
        }
    ),
    "histograms": lambda: plots.histograms(
        {"L": X, "V": np.array([])},
        {"L": "run-out L [m]", "V": "volume V [m³]"},
        {"L": {"normal": (X, np.full(X.size, 0.04))}},
    ),
    "convergence": lambda: plots.convergence(
        {"two-phase": RUNS},
        {"two-phase": RUNS / 200},
        {"two-phase": np.stack([RUNS / 250, RUNS / 150])},
        truth=0.2,
    ),
}


@pytest.mark.parametrize("name", FIGURES)
def test_every_figure_is_drawn_with_units(name, tmp_path):
    figure = FIGURES[name]()
    pixels = imread(plots.save(figure, tmp_path / f"{name}.png", dpi=60))
    assert pixels[..., :3].std() > 0.02
    for ax in figure.axes:
        if ax.axison and ax.get_xlabel():
            assert "[" in ax.get_xlabel()
            assert "[" in ax.get_ylabel() or ax.get_ylabel() == "probability density"


def test_particles_are_drawn_in_true_size():
    figure = FIGURES["before_and_after"]()
    boxes = [c for ax in figure.axes for c in ax.collections if isinstance(c, PolyCollection)]
    corners = boxes[0].get_paths()[0].vertices
    np.testing.assert_allclose(np.ptp(corners, axis=0), [1.0, 1.0])
    assert len(boxes[1].get_paths()) == X.size


def test_the_ranked_figure_counts_what_it_shows():
    figure = FIGURES["ranked_displacements"]()
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert labels == [
        "rough grid (2 samples)",
        "refined grid (2 samples)",
        "refined grid, audit (1 samples)",
        "rough lane failed (1)",
    ]


def test_no_global_state_is_left():
    plt = pytest.importorskip("matplotlib.pyplot")
    FIGURES["convergence"]()
    assert plt.get_fignums() == []
