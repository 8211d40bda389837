"""Volumetric strain averaged over cells, the cure for soil with friction: what it is, costs and cures."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

import jaxmpm as mpm
from benchmarks.accuracy.collapse import WEIGHT, collapse
from jaxmpm import tensors
from jaxmpm.diagnostics import elastic_energy, kinetic_energy, potential_energy, unbalanced_force
from jaxmpm.equations import Maps, acting_stress, update_stress
from jaxmpm.grid import Grid
from jaxmpm.laws import frictional
from jaxmpm.transfer import cell_sums, filtered, native_available, within_cells
from tests.differences import check_run

SHAPE = mpm.Slope(crest=6.0, height=4.0, run_per_rise=1.0, toe=8.0, foundation=2.0)
SAND = mpm.FrictionalSoil(cohesion=3e3, friction=25.0, young=2e7, law=mpm.laws.DruckerPrager)
NUMERICS = mpm.Discretisation(1.0, (0.5, 0.5))
CLAY = mpm.Soil(unit_weight=17e3, young=2e7, poisson=0.4, strength=18e3, softening_modulus=40e3, tension_cutoff=0.0)
FILL = mpm.FrictionalSoil(2e3, 33.0, young=3e7)
BANK = mpm.Section([(0, 13), (14, 13), (24, 8), (48, 8)])
UNDER_FILL = [mpm.Layer(FILL, [(0, 8), (24, 8)]), mpm.Layer(CLAY)]


def sand_slope(**choices):
    return mpm.slope(SHAPE, SAND, replace(NUMERICS, **choices))


def test_the_average_is_a_projection_and_symmetric_in_its_weights(x64):
    rng = np.random.default_rng(3)
    grid = Grid((9, 8), 0.5, (-1.0, 2.0))
    position = jnp.asarray(np.array([[-0.5], [2.5]]) + rng.uniform(size=(2, 200)) * np.array([[3.0], [2.5]]))
    weights = jnp.asarray(rng.uniform(0.5, 2.0, 200))
    one, other = (jnp.asarray(rng.normal(size=200)) for _ in range(2))
    average = jax.jit(lambda values: within_cells(grid, position, values, weights))
    assert np.allclose(average(average(one)), average(one))
    assert np.isclose(jnp.sum(weights * other * average(one)), jnp.sum(weights * one * average(other)))
    cell = np.floor((np.asarray(position) - [[-1.0], [2.0]]) / 0.5)
    for chosen in np.unique(cell, axis=1).T[:5]:
        inside = np.all(cell == chosen[:, None], axis=0)
        expected = np.average(np.asarray(one)[inside], weights=np.asarray(weights)[inside])
        assert np.allclose(average(one)[inside], expected)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_sums_over_cells_agree_between_engines_lanes_and_plain_loops(x64, dtype):
    rng = np.random.default_rng(7)
    cell = jnp.asarray(rng.integers(0, 40, (3, 500)), jnp.int32)
    values = jnp.asarray(rng.normal(size=(3, 3, 500)), dtype)

    def sums(cell, values, engine=None):
        return cell_sums(cell, values, cells=40, engine=engine)

    plain = np.stack([[np.bincount(c, row, 40)[c] for row in v] for c, v in zip(cell, np.asarray(values), strict=True)])
    tight = 1e-5 if dtype == jnp.float32 else 1e-12
    for engine in (None, mpm.Engine.XLA):
        many = partial(sums, engine=engine)
        assert np.allclose(jax.vmap(many)(cell, values), plain, atol=tight)
        assert np.array_equal(jax.vmap(many)(cell, values)[1], many(cell[1], values[1]))
        shared = jax.vmap(many, in_axes=(None, 0))(cell[2], values)
        assert np.array_equal(shared[2], many(cell[2], values[2]))
        assert np.array_equal(jax.vmap(many, in_axes=(0, None))(cell, values[2])[2], shared[2])
    assert np.array_equal(sums(cell[0], values[0]), sums(cell[0], values[0], mpm.Engine.XLA))


def test_sums_over_cells_differentiate_in_lanes_that_share_cells_or_values(x64):
    rng = np.random.default_rng(8)
    cell, values = jnp.asarray(rng.integers(0, 9, (2, 30)), jnp.int32), jnp.asarray(rng.normal(size=(2, 2, 30)))

    def energy(scale, cells, values):
        return jnp.sum(cell_sums(cells, scale * values, cells=9) ** 3)

    for axes in ((None, 0, 0), (None, None, 0), (None, 0, None), (0, None, None)):
        shared = [x if a is not None else x[0] for x, a in zip((cell, values), axes[1:], strict=True)]
        scale = jnp.asarray([1.1, 0.9]) if axes[0] == 0 else jnp.asarray(1.1)
        lanes = jax.vmap(energy, in_axes=axes)
        check_grads(lambda s, lanes=lanes, shared=shared: lanes(s, *shared), (scale,), order=2, modes=("fwd", "rev"))


REFUSED = [
    ({}, None),
    ({"cells": 0}, "no cell"),
    ({"integers": jnp.int16}, "must be int32"),
    ({"values": (3, 2, 4)}, "number of particles"),
    ({"values": (3, 1, 5)}, "number of particles or rows"),
    ({"cell": (3, 2, 5)}, "number of particles or rows"),
    ({"cell": (2, 1, 5)}, "leading axes"),
    ({"values": (2, 5)}, "rank"),
]


@pytest.mark.skipif(not native_available(), reason="the native engine was not built")
@pytest.mark.parametrize(("changed", "message"), REFUSED, ids=[f"{list(c)}: {m}" for c, m in REFUSED])
def test_the_kernel_refuses_what_it_cannot_do(changed, message):
    """Straight to the library, past the checks in Python: three lanes of five particles, two rows, four cells."""
    given = {"cell": (1, 1, 5), "values": (3, 2, 5), "cells": 4, "integers": jnp.int32} | changed
    call = jax.ffi.ffi_call("jaxmpm_cell_sums", jax.ShapeDtypeStruct((3, 2, 5), jnp.float32))
    arrays = jnp.zeros(given["cell"], given["integers"]), jnp.ones(given["values"], jnp.float32)
    if message is None:
        assert np.array_equal(call(*arrays, cells=np.int64(given["cells"])), np.full((3, 2, 5), 5.0))
    else:
        with pytest.raises(Exception, match=message):
            call(*arrays, cells=np.int64(given["cells"]))


def test_a_discretisation_has_it_by_default_for_soil_with_friction_only():
    def averages(soil, **choices):
        return mpm.slope(SHAPE, soil, replace(NUMERICS, **choices), at_rest=False)[0].numerics.cell_average

    assert averages(SAND)
    assert not averages(SAND, cell_average=False)
    assert not averages(mpm.Soil(strength=2e4, tension_cutoff=0.0))
    assert not mpm.column(4.0, SAND, mpm.Discretisation(1.0, (0.5,)), at_rest=False)[0].numerics.cell_average
    with pytest.raises(ValueError, match="fbar = True with cell_average = True"):
        mpm.slope(SHAPE, mpm.Soil(strength=2e4, tension_cutoff=0.0), replace(NUMERICS, fbar=True, cell_average=True))


def test_a_slope_starts_in_balance():
    assert float(unbalanced_force(*sand_slope())) < 1e-4


def clay_bank(*layers):
    return mpm.section(BANK, layers, mpm.Discretisation(1.0, (0.5, 0.5), cfl=0.9, cell_average=True))


@pytest.mark.parametrize(
    ("begin", "factor"),
    [(sand_slope, 1.5), (partial(clay_bank, mpm.Layer(CLAY)), 1.6), (partial(clay_bank, *UNDER_FILL), 1.6)],
    ids=["sand", "clay that softens", "clay under fill"],
)
def test_energy_of_a_slide_closes(begin, factor):
    # What gravity gives is moving, stored or dissipated, so that what is stored and moving never exceeds it.
    scene, state = begin()
    start = float(elastic_energy(scene, state))
    times = np.linspace(0.2, 3.0, 8)
    run = mpm.solve(mpm.reduced(scene, factor), state, t_end=3.0, snapshots=times).raise_if_failed()
    given = np.array([-float(potential_energy(scene, s)) for s in run.snapshots])
    held = np.array([float(kinetic_energy(scene, s) + elastic_energy(scene, s)) - start for s in run.snapshots])
    dissipated = given - held
    assert float(jnp.max(mpm.diagnostics.displacement(run.state))) > 1.0
    assert np.all(np.diff(dissipated) > 0)


@pytest.mark.parametrize(
    ("layers", "fbar"),
    [([mpm.Layer(CLAY)], False), (UNDER_FILL, False), ([mpm.Layer(CLAY)], True)],
    ids=["clay", "under fill", "F-bar"],
)
def test_forces_do_the_work_that_the_averaged_strain_stores(x64, layers, fbar):
    scene, state = clay_bank(*layers)
    scene = replace(scene, numerics=replace(scene.numerics, fbar=fbar, cell_average=not fbar))
    rng = np.random.default_rng(5)
    position = scene.particles.position + 0.3 * jnp.asarray(rng.uniform(-1, 1, scene.particles.position.shape))
    stress, volume = jnp.asarray(rng.normal(size=state.stress.shape)), scene.particles.volume
    # Soil with friction keeps its own mean stress, which is 0 here so that it does no work on the averaged strain.
    full = tensors.expand(stress, 2)
    full = tensors.with_mean(full, jnp.where(frictional(scene.material), 0.0, tensors.mean(full)))
    maps, velocity = Maps(scene, position), jnp.asarray(rng.normal(size=(scene.grid.nodes, 2)))
    forces = maps.to_grid(None, acting_stress(scene, tensors.compress(full, 2), volume, maps))
    strain = tensors.strain_increment(tensors.entries(maps.gradient(velocity)), jnp.ones(()))
    products = (jnp.sum(volume * a * b) for a, b in zip(full, maps.unlocked(strain, volume), strict=True))
    xx, yy, zz, _, _, xz = products
    assert np.isclose(-jnp.sum(forces * velocity), xx + yy + zz + 2 * xz, rtol=1e-9)


def test_a_free_surface_keeps_its_strength():
    # Without cohesion 1:2 stands up to tan(38) / tan(26.6) = 1.56. Neighbours averaged with their stress would run.
    shape = mpm.Slope(crest=6.0, height=4.0, run_per_rise=2.0, toe=8.0, foundation=2.0)
    sand = replace(SAND, cohesion=0.0, friction=38.0)
    scene, state = mpm.slope(shape, sand, NUMERICS)
    stands, runs = (
        float(mpm.diagnostics.largest_displacement(mpm.solve(mpm.reduced(scene, r), state, t_end=2.0).state))
        for r in (1.4, 1.8)
    )
    assert stands < 0.1
    assert runs > 0.3


def test_it_lowers_what_locks():
    def displacement(choice):
        scene, state = sand_slope(cell_average=choice)
        return float(
            mpm.diagnostics.mean_displacement(scene, mpm.solve(mpm.reduced(scene, 1.3), state, t_end=2.0).state)
        )

    assert displacement(None) > 1.3 * displacement(False)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    "criterion", [mpm.laws.MohrCoulomb, pytest.param(mpm.laws.DruckerPrager, marks=pytest.mark.slow)]
)
def test_gradients_are_those_of_differences_and_engines_and_lanes_agree(criterion):
    scene, state = mpm.slope(SHAPE, replace(SAND, law=criterion), NUMERICS)
    weak = mpm.reduced(scene, 1.3)

    def slid(scene, cohesion, friction):
        varied = replace(scene, material=replace(scene.material, cohesion=cohesion, friction=friction))
        return jnp.sum(mpm.advance(varied, state, 40).displacement[0])

    at = weak.material.cohesion, weak.material.friction
    check_run(slid, weak, at, (1e-3, 1e-7), tolerance=1e-4)


def test_a_gap_belongs_to_its_cell():
    scene, state = sand_slope()
    scene = replace(scene, material=replace(scene.material, tension_cutoff=jnp.zeros_like(scene.material.bulk)))
    rng = np.random.default_rng(5)
    opened = jnp.asarray(rng.uniform(0, 0.02, scene.particles.mass.size), jnp.float32)
    loose = replace(state, stress=jnp.zeros_like(state.stress), gap=opened)
    maps = Maps(scene, scene.particles.position)
    still = jnp.zeros((2, 2, opened.size), jnp.float32)
    strained = update_stress(scene, loose, still, jnp.asarray(1e-4, jnp.float32), maps)
    after, volume = strained.gap, scene.particles.volume
    # Soil that bears pressure once its gap has closed fills its own volume, and is as stiff as its mass allows.
    assert np.allclose(jnp.log(strained.volume_ratio / loose.volume_ratio), after - opened, atol=1e-6)
    assert np.allclose(after, within_cells(scene.grid, maps.position, opened, volume), rtol=1e-5)
    assert float(jnp.max(jnp.abs(after - opened))) > 0.005
    assert np.isclose(jnp.sum(volume * after), jnp.sum(volume * opened), rtol=1e-5)
    apart = replace(scene, numerics=replace(scene.numerics, gap_average=False))
    local = update_stress(apart, loose, still, jnp.asarray(1e-4, jnp.float32), maps).gap
    assert np.array_equal(local, opened)


def test_the_gap_of_clay_is_its_own():
    # Averaged it takes energy: 2.7 % of what gravity gives in a collapse of clay, 0.4 % without.
    opening = [replace(layer, soil=replace(layer.soil, tension_cutoff=0.0)) for layer in UNDER_FILL]
    scene, state = clay_bank(*opening)
    assert not clay_bank(mpm.Layer(CLAY))[0].numerics.gap_average
    rng = np.random.default_rng(5)
    opened = jnp.asarray(rng.uniform(0, 0.02, scene.particles.mass.size), jnp.float32)
    loose = replace(state, stress=jnp.zeros_like(state.stress), gap=opened)
    still = jnp.zeros((2, 2, opened.size), jnp.float32)
    maps = Maps(scene, scene.particles.position)
    after = update_stress(scene, loose, still, jnp.asarray(1e-4, jnp.float32), maps).gap
    with_friction = np.asarray(frictional(scene.material))
    assert np.array_equal(after[~with_friction], opened[~with_friction])
    averaged = maps.cell_average(opened, scene.particles.volume)[with_friction]
    assert np.allclose(after[with_friction], averaged, rtol=1e-5)
    assert not np.allclose(averaged, opened[with_friction], rtol=1e-2)


@pytest.mark.parametrize("aspect", [1.0, 2.0])
def test_a_heap_at_rest_bears_its_weight(aspect):
    # With a gap of each particle's own 11 and 14 % of it lie without stress beside what bears their weight.
    scene, state = collapse(aspect, 8)
    pressure, volume = -np.mean(np.asarray(state.stress[:3]), axis=0), np.asarray(scene.particles.volume)
    assert volume[pressure < 1e-3 * WEIGHT * aspect].sum() < 0.03 * volume.sum()


@pytest.mark.parametrize("passes", [2, 3, 7, 29])
def test_filters_do_not_reach_round_the_grid(passes):
    shape, wide = (12, 9), 2 * passes + 1
    sums = np.random.default_rng(4).random(shape)
    got = filtered(Grid(shape, 1.0, (0.0, 0.0)), jnp.asarray(sums.reshape(-1, 1)), passes).reshape(shape)
    # On a grid without end: the weights of all filters together, at once.
    weights = np.array([1.0])
    for _ in range(passes):
        weights = np.convolve(weights, [0.25, 0.5, 0.25])
    expected = sums
    for axis in (0, 1):
        expected = np.apply_along_axis(np.convolve, axis, expected, weights)
        expected = np.take(expected, np.arange(passes, passes + shape[axis]), axis)
    assert weights.size == wide
    np.testing.assert_allclose(got, expected, atol=2e-4 * sums.max())
