"""Terrain cut to a polygon and to a depth: what is left, what holds it, what a slide does there, what is refused."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from benchmarks.robustness.invented import TERRAIN
from cooperative import runs
from cooperative.measure import EDGE, OpenGround, consequences, walls_reached
from cooperative.scene import parse
from jaxmpm.diagnostics import unbalanced_force

CLAY = mpm.Soil(strength=30e3, young=2e7, tension_cutoff=0.0)
ONES = mpm.Discretisation(2.0, (1.0, 1.0, 1.0))
X, Y = np.meshgrid(np.arange(0, 17, 4.0), np.arange(0, 9, 4.0), indexing="ij")
PLANE = mpm.Raster(9.0 - 0.25 * X, (0.0, 0.0), 4.0)
TRIANGLE = ((0.0, 0.0), (16.0, 0.0), (0.0, 8.0))


def built(at_rest=False, **cuts):
    shape = mpm.Terrain(PLANE, 0.0, **cuts)
    return shape, *mpm.terrain(shape, CLAY, ONES, at_rest=at_rest)


def test_a_polygon_keeps_what_lies_in_it():
    shape, scene, _ = built(polygon=TRIANGLE)
    x, y, _ = np.asarray(scene.particles.position, float)
    assert (x / 16 + y / 8 < 1).all()
    whole = built()[1]
    assert x.size == pytest.approx(whole.particles.mass.size * 0.55, rel=0.1)
    assert float(jnp.sum(scene.particles.volume)) == pytest.approx(shape.volume, rel=0.02)
    # A third of the way along x stands the middle of a triangle.
    assert shape.volume == pytest.approx(64 * (9 - 0.25 * 16 / 3), rel=0.02)
    held = np.asarray(scene.boundary.cut).reshape(scene.grid.shape)
    x, y, _ = (start + 2.0 * np.arange(n) for start, n in zip(scene.grid.origin, scene.grid.shape, strict=True))
    # Along the walls these hold, which are rollers.
    x, y = np.meshgrid(x.clip(0.01, 15.99), y.clip(0.01, 7.99), indexing="ij")
    from_edge = (16 * 8 - 8 * x - 16 * y) / np.hypot(8, 16)
    assert np.array_equal(held[:, :, 0], from_edge < 0.999)  # half a cell
    assert (held == held[:, :, :1]).all()


@pytest.mark.parametrize("cut", ["fixed", "free"])
def test_holes_outside_the_polygon_change_nothing(cut):
    x, y = np.meshgrid(np.arange(0, 17.0), np.arange(0, 9.0), indexing="ij")
    plane = mpm.Raster(9.0 - 0.25 * x, (0.0, 0.0), 1.0)
    polygon = ((2.0, 2.0), (14.0, 2.0), (14.0, 6.0), (2.0, 6.0))
    away = (x < 1) | (x > 15) | (y < 1) | (y > 7)
    holed = mpm.Raster(np.where(away, np.nan, plane.heights), plane.corner, 1.0)
    rock, dry = (mpm.Raster(each.heights - low, (0.0, 0.0), 1.0) for each, low in ((holed, 4.0), (holed, 3.0)))
    numerics = mpm.Discretisation(1.0, (0.5, 0.5, 0.5))
    clays = [mpm.Layer(CLAY, bottom=dry), mpm.Layer(replace(CLAY, strength=50e3))]
    holes, whole = (
        mpm.terrain(
            mpm.Terrain(surface, 0.0, polygon=polygon, cut=cut, bedrock=filled(rock)),
            [mpm.Layer(CLAY, bottom=filled(dry)), clays[1]],
            numerics,
            water=filled(dry),
            at_rest=False,
        )
        for surface, filled in (
            (holed, lambda r: r),
            (plane, lambda r: mpm.Raster(plane.heights - (4.0 if r is rock else 3.0), (0.0, 0.0), 1.0)),
        )
    )
    assert np.array_equal(holes[0].particles.position, whole[0].particles.position)
    assert np.allclose(holes[0].particles.volume, whole[0].particles.volume, rtol=1e-6)
    assert np.allclose(holes[0].particles.mass, whole[0].particles.mass, rtol=1e-6)
    if cut == "fixed":
        assert np.array_equal(holes[0].boundary.cut, whole[0].boundary.cut)


@pytest.mark.parametrize("at", [(8, 4), (2, 4), (14, 6)])
def test_holes_that_the_polygon_needs_are_refused(at):
    heights = PLANE.heights.copy()
    heights[at[0] // 4, at[1] // 4] = np.nan
    shape = mpm.Terrain(mpm.Raster(heights, (0.0, 0.0), 4.0), 0.0, polygon=((2, 2), (14, 2), (14, 6), (2, 6)))
    with pytest.raises(ValueError, match=r"the surface has 1 holes between the walls"):
        shape.check()


def test_a_depth_keeps_what_lies_above_it():
    shape, scene, _ = built(depth=3.0)
    x, _, z = np.asarray(scene.particles.position, float)
    assert (9 - 0.25 * x - z < 3).all()
    assert shape.volume == pytest.approx(16 * 8 * 3, rel=1e-6)
    assert float(jnp.sum(scene.particles.volume)) == pytest.approx(shape.volume, rel=0.05)
    held = np.asarray(scene.boundary.cut).reshape(scene.grid.shape)
    assert held[2, 2, :].nonzero()[0].max() * 2 - 2 == 6  # at x = 2 m the cut lies at 5.5 m


@pytest.mark.parametrize("inset", [0.0, 0.6, 1.0, 1.6, 1.9])
def test_a_fixed_edge_holds_wherever_it_lies_within_a_cell(inset):
    x, y = np.arange(0, 31, 2.0), np.arange(0, 21, 2.0)
    gentle = mpm.Raster((8 - 0.1 * x)[:, None] + 0 * y, (0.0, 0.0), 2.0)
    low, high = 4 + inset, 16 - inset
    polygon = ((2 + low, low), (8 + high, low), (8 + high, high), (2 + low, high))
    sand = mpm.FrictionalSoil(cohesion=5e3, friction=30, unit_weight=18e3, young=2e7)
    scene, state = mpm.terrain(mpm.Terrain(gentle, 0.0, polygon=polygon), sand, ONES)
    assert float(mpm.diagnostics.largest_displacement(mpm.solve(scene, state, t_end=0.5).state)) < 1e-3


@pytest.mark.parametrize("shift", [0.0, 0.7])
def test_a_fixed_edge_that_leaves_no_node_free_is_refused(shift):
    narrow = ((2.0, 2.0 + shift), (14.0, 2.0 + shift), (14.0, 4.0 + shift), (2.0, 4.0 + shift))
    with pytest.raises(ValueError, match="holds all soil in it, which is no wider than cells of 2 m: draw it wider"):
        built(polygon=narrow)
    built(polygon=narrow, cut="free")


@pytest.mark.parametrize("depth", [2.0, 2.5, 3.0, 3.9])
def test_a_cut_at_a_depth_holds_wherever_it_lies_within_a_cell(depth):
    level = mpm.Raster(np.full((9, 5), 8.0), (0.0, 0.0), 2.0)
    rock = mpm.Raster(level.heights - depth, (0.0, 0.0), 2.0)
    fallen = []
    for shape in (mpm.Terrain(level, 0.0, depth=depth), mpm.Terrain(level, 0.0, bedrock=rock)):
        final = mpm.solve(*mpm.terrain(shape, CLAY, ONES, at_rest=False), t_end=0.3).state
        fallen.append(float(mpm.diagnostics.largest_displacement(final)))
    assert fallen[0] < 0.03  # free fall: 0.44 m
    assert fallen[0] == pytest.approx(fallen[1], rel=0.1)


def test_a_cut_along_a_slope_holds_as_bedrock_does():
    x, y = np.arange(0, 31, 2.0), np.arange(0, 21, 2.0)
    heights = (12 - 0.2 * x)[:, None] + 0 * y
    surface, rock = (mpm.Raster(heights - down, (0.0, 0.0), 2.0) for down in (0.0, 6.0))
    lowest = [
        float(mpm.terrain(shape, CLAY, ONES)[1].stress[2].min())
        for shape in (mpm.Terrain(surface, 0.0, depth=6.0), mpm.Terrain(surface, -6.0, bedrock=rock))
    ]
    assert lowest[0] == pytest.approx(lowest[1], rel=0.1)  # -429 kPa where it held at a few points alone


@pytest.fixture(scope="module")
def rested():
    return {cut: built(at_rest=True, polygon=TRIANGLE, cut=cut)[1:] for cut in ("fixed", "free")}


def test_what_a_cut_holds_is_in_balance_and_a_free_one_holds_nothing(rested):
    assert rested["free"][0].boundary.cut is None
    for scene, state in rested.values():
        assert float(unbalanced_force(scene, state)) < 1e-3
    # Across the edge, towards (1, 2) / sqrt(5), the one is pressed as by the soil around it and the other not.
    x, y, _ = np.asarray(rested["free"][0].particles.position, float)
    beside = x / 16 + y / 8 > 0.85
    across = {
        cut: np.asarray((state.stress[0] + 4 * state.stress[1] + 4 * state.stress[3]) / 5)[beside].mean()
        for cut, (_, state) in rested.items()
    }
    assert across["fixed"] < 2 * across["free"] < 0


def test_soil_stays_within_a_fixed_edge_and_leaves_a_free_one(rested):
    beyond = {}
    for cut, (scene, state) in rested.items():
        weak = mpm.reduced(scene, 8.0)
        final = mpm.solve(weak, state, t_end=1.5).raise_if_failed().state
        x, y, _ = np.asarray(scene.particles.position + final.displacement, float)
        beyond[cut] = (x / 16 + y / 8).max() - 1
    assert beyond["fixed"] < 0.06  # half a cell
    assert beyond["free"] > 0.1


def test_a_slide_that_reaches_the_edge_is_named():
    position = np.array([[2.5, 3.5, 4.5], [2.5, 2.5, 2.5], [1.0, 1.0, 1.0]])

    def reached(along_x):
        displacement = np.array([along_x, [0.0] * 3, [0.0] * 3])
        return walls_reached(
            position, displacement, np.ones(3), [], half_size=np.full(3, 0.5), failure_displacement=1.0, within=1.0,
            polygon=TRIANGLE,
        )  # fmt: skip

    assert reached([2.0] * 3) == ""
    assert reached([5.0] * 3) == EDGE
    assert reached([0.0] * 3) == ""


def test_a_scene_says_its_cuts():
    cuts = "base = 0.0\npolygon = [[0, 0], [16, 0], [0, 8]]\ndepth = 3.0\n"
    campaign = parse(TERRAIN.replace("base = 0.0\n", cuts))
    model = runs.build(campaign, "rough", None, at_rest=False)
    x, y, z = np.asarray(model.scene.particles.position, float)
    assert (x / 16 + y / 8 < 1).all()
    assert (campaign.site.shape.heights(x, y) - z < 3).all()
    assert campaign.site.fixed_edge == TRIANGLE
    free = parse(TERRAIN.replace("base = 0.0\n", cuts + 'cut = "free"\n'))
    assert free.site.fixed_edge is None
    # The field is that of the whole ground.
    assert np.allclose(free.site.shape.extent, parse(TERRAIN).site.shape.extent)


REFUSED = [
    ("polygon = [[0, 0], [16, 0]]", "give three or more corners"),
    ("polygon = [[0, 0], [16, 0], [16]]", "give three or more corners"),
    ("polygon = [[0, 0], [16, 8], [16, 0], [0, 8]]", r"crosses itself \(Self-intersection"),
    ("polygon = [[0, 0], [8, 4], [16, 8]]", "encloses nothing, or crosses itself"),
    ("polygon = [[0, 0], [17, 0], [0, 8]]", "reaches from x = 0 to 17 m, beyond the walls at 0 and 16 m"),
    ("depth = 0.0", "depth = 0"),
    ('cut = "roller"', r"\[terrain\] cut = 'roller': give one of 'fixed', 'free'"),
    ('cut = "free"', "cut = 'free' has no effect without polygon"),
    ('ends = "free"', r"\[terrain\] ends = 'free': give one of 'roller', 'fixed'"),
]


@pytest.mark.parametrize(("given", "message"), REFUSED, ids=[message[:30] for _, message in REFUSED])
def test_cuts_that_cannot_be_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        parse(TERRAIN.replace("base = 0.0\n", f"base = 0.0\n{given}\n"))


def test_cuts_in_python_are_refused_likewise():
    for cuts, message in (
        ({"cut": "roller"}, "cut = 'roller': give 'fixed' or 'free'; nothing can roll"),
        ({"polygon": ((1.1, 1.1), (1.2, 1.1), (1.1, 1.2))}, "the cuts leave no particle"),
    ):
        with pytest.raises(ValueError, match=message):
            built(**cuts)
    scene = built()[1]
    with pytest.raises(ValueError, match=r"cut has shape \(3,\): give"):
        mpm.scene(scene.particles, scene.grid, scene.material, ONES, boundary=mpm.Boundary(cut=np.zeros(3, bool)))


@pytest.mark.slow
def test_what_slides_within_the_cuts_slides_as_in_the_whole():
    x, y = np.meshgrid(np.arange(0, 65, 4.0), np.arange(0, 49, 4.0), indexing="ij")
    plane = mpm.Raster(34.0 - 0.4 * x + 0 * y, (0.0, 0.0), 4.0)
    around = ((8.0, 6.0), (60.0, 8.0), (60.0, 40.0), (8.0, 42.0))
    results = []
    for cuts in ({}, {"polygon": around, "depth": 8.0}):
        scene, state = mpm.terrain(mpm.Terrain(plane, 0.0, **cuts), CLAY, ONES)
        x, y, z = np.asarray(scene.particles.position, float)
        weak = (np.hypot(x - 28, y - 24) < 10) & (34 - 0.4 * x - z < 3)
        slides = mpm.with_soil(scene, state, strength=np.where(weak, 1e3, 200e3).astype(np.float32))[0]
        final = mpm.solve(slides, state, t_end=3.0).raise_if_failed().state
        measured = consequences(
            np.asarray(scene.particles.position), np.asarray(final.displacement), np.asarray(scene.particles.volume),
            OpenGround(plane.at(x, y)), half_size=np.full(3, 0.5),
        )  # fmt: skip
        results.append((measured, x.size))
    (whole, particles), (cut, fewer) = results
    assert whole.displacement > 1.5
    assert fewer < 0.5 * particles
    assert (cut.runout, cut.volume, cut.displacement) == pytest.approx(
        (whole.runout, whole.volume, whole.displacement), rel=0.01
    )
