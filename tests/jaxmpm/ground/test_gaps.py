"""Undrained soil that slides above rigid ground by a share of a cell: its drag, and what else is left alone."""

from dataclasses import replace

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given

import jaxmpm as mpm
from benchmarks.stability import stability_gap
from jaxmpm import equations
from jaxmpm.equations import gap_of
from jaxmpm.equations._gaps import NARROW, WIDE
from tests.jaxmpm.step.test_absent import program

FILLED = st.floats(0.1, 4.0)


@given(st.floats(2 * NARROW + 1e-3, WIDE - 1e-3), FILLED)
def test_the_gap_follows_from_two_masses_whatever_part_of_the_ground_is_covered(gap, cover):
    assert float(gap_of(cover * (1 - gap) ** 2 / 2, cover * (1 - gap**2 / 2))) == pytest.approx(gap, abs=1e-3)


@given(st.floats(0.05, 2.0), FILLED)
def test_a_thin_layer_lies_on_the_ground(thickness, cover):
    first, second = (
        np.trapezoid(np.clip(1 - np.abs(z - node), 0, None), z)
        for z, node in ((np.linspace(0, thickness, 2001), node) for node in (0, 1))
    )
    assert float(gap_of(cover * first, cover * second)) == 0


def test_no_soil_no_gap_and_a_finite_derivative():
    for masses in ((0.0, 0.0), (0.0, 1.0), (1e-30, 1.0), (1.0, 0.0)):
        slopes = jax.grad(gap_of, argnums=(0, 1))(*masses)
        assert np.isfinite(slopes).all()
    assert float(gap_of(0.0, 0.0)) == 0


DRAGS = [
    ("fixed", 0.5, {}),
    ("interface", 0.75, {}),
    ("bedrock", 0.5, {"offset": -0.4}),
    ("stuck bedrock", 0.25, {"offset": 0.4}),
]


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("ground", "gap", "choices"), DRAGS, ids=[ground for ground, *_ in DRAGS])
def test_clay_is_held_by_all_of_its_strength_at_every_gap(ground, gap, choices):
    """Without what closes the gap it would be held by 0.5, 0.06, 0.94 and 0.35 of it."""
    row = stability_gap.drag_row(ground, gap, cells=4, **choices)
    assert row["passed"], row
    assert row["drag"] == pytest.approx(1, abs=0.02)


def sliding(soil, **choices):
    scene, state = mpm.section(
        mpm.Section([(0, 4), (4, 4)]),
        soil,
        mpm.Discretisation(1.0, (0.5, 0.5), **choices),
        ends="tied",
    )
    up = scene.particles.position.at[1].add(0.4)
    return replace(scene, particles=replace(scene.particles, position=up)), state


CLAY = mpm.Soil(unit_weight=20e3, young=2e7, poisson=0.49, strength=20e3, tension_cutoff=0.0)
SAND = mpm.FrictionalSoil(0.0, 30.0, unit_weight=20e3, young=2e7)


def test_forces_across_a_gap_are_equal_and_opposite_along_the_ground_alone():
    scene, _ = sliding(CLAY)
    force = jnp.asarray(np.random.default_rng(0).normal(size=(scene.grid.nodes, 2)), jnp.float32)
    mass = equations.Maps(scene, scene.particles.position).to_grid(scene.particles.mass[None], None)[:, 0]
    gap = equations.gaps(scene, mass)
    assert float(gap.max()) == pytest.approx(0.4, abs=0.01)
    change = np.asarray(equations.closed(scene, gap, force) - force)
    assert np.abs(change).max() > 0.1
    np.testing.assert_allclose(change.sum(axis=0), 0, atol=1e-5)
    assert not change[:, 1].any()
    pulls = np.asarray(force)[:, 1] >= 0
    lowest = np.arange(scene.grid.nodes).reshape(scene.grid.shape)[:, scene.boundary.walls[0].index]
    assert not change[lowest[pulls[lowest]]].any()


def test_soil_with_friction_has_nothing_of_it_in_its_program():
    for soil, found in ((SAND, False), (CLAY, True)):
        scene, state = sliding(soil)
        assert equations.sheared(scene) is found
        walls = tuple(replace(wall, hold="roller") for wall in scene.boundary.walls)
        rollers = replace(scene, boundary=replace(scene.boundary, walls=walls))
        assert equations.sheared(rollers) is False
        assert equations.gaps(rollers, jnp.ones(scene.grid.nodes)) is None
        sqrts = [program(each, state).count("stablehlo.sqrt ") for each in (scene, rollers)]
        assert sqrts[0] == sqrts[1] + found


def test_of_layers_of_both_kinds_the_clay_alone_is_held_across_a_gap():
    weak = replace(CLAY, unusual=True)  # beside the sand, in few cells
    layers = [mpm.Layer(SAND, [(0, 1.5), (4, 1.5)]), mpm.Layer(weak)]
    drags = []
    for order in (layers, [replace(layers[0], soil=weak), replace(layers[1], soil=replace(SAND, cohesion=20e3))]):
        scene, state = mpm.section(
            mpm.Section([(0, 4), (4, 4)]), order, mpm.Discretisation(1.0, (0.5, 0.5)), ends="tied"
        )
        up = scene.particles.position.at[1].add(0.4)
        scene = replace(scene, particles=replace(scene.particles, position=up))
        shear = state.stress.at[3].set(10e3)
        nodal = equations.particles_to_grid(
            scene, replace(state, stress=shear), scene.numerics.time_step, equations.Maps(scene, up)
        )
        force = np.asarray(nodal.force).reshape(*scene.grid.shape, 2)[1:5, scene.boundary.walls[0].index, 0]
        drags.append(-force.sum() / (4 * 10e3))
    assert np.abs(drags) == pytest.approx([1.0, 0.6], abs=0.01)


@pytest.mark.parametrize("scheme", [mpm.Scheme.USF, mpm.Scheme.USL])
def test_other_schemes_close_gaps_too(scheme):
    scene, state = sliding(CLAY, scheme=scheme, cell_average=True)
    state = replace(state, velocity=state.velocity.at[0].set(3.0))
    start = mpm.advance(scene, state, jnp.asarray(30))
    steps = 60
    end = mpm.advance(scene, start, jnp.asarray(steps))
    lost = float(jnp.sum(scene.particles.mass * (start.velocity[0] - end.velocity[0])))
    assert lost / (steps * float(scene.numerics.time_step) * 20e3 * 4) == pytest.approx(1, abs=0.05)
