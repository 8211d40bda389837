"""Scenes of ground and of its mirror image, and their motion: each other's images."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

import jaxmpm as mpm

LENGTH = 12.0
CLAY = mpm.Soil(unit_weight=18e3, young=2e7, poisson=0.45, strength=8e3, tension_cutoff=0.0)

pytestmark = [pytest.mark.usefixtures("x64"), pytest.mark.filterwarnings("ignore:layer")]


def image(points):
    return [(LENGTH - x, z) for x, z in reversed(points)]


def sorted_leaves(scene, state, *, mirrored=False):
    """Numbers of particles, those of the mirror image turned back, in an order that depends on position alone."""
    position, push = scene.particles.position, jnp.zeros((2, 1))
    if scene.loads.water is not None:
        push = scene.loads.water.push(position)
    way = np.array([-1.0 if mirrored else 1.0, 1.0])[:, None]
    x = LENGTH - position[0] if mirrored else position[0]
    order = np.lexsort(np.round(64 * np.stack([x, position[1]])))
    stress = state.stress * np.array([1, 1, 1, way[0, 0]])[:, None]
    parts = (x, position[1], scene.particles.mass, scene.particles.volume, way * push, stress)
    moving = (way * state.displacement, way * state.velocity, state.volume_ratio)
    return [np.asarray(jnp.broadcast_to(part, (*part.shape[:-1], x.size)))[..., order] for part in (*parts, *moving)]


def nodes(scene, *, mirrored=False):
    """Numbers of the base at the nodes, those of the mirror image turned back."""
    base = scene.boundary.base
    if base is None:
        return []
    way = np.array([-1.0, 1.0]) if mirrored else 1.0
    fields = [each.reshape(*scene.grid.shape, -1) for each in (base.normal * way, base.area, base.volume)]
    return [np.asarray(field[::-1] if mirrored else field) for field in fields]


quarter = st.integers(0, 11).map(lambda n: n / 4)
inner = st.integers(1, 2 * int(LENGTH) - 1).map(lambda n: n / 2)


@st.composite
def lines(draw, lowest):
    """From wall to wall, with up to two upright steps, on quarters of a metre and so through particles."""
    x = sorted(draw(st.lists(inner, min_size=1, max_size=2, unique=True)))
    twice = draw(st.lists(st.booleans(), min_size=len(x), max_size=len(x)))
    along = [0.0, *(each for at, step in zip(x, twice, strict=True) for each in [at] * (1 + step)), LENGTH]
    return [(at, lowest + draw(quarter)) for at in along]


STEP, ROCK = [(0.0, 6.0), (4.5, 6.0), (4.5, 4.0), (12.0, 5.0)], [(0.0, 1.5), (6.5, 1.0), (6.5, 2.0), (12.0, 2.5)]


@example(surface=STEP, inside=ROCK, kind="layers", spacing=(1.0, 1.0))
@example(surface=STEP, inside=ROCK, kind="bedrock", spacing=(1.0, 0.5))
@example(surface=STEP, inside=[ROCK[0], *ROCK[2:]], kind="water", spacing=(1.0, 1.0))
@settings(max_examples=9)
@given(
    surface=lines(4.0),
    inside=lines(0.75),
    kind=st.sampled_from(["plain", "layers", "water", "bedrock"]),
    spacing=st.sampled_from([(1.0, 1.0), (0.5, 0.5), (1.0, 0.5)]),
)
def test_ground_and_its_mirror_image_have_the_same_particles_loads_and_base(surface, inside, kind, spacing):
    choices = mpm.Discretisation(1.0, spacing, cell_average=True)
    if kind == "water":
        inside = [point for point, after in zip(inside, [*inside[1:], (None, 0)], strict=True) if point[0] != after[0]]

    def made(turned):
        contact = mpm.Interface(20.0, 2e3) if kind == "bedrock" else None
        shape = mpm.Section(turned(surface), bedrock=turned(inside) if kind == "bedrock" else None, interface=contact)
        stiff = mpm.Soil(unit_weight=22e3, strength=40e3)
        soil = [mpm.Layer(CLAY, bottom=turned(inside)), mpm.Layer(stiff)] if kind == "layers" else CLAY
        table = {"water": turned(inside)} if kind == "water" else {}
        return mpm.section(shape, soil, choices, at_rest=False, **table)

    def built(turned):
        try:
            return made(turned)
        except ValueError:
            return None

    drawn, mirrored = built(list), built(image)
    assert (drawn is None) == (mirrored is None)
    assume(drawn is not None)
    pairs = zip(sorted_leaves(*drawn), sorted_leaves(*mirrored, mirrored=True), strict=True)
    bases = zip(nodes(drawn[0]), nodes(mirrored[0], mirrored=True), strict=True)
    for first, second in (*pairs, *bases):
        assert first.shape == second.shape
        np.testing.assert_allclose(second, first, rtol=1e-9, atol=1e-9 * max(np.abs(first).max(), 1))


@settings(max_examples=25)
@given(seed=st.integers(0, 99), axis=st.sampled_from([0, 1]), step=st.sampled_from([0.5, 1.0, 2.0]))
def test_water_on_a_grid_pushes_its_mirror_image_the_other_way(seed, axis, step):
    heights = np.random.default_rng(seed).uniform(1.0, 4.0, (5, 4))
    end = step * (np.array(heights.shape) - 1)
    # On and between points of the grid, along its edges and beyond them.
    plan = np.stack(np.meshgrid(*(np.arange(-step, last + 1.5 * step, step / 2) for last in end), indexing="ij"))
    position = np.stack([*plan.reshape(2, -1), np.full(plan[0].size, 1.0)])
    turned = position.copy()
    turned[axis] = end[axis] - position[axis]
    numbers = (jnp.zeros(2), step, 9.81e3, 0.5)
    first, second = (
        np.asarray(mpm.laws.WaterSurface(jnp.asarray(h), *numbers).push(jnp.asarray(at)))
        for h, at in ((heights, position), (np.flip(heights, axis).copy(), turned))
    )
    np.testing.assert_allclose(second * np.where(np.arange(3) == axis, -1, 1)[:, None], first, atol=1e-8)


SLOPE = [(0.0, 6.0), (3.0, 6.0), (3.0, 5.0), (6.25, 2.0), (LENGTH, 2.0)]


@pytest.mark.parametrize("contact", ["fixed", "interface", "bedrock"])
def test_a_slope_slides_as_its_mirror_image(contact):
    rock = [(0.0, 2.0), (4.5, 1.75), (4.5, 0.5), (LENGTH, 0.5)]
    moved = []
    for turned in (list, image):
        shape = mpm.Section(
            turned(SLOPE),
            interface=None if contact == "fixed" else mpm.Interface(5.0, 1e3),
            bedrock=turned(rock) if contact == "bedrock" else None,
        )
        scene, state = mpm.section(shape, CLAY, mpm.Discretisation(1.0, (0.5, 0.5), cell_average=True), at_rest=False)
        state = jax.block_until_ready(mpm.advance(scene, state, jnp.asarray(60)))
        moved.append(sorted_leaves(scene, state, mirrored=turned is image))
    assert np.abs(moved[0][-3]).max() > 1e-3
    for first, second in zip(*moved, strict=True):
        np.testing.assert_allclose(second, first, atol=1e-9 * max(np.abs(first).max(), 1e-3))
