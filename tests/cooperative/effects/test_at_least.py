"""Where slides had not come to rest, "at least" is said of what may still grow, and of nothing else."""

from types import SimpleNamespace

import numpy as np
import pytest

from cooperative.estimate import monte_carlo
from cooperative.measure import ElementAtRisk, Vulnerability
from cooperative.reporting import _sentences as sentences
from cooperative.summary import CutOff
from cooperative.summary._slides import SlideRows, risk_of

PLAIN = monte_carlo(np.ones(20, bool))
HOUSE = ElementAtRisk("house", ((3.0,), (5.0,)), 400_000.0, Vulnerability("thickness", (0.0, 0.5), (0.0, 1.0)))


def risk(thickness):
    """Of twenty slides, all under way at the end of their run, of which those with a thickness have arrived."""
    arrived = np.isfinite(thickness)
    columns = {
        "area_columns": np.ones(20), "mode": np.full(20, "deep"), "sample": np.arange(20.0),
        f"thickness_at_{HOUSE.key}": thickness, f"speed_at_{HOUSE.key}": np.where(arrived, 1.0, np.nan),
        f"arrival_at_{HOUSE.key}": np.where(arrived, 9.0, np.nan), f"ground_at_{HOUSE.key}": np.zeros(20),
    }  # fmt: skip
    return risk_of([HOUSE], PLAIN, SlideRows(columns, np.ones(20)), CutOff(20, 20, 0, 60.0), 1.0, unknown=False)


def words(known):
    probability, consequences = SimpleNamespace(annual_frequency=None), SimpleNamespace(elements_at_risk=known.places)
    return next(sentences.at_risk(SimpleNamespace(probability=probability, consequences=consequences)))


def test_a_loss_that_cannot_grow_is_no_least_value():
    known = risk(np.full(20, 2.0))
    loss = known.places["house"].loss
    assert [loss.at_least, known.places["house"].reached.at_least, known.loss.at_least] == [False] * 3
    assert loss.interval == (pytest.approx(400_000 * PLAIN.interval[0], rel=1e-6), 400_000.0)
    assert words(known) == (
        "house is reached with probability 1 (0.845 to 1); of its value 400,000 the expected loss is 400,000 "
        "(344,000 to 400,000)"
    )


@pytest.mark.parametrize("thickness", [np.full(20, 0.1), np.where(np.arange(20) < 10, 2.0, np.nan)])
def test_a_loss_that_may_grow_is_a_least_value_below_its_limit(thickness):
    known = risk(thickness)
    loss = known.places["house"].loss
    assert loss.at_least
    assert known.places["house"].reached.at_least == bool(np.isnan(thickness).any())
    assert loss.interval[0] < loss.expected < loss.interval[1]
    assert "the expected loss is at least" in words(known)
