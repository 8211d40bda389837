"""The drawing of a typical slide of each failure mode."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.study import __main__ as command
from benchmarks.study import cases, draw
from benchmarks.study.rows import Outcome, Run
from cooperative.reporting import save

WIDE = {"slope": {"width": 8.0}, "strength": {"mean": 12e3, "length": [60.0, 60.0, 2.0]}, "run": {"t_end": 2.0}}
WIDE |= {grid: {"cell": 4.0, "spacing": [2.0] * 3} for grid in ("rough", "refined")}
SLID = Outcome("FINISHED", 14.0, 20.0, 5000, 9.0, volume=4000.0, mode="deep")


@pytest.mark.slow
def test_a_typical_slide_of_each_mode_is_run_again_and_drawn(monkeypatch, tmp_path):
    monkeypatch.setitem(cases.CASES, "published", {"scene": "demo", "changes": WIDE})
    known = {
        Run("published", "refined", n, until="end"): replace(SLID, mode=mode, volume=volume)
        for n, (mode, volume) in enumerate((("deep", 10.0), ("deep", 30.0), ("deep", 31.0), ("shallow", 5.0)))
    }
    known[Run("published", "refined", 9)] = Outcome("DECIDED", 1.1, 2.0, 1, 1.0)
    chosen = draw.typical(known)
    assert {mode: run.sample for mode, run in chosen.items()} == {"deep": 1, "shallow": 3}
    slide = draw.run_again(chosen["deep"], (1.0, 20.0))
    assert slide.times == (1.0, 2.0)
    largest = np.linalg.norm(slide.displacement, axis=1).max(axis=1)
    assert largest[1] > largest[0] > 0
    x, y, height, value = draw.surface(slide.position, slide.position[2], 4.0)
    assert (len(x), len(y)) == height.shape == (33, 2)
    assert height == pytest.approx(value)
    assert height[0] == pytest.approx(15.0)
    assert height[-1] == pytest.approx(3.0)
    cut = draw.deepest_section(slide)
    assert np.ptp(slide.position[1, cut]) < 1e-3
    figure = draw.drawing(slide, "deep")
    assert save(figure, tmp_path / "slide.png").stat().st_size > 10_000


def test_a_typical_slide_may_be_one_that_left_its_grid():
    left = Run("published", "refined", 0, until="end")
    known = {
        left: replace(SLID, status="OUTSIDE_GRID", mode=None, volume=None),
        replace(left, case=cases.MORE_AIR): replace(SLID, volume=20.0),
        replace(left, sample=1): replace(SLID, volume=10.0),
        replace(left, sample=2): replace(SLID, volume=30.0),
    }
    assert draw.typical(known) == {"deep": replace(left, case=cases.MORE_AIR)}


def made_up_slide(slip):
    """A block of 16 x 4 x 6 particles 0.5 m apart. slip: of each of its 4 layers, how many particles high the soil is
    that stands; what is above has a displacement along x of 0.25 m first and 3 m at the end."""
    index = np.stack(np.meshgrid(*(np.arange(n) for n in (16, 4, 6)), indexing="ij")).reshape(3, -1)
    step = np.zeros((2, *index.shape))
    step[:, 0] = np.outer((0.25, 3.0), index[2] >= np.array(slip)[index[1]])
    return draw.Slide(0.5 * index + 0.25, np.full(3, 0.25), 4e4 + 1e3 * index[2], (2.0, 20.0), step, 1.0)


def test_the_section_is_the_layer_with_the_lowest_soil_that_slid():
    slide = made_up_slide((4, 3, 2, 5))
    assert set(slide.position[1, draw.deepest_section(slide)]) == {1.25}
    wider = replace(slide, displacement=slide.displacement * (slide.position[1] < 1.0))
    assert set(wider.position[1, draw.deepest_section(wider)]) == {0.75}
    still = replace(slide, displacement=0 * slide.displacement)
    assert set(still.position[1, draw.deepest_section(still)]) == {0.25}


def test_a_slide_is_drawn_in_views_and_sections_at_each_time_and_named(tmp_path):
    figure = draw.drawing(made_up_slide((4, 3, 2, 5)), "Typical deep slide")
    assert figure.get_suptitle() == "Typical deep slide"
    above, below = figure.subfigs
    assert [ax.get_title("left") for ax in above.axes] == ["t = 2 s", "t = 20 s"]
    assert [ax.get_title("right").strip() for ax in below.axes[:3]] == ["t = 2 s", "t = 20 s", "strength before"]
    early, late = (below.axes[n].collections[0].get_array() for n in range(2))
    # Soil with a displacement of a quarter of a metre counts as standing; what is above the second particle has slid.
    assert early.mask.all()
    assert late.compressed() == pytest.approx(3.0)
    assert save(figure, tmp_path / "slide.png").stat().st_size > 10_000


def test_a_slope_that_stands_is_drawn_too(tmp_path):
    figure = draw.drawing(made_up_slide((6, 6, 6, 6)), "stands")
    assert all(ax.collections[0].get_array().mask.all() for ax in figure.subfigs[1].axes[:2])
    assert save(figure, tmp_path / "stands.png").stat().st_size > 10_000


def test_a_typical_slide_that_breaks_off_leaves_the_others(monkeypatch, capsys):
    known = {
        Run("published", "refined", n, until="end"): replace(SLID, mode=mode)
        for n, mode in enumerate(("compound", "deep", "shallow"))
    }

    def run_again(run):
        if run.sample == 1:
            raise FloatingPointError("a particle left the grid: lengthen toe")
        return run

    monkeypatch.setattr(draw, "run_again", run_again)
    monkeypatch.setattr(draw, "drawing", lambda slide, title: title)
    monkeypatch.setattr(draw, "save", lambda figure, path, dpi: path)
    monkeypatch.setattr(command, "read_study", lambda: known)
    monkeypatch.setattr(command, "FIGURES", Path("figures"))
    monkeypatch.setattr(sys, "argv", ["benchmarks.study", "--draw"])
    with pytest.raises(SystemExit, match=r"deep: sample 1 of 'published' broke off.* lengthen toe"):
        command.main()
    drawn = capsys.readouterr().out.split()
    assert drawn == ["figures/published_slide_compound.png", "figures/published_slide_shallow.png"]
    monkeypatch.setattr(sys, "argv", ["benchmarks.study", "--draw", "--modes", "shallow"])
    with pytest.raises(SystemExit):
        command.main()
    assert capsys.readouterr().out.split() == ["figures/published_slide_shallow.png"]
