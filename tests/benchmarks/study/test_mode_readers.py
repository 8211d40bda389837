"""Modes as readers name them, and the kappa of two judges."""

import pytest

from benchmarks.study.mode_readers import agreement, kappa, kappa_interval, mean_kappa, read

HEAD = "slide,reader,mode\n"


def judges(*counts):
    """Two judges of slides: of each pair of names, how many slides have it."""
    pairs = [pair for pair, number in counts for _ in range(number)]
    return tuple({n: pair[side] for n, pair in enumerate(pairs)} for side in (0, 1))


def test_kappa_of_a_closed_case():
    # They agree on 35 of 50; chance is 25 / 50 * 30 / 50 + 25 / 50 * 20 / 50 = 0.5.
    one, other = judges(
        (("deep", "deep"), 20), (("deep", "shallow"), 5), (("shallow", "deep"), 10), (("shallow", "shallow"), 15)
    )
    assert agreement(one, other) == pytest.approx(0.7)
    assert kappa(one, other) == pytest.approx(0.4)
    assert kappa(other, one) == pytest.approx(0.4)
    assert kappa(one, one) == 1.0
    assert mean_kappa(one, {"a": one, "b": other}) == pytest.approx(0.7)


def test_kappa_without_agreement_beyond_chance_is_0_and_below_chance_negative():
    one, other = judges((("deep", "deep"), 9), (("deep", "shallow"), 1))
    assert kappa(one, other) == pytest.approx(0.0)
    assert kappa(*judges((("deep", "shallow"), 1), (("shallow", "deep"), 1))) == pytest.approx(-1.0)


def test_kappa_is_not_defined_where_both_name_one_mode():
    one, other = judges((("deep", "deep"), 5))
    assert kappa(one, other) is None
    assert mean_kappa(one, {"a": other}) is None


def test_kappa_of_judges_of_other_slides_is_refused():
    with pytest.raises(ValueError, match="1 slides and 2 others"):
        kappa({1: "deep"}, {1: "deep", 2: "deep"})


def test_readers_are_read_from_their_file(tmp_path):
    path = tmp_path / "readers.csv"
    assert read(path) == {}
    path.write_text(HEAD + "2,a,deep\n1,a,unsure\n1,b,progressive\n2,b,compound\n")
    assert read(path) == {"a": {2: "deep", 1: "unsure"}, "b": {1: "progressive", 2: "compound"}}


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("1,a,rotational\n", "line 2: mode = 'rotational': give one of"),
        ("one,a,deep\n", "line 2: slide = 'one': give a whole number"),
        ("1,,deep\n", "line 2: reader = '': give a text"),
        ("1,a,deep\n1,a,deep\n", "line 3: .* twice"),
        ("1,a,deep\n1,b,deep\n2,b,deep\n", r"readers name different slides \(a 1, b 2\)"),
    ],
)
def test_a_line_of_readers_that_does_not_parse_is_named(tmp_path, lines, message):
    path = tmp_path / "readers.csv"
    path.write_text(HEAD + lines)
    with pytest.raises(ValueError, match=message):
        read(path)


def test_the_interval_of_kappa_closes_where_readers_and_rule_agree_and_holds_kappa_elsewhere():
    rule = {n: "deep" if n % 3 else "progressive" for n in range(30)}
    assert kappa_interval(rule, {"a": rule, "b": rule}) == (1.0, 1.0)
    other = rule | dict.fromkeys(range(0, 30, 7), "shallow")
    low, high = kappa_interval(rule, {"a": other})
    assert 0 < low < kappa(rule, other) < high < 1
