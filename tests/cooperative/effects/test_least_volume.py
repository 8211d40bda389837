"""How much soil is a failure where a scene does not say: by the size of the slope, and the same on both grids."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxmpm as mpm
from benchmarks.robustness.invented import TERRAIN
from cooperative import Run
from cooperative.scene import parse
from cooperative.summary import summarise
from jaxmpm import Raster, Terrain
from tests.cooperative.campaign.test_campaign import TINY
from tests.cooperative.campaign.test_campaign_value import TINY_IN_PYTHON
from tests.cooperative.effects.test_summary import rows


def campaign_on(ground, spacing=(1.0, 1.0)):
    rough = replace(TINY_IN_PYTHON.rough, spacing=spacing)
    return replace(TINY_IN_PYTHON, ground=ground, rough=rough, refined=rough)


def slope(height, scale=1.0):
    return mpm.Slope(crest=scale * 8.0, height=height, run_per_rise=1.0, toe=scale * 16.0, foundation=scale * 2.0)


@given(height=st.floats(2.0, 40.0))
def test_it_goes_with_the_square_of_the_height_of_a_section(height):
    least = campaign_on(slope(height, height / 8), (height / 20, height / 20)).failing_volume
    assert least == pytest.approx(0.05 * height**2, rel=5e-3)


def test_it_is_at_least_a_particle_of_the_coarsest_grid():
    assert campaign_on(slope(2.0), (1.0, 1.0)).failing_volume == 1.0


def test_the_terrain_that_failed_by_a_particle_asks_for_more_than_that():
    """A hillside of 4 m relief with particles of 1 m3: one of 0.047 m3 is no failure, nor is any other one alone."""
    campaign = parse(TERRAIN)
    assert campaign.failing_volume == pytest.approx(0.05 * 4.0**3, rel=5e-3)
    assert campaign.failing_volume > 1.0


def test_thin_soil_on_bedrock_and_narrow_ground_ask_for_less():
    heights = np.linspace(60.0, 0.0, 31)[:, None] * np.ones(11)
    surface, rock = Raster(heights, (0.0, 0.0), 4.0), Raster(heights - 2.0, (0.0, 0.0), 4.0)
    thick = parse(TERRAIN).site
    for bedrock, size in ((None, (60.0, 60.0, 40.0)), (rock, (6.0, 6.0, 6.0))):
        shape = Terrain(surface, -20.0, (0.0, 120.0), (0.0, 40.0), bedrock=bedrock)
        campaign = replace(parse(TERRAIN), ground=replace(thick, shape=shape, layers=()))
        assert campaign.failing_volume == pytest.approx(0.05 * np.prod(size), rel=0.02)


def test_it_does_not_depend_on_the_refined_grid_and_stays_with_the_ground():
    campaign = parse(TINY)
    fine = replace(campaign, refined=replace(campaign.refined, cell=0.25, spacing=(0.125, 0.125)))
    assert fine.failing_volume == campaign.failing_volume == 3.2
    assert replace(campaign, ground=slope(4.0)).failing_volume == 1.0
    assert replace(campaign, run=Run(least_volume=7.5)).failing_volume == 7.5
    assert replace(campaign, run=Run(least_volume=0.0)).failing_volume is None
    assert summarise(campaign, rows([0], [0.1]), rows([0], [0.1])).probability.least_volume == 3.2


def test_slides_that_are_smaller_are_counted_in_a_note():
    campaign, standing = parse(TINY), np.array([0.2, 0.3, 0.1])
    table = rows(range(3), standing, volume=np.array([0.0, 2.5, 1.0]))
    (note,) = [note for note in summarise(campaign, rows(range(3), standing), table).notes if "least_volume" in note]
    assert note.startswith("in 2 of 3 refined runs that stand less than 3.2 m2 of soil moved so far, 2.5 at most")
