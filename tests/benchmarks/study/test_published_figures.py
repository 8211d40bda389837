"""Figures of the published study, from a table and rows that are made up."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.text import Text

from benchmarks.study import published, study_figures, study_pieces, study_runs
from benchmarks.study.published_answers import Found, Hours, Line, rises
from benchmarks.study.published_modes import Slides
from benchmarks.study.study import file_of
from benchmarks.study.study_figures import FIGURES, Study, _chances, _headline, _slides
from benchmarks.study.study_table import Run, write_table
from cooperative.estimate import fit_distributions
from tests.benchmarks.study.test_study import FAILED, SLID, STOOD, made_up

FOUND = Found(0.3, (0.2, 0.5), "40 refined samples; a note", Hours(0.0, 0.0))
SWEPT = 5
"""Slides at each correlation length."""


@pytest.fixture(scope="module")
def nothing(tmp_path_factory):
    """What is handed to the figures where nothing ran."""
    return published.study_in(tmp_path_factory.mktemp("empty"))


@pytest.fixture
def study(nothing, monkeypatch):
    """All lines found, 60 samples on both grids of which an audit draws 40, slides of which 24 are deep."""
    monkeypatch.setattr(study_runs, "SAMPLES", 60)
    monkeypatch.setattr(study_pieces, "AUDIT", replace(study_pieces.AUDIT, runs=40))
    rows = {
        Run("published", grid, n): made_up(n)[at] for n in range(60) for at, grid in enumerate(("rough", "refined"))
    }
    rows |= {Run(case, "rough", n, 1.1, "end"): SLID for case in study_pieces.sweep_cases() for n in range(SWEPT)}
    spread = np.random.default_rng(3).gamma(9.0, size=26)
    slides = [replace(SLID, area=100 * x, volume=1e3 * x**2, runout=9 + x) for x in spread]
    slides[:2] = [replace(slide, mode="progressive") for slide in slides[:2]]
    ended = Slides(slides, 1 + np.arange(26) % 3, 0.0, "26 slides")
    monkeypatch.setattr(_slides, "weighted_slides", lambda rows: ended)
    monkeypatch.setattr(_slides, "rough_shares", lambda rows, cases, group: FOUND)
    return Study(rows, [replace(line, found=FOUND) for line in nothing.lines])


def texts(figure) -> list[str]:
    return [text.get_text() for text in figure.findobj(Text)]


def without(study, missing) -> Study:
    """The same with lines that have not run."""
    return replace(
        study, lines=[replace(line, found="no run") if missing(at) else line for at, line in enumerate(study.lines)]
    )


def test_nothing_is_drawn_where_nothing_ran(nothing, tmp_path):
    assert study_figures.draw(nothing, tmp_path) == []
    assert list(tmp_path.iterdir()) == []


def test_every_figure_is_drawn_and_small(study, tmp_path):
    drawn = study_figures.draw(study, tmp_path)
    assert {path.name for path in drawn} == {f"published_{name}.png" for name in FIGURES}
    assert all(5_000 < path.stat().st_size < 150_000 for path in drawn)


def test_the_figures_of_a_table_are_drawn_where_they_are_asked_for(tmp_path):
    runs = [Run(f"section, {name}", "refined", n) for name in ("as here", "F-bar") for n in range(20)]
    rows = {run: FAILED if run.sample < 8 else STOOD for run in runs}
    write_table(file_of(tmp_path, "section"), rows, study_runs.CASES)
    report = published.report(tmp_path)
    assert list(tmp_path.glob("*.png")) == []
    report.draw(tmp_path)
    assert [path.name for path in tmp_path.glob("*.png")] == ["published_readings.png"]


@pytest.mark.parametrize("odd", [0, 1])
def test_a_line_that_has_not_run_leaves_a_gap(study, odd):
    gaps = without(study, lambda at: at % 2 == odd)
    keys = [key for panel in _headline.PANELS for key in panel.rows]
    missing = sum(gaps.answer(key) is None for key in keys)
    assert 0 < missing < len(keys)
    assert texts(FIGURES["against"](gaps)).count("not run yet") == missing
    missing = sum(isinstance(line.found, str) for line in gaps.lines if line.what.startswith(_chances.CHANGE))
    assert sum("not run yet" in text for text in texts(FIGURES["readings"](gaps))) == missing
    marks = FIGURES["lengths"](gaps).axes[0].get_lines()
    assert any(np.isnan(np.asarray(line.get_ydata(), float)).any() for line in marks)


def test_figures_without_their_data_are_left_out_alone(study, monkeypatch):
    unmeasured = replace(without(study, lambda at: True), rows={})
    assert [name for name, of in FIGURES.items() if of(unmeasured) is not None] == ["fits", "modes"]
    slides = _slides.weighted_slides({})
    few = replace(slides, ended=slides.ended[:10], weight=slides.weight[:10])
    monkeypatch.setattr(_slides, "weighted_slides", lambda rows: few)
    assert FIGURES["fits"](study) is None
    monkeypatch.setattr(_slides, "rough_shares", lambda rows, cases, group: "no run")
    assert FIGURES["modes"](unmeasured) is None
    assert FIGURES["modes"](study) is not None


def test_the_headline_figure_has_a_row_of_the_table_for_each_of_its_own(nothing):
    keys = [key for panel in _headline.PANELS for key in panel.rows]
    found = [nothing.line(key) for key in keys]
    assert None not in found
    assert len({line.what for line in found}) == len(keys)
    rises = [key for panel in _headline.PANELS if panel.rises for key in panel.rows]
    assert [line.printed is None for line in found] == [key in rises for key in keys]


@pytest.mark.parametrize(
    ("line", "word"),
    [
        (Line("a", None, 0.3, FOUND), "agrees"),
        (Line("a", None, 0.52, FOUND, "", (0.4, 0.7)), "agrees"),
        (Line("a", None, 0.6, FOUND), "differs"),
        (Line("a", None, 0.1, replace(FOUND, value=0.0, interval=(0.0, 0.2))), "not resolved"),
        *((Line("a", None, None, FOUND, rises(limits)), word)
          for limits, word in (((0.1, 0.2), "agrees"), ((-0.2, -0.1), "differs"), ((-0.1, 0.1), "not resolved"))),
    ],
)  # fmt: skip
def test_verdicts_come_to_a_word(line, word):
    assert _headline.judged(line)[0] == word


def test_ranks_tell_the_probability_sample_from_the_rest(study):
    left, right = FIGURES["ranks"](study).axes
    labels = {line.get_label(): line for line in left.get_lines()}
    assert {"rough grid, 60 samples", "refined, in rank order: 20", "refined, drawn by chance: 40"} <= set(labels)
    heights = np.sort(labels["refined, drawn by chance: 40"].get_ydata())
    assert np.sort(np.asarray(right.collections[0].get_offsets())[:, 1]) == pytest.approx(heights)
    assert sum(int(text.get_text().split(": ")[1]) for text in right.texts) == 40
    assert right.get_title(loc="left").startswith("rank correlation 0.30 (0.20 to 0.50)")


def test_the_printed_probability_stands_at_its_own_length_alone(study):
    for ax in FIGURES["lengths"](study).axes:
        (printed,) = [line for line in ax.get_lines() if str(line.get_label()).startswith("printed: 0.244")]
        assert np.asarray(printed.get_xdata()) == pytest.approx(60, abs=5)
        assert list(ax.get_xticks()) == list(study_runs.LENGTHS)


def test_modes_have_their_numbers_of_slides(study):
    along, across, beside = FIGURES["modes"](study).axes
    for ax in (along, across):
        assert [text.get_text() for text in ax.get_xticklabels()] == [f"{x} m\nn = {SWEPT}" for x in study_runs.LENGTHS]
    pooled = SWEPT * len(study_pieces.sweep_cases())
    ticks = [text.get_text() for text in beside.get_xticklabels()]
    assert ticks[0].endswith(f"n = {pooled}")
    assert ticks[1].endswith("n = 26")


def test_fits_are_those_of_the_weighted_slides_with_the_printed_family_marked(study):
    axes = FIGURES["fits"](study).axes
    assert len(axes) == 3
    slides = _slides.weighted_slides(study.rows)
    values, weight = np.array([slide.volume for slide in slides.ended[2:]]), slides.weight[2:]
    done = fit_distributions(values, weight)
    best = done.fits[0].aic
    said = [text.get_text() for text in axes[1].get_legend().get_texts()]
    assert said == [f"{f.name} {f.aic - best:.1f}{' (printed)' * (f.name == 'logistic')}" for f in done.fits]
    steps = axes[1].get_lines()[0]
    assert np.asarray(steps.get_xdata())[1:] == pytest.approx(np.sort(values))
    heaviest = np.diff(np.asarray(steps.get_ydata())).max()
    assert heaviest == pytest.approx(3 / weight.sum())
