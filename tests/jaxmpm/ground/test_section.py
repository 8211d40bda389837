"""A section drawn as lines: the lattice it makes, its layers, and what it refuses, with the coordinates."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm

CLAY = mpm.Soil(strength=42e3, softening_modulus=85e3, tension_cutoff=0.0)
HALVES = mpm.Discretisation(1.0, (0.5, 0.5))
FLAT = mpm.Section([(0, 6), (8, 6), (14, 3), (20, 3)])


def drained(cohesion, friction, **other):
    return mpm.FrictionalSoil(cohesion=cohesion, friction=friction, **other)


def outline(shape):
    """A slope as the line that a user would draw."""
    crest, toe, top = shape.crest, shape.toe_x, shape.foundation + shape.height
    return mpm.Section([(0, top), (crest, top), (toe, shape.foundation), (shape.length, shape.foundation)])


@pytest.mark.parametrize(("cell", "ratio"), [(1.0, 0.0), (0.6, 3.0), (0.2, 1.5)])
def test_a_trapezoid_is_the_slope_bit_for_bit(cell, ratio):
    # The slope of 1:3 puts centres on the surface itself, and cells of 0.2 m round the height up.
    shape = mpm.Slope(6 * cell, 4 * cell, ratio, 8 * cell, 2 * cell)
    numerics = mpm.Discretisation(cell, (cell / 2, cell / 2))
    one = mpm.slope(shape, CLAY, numerics, at_rest=False)
    other = mpm.section(outline(shape), CLAY, numerics, at_rest=False)
    assert jax.tree.structure(one) == jax.tree.structure(other)
    assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True))


def test_the_initial_stress_of_a_trapezoid_is_the_slopes_bit_for_bit():
    shape = mpm.Slope()
    (_, one), (_, other) = mpm.slope(shape, CLAY, HALVES), mpm.section(outline(shape), CLAY, HALVES)
    assert np.array_equal(one.stress, other.stress)


def test_a_section_lies_where_it_is_drawn():
    shifted = mpm.Section([(x + 30, z + 12) for x, z in FLAT.surface], base=12.0)
    (here, at_rest), (there, elsewhere) = (mpm.section(shape, CLAY, HALVES) for shape in (FLAT, shifted))
    assert np.allclose(there.particles.position, here.particles.position + jnp.array([[30.0], [12.0]]))
    assert np.allclose(elsewhere.stress, at_rest.stress, rtol=1e-3, atol=30.0)


def test_walls_leave_out_what_is_drawn_beyond_them():
    cut, whole = (
        mpm.section(mpm.Section(FLAT.surface, walls=walls), CLAY, HALVES, at_rest=False)[0] for walls in ((4, 18), None)
    )
    x, _ = np.asarray(whole.particles.position)
    assert cut.particles.mass.size == np.count_nonzero((x > 4) & (x < 18))


def test_what_lies_beyond_the_walls_changes_nothing():
    hill = [(0.0, 0.0), (10.0, 200.0), (10.0, 20.0), (20.0, 20.0), (50.0, 5.0), (60.0, -90.0)]
    cut = mpm.Section(hill, base=-5.0, walls=(10.0, 45.0))
    drawn = mpm.Section([(10.0, 20.0), (20.0, 20.0), (45.0, 7.5)], base=-5.0)
    assert (cut.relief, cut.extent, cut.downhill) == (drawn.relief, drawn.extent, drawn.downhill) == (12.5, (35, 25), 1)
    one, other = (mpm.section(shape, CLAY, mpm.Discretisation(1.0, (0.5, 0.5)), k_h=0.2)[0] for shape in (cut, drawn))
    assert np.array_equal(one.loads.gravity, other.loads.gravity)
    assert one.grid == other.grid
    assert np.array_equal(one.particles.position, other.particles.position)


def test_a_point_drawn_twice_changes_nothing():
    drawn = [(0.0, 14.0), (20.0, 14.0), (36.0, 6.0), (84.0, 6.0)]
    twice = [drawn[0], drawn[1], drawn[1], drawn[2], drawn[2], drawn[3]]
    assert mpm.Section(twice, toe=36.0).face == mpm.Section(drawn, toe=36.0).face is not None


def test_each_end_is_held_as_asked():
    """Level ground that gets its weight at once hangs on a fixed end, and comes down along a roller."""
    level, fallen = mpm.Section([(0, 6), (20, 6)]), {}
    for ends in ("left fixed", "right fixed"):
        scene, state = mpm.section(level, CLAY, HALVES, ends=ends, at_rest=False)
        x, z = np.asarray(scene.particles.position)
        down = -np.asarray(mpm.solve(scene, state, t_end=0.2).raise_if_failed().state.displacement[1])
        fallen[ends] = [down[(z > 5) & side].mean() for side in (x < 0.5, x > 19.5)]
    left, right = fallen["left fixed"]
    assert left < 0.5 * right
    assert np.allclose(fallen["right fixed"], (right, left), rtol=1e-2)


def test_an_end_is_free_where_the_surface_is_drawn_down_to_the_base():
    held, free = mpm.Section([(0, 6), (8, 6)]), mpm.Section([(0, 6), (8, 6), (8, 0), (20, 0)])
    across = []
    for shape in (held, free):
        scene, state = mpm.section(shape, CLAY, HALVES)
        x, z = np.asarray(scene.particles.position)
        across.append(-np.asarray(state.stress[0])[(x > 7.5) & (z > 2)].mean())  # above what the base holds
    assert across[1] < 0.25 * across[0]
    final = mpm.solve(mpm.reduced(scene, 4.0), state, t_end=0.5).raise_if_failed().state
    assert float(jnp.max(scene.particles.position[0] + final.displacement[0])) > 8.1


LAYERS = [
    mpm.Layer(drained(0.0, 38, unit_weight=18e3), [(0, 4.5), (11, 4.5)]),  # ends on the slope's face
    mpm.Layer(drained(5e3, 23, unit_weight=20e3), [(0, 1), (20, 2)]),
    mpm.Layer(drained(7e3, 23, unit_weight=22e3)),
]


@pytest.mark.parametrize(("left", "toe", "direction"), [(6, None, 1), (1, None, -1), (1, 16, 1)])
def test_an_earthquake_acts_towards_the_toe_or_the_lower_end(left, toe, direction):
    bank = mpm.Section([(0, left), (4, 6), (10, 6), (16, 3), (24, 3)], toe=toe)
    scene, _ = mpm.section(bank, CLAY, HALVES, k_h=0.2, at_rest=False)
    assert np.allclose(scene.loads.gravity, (direction * 0.2 * 9.81, -9.81))


def test_particles_are_of_the_layer_in_which_they_lie():
    scene, _ = mpm.section(FLAT, LAYERS, HALVES, at_rest=False)
    x, z = np.asarray(scene.particles.position)
    expected = np.where(z >= 4.5, 0, np.where(z >= 1 + x / 20, 1, 2))
    assert np.allclose(scene.material.cohesion, np.array([0.0, 5e3, 7e3])[expected])
    assert np.allclose(scene.particles.mass * 9.81 / 0.25, np.array([18e3, 20e3, 22e3])[expected])
    # What the layers share stays one number.
    assert scene.material.dilation.shape == scene.material.shear.shape == ()


def test_the_stress_under_layers_is_their_weight():
    level = mpm.Section([(0, 8), (12, 8)])
    layers = [
        mpm.Layer(drained(5e3, 30, unit_weight=16e3), [(0, 5), (12, 5)]),
        mpm.Layer(drained(5e3, 30, unit_weight=22e3)),
    ]
    scene, state = mpm.section(level, layers, HALVES)
    z = np.asarray(scene.particles.position[1])
    weight = 16e3 * np.clip(8 - z, 0, 3) + 22e3 * np.clip(5 - z, 0, None)
    inner = (z > 1) & (z < 7) & (abs(z - 5) > 1)
    assert np.allclose(-state.stress[2][inner], weight[inner], rtol=5e-3)


def test_a_strong_layer_does_not_yield():
    layers = [mpm.Layer(drained(1e3, 20), [(0, 1), (20, 1)]), mpm.Layer(drained(1e9, 20, unusual=True))]
    scene, state = mpm.section(FLAT, layers, HALVES)
    final = mpm.solve(mpm.reduced(scene, 3.0), state, t_end=1.0).raise_if_failed().state
    displacement = np.asarray(mpm.diagnostics.displacement(final))
    rock = np.asarray(scene.particles.position[1]) < 1
    assert displacement[~rock].max() > 0.5
    assert displacement[rock].max() < 1e-3


@pytest.mark.parametrize("bottom", [[(0, 6), (20, 0)], [(0, 6), (9, 0), (20, 0)], [(0, 0), (14, 3), (20, 3)]], ids=str)
def test_a_layer_may_taper_off_exactly_at_a_wall(bottom):
    soils = drained(5e3, 20), drained(1e3, 30)
    scene, _ = mpm.section(FLAT, [mpm.Layer(soils[0], bottom), mpm.Layer(soils[1])], HALVES, at_rest=False)
    x, z = np.asarray(scene.particles.position)
    above = z > np.interp(x, *np.transpose(bottom))
    assert 50 < above.sum() < above.size - 50
    assert np.array_equal(np.asarray(scene.material.cohesion) == 5e3, above)


def layered(*bottoms):
    return [mpm.Layer(CLAY, bottom) for bottom in bottoms] + [mpm.Layer(CLAY)]


REFUSED = {
    "overhang": (mpm.Section([(0, 6), (8, 6), (7, 3), (20, 3)]), CLAY, r"turns back from \(8, 6\) to \(7, 3\) m"),
    "wall": (mpm.Section(FLAT.surface, walls=(-2, 20)), CLAY, r"ends at \(0, 6\) m, 2 m from the wall at x = -2 m"),
    "base": (mpm.Section(FLAT.surface, base=4.0), CLAY, r"surface at \(14, 3\) m lies below the base at 4 m"),
    "walls": (mpm.Section(FLAT.surface, walls=(20, 0)), CLAY, "give the left one first"),
    "length": (mpm.Section([(0, 6), (20.3, 3)]), CLAY, "section's length = 20.3 m is no whole multiple"),
    "far away": (
        mpm.Section([(x + 5e5, z) for x, z in FLAT.surface]),
        CLAY,
        "float32 resolves to 0.06 m only: measure from a corner",
    ),
    "no line": (mpm.Section([(0, 6)]), CLAY, "give two points"),
    "nan": (mpm.Section([(0, 6), (10, float("nan")), (20, 6)]), CLAY, "surface = nan m at "),
    "crossing the surface": (FLAT, layered([(0, 4), (20, 4)]), r"layer 1 crosses the surface: at x = \S+ m it is 1 m"),
    "crossing": (
        FLAT,
        layered([(0, 2), (20, 1)], [(0, 1), (20, 2)]),
        "bottom of layer 2 crosses the bottom of layer 1: at x = 20 m it is 1 m higher, at z = 2 m",
    ),
    "ends in the ground": (FLAT, layered([(0, 2), (10, 2)]), r"ends at \(10, 2\) m, 3 m below the boundary above"),
    "ends in the air": (FLAT, layered([(0, 4), (10, 6)]), r"ends at \(10, 6\) m, 1 m above the boundary above"),
    "thin": (
        FLAT,
        layered([(0, 2.4), (20, 2.4)], [(0, 2), (20, 2)]),
        "layer 2 is 0.4 m thick at .* less than a particle",
    ),
    "thin at a wall": (FLAT, layered([(0, 5.9), (20, 0)]), "layer 1 is .* m thick at .* less than a particle of 0.5 m"),
    "thin in between": (FLAT, layered([(0, 2), (4, 5.75), (8, 5), (14, 2), (20, 2)]), "layer 1 is .* m thick at"),
    "below the base": (FLAT, layered([(0, 1), (20, 1)], [(0, -1), (20, -1)]), "layer 3 holds no particle"),
    "order": (FLAT, [mpm.Layer(CLAY), mpm.Layer(CLAY, [(0, 1), (20, 1)])], "all but the last with their bottom"),
    "parameter per particle": (
        FLAT,
        [mpm.Layer(CLAY, [(0, 1), (20, 1)]), mpm.Layer(replace(CLAY, strength=np.full(7, 9e3)))],
        "a soil of a layer has a parameter per particle: give numbers, then `with_soil`",
    ),
}


@pytest.mark.parametrize(("shape", "soil", "message"), REFUSED.values(), ids=REFUSED)
def test_what_no_lattice_can_hold_is_refused_with_its_position(shape, soil, message):
    with pytest.raises(ValueError, match=message):
        mpm.section(shape, soil, HALVES)
