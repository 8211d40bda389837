"""The benchmark of sites: its real terrain, its count of slides, and the rows that it keeps."""

from dataclasses import replace

import numpy as np
import pytest

import jaxmpm as mpm
from benchmarks.measure import stored_row
from benchmarks.sites import sites_retrogression, sites_terrain
from cooperative.scene import parse, read_scene


def test_the_terrain_is_a_slope_above_a_level_floor():
    heights = sites_terrain.surface().heights
    assert heights.shape == (97, 65)
    assert heights.min() == 0
    assert 130 < heights.max() < 180
    steep = np.hypot(*np.gradient(heights, sites_terrain.STEP))
    assert 0.5 < steep[:, 32].max() < 0.7
    floor = heights[20:40, 32]
    assert np.ptp(floor) < 3


def test_clay_is_nowhere_but_above_the_slip_surface():
    ground = sites_terrain.surface()
    slip = sites_terrain.slip(ground)
    depth = ground.heights - slip.heights
    assert depth.min() == 0
    assert 45 < depth.max() < 60
    shape = mpm.Terrain(ground, base=sites_terrain.BASE)
    layers = [mpm.Layer(replace(sites_terrain.CLAY, unusual=True), slip), mpm.Layer(sites_terrain.ROCK)]
    numerics = mpm.Discretisation(24.0, (12.0,) * 3, dtype="float32")
    scene, _ = mpm.terrain(shape, layers, numerics, at_rest=False)
    position, volume = np.asarray(scene.particles.position, float), np.asarray(scene.particles.volume, float)
    clay = np.asarray(scene.material.strength) < 1e7
    # Boxes that the surface cuts have their centre in the air: they are rock where the clay has no thickness.
    bare = shape.heights(*position[:2]) - slip.at(*position[:2]) < 1e-9
    assert bare.any()
    assert not (clay & bare).any()
    assert volume[clay].sum() == pytest.approx(depth[1:, 1:].sum() * sites_terrain.STEP**2, rel=0.03)


@pytest.mark.parametrize(
    ("onset", "count"),
    [
        ([], 0),
        ([np.inf, np.inf], 0),
        ([0.8, 0.8, 0.9, np.inf], 1),
        ([0.8, 0.8, 3.1, 3.0, 5.5, np.inf], 3),
        # A crack that runs backwards is one slide, however long it takes.
        (np.arange(0.0, 8.0, 0.9), 1),
    ],
)
def test_slides_are_counted_by_their_pauses(onset, count):
    assert sites_retrogression.slides(np.array(onset)) == count


def test_a_cell_that_a_scene_does_not_have_is_refused():
    with pytest.raises(ValueError, match=r"cell = 0\.3 m: scene retrogression_5m has other grids"):
        sites_retrogression.slide("retrogression_5m", 0.3)


def test_both_readings_of_the_strength_are_the_same_slope():
    files = [sites_retrogression.SCENES / f"{name}.toml" for name in sites_retrogression.READINGS]
    whole, divided = (parse(read_scene(path)) for path in files)
    assert whole.site == divided.site
    assert whole.grids == divided.grids
    peaks = [campaign.random["strength"].mean for campaign in (whole, divided)]
    assert peaks[0] / peaks[1] == pytest.approx(1.65, rel=1e-3)
    # c_r = 1.5 kPa, and 5 e_p is 3 g / strain_95.
    assert whole.soil.residual_ratio * 15.1e3 == pytest.approx(1.5e3, rel=1e-3)
    assert 3 / whole.soil.strain_95 == pytest.approx(5)


def test_the_buoyant_reading_has_the_weight_under_water_and_the_residual_strength_of_the_whole_one():
    names = ("retrogression_5m", "retrogression_5m_buoyant")
    whole, buoyant = (parse(read_scene(sites_retrogression.SCENES / f"{name}.toml")) for name in names)
    strengths = [campaign.random["strength"].mean for campaign in (whole, buoyant)]
    assert strengths[0] / strengths[1] == pytest.approx(1.65, rel=1e-3)
    residuals = [
        campaign.soil.residual_ratio * peak for campaign, peak in zip((whole, buoyant), strengths, strict=True)
    ]
    assert residuals == pytest.approx([1.5e3, 1.5e3], rel=1e-3)
    assert buoyant.soil.unit_weight == whole.soil.unit_weight
    assert buoyant.soil.unit_weight / 9.81 * buoyant.run.gravity == pytest.approx((2150 - 1000) * 9.81, rel=1e-3)
    assert buoyant.soil.viscosity is None


def test_a_stored_row_is_not_made_again(tmp_path):
    made = []

    def make():
        made.append(1)
        return {"answer": 0.1}

    assert (
        stored_row(tmp_path / "new", "row 0.5", make)
        == stored_row(tmp_path / "new", "row 0.5", make)
        == {"answer": 0.1}
    )
    assert made == [1]
