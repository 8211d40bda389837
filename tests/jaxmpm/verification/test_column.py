"""A column settling under its own weight: displacement, stress and period against the closed form, with orders."""

from contextlib import nullcontext

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from tests.verification import order

HEIGHT, WEIGHT, POISSON = 8.0, 20e3, 0.3
SOIL = mpm.Soil(unit_weight=WEIGHT, young=1e9, poisson=POISSON)  # strains of 1e-4: geometry stays linear
STIFFNESS = 1e9 * (1 - POISSON) / ((1 + POISSON) * (1 - 2 * POISSON))
OMEGA = np.pi / (2 * HEIGHT) * np.sqrt(STIFFNESS * 9.81 / WEIGHT)
CELLS = (4, 8, 16, 32)


def column(cells, **choices):
    h = HEIGHT / cells
    return mpm.column(HEIGHT, SOIL, mpm.Discretisation(h, (h / 2,), **choices), at_rest=False)


def settlement(height):
    """Displacement (m) at rest, -w (H z - z^2 / 2) / M."""
    return -WEIGHT / STIFFNESS * (HEIGHT * height - height**2 / 2)


def settled(cells, **choices):
    """Largest errors of displacement, vertical and lateral stress after critical damping, over the largest value."""
    scene, state = column(cells, damping=2 * OMEGA, **choices)
    final = mpm.solve(scene, state, t_end=20 / OMEGA).raise_if_failed().state
    z = np.asarray(scene.particles.position[0])
    vertical = -WEIGHT * (HEIGHT - z)
    lateral = POISSON / (1 - POISSON) * vertical
    computed = final.displacement[0], *final.stress[:2]
    return [
        np.max(np.abs(np.asarray(ours) - exact)) / np.max(np.abs(scale))
        for ours, exact, scale in zip(
            computed, (settlement(z), vertical, lateral), (settlement(HEIGHT), WEIGHT * HEIGHT, lateral), strict=True
        )
    ]


def orders(cells, errors):
    return [order(1 / np.array(cells), column) for column in np.transpose(errors)]


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("scheme", list(mpm.Scheme))
@pytest.mark.parametrize("kernel", [mpm.GIMP, mpm.Linear])
def test_settlement_is_of_order_2_and_stress_constant_in_a_cell_of_order_1(kernel, scheme):
    warns = (kernel, scheme) == (mpm.Linear, mpm.Scheme.USL)
    with pytest.warns(UserWarning, match="kernel = Linear with scheme = USL") if warns else nullcontext():
        errors = [settled(n, kernel=kernel, scheme=scheme) for n in CELLS]
    displacement, vertical, lateral = orders(CELLS, errors)
    assert displacement > 1.85
    assert vertical > 0.95
    assert lateral > 0.95
    assert errors[-1][0] < 3e-4
    assert max(errors[-1][1:]) < 0.01


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("scheme", list(mpm.Scheme))
def test_quadratic_splines_settle_at_order_1_and_do_not_resolve_the_stress_at_the_wall(scheme):
    # The spline of the wall's own node reaches beyond the wall, where nothing moves.
    errors = [settled(n, kernel=mpm.QuadraticBSpline, scheme=scheme) for n in CELLS]
    displacement, vertical, _ = orders(CELLS, errors)
    assert 0.9 < displacement < 1.2
    assert vertical < 0.2


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("scheme", list(mpm.Scheme))
def test_sudden_weight_swings_about_the_settlement_in_the_period_of_the_column(scheme):
    # The modes share their period, 4 H / c, so that the whole column is back where it began, and twice as deep halfway.
    errors = []
    for cells in CELLS[1:]:
        scene, state = column(cells, scheme=scheme, cfl=0.1)
        times = np.linspace(0, 2 * np.pi / OMEGA, 65)[1:]
        snapshots = mpm.solve(scene, state, t_end=times[-1], snapshots=times).raise_if_failed().snapshots
        # Velocity is advanced first, so that positions of step n are those of half a step later.
        reached = (np.array([int(s.step) for s in snapshots]) + 0.5) * float(scene.numerics.time_step)
        mean = np.array([float(jnp.mean(s.displacement[0])) for s in snapshots])
        # The mean follows from the momentum: free fall less the force at the base, a triangle wave in time.
        odd = np.arange(1, 400, 2)[:, None]
        exact = np.sum(32 / (np.pi * odd) ** 4 * 3 * (1 - np.cos(odd * OMEGA * reached)), axis=0)
        errors.append(np.max(np.abs(mean / (settlement(HEIGHT) * 2 / 3) - exact)))
    assert order(1 / np.array(CELLS[1:]), errors) > 1.8
    assert errors[-1] < 2e-3
