"""The step against theory: conservation, wave motion, objectivity of the dimension, derivatives, lanes."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm import diagnostics

ELASTIC = mpm.Soil(unit_weight=9.81e3, young=1e6, poisson=0.0)
SCHEMES = list(mpm.Scheme)


def bar(cells, scheme=mpm.Scheme.MUSL, kernel=mpm.GIMP, cfl=0.2, flip=1.0):
    cell = 25.0 / cells
    numerics = mpm.Discretisation(cell, (cell / 2,), kernel=kernel, scheme=scheme, cfl=cfl, flip=flip)
    return mpm.bar(25.0, ELASTIC, numerics, velocity=0.1)


def bar_error(cells, periods=1.0, **choices):
    """Largest error of the centre-of-mass velocity over its amplitude, and energies at the same times."""
    scene, state = bar(cells, **choices)
    omega = np.pi / 50 * np.sqrt(1e6 / 1e3)
    times = np.linspace(0, periods * 2 * np.pi / omega, round(16 * periods) + 1)[1:]
    result = mpm.solve(scene, state, t_end=times[-1], snapshots=times).raise_if_failed()
    start = float(diagnostics.momentum(scene, state)[0])
    momentum = np.array([float(diagnostics.momentum(scene, s)[0]) for s in result.snapshots])
    dt = float(scene.numerics.time_step)
    exact_times = np.array([int(s.step) * dt for s in result.snapshots])
    energy = [
        float(diagnostics.kinetic_energy(scene, s) + diagnostics.elastic_energy(scene, s)) for s in result.snapshots
    ]
    return (
        np.max(np.abs(momentum / start - np.cos(omega * exact_times))),
        np.array(energy),
        float(diagnostics.kinetic_energy(scene, state)),
    )


@pytest.mark.parametrize("scheme", SCHEMES)
def test_free_block_keeps_its_momentum_and_moves_as_one(scheme):
    numerics = mpm.Discretisation(0.5, (0.25, 0.25, 0.25), scheme=scheme)
    scene, state = mpm.block(
        (1, 1, 1),
        ELASTIC,
        numerics,
        domain=(4, 4, 4),
        corner=(1.1, 1.2, 1.3),
        velocity=(1.0, -0.5, 0.25),
        gravity=(0, 0, -1),
    )
    steps = 50
    result = mpm.advance(scene, state, jnp.asarray(steps))
    time = steps * float(scene.numerics.time_step)
    expected = diagnostics.momentum(scene, state) + jnp.sum(scene.particles.mass) * scene.loads.gravity * time
    assert np.allclose(diagnostics.momentum(scene, result), expected, rtol=5e-6)
    assert np.allclose(result.velocity - result.velocity[:, :1], 0, atol=2e-4)


@pytest.mark.usefixtures("x64")
def test_column_is_the_same_in_one_two_and_three_dimensions():
    soil = mpm.Soil(young=2e6, poisson=0.3, strength=20e3, softening_modulus=50e3, tension_cutoff=0.0)
    finals = []
    for d in (1, 2, 3):
        scene, state = mpm.column(8.0, soil, mpm.Discretisation(1.0, (0.5,) * d), at_rest=False)
        state = mpm.advance(scene, state, jnp.asarray(60))
        height = np.asarray(scene.particles.position[-1])
        finals.append([np.asarray(state.displacement[-1])[np.argsort(height)][:: 2 ** (d - 1)]])
        vertical = np.asarray(state.stress[0 if d == 1 else 2])
        finals[-1].append(vertical[np.argsort(height)][:: 2 ** (d - 1)])
    for one, other in ((0, 1), (0, 2)):
        assert np.allclose(finals[one][0], finals[other][0], rtol=1e-9, atol=1e-14)
        assert np.allclose(finals[one][1], finals[other][1], rtol=1e-9, atol=1e-5)


def small_slope(**choices):
    shape = mpm.Slope(crest=6, height=4, run_per_rise=1.0, toe=8, foundation=2)
    soil = mpm.Soil(young=5e6, strength=9e3, softening_modulus=40e3, tension_cutoff=0.0)
    return mpm.slope(shape, soil, mpm.Discretisation(1.0, (0.5, 0.5), **choices))


def test_vmapped_lanes_equal_single_runs():
    scene, state = small_slope()
    strengths = scene.material.strength * jnp.asarray([0.8, 1.0, 3.0])
    varied, axes = mpm.run.lanes(scene, strength=strengths)
    batch = mpm.solve(varied, mpm.run.repeat(state, 3), t_end=0.5, axes=axes)
    for i, strength in enumerate(strengths):
        single = mpm.solve(mpm.with_soil(scene, state, strength=strength)[0], state, t_end=0.5)
        for ours, theirs in zip(jax.tree.leaves(batch.state), jax.tree.leaves(single.state), strict=True):
            scale = max(1.0, float(jnp.max(jnp.abs(theirs))))
            assert np.allclose(ours[i] / scale, theirs / scale, rtol=1e-5, atol=1e-6)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    "scheme", [pytest.param(s, marks=() if s is mpm.Scheme.MUSL else pytest.mark.slow) for s in SCHEMES]
)
def test_fifty_steps_differentiate_with_respect_to_strength_and_modulus(scheme):
    scene, state = small_slope(scheme=scheme)

    def objective(strength, bulk):
        varied = replace(scene, material=replace(scene.material, strength=strength, bulk=bulk))
        final = mpm.advance(varied, state, 50)
        return 1e3 * jnp.sum(final.displacement**2) + jnp.sum(final.velocity**2)

    point = (scene.material.strength * jnp.ones_like(scene.particles.mass), scene.material.bulk)
    gradient = jax.jit(jax.grad(objective, argnums=(0, 1)))(*point)
    value = jax.jit(objective)
    weights = jnp.sin(jnp.arange(point[0].size))
    for k, (direction, h) in enumerate(((weights, 1e-2), (jnp.ones(()), 1e2))):
        shifted = [tuple(p + s * h * direction if i == k else p for i, p in enumerate(point)) for s in (1, -1)]
        central = (value(*shifted[0]) - value(*shifted[1])) / (2 * h)
        assert np.isclose(jnp.sum(gradient[k] * direction), central, rtol=1e-6)


def test_float32_agrees_with_float64():
    finals = []
    for precise in (False, True):
        with jax.enable_x64(precise):
            scene, state = small_slope()
            finals.append(np.asarray(mpm.solve(scene, state, t_end=0.5).state.displacement, float))
    scale = np.abs(finals[1]).max()
    assert np.abs(finals[0] - finals[1]).max() < 1e-3 * scale


def test_a_lane_that_breaks_off_stops_with_status_and_step_and_leaves_its_neighbours():
    scene, state = small_slope()
    varied, axes = mpm.run.lanes(scene, strength=jnp.broadcast_to(scene.material.strength, (3,)))
    states = mpm.run.repeat(state, 3)
    bad = replace(states, velocity=states.velocity.at[1, 0, 7].set(jnp.nan))
    whole = mpm.solve(varied, states, t_end=0.3, axes=axes)
    broken = mpm.solve(varied, bad, t_end=0.3, axes=axes)
    assert list(broken.status) == [mpm.Status.FINISHED, mpm.Status.NOT_FINITE, mpm.Status.FINISHED]
    assert int(broken.state.step[1]) == 1
    for a, b in zip(jax.tree.leaves(whole.state), jax.tree.leaves(broken.state), strict=True):
        assert np.array_equal(a[0], b[0])
        assert np.array_equal(a[2], b[2])
    with pytest.raises(FloatingPointError, match=r"lane 1: .* not finite.*step 1"):
        broken.raise_if_failed()


def test_leaving_the_grid_is_a_status():
    scene, state = mpm.block(
        (1, 1), ELASTIC, mpm.Discretisation(0.5, (0.25, 0.25)), domain=(3, 3), corner=(1, 1), velocity=(5.0, 0.0)
    )
    result = mpm.solve(scene, state, t_end=2.0)
    assert result.status == mpm.Status.OUTSIDE_GRID
    # The block's front, at 2 m, reaches the last node but one (3.5 m less one and a half cells) after 0.2 s.
    assert 0.1 < int(result.state.step) * float(scene.numerics.time_step) < 0.35
    with pytest.raises(FloatingPointError, match="left the grid"):
        result.raise_if_failed()


def test_too_fast_for_the_time_step_is_a_status():
    scene, state = mpm.block(
        (1, 1),
        ELASTIC,
        mpm.Discretisation(0.5, (0.25, 0.25)),
        domain=(400, 3),
        corner=(1, 1),
        gravity=(4e4, 0),
        speed=1.0,
    )
    assert mpm.solve(scene, state, t_end=0.1).status == mpm.Status.TIME_STEP_TOO_LARGE


def test_pic_blend_damps_and_pure_flip_does_not():
    scene, state = bar(25)
    blended, _ = bar(25, flip=0.9)
    energies = []
    for s in (scene, blended):
        final = mpm.advance(s, state, jnp.asarray(400))
        energies.append(float(diagnostics.kinetic_energy(s, final) + diagnostics.elastic_energy(s, final)))
    start = float(diagnostics.kinetic_energy(scene, state))
    assert energies[0] > 0.995 * start
    assert energies[1] < 0.98 * start


def test_linear_kernel_equals_a_hand_computed_pair_of_nodes():
    scene, _ = mpm.block(
        (0.5,), ELASTIC, mpm.Discretisation(1.0, (0.5,), kernel=mpm.Linear), domain=(4,), corner=(1.0,), velocity=(2.0,)
    )
    from jaxmpm.transfer import p2g

    nodal = p2g(scene.grid, scene.numerics.kernel, scene.particles.position, scene.particles.mass[None], None)[:, 0]
    # One particle at 1.25 m, nodes at -1, 0, 1 ... m.
    mass = float(scene.particles.mass[0])
    assert np.allclose(nodal[1:5], [0, 0.75 * mass, 0.25 * mass, 0])
