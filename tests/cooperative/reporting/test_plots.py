"""Figures: every one is drawn, its axes carry units, its legend tells, its marks are the data's."""

import itertools
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.image import imread

from cooperative.estimate import Chances, Exceedance, fit_distributions, severity_ranking
from cooperative.hazard import HazardMaps
from cooperative.measure import ColumnPlan
from cooperative.reporting import _charts as charts
from cooperative.reporting import _interactive as interactive
from cooperative.reporting import _plots as plots
from cooperative.summary import Convergence, ModeShare

HALF = np.array([0.5, 0.5])
X, Z = (grid.ravel() for grid in np.meshgrid(np.arange(0.5, 24), np.arange(0.5, 8), indexing="ij"))
POSITION = np.stack([X, Z])
SOLID = np.stack([X, 4 + 0 * X, Z])
RUNS = np.arange(10, 60, 10)
SAMPLES = np.random.default_rng(0).gamma(4.0, 3.0, 40)
FITS = fit_distributions(SAMPLES, np.ones(SAMPLES.size))
SEVERITY = severity_ranking({"deep": SAMPLES[:20], "shallow": SAMPLES[20:] / 2})
MODES = {"deep": ModeShare(8, 0.8, (0.5, 0.94), 0.08), "shallow": ModeShare(2, 0.2, (0.06, 0.5), 0.02)}
CURVE = Exceedance((0.0, 5.0, 9.0), (0.3, 0.1, 0.0), (0.2, 0.04, 0.0), (0.4, 0.2, 0.1))


def maps(*shape):
    """Maps over columns of 4 m, made up."""
    value = np.linspace(0.5, 0.0, int(np.prod(shape))).reshape(shape)
    chances = Chances(value, value / 2, 0.5 + value / 2, np.ones(shape, int))
    units = {"reached": "-", "faster than 1 m/s": "-", "expected thickness": "m", "arrival": "s"}
    plan = ColumnPlan((0.0,) * len(shape), 4.0, shape, tuple((0.0, 4.0 * count) for count in shape))
    edges = tuple(plan.edges(axis) for axis in range(len(shape)))
    return HazardMaps(plan, edges, dict.fromkeys(units, chances), units, slice(4, None), 9, 0.4, 0.07, 0.5)


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
        {"rough": np.array([0.1, np.nan, 3.0]), "refined": np.array([0.2, 9.0, 8.0])}
    ),
    "convergence": lambda: charts.convergence(
        Convergence(tuple(RUNS), tuple(RUNS / 200), tuple(RUNS / 250), tuple(RUNS / 150)), "two-phase", level=0.95
    ),
    "grids": lambda: charts.grids(np.array([0.1, 0.2, 3.0]), np.array([0.1, 4.0, 8.0]), failure_displacement=1.0),
    "mode_shares": lambda: charts.mode_shares(MODES),
    "fitted": lambda: charts.fitted({"L": SAMPLES}, np.ones(SAMPLES.size), {"L": FITS}, {"L": "run-out L [m]"}),
    "exceedance": lambda: charts.exceedance({"L": CURVE}, {"L": "run-out L [m]"}, level=0.95),
    "losses": lambda: charts.losses(CURVE, level=0.95),
    "profile": lambda: charts.profile(maps(8), toe=16.0),
    "plan_maps": lambda: charts.plan_maps(maps(8, 6), toe=16.0),
    "severity": lambda: charts.severity({"L": SEVERITY}, {"L": "run-out L [m]"}),
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


@pytest.mark.parametrize("name", ["exceedance", "plan_maps", "slide"])
def test_a_figure_on_the_page_is_an_element_of_its_own(name):
    figure = FIGURES[name]()
    plots.lay_out(figure)
    shown = interactive.figure(interactive.Drawn("this", "What it shows & how.", figure))
    drawing = ElementTree.fromstring(shown).find(".//{*}svg")
    assert drawing.get("aria-labelledby") == "of-this"
    assert all(each.get("id", "of-this").startswith(("this-", "of-this")) for each in drawing.iter())
    # Labels are text; particles and maps are pictures in it.
    words = "".join(drawing.itertext())
    assert all(word in words for ax in figure.axes for word in ax.get_xlabel().split("$")[:1])
    assert bool(drawing.findall(".//{*}image")) == (name != "exceedance")


def test_maps_and_curves_that_answer_are_those_that_are_drawn():
    pytest.importorskip("plotly", reason="the extra interactive is not installed")
    made = maps(8, 6)
    shown = interactive.plan_maps(made, toe=16.0)
    assert len(shown.data) == len(charts.plan_maps(made, toe=None).axes) // 2
    np.testing.assert_allclose(shown.data[0].z.T, made.maps["reached"].value)
    np.testing.assert_allclose(shown.data[0].x, np.arange(8) * 4.0 + 2)
    assert shown.data[1].zmax == shown.data[0].zmax == 1.0 - 0.25
    along = interactive.profile(maps(8), toe=16.0)
    curve = next(trace for trace in along.data if trace.name == "reached")
    assert curve.y[:-1].tolist() == maps(8).maps["reached"].value.tolist()
    losses = interactive.stairs({"loss": CURVE}, {"loss": "loss"}, "probability")
    assert losses.data[-1].x.tolist() == [*CURVE.thresholds]


def test_particles_are_drawn_in_true_size():
    figure = FIGURES["before_and_after"]()
    boxes = [c for ax in figure.axes for c in ax.collections if isinstance(c, PolyCollection)]
    corners = boxes[0].get_paths()[0].vertices
    np.testing.assert_allclose(np.ptp(corners, axis=0), [1.0, 1.0])
    # Over the soil between them.
    assert len(boxes[0].get_paths()) == X.size < len(boxes[1].get_paths())


@pytest.mark.parametrize(("rows", "beside"), [(2, 0), (4, 1), (6, 3)])
def test_panels_of_a_section_keep_clear_of_each_other(rows, beside):
    figure, panels, others = plots.section_panels_beside(POSITION, rows, beside)
    assert (len(panels), len(others)) == (rows, beside)
    for ax in (*panels, *others):
        ax.set(xlabel="x [m]", ylabel="z [m]", xlim=(0, 24), ylim=(0, 8))
        ax.set_title("one sample", loc="left")
    for ax in panels:
        ax.set_aspect("equal")
    plots.lay_out(figure)
    renderer = FigureCanvasAgg(figure).get_renderer()
    boxes = [ax.get_tightbbox(renderer) for ax in figure.axes]
    assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))


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
        "refined grid (3 samples)",
        "rough run broke off (1)",
    ]


def test_the_fitted_figure_draws_the_runs_by_weight_and_the_best_fits():
    figure = charts.fitted(
        {"L": np.array([1.0, 3.0])}, np.array([3.0, 1.0]), {"L": FITS}, {"L": "run-out L [m]"}, most=2
    )
    runs, *fits = figure.axes[0].lines
    assert runs.get_ydata().tolist() == [0.0, 0.75, 1.0]
    assert len(fits) == 2
    assert fits[0].get_label().startswith(FITS.fits[0].name)


def test_the_most_severe_mode_stands_on_top():
    ax = FIGURES["severity"]().axes[0]
    assert [text.get_text() for text in ax.get_yticklabels()] == ["shallow (20)", "deep (20)"]


def test_no_global_state_is_left():
    plt = pytest.importorskip("matplotlib.pyplot")
    FIGURES["convergence"]()
    assert plt.get_fignums() == []


def lattice():
    x, z = np.meshgrid(np.arange(6) * 0.5 + 0.25, np.arange(4) * 0.5 + 0.25, indexing="ij")
    return np.stack([x.ravel(), z.ravel()]), np.array([0.25, 0.25])


def area(boxes):
    x, z = np.moveaxis(boxes, -1, 0)
    return 0.5 * np.sum(x * np.roll(z, -1, axis=1) - z * np.roll(x, -1, axis=1), axis=1)


def test_soil_that_stretches_is_drawn_without_cracks():
    position, half = lattice()
    still = plots.displaced_boxes(position, np.zeros_like(position), half)
    assert area(still) == pytest.approx(np.full(24, 0.25))
    stretched = plots.displaced_boxes(position, np.stack([0.8 * position[0], 0 * position[0]]), half)
    # Neighbours share their corners: those of each box are corners of the boxes beside it, and all of it is covered.
    corners = {tuple(corner) for box in stretched.round(9) for corner in box}
    assert len(corners) == 7 * 5
    assert area(stretched).sum() == pytest.approx((3.0 + 0.8 * 2.5) * 2.0)


def test_gaps_narrower_than_soil_are_filled_and_wider_ones_are_not():
    position, half = lattice()
    for gap, filled in ((0.6, True), (1.6, False)):
        apart = position + np.stack([np.where(position[0] > 1.5, gap, 0.0), 0 * position[0]])
        corners = apart.T[plots.soil_between(apart, half)]
        over = (corners[..., 0].min(axis=1) < 1.5) & (corners[..., 0].max(axis=1) > 1.5)
        assert np.abs(area(corners[over])).sum() == pytest.approx(1.5 * (0.5 + gap) if filled else 0.0)
    assert plots.soil_between(np.stack([np.arange(5.0), np.zeros(5)]), half).shape == (0, 3)


def test_soil_that_tears_is_drawn_torn():
    position, half = lattice()
    apart = np.where(position[0] > 1.5, 5.0, 0.0)
    torn = plots.displaced_boxes(position, np.stack([apart, 0 * apart]), half)
    assert area(torn) == pytest.approx(np.full(24, 0.25))
    assert torn[..., 0].max() == pytest.approx(8.0)
    # Two particles at one position are no lattice: their boxes go with them.
    twice = plots.displaced_boxes(np.tile(position, 2), np.zeros((2, 48)), half)
    assert area(twice) == pytest.approx(np.full(48, 0.25))


def test_severity_of_a_section_leaves_out_the_areas_that_it_has_none_of():
    figure = charts.severity(dict.fromkeys(("depth", "area"), SEVERITY), {"depth": "H"})
    assert [ax.get_xlabel() for ax in figure.axes] == ["H"]


def test_slides_that_leave_their_section_are_measured_whole():
    """Of a slide across the section, which shows its vertical part alone."""
    across = np.stack([0 * X, 3 + 0 * X, -4 + 0 * X])
    figure = plots.slide((POSITION, HALF), "friction", 30 + X / 8, across[None], [2.0])
    assert [ax.get_title(loc="left") for ax in figure.axes][1] == "t = 2 s, moved up to 5 m"
    figure = plots.before_and_after(POSITION, across, Z / 8, HALF)
    assert figure.axes[1].get_title(loc="left") == "after, largest displacement 5 m"
