"""The published study beside this one: the answers, their intervals, verdicts and figures."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.study import figures, modes, published, rows
from benchmarks.study.answers import Answer, Hours, Line, difference, mean_seconds, paired_change, rises
from benchmarks.study.cases import SWEEP
from benchmarks.study.figures import _headline
from benchmarks.study.rows import Outcome, Run
from cooperative.estimate import wilson_interval

NO_TIME = Hours(0.0, 0.0)
ANSWER = Answer(0.3, (0.2, 0.4), "", NO_TIME)


@pytest.fixture(scope="module")
def study():
    return published.compared(rows.read_study())


def test_every_figure_is_drawn(study, tmp_path):
    files = figures.draw(study, tmp_path)
    assert {path.name for path in files} == {f"published_{name}.png" for name in figures.FIGURES}
    assert min(path.stat().st_size for path in files) > 10_000


def test_an_answer_that_is_missing_is_named(study):
    without = replace(study, lines=[Line("median area", "area", None, "2 slides")])
    with pytest.raises(ValueError, match="area: not run yet: 2 slides"):
        without.answer("area")
    assert without.line("area").as_row()["ours"] == "none"


def test_ranks_tell_the_probability_sample_from_the_rest(study):
    left, right = figures.FIGURES["ranks"](study).axes
    labels = {str(line.get_label()) for line in left.get_lines()}
    assert {"rough grid, 750 samples", "refined, drawn by chance: 100"} <= labels
    assert sum(int(text.get_text().split(": ")[1]) for text in right.texts) == 100


@pytest.mark.parametrize(
    ("line", "verdict", "word"),
    [
        (Line("a", None, 0.25, ANSWER), "agrees", "agrees"),
        (Line("a", None, 0.5, ANSWER, "x"), "differs by -0.2: x", "differs"),
        (
            Line("a", None, 0.45, ANSWER, "", (0.38, 0.5)),
            "differs by -0.15, where the two samples leave 0.122 open",
            "differs",
        ),
        (
            Line("a", None, 0.42, ANSWER, "", (0.3, 0.5)),
            "agrees: -0.12, where the two samples leave 0.156 open",
            "agrees",
        ),
        (
            Line("a", None, 0.1, replace(ANSWER, value=0.0, interval=(0.0, 0.2))),
            "not resolved: none was found",
            "not resolved",
        ),
        (Line("a", None, None, ANSWER, rises((0.1, 0.2))), "rises, as published", "agrees"),
        (Line("a", None, None, ANSWER, rises((-0.2, -0.1))), "falls, published as rising", "differs"),
        (Line("a", None, None, ANSWER, rises((-0.1, 0.1))), "not resolved", "not resolved"),
        (Line("a", None, 0.1, "2 slides"), "not run yet: 2 slides", "not resolved"),
    ],
)
def test_verdicts_come_to_a_word(line, verdict, word):
    assert line.verdict().startswith(verdict)
    assert _headline.judged(line)[0] == word


def test_the_interval_of_a_share_leaves_slides_that_broke_off_any_mode():
    """16 of 36 slides that ended are deep; the four others would have been any mode."""
    slides = modes.Slides([], np.ones(36), 4 / 40, "")
    low, high = modes.share_of(np.arange(36) < 16, slides, NO_TIME, "").interval
    for deep in range(5):
        would_be = wilson_interval(16 + deep, 40)
        assert low <= would_be[0]
        assert would_be[1] <= high
    whole = modes.Slides([], np.ones(40), 0.0, "")
    assert modes.share_of(np.arange(40) < 20, whole, NO_TIME, "").interval == wilson_interval(20, 40)


def test_common_samples_count_once_in_a_pool_of_lengths():
    """Slides of one sample at several lengths are alike: the interval is that of the samples."""
    known = {
        Run(case, "rough", n, 1.1, until): Outcome(
            "FINISHED", 14.0, 20.0, 1, 1.0, mode="deep" if until == "end" else None
        )
        for case in list(SWEEP)
        for n in range(200)
        for until in ("class", "end")
    }
    pooled = modes.rough_shares(known, list(SWEEP), ("shallow",))
    single = modes.rough_shares(known, list(SWEEP)[:1], ("shallow",))
    assert pooled.interval == pytest.approx(wilson_interval(0, 200))
    assert pooled.interval == pytest.approx(single.interval)


def test_few_runs_have_a_range_instead_of_an_interval():
    middle, limits, words = mean_seconds(np.array([10.0, 20.0, 60.0]))
    assert (middle, limits) == (30.0, (10.0, 60.0))
    assert "from the least to the most" in words
    rng, held = np.random.default_rng(7), 0
    for _ in range(1000):
        _, (low, high), words = mean_seconds(rng.normal(100, 20, 8))
        held += low <= 100 <= high
    assert words == ""
    assert 0.93 < held / 1000 < 0.97


def test_the_interval_of_a_change_covers():
    """2000 repetitions of 60 pairs with known probabilities of a gain and a loss."""
    rng, held = np.random.default_rng(5), 0
    for _ in range(2000):
        kind = rng.choice(3, 60, p=[0.1, 0.05, 0.85])
        _, (low, high) = paired_change((kind == 1).tolist(), (kind == 0).tolist())
        held += low <= 0.05 <= high
    assert 0.93 < held / 2000 < 0.985


@pytest.mark.parametrize("shares", [(0.1, 0.4), (0.05, 0.1), (0.3, 0.3)])
def test_the_interval_of_a_difference_covers(shares):
    rng, held = np.random.default_rng(6), 0
    for _ in range(1000):
        ends = [rng.binomial(40, share) for share in shares]
        answers = [Answer(n / 40, wilson_interval(n, 40), "", NO_TIME) for n in ends]
        change, (low, high) = difference(*answers)
        assert low <= change <= high
        held += low <= shares[1] - shares[0] <= high
    assert 0.93 < held / 1000 < 0.99
