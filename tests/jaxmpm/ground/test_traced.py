"""Set-up under `jit`, `grad` and `vmap`: derivatives of the initial stress, and what is refused with the way out."""

import re
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm.soil import Interface
from jaxmpm.types import Status

SURFACE = [(0, 6), (6, 6), (10, 2), (20, 2)]
BEDROCK = [(0, 1.5), (8, 0.5), (20, 0.5)]


def grid(dimension=2):
    return mpm.Discretisation(cell=2.0, spacing=(1.0,) * dimension)


def measure(built):
    """A number that depends on all of the initial stress, the mass and the time step."""
    scene, state = built
    weights = jnp.cos(jnp.arange(state.stress.size)).reshape(state.stress.shape)
    mass = scene.particles.mass
    weighed = jnp.sum(mass * jnp.cos(jnp.arange(mass.size))) / 1e3
    return jnp.sum(weights * state.stress) / 1e4 + weighed + 1e3 * scene.numerics.time_step


def difference(function, step):
    """A derivative at 0 by differences of fourth order."""
    near, far = (float(function(k * step)) - float(function(-k * step)) for k in (1, 2))
    return (8 * near - far) / (12 * step)


def clay(young, unit_weight, strength):
    shape = mpm.Slope(crest=6, height=4, run_per_rise=1, toe=8, foundation=2)
    return mpm.slope(shape, mpm.Soil(young=young, unit_weight=unit_weight, strength=strength), grid())


def rough_bedrock(friction, cohesion, poisson):
    shape = mpm.Section(SURFACE, bedrock=BEDROCK, interface=Interface(friction, cohesion))
    scene, state = mpm.section(shape, mpm.FrictionalSoil(5e3, 25.0, poisson=poisson), grid())
    return replace(
        scene, particles=replace(scene.particles, mass=scene.particles.mass * scene.boundary.friction)
    ), state


def wet(level, saturated, friction):
    upper = mpm.Layer(mpm.FrictionalSoil(5e3, friction, saturated_unit_weight=saturated, unusual=True), depth=1.0)
    lower = mpm.Layer(mpm.Soil(strength=30e3, young=5e7))
    return mpm.section(mpm.Section(SURFACE), [upper, lower], grid(), water=level)


CASES = {
    "clay": (clay, (5e7, 20e3, 9e3)),
    "bedrock": (rough_bedrock, (20.0, 2e3, 0.3)),
    "water": (wet, (3.2, 21e3, 25.0)),
}


@pytest.mark.parametrize("name", CASES)
def test_derivatives_of_the_set_up_are_those_of_differences(name):
    build, at = CASES[name]

    def number(*values):
        return measure(build(*values))

    with jax.enable_x64(True):
        gradient = jax.jit(jax.grad(number, range(len(at))))(*at)
        one = jax.jit(number)
        assert one(*at) == pytest.approx(float(number(*at)), rel=1e-8)
        for which, slope in enumerate(gradient):
            way = np.eye(len(at))[which]
            known = difference(lambda step, way=way: one(*(at + step * way)), 1e-3 * at[which])
            # Strength is no part of the initial state.
            assert float(slope) == pytest.approx(known, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("facing", [1, -1])
def test_derivatives_by_what_with_soil_varies(facing):
    with jax.enable_x64(True):
        surface = [(facing * x, z) for x, z in SURFACE][::facing]
        scene, state = mpm.section(mpm.Section(surface), mpm.Soil(strength=9e3, young=5e7), grid(), water=3.2)
        at = {"young": 5e7, "poisson": 0.35, "unit_weight": 20.5e3, "water_level": 3.3}

        @jax.jit
        def number(values):
            return measure(mpm.with_soil(scene, state, **values))

        gradient = jax.grad(number)(at)
        for name, value in at.items():
            known = difference(lambda step, name=name: number(at | {name: at[name] + step}), 1e-3 * value)
            assert float(gradient[name]) == pytest.approx(known, rel=1e-6)


def test_a_batch_of_soils_is_each_of_them():
    young = jnp.asarray([2e7, 5e7])
    each = jax.vmap(lambda value: measure(clay(value, 20e3, 9e3)))(young)
    assert np.asarray(each) == pytest.approx([float(measure(clay(float(y), 20e3, 9e3))) for y in young], rel=1e-4)


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_contact_is_a_field_that_a_run_is_differentiated_by(dimension):
    flat = [(0, 4), (4, 4), (4, 0), (10, 0)]
    with jax.enable_x64(True):
        soil, contact = mpm.FrictionalSoil(1e2, 28.0, young=2e5), Interface(20.0, 50.0)
        if dimension == 2:
            scene, state = mpm.section(mpm.Section(flat, interface=contact), soil, grid())
        else:
            raster = mpm.Raster(np.repeat([4.0, 4.0, 4.0, 0.0, 0.0, 0.0], 2).reshape(6, 2), (0.0, 0.0), 2.0)
            shape = mpm.Terrain(raster, 0.0, (0.0, 10.0), (0.0, 2.0), interface=contact)
            scene, state = mpm.terrain(shape, soil, grid(3))
        nodes = mpm.ground.Contact.of(scene)

        def moved(friction, cohesion):
            strength = {"wall_friction": nodes.spread(friction), "wall_cohesion": nodes.spread(cohesion)}
            final, _ = mpm.replay(*mpm.with_soil(scene, state, **strength), 60)
            return jnp.sum(final.displacement[0])

        count = nodes.nodes.size
        at = jnp.linspace(0.3, 0.5, count), jnp.linspace(40.0, 80.0, count)
        gradient = jax.jit(jax.grad(moved, (0, 1)))(*at)
        for which, slope in enumerate(gradient):
            node = int(np.argmax(np.abs(slope)))
            way = jnp.zeros(count).at[node].set(1.0)

            def along(step, which=which, way=way):
                return moved(*(each + step * way if k == which else each for k, each in enumerate(at)))

            known = difference(along, 1e-5 * float(at[which][node]))
            assert float(slope[node]) == pytest.approx(known, rel=1e-5)


def test_a_run_is_differentiated_with_its_set_up():
    def front(level):
        scene, state = mpm.section(mpm.Section(SURFACE), mpm.Soil(strength=4e3, young=1e7), grid(), water=level)
        final, _ = mpm.replay(scene, state, 40)
        return jnp.sum(final.displacement[0])

    with jax.enable_x64(True):
        assert float(jax.grad(front)(3.2)) == pytest.approx(difference(lambda z: front(3.2 + z), 1e-4), rel=1e-6)


def test_heights_of_a_section_are_differentiable_points():
    with jax.enable_x64(True):
        shape = mpm.Section(SURFACE)
        scene, state = mpm.section(shape, mpm.Soil(strength=9e3, young=5e7), grid())
        heights = np.array([6.0, 6.0, 2.0, 2.0])

        def number(z):
            return measure(mpm.ground.reshaped(scene, state, shape, z))

        assert number(heights) == pytest.approx(float(measure((scene, state))), rel=1e-9)
        gradient = jax.jit(jax.grad(number))(heights)
        for which, way in enumerate(np.eye(4)):
            known = difference(lambda step, way=way: number(heights + step * way), 1e-2)
            assert float(gradient[which]) == pytest.approx(known, rel=1e-6)
        # The soil above the old surface is that of the new section.
        after = [6.2, 6.1, 2.3, 2.2]
        higher, _ = mpm.ground.reshaped(scene, state, shape, after)
        new = mpm.Section([(x, z) for (x, _), z in zip(SURFACE, after, strict=True)])
        grown = float(higher.particles.volume.sum() - scene.particles.volume.sum())
        assert grown == pytest.approx(new.volume - shape.volume, rel=0.01)


def test_a_layer_that_is_higher_bears_more():
    with jax.enable_x64(True):
        shape = mpm.Section([(0.0, 4.0), (10.0, 4.0)])
        scene, state = mpm.section(shape, mpm.Soil(strength=9e3, young=5e7), grid())
        _, higher = mpm.ground.reshaped(scene, state, shape, [4.5, 4.5])
        low = np.asarray(scene.particles.position[-1]) == 0.5
        added = np.asarray(higher.stress[2] - state.stress[2])[low]
        assert added == pytest.approx(-20e3 * 0.5, rel=0.02)


@pytest.mark.parametrize(
    ("heights", "message"),
    [
        ([6.0, 6.0], r"heights have shape \(2,\): give \(4,\)"),
        ([6.0, 7.5, 2.0, 2.0], "move the surface by 1 m or more"),
        ([6.0, 6.0, np.nan, 2.0], "move the surface by 1 m or more"),
    ],
)
def test_heights_that_a_section_cannot_have_are_refused(heights, message):
    shape = mpm.Section(SURFACE)
    built = mpm.section(shape, mpm.Soil(strength=9e3), grid())
    with pytest.raises(ValueError, match=message):
        mpm.ground.reshaped(*built, shape, heights)


def small(**of_shape):
    return mpm.Slope(**{"crest": 6, "height": 4, "run_per_rise": 1, "toe": 8, "foundation": 2} | of_shape)


SOIL = mpm.Soil(strength=9e3)
SHAPES = {
    "height of ground is traced": lambda x: mpm.slope(small(height=x), SOIL, mpm.Discretisation(2.0, (1.0, 1.0))),
    "gravity is traced": lambda x: mpm.slope(small(), SOIL, mpm.Discretisation(2.0, (1.0, 1.0)), gravity=x),
    "surface of shape is traced": lambda x: mpm.section(
        mpm.Section([(0, x), (6, x), (10, 2), (20, 2)]), SOIL, mpm.Discretisation(2.0, (1.0, 1.0))
    ),
    "height is traced": lambda x: mpm.column(x, SOIL, grid()),
    "length is traced": lambda x: mpm.bar(x, SOIL, grid(1), velocity=0.1),
    "velocity is traced": lambda x: mpm.block((2.0, 2.0), SOIL, grid(), domain=(8, 8), corner=(0, 0), velocity=(x, 0)),
    "friction is traced": lambda x: mpm.block(
        (2.0, 2.0), SOIL, grid(), domain=(8, 8), corner=(0, 0), walls="friction", friction=x
    ),
    **{
        f"{name} of discretisation is traced": lambda x, name=name: mpm.column(
            4.0, SOIL, replace(grid(), **{name: (x, x) if name == "spacing" else x})
        )
        for name in ("cell", "spacing", "cfl", "flip", "pic_damping", "damping", "air")
    },
}


@pytest.mark.parametrize("message", SHAPES)
@pytest.mark.parametrize("transform", [jax.jit, jax.grad])
def test_what_shapes_the_program_says_so_and_names_the_way_out(message, transform):
    with pytest.raises(ValueError, match=re.escape(message) + ".*shapes the program: give a number; differentiate by"):
        transform(lambda x: measure(SHAPES[message](x)))(4.0)


def test_a_scene_that_is_an_argument_is_refused_with_the_way_out():
    scene, _ = mpm.slope(small(), SOIL, mpm.Discretisation(2.0, (1.0, 1.0)))
    with pytest.raises(ValueError, match=r"position is traced.*close over the scene"):
        jax.jit(mpm.setup.at_rest)(scene)


def test_a_lane_with_a_number_that_no_soil_has_gets_a_status():
    status = jax.vmap(lambda weight: clay(5e7, weight, 9e3)[1].status)(jnp.asarray([20e3, jnp.nan]))
    assert status.tolist() == [Status.RUNNING, Status.BAD_PARAMETER]


def test_terrain_is_traced_too():
    raster = mpm.Raster(np.linspace(6.0, 4.0, 5)[:, None] * np.ones(5), (0.0, 0.0), 2.0)
    shape = mpm.Terrain(raster, 0.0, (0.0, 8.0), (0.0, 8.0), interface=Interface(15.0))

    def number(young, unit_weight):
        soil = mpm.FrictionalSoil(5e3, 25.0, young=young, unit_weight=unit_weight)
        return measure(mpm.terrain(shape, soil, grid(3), water=3.0))

    with jax.enable_x64(True):
        at = 5e7, 20e3
        gradient = jax.jit(jax.grad(number, (0, 1)))(*at)
        for which in (0, 1):
            way = np.eye(2)[which]
            known = difference(lambda step, way=way: number(*(at + step * way)), 1e-3 * at[which])
            assert float(gradient[which]) == pytest.approx(known, rel=1e-6)
