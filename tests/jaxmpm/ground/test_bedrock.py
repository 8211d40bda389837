"""Bedrock of any shape: blocks slide on it as theory says, soil lies above it, and level bedrock is a base."""

import math
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm.run._strength_reduction import reductions

STIFF = mpm.Soil(unit_weight=20e3, young=1e8, poisson=0.0)
LENGTH, HEIGHT, G = 6.0, 2.0, 9.81


def on_an_incline(angle, cell, interface, *, end=0.6):
    """Displacement down the incline of a block that starts in balance with its weight, and normal to it (m)."""
    tilt = math.radians(angle)
    along, normal = np.array([math.cos(tilt), -math.sin(tilt)]), np.array([math.sin(tilt), math.cos(tilt)])
    top = 24 * math.tan(tilt)
    rock, up = [(0.0, top), (24.0, 0.0)], HEIGHT / math.cos(tilt)
    x0, x1 = 3.0, 3.0 + LENGTH
    z0, z1 = (float(np.interp(x, [0, 24], [top, 0])) for x in (x0, x1))
    surface = [rock[0], (x0, z0), (x0, z0 + up), (x1, z1 + up), (x1, z1), rock[1]]
    numerics = mpm.Discretisation(cell, (cell / 2,) * 2)
    shape = mpm.Section(surface, base=-1.0, bedrock=rock, interface=interface)
    scene, state = mpm.section(shape, STIFF, numerics, at_rest=False, speed=5.0)
    position, mass = np.asarray(scene.particles.position, float), np.asarray(scene.particles.mass, float)
    pull = G * math.sin(tilt)
    held = interface.cohesion * LENGTH / math.cos(tilt) / mass.sum() + math.tan(
        math.radians(interface.friction)
    ) * G * math.cos(tilt)
    depth = HEIGHT - normal @ (position - np.array([[0.0], [top]]))
    density = STIFF.unit_weight / 9.80665
    pressed, sheared = -density * G * math.cos(tilt) * depth, density * min(held, pull) * depth
    stress = (
        pressed * np.outer(normal, normal)[:, :, None]
        + sheared * (np.outer(normal, along) + np.outer(along, normal))[:, :, None]
    )
    start = jnp.asarray(np.stack([stress[0, 0], 0 * pressed, stress[1, 1], stress[0, 1]]), state.stress.dtype)
    final = mpm.solve(scene, replace(state, stress=start), t_end=end).raise_if_failed().state
    displacement = np.asarray(final.displacement, float).mean(axis=1)
    exact = max(pull - held, 0.0) * end**2 / 2
    if interface.slip_length is not None:
        growth = held * (1 - interface.residual_ratio) / interface.slip_length
        exact = (pull - held) / growth * (math.cosh(math.sqrt(growth) * end) - 1)
        assert exact < interface.slip_length
    return displacement @ along, displacement @ normal, exact


CONTACTS = {
    "smooth": mpm.Interface(0.0),
    "rough": mpm.Interface(16.0),
    "sticky": mpm.Interface(0.0, 5e3),
    "softening": mpm.Interface(16.0, residual_ratio=0.2, slip_length=0.5),
}


@pytest.mark.parametrize(
    ("contact", "error"), [("smooth", 0.005), ("rough", 0.005), ("sticky", 0.02), ("softening", 0.005)]
)
def test_a_block_slides_down_an_incline_across_the_cells(contact, error):
    along, away, exact = on_an_incline(26.565, 0.25, CONTACTS[contact])
    assert along == pytest.approx(exact, rel=error)
    assert abs(away) < 1e-3


def test_a_block_sticks_to_an_incline_that_is_rough_enough():
    along, _, exact = on_an_incline(26.565, 0.25, mpm.Interface(30.0))
    assert exact == 0
    assert abs(along) < 1e-3


def tilted(interface, *, cell=2.0):
    """Terrain of a hump of soil on a plane of rock that dips along x and y."""
    x, y = np.meshgrid(np.arange(0, 41.0), np.arange(0, 33.0), indexing="ij")
    rock = 20 - 0.4 * x - 0.2 * y
    hump = 5 * np.clip(1.5 - np.hypot((x - 15) / 7, (y - 14) / 7), 0, 1)
    shape = mpm.Terrain(
        mpm.Raster(rock + hump, (0, 0), 1.0), base=-4.0, bedrock=mpm.Raster(rock, (0, 0), 1.0), interface=interface
    )
    return shape, mpm.terrain(shape, STIFF, mpm.Discretisation(cell, (cell / 2,) * 3), speed=5.0)


def test_soil_on_a_tilted_plane_in_3d_goes_down_the_dip_at_the_rate_of_coulombs_law():
    shape, (scene, state) = tilted(mpm.Interface(12.0))
    assert float(jnp.sum(scene.particles.volume)) == pytest.approx(shape.volume, rel=0.02)
    final = mpm.solve(scene, state, t_end=0.6).raise_if_failed().state
    mass = np.asarray(scene.particles.mass, float)
    displacement = np.asarray(final.displacement, float) @ mass / mass.sum()
    normal = np.array([0.4, 0.2, 1.0]) / math.sqrt(1.2)
    pull = np.array([0, 0, -G]) + G * normal[2] * normal
    rate = 1 - math.tan(math.radians(12.0)) * G * normal[2] / np.linalg.norm(pull)
    assert displacement == pytest.approx(pull * rate * 0.18, rel=0.02)


SURFACE, SOIL = (
    [(0, 6), (6, 6), (10, 2), (18, 2)],
    mpm.Soil(strength=12e3, unit_weight=20e3, young=1e7, tension_cutoff=0.0),
)


@pytest.mark.parametrize("interface", [None, mpm.Interface(10.0, 2e3)], ids=["stuck", "contact"])
def test_level_bedrock_is_a_base(interface):
    """Nodes of a level base beyond its wall, and of bedrock above it, are constrained alike."""
    numerics, displacement = mpm.Discretisation(1.0, (0.5, 0.5)), []
    for shape in (
        mpm.Section(SURFACE, base=-1.0, interface=interface),
        mpm.Section(SURFACE, base=-3.0, bedrock=[(0, -1), (18, -1)], interface=interface),
    ):
        scene, state = mpm.section(shape, SOIL, numerics, speed=10.0)
        final = mpm.solve(mpm.reduced(scene, 1.5), state, t_end=1.0).raise_if_failed().state
        displacement.append(float(mpm.diagnostics.mean_displacement(scene, final)))
    assert displacement[0] > 0.1
    assert displacement[1] == pytest.approx(displacement[0], rel=1e-3 if interface is None else 0.05)


def test_a_batch_over_bedrock_is_its_single_runs():
    shape = mpm.Section(SURFACE, base=-3.0, bedrock=[(0, 0), (18, -2)], interface=mpm.Interface(10.0, 2e3))
    scene, state = mpm.section(shape, SOIL, mpm.Discretisation(1.0, (0.5, 0.5)))
    varied, axes = reductions(scene, jnp.array([1.2, 1.6]))
    batch = mpm.solve(varied, mpm.run.repeat(state, 2), t_end=0.5, axes=axes).raise_if_failed().state
    single = mpm.solve(mpm.reduced(scene, 1.6), state, t_end=0.5).raise_if_failed().state
    assert np.allclose(batch.displacement[1], single.displacement, atol=1e-5)


REFUSED = [
    ({"bedrock": [(0, 5), (10, 3), (18, 0)]}, r"bedrock at \(10, 3\) m lies 1 m above the surface: draw it below"),
    ({"bedrock": [(0, 0), (18, -5)]}, r"bedrock at \(18, -5\) m lies 2 m below the base at -3 m: lower the base"),
    ({"bedrock": [(2, 0), (18, 0)]}, "bedrock goes from .* draw it to the walls at x = 0 and 18 m"),
]


@pytest.mark.parametrize(("given", "message"), REFUSED)
def test_bedrock_that_does_not_lie_in_the_ground_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        mpm.Section(SURFACE, base=-3.0, **given).check()


def test_bedrock_under_ends_without_walls_is_refused():
    shape = mpm.Section([(0, 6), (18, 6)], base=-3.0, bedrock=[(0, 0), (18, 0)])
    with pytest.raises(ValueError, match="ends = 'tied' with bedrock"):
        mpm.section(shape, SOIL, mpm.Discretisation(1.0, (0.5, 0.5)), ends="tied")
    rock = mpm.Raster(np.full((3, 3), 8.0), (0, 0), 2.0)
    with pytest.raises(ValueError, match=r"bedrock at \(0, 0, 8\) m lies 2 m above the surface"):
        mpm.Terrain(mpm.Raster(np.full((3, 3), 6.0), (0, 0), 2.0), base=0.0, bedrock=rock).check()


def test_bedrock_may_crop_out_at_walls_between_the_points_of_a_raster():
    raster = mpm.Raster(np.add.outer(np.zeros(8), -3.0 * np.arange(8.0)), (0.0, 0.0), 10.0)
    terrain = mpm.Terrain(raster, -40.0, (12.0, 52.0), (12.0, 52.0), bedrock=raster)
    terrain.check()
    with pytest.raises(ValueError, match="above the surface"):
        replace(terrain, bedrock=replace(raster, heights=raster.heights + 1.0)).check()


@pytest.mark.parametrize("interface", [None, mpm.Interface(10.0)], ids=["stuck", "contact"])
def test_the_edge_of_a_polygon_stays_fixed_over_bedrock(interface):
    polygon = ((4.0, 4.0), (36.0, 4.0), (36.0, 28.0), (4.0, 28.0))
    shape, _ = tilted(interface)
    surface = replace(shape.surface, heights=shape.surface.heights + 4)
    scene, _ = replace(shape, surface=surface, polygon=polygon).build(
        [mpm.Layer(STIFF)], mpm.Discretisation(2.0, (1.0,) * 3), at_rest=False
    )
    cut = np.asarray(scene.boundary.cut).reshape(scene.grid.shape)
    top = cut[..., -1]
    assert top[[0, -1]].all()
    assert not top[8:12, 6:10].any()
    assert cut[10, 8, 0] == (interface is None)


def test_a_wall_with_friction_beside_a_base_is_refused():
    scene, _ = tilted(mpm.Interface(12.0))[1]
    wall = replace(scene.boundary.walls[0], hold="friction")
    with pytest.raises(ValueError, match="walls of 'friction' with a base"):
        mpm.scene(
            scene.particles, scene.grid, scene.material, mpm.Discretisation(2.0, (1.0,) * 3),
            boundary=mpm.Boundary((wall,), friction=0.2, base=scene.boundary.base),
        )  # fmt: skip
