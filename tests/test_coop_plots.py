"""Figures: every one is drawn, its axes carry units, its legend tells, its marks are the data's."""

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.image import imread

from cooperative.estimate import fit_distributions, severity_ranking
from cooperative.reporting import _charts as charts
from cooperative.reporting import _plots as plots

HALF = np.array([0.5, 0.5])
X, Z = (grid.ravel() for grid in np.meshgrid(np.arange(0.5, 24), np.arange(0.5, 8), indexing="ij"))
POSITION = np.stack([X, Z])
SOLID = np.stack([X, 4 + 0 * X, Z])
RUNS = np.arange(10, 60, 10)
SAMPLES = np.random.default_rng(0).gamma(4.0, 3.0, 40)
FITS = {
    "fits": [
        {"name": fit.name, "parameters": fit.parameters, "aic": fit.aic}
        for fit in fit_distributions(SAMPLES, np.ones(SAMPLES.size)).fits
    ]
}
PLACES = [
    {"group": place.group, "count": place.count, "middle": place.middle, "interval": place.interval}
    for place in severity_ranking({"deep": SAMPLES[:20], "shallow": SAMPLES[20:] / 2})
]
MODES = {
    "deep": {"count": 8, "ratio": 0.8, "interval": [0.5, 0.94]},
    "shallow": {"count": 2, "ratio": 0.2, "interval": [0.06, 0.5]},
}

FIGURES = {
    "parameter_fields": lambda: plots.parameter_fields(
        "strength", {"rough": (POSITION, HALF), "refined": (POSITION, HALF)}, {"rough": 4e4 + X, "refined": 4e4 + Z}
    ),
    "before_and_after": lambda: plots.before_and_after(POSITION, 0.1 * POSITION, Z / 8, HALF),
    "slide": lambda: plots.slide(
        (POSITION, HALF), "friction", 30 + X / 8, np.stack([POSITION * s for s in (0, 0.1, 0.2)]), [0.0, 1.0, 2.0]
    ),
    "plan": lambda: plots.plan(
        SOLID, np.stack([SOLID * s for s in (0.1, 0.2)]), [1.0, 2.0], np.array([0.5, 4.0, 0.5]), toe=16.0
    ),
    "ranked_displacements": lambda: charts.ranked_displacements(
        {
            "rough": np.array([0.1, np.nan, 3.0]),
            "refined": np.array([0.2, 9.0, 8.0]),
            "audited": np.array([True, False, False]),
        }
    ),
    "histograms": lambda: charts.histograms({"L": X, "V": np.array([])}, {"L": "run-out L [m]", "V": "volume V [m³]"}),
    "convergence": lambda: charts.convergence(
        {"two-phase": RUNS},
        {"two-phase": RUNS / 200},
        {"two-phase": np.stack([RUNS / 250, RUNS / 150])},
        truth=0.2,
    ),
    "grids": lambda: charts.grids(np.array([0.1, 0.2, 3.0]), np.array([0.1, 4.0, 8.0]), failure_displacement=1.0),
    "mode_shares": lambda: charts.mode_shares(MODES),
    "fitted": lambda: charts.fitted({"L": SAMPLES}, np.ones(SAMPLES.size), {"L": FITS}, {"L": "run-out L [m]"}),
    "severity": lambda: charts.severity({"L": PLACES}, {"L": "run-out L [m]"}),
}


@pytest.mark.parametrize("name", FIGURES)
def test_every_figure_is_drawn_with_units(name, tmp_path):
    figure = FIGURES[name]()
    pixels = imread(plots.save(figure, tmp_path / f"{name}.png", dpi=60))
    assert pixels[..., :3].std() > 0.02
    for ax in figure.axes:
        if ax.axison and ax.get_xlabel():
            assert "[" in ax.get_xlabel()
            assert "[" in ax.get_ylabel()


def test_particles_are_drawn_in_true_size():
    figure = FIGURES["before_and_after"]()
    boxes = [c for ax in figure.axes for c in ax.collections if isinstance(c, PolyCollection)]
    corners = boxes[0].get_paths()[0].vertices
    np.testing.assert_allclose(np.ptp(corners, axis=0), [1.0, 1.0])
    assert len(boxes[1].get_paths()) == X.size


def test_the_panels_of_a_slide_show_the_same_piece_of_ground():
    panels = [ax for ax in FIGURES["slide"]().axes if ax.get_xlabel() == "x [m]"]
    assert len(panels) == 4
    assert len({ax.get_xlim() for ax in panels}) == len({ax.get_ylim() for ax in panels}) == 1
    assert panels[0].get_xlim()[1] > 1.2 * 23.5


def test_a_plan_shows_the_soil_on_top():
    figure = FIGURES["plan"]()
    drawn = next(c for c in figure.axes[0].collections if isinstance(c, PolyCollection))
    far = np.linalg.norm(0.1 * SOLID, axis=0)
    np.testing.assert_allclose(np.asarray(drawn.get_array()), far[np.argsort(SOLID[2], kind="stable")])


def test_the_ranked_figure_counts_what_it_shows():
    figure = FIGURES["ranked_displacements"]()
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert labels == [
        "rough grid (2 samples)",
        "refined grid (2 samples)",
        "refined grid, audit (1 samples)",
        "rough run broke off (1)",
    ]


def test_the_fitted_figure_draws_the_runs_by_weight_and_the_best_fits():
    figure = charts.fitted(
        {"L": np.array([1.0, 3.0])}, np.array([3.0, 1.0]), {"L": FITS}, {"L": "run-out L [m]"}, most=2
    )
    runs, *fits = figure.axes[0].lines
    assert runs.get_ydata().tolist() == [0.0, 0.75, 1.0]
    assert len(fits) == 2
    assert fits[0].get_label().startswith(FITS["fits"][0]["name"])


def test_the_most_severe_mode_stands_on_top():
    ax = FIGURES["severity"]().axes[0]
    assert [text.get_text() for text in ax.get_yticklabels()] == ["shallow (20)", "deep (20)"]


def test_no_global_state_is_left():
    plt = pytest.importorskip("matplotlib.pyplot")
    FIGURES["convergence"]()
    assert plt.get_fignums() == []
