"""Sheets of slides for readers."""

import sys

import numpy as np
import pytest

from benchmarks.study import cases, mode_pasts, mode_readings, mode_sheets
from benchmarks.study.draw import Slide
from benchmarks.study.rows import Run
from cooperative.measure import SEVERITY
from jaxmpm import Face

WIDE = {"slope": {"width": 8.0}, "strength": {"mean": 20e3, "length": [60.0, 60.0, 2.0]}, "run": {"t_end": 4.0}}
WIDE |= {grid: {"cell": 4.0, "spacing": [2.0] * 3} for grid in ("rough", "refined")}


def made_up():
    """A block of 16 x 12 x 6 particles 1 m apart; its upper half lets go after 2 s and moves 3 m."""
    index = np.stack(np.meshgrid(*(np.arange(n) for n in (16, 12, 6)), indexing="ij")).reshape(3, -1)
    upper = index[2] >= 3
    step = np.zeros((2, *index.shape))
    step[:, 0] = np.outer((0.5, 3.0), upper)
    slide = Slide(index + 0.5, np.full(3, 0.5), np.full(upper.size, 4e4), (2.0, 20.0), step, 2.0)
    released = np.zeros(80)
    released[8] = 1.0
    past = mode_pasts.Past(released, np.full(6, 3.0), np.full(6, 1 / 6), 4.0, "shallow")
    return mode_pasts.Watched(slide, np.where(upper, 2.0, np.inf), Face(12.0, 2.0, 4.0), past)


def words(figure):
    """All text of a figure."""
    axes = [ax for part in figure.subfigs for ax in part.axes]
    titles = [title for ax in axes for title in (ax.get_title(), ax.get_title("left"), ax.get_title("right"))]
    all_of_it = [figure.get_suptitle(), *(part.get_suptitle() for part in figure.subfigs), *titles]
    return [text.strip() for text in all_of_it]


def test_a_sheet_has_no_word_of_a_mode_and_a_map_at_each_time(tmp_path):
    figure = mode_sheets.drawing(made_up(), "Slide 5")
    text = words(figure)
    assert text[0] == "Slide 5"
    assert [title for title in text if title.startswith("t = ")] == ["t = 2 s", "t = 20 s"] * 2
    assert not any(mode in title for title in text for mode in SEVERITY)
    assert mode_sheets.save(figure, tmp_path / "sheet.png", dpi=50).stat().st_size > 10_000


def test_numbers_of_sheets_are_those_of_all_slides_in_an_order_of_their_own():
    samples = [1, 3, 8, 10, 20, 27]
    numbered = mode_sheets.numbered(samples)
    assert list(numbered) == [1, 2, 3, 4, 5, 6]
    assert sorted(numbered.values()) == samples
    assert list(numbered.values()) != samples
    assert mode_sheets.numbered(samples[::-1]) == numbered


def test_readers_see_the_slides_of_the_lowest_samples(monkeypatch):
    monkeypatch.setattr(mode_sheets, "SHEETS", 3)
    assert mode_sheets.numbered([27, 1, 3, 8, 10]) == mode_sheets.numbered([8, 3, 1])


def test_a_slide_is_drawn_some_seconds_after_its_first_release_and_at_its_end():
    times = np.arange(0.25, 20.1, 0.25)
    assert times[mode_pasts.looks(times, 2.1)].tolist() == [3.0, 4.0, 6.0, 9.0, 13.0, 20.0]
    assert times[mode_pasts.looks(times, 12.0)].tolist() == [13.0, 14.0, 16.0, 19.0, 20.0]


def test_sheets_that_are_there_are_not_drawn_again(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(mode_sheets, "slides", lambda: [Run("a", "rough", sample) for sample in (4, 9)])
    monkeypatch.setattr(mode_sheets, "watch", lambda run: made_up())
    monkeypatch.setattr(sys, "argv", ["mode_readings", "--draw", str(tmp_path)])
    (tmp_path / "slide_01.png").write_bytes(b"there")
    mode_readings.main()
    assert capsys.readouterr().out.split() == [str(tmp_path / "slide_02.png")]
    assert (tmp_path / "slide_01.png").read_bytes() == b"there"


@pytest.mark.slow
def test_a_slide_is_run_again_and_its_shares_are_whole(monkeypatch):
    monkeypatch.setitem(cases.CASES, mode_pasts.CASE, {"scene": "demo", "changes": WIDE})
    watched = mode_pasts.watch(Run(mode_pasts.CASE, "rough", 1, 1.5, "end"))
    assert watched.past.released.sum() == pytest.approx(1.0)
    assert watched.past.share.sum() == pytest.approx(1.0)
    assert watched.past.released.size == 16
    assert watched.slide.times[-1] == 4.0
    assert len(watched.slide.displacement) == len(watched.slide.times)
    assert 0 < watched.onset.min() < 4.0
