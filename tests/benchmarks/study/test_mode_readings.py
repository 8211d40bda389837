"""Modes of made-up slides by each reading of the printed definitions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.study import mode_pasts, mode_readers, mode_readings
from benchmarks.study.mode_pasts import EVERY, Past
from benchmarks.study.mode_readings import adjoining, lull, named, pulses, verdict


def slide(rates, seconds=3.0, depth=(16.0, 16.0), share=(0.5, 0.5)):
    """A slide that lets go at these rates in turn, each for so long."""
    released = np.repeat(np.asarray(rates, float), round(seconds / EVERY))
    return Past(released / released.sum(), np.array(depth), np.array(share), 12.0, "deep")


@pytest.mark.parametrize(
    ("rates", "by_pulses", "by_lull"),
    [
        # A tail: 6 % of the volume lets go in a second, and less after it.
        ([4, 1, 0.2], (False, False, False), (False, False, True)),
        # Valleys of 0.4 and 0.25 of the lesser peak, in which 3 and 2 % let go in a second.
        ([5, 0.8, 2], (True, False, False), (False, True, True)),
        ([5, 0.5, 2], (True, True, False), (False, True, True)),
        ([5, 0.0, 2], (True, True, True), (True, True, True)),
        # A second pulse of 1 % of the volume is none.
        ([5, 0.0, 0.05], (False, False, False), (False, False, False)),
    ],
)
def test_pulses_and_lulls_of_a_slide(rates, by_pulses, by_lull):
    past = slide(rates)
    assert tuple(pulses(past, valley) for valley in (1 / 2, 1 / 3, 1 / 5)) == by_pulses
    assert tuple(lull(past, share) for share in (0.02, 0.05, 0.1)) == by_lull


def always(past):
    return True


def never(past):
    return False


def test_deep_and_shallow_slices_adjoin_if_each_has_its_share():
    past = slide([1], depth=(16.0, 11.0, 0.0), share=(0.85, 0.15, 0.0))
    assert [adjoining(past, least) for least in (0.05, 0.1, 0.2)] == [True, True, False]
    assert named(past, never, None) == "deep"
    assert named(past, never, always) == "compound"
    assert named(past, always, always) == "progressive"
    assert named(replace(past, mode="compound"), never, None) == "compound"
    assert named(replace(past, depth=np.full(3, 9.0)), never, None) == "shallow"


def test_a_share_depends_on_the_rule_where_intervals_of_least_and_most_are_apart():
    assert verdict(0.5, 0.5, 20) == "the same by each reading"
    assert verdict(0.0, 0.1, 20) == "too few slides to decide"
    assert verdict(0.0, 0.9, 20) == "depends on a rule that is not printed"


@pytest.fixture
def two_slides(tmp_path, monkeypatch):
    """Pasts of a progressive and a deep slide by two pulses, and no readers."""
    monkeypatch.setattr(mode_pasts, "STORED", tmp_path / "pasts.npz")
    monkeypatch.setattr(mode_readings.mode_readers, "read", dict)
    mode_pasts.keep({7: slide([5, 0.8, 2]), 9: slide([1, 1, 1])})


def test_pasts_are_read_as_they_were_stored(two_slides):
    assert list(mode_pasts.stored()) == [7, 9]
    np.testing.assert_allclose(mode_pasts.stored()[7].released, slide([5, 0.8, 2]).released, rtol=1e-6)
    report = mode_readings.run(quick=False)
    assert report.values["slides"] == 2
    assert report.values["progressive_least"] == 0.0
    assert report.values["progressive_most"] == 0.5
    assert all(sum(row[mode] for mode in mode_readings.SEVERITY) == pytest.approx(1) for row in report.rows)
    assert not any("kappa" in name for name in (*report.values, *report.rows[0]))
    two = report.rows[0]
    assert (two["progressive_or_compound"], two["low"], two["high"]) == (0.5, 0.095, 0.905)


def test_no_file_has_no_pasts(tmp_path, monkeypatch):
    monkeypatch.setattr(mode_pasts, "STORED", tmp_path / "pasts.npz")
    assert mode_pasts.stored() == {}


def test_each_reading_is_compared_with_each_reader_under_the_numbers_of_the_sheets(two_slides, monkeypatch):
    sheet = {sample: number for number, sample in mode_readings.mode_sheets.numbered([7, 9]).items()}
    right, wrong = ({sheet[7]: one, sheet[9]: other} for one, other in (("progressive", "deep"), ("deep", "unsure")))
    monkeypatch.setattr(mode_readings.mode_readers, "read", lambda: {"a": right, "b": wrong})
    report = mode_readings.run(quick=False)
    rows = {row["reading"]: row for row in report.rows}
    two, lull = rows["two pulses, valley below 1/2 of the lesser (the default)"], rows["a second with less than 2%"]
    assert (two["kappa_a"], two["kappa_b"], two["alike"]) == (1.0, -0.333, 0.5)
    assert (lull["kappa_a"], lull["kappa_b"], lull["alike"]) == (0.0, 0.0, 0.5)
    assert report.values["kappa_a_b"] == mode_readings.rounded(mode_readers.kappa(right, wrong))
    assert report.values["unsure_b"] == 0.5
