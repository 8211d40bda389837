"""Elements at risk in sentences: probabilities, losses, and both a year; published vulnerability curves."""

from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest

from cooperative.measure import PUBLISHED
from cooperative.reporting import _sentences as sentences
from cooperative.scene import parse
from cooperative.scene.tables._hazard import Curve
from cooperative.summary import Element, ElementLoss, Reached
from tests.cooperative.campaign.test_campaign import TINY

STAYS = Reached(0.0, (0.0, 0.05), False)
ROAD = Element(
    Reached(0.1, (0.04, 0.2), False), None, None, None, ElementLoss(1000.0, 50.0, (10.0, 120.0), False), STAYS, None
)
HOUSE = Element(Reached(0.0, (0.0, 0.05), False), None, None, None, None, Reached(0.3, (0.2, 0.4), True), None)


def summary(often):
    elements = {"road": ROAD, "house": HOUSE, "mast": None}
    return SimpleNamespace(
        probability=SimpleNamespace(annual_frequency=often, value=0.2, interval=(0.1, 0.3)),
        consequences=SimpleNamespace(elements_at_risk=elements),
    )


def test_elements_at_risk_have_probability_and_loss_with_their_limits():
    road, house, mast = sentences.at_risk(summary(None))
    assert road == (
        "road is reached with probability 0.1 (0.04 to 0.2); of its value 1,000 the expected loss is 50 (10 to 120)"
    )
    carried = "; its own ground is carried away with probability at least 0.3 (0.2 to 0.4)"
    assert house == f"house is reached with probability 0 (at most 0.05){carried}"
    assert "not known yet" in mast
    assert "conditional on the scene" in sentences.condition(summary(None))


def test_a_frequency_makes_them_annual():
    road, house, _ = sentences.at_risk(summary(0.01))
    assert "0.001 a year (0.0004 to 0.002); of its value" in road
    assert road.endswith("; 0.5 a year (0.1 to 1.2)")
    assert ", 0 a year (at most 0.0005); its own ground" in house
    assert "annual probability of 0.002 (0.001 to 0.003)" in sentences.condition(summary(0.01))
    assert parse(TINY + "annual_frequency = 0.01\n").plan.annual_frequency == 0.01
    with pytest.raises(ValueError, match="annual_frequency = 0"):
        parse(TINY + "annual_frequency = 0.0\n")


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_curves_are_those_of_their_formula(name):
    exposed = f'[[exposed]]\nname = "house"\nat = [22.5]\nvalue = 1.0\nvulnerability = "{name}"\n'
    [house] = parse(TINY + exposed).elements_at_risk
    # Straight over a tenth of a metre: off in the middle by half of the second difference there.
    curve = PUBLISHED[name]
    depth = np.arange(0.0, curve.curve.at[-1], 0.05)
    lost = 1 - np.exp(-curve.a * (depth / curve.b) ** curve.c)
    most = np.abs(np.diff(lost, 2)).max() / 2
    assert np.abs(house.vulnerability.share(depth) - lost).max() <= most + 1e-6
    assert house.vulnerability.share(np.array([20.0])) > 0.998


def test_a_scene_may_name_every_published_curve():
    assert set(get_args(get_args(Curve)[1])) == set(PUBLISHED)
