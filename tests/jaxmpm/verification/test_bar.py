"""The axial bar over several periods: how late it swings and what energy it loses, per scheme and kernel."""

from contextlib import nullcontext

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm import diagnostics
from tests.verification import order

LENGTH, YOUNG, DENSITY = 25.0, 1e6, 1e3
SOIL = mpm.Soil(unit_weight=9.81 * DENSITY, young=YOUNG, poisson=0.0)
WAVE = np.pi / (2 * LENGTH)
OMEGA = WAVE * np.sqrt(YOUNG / DENSITY)
CELLS, PERIODS, SAMPLES, CFL = (8, 16, 32), 5, 16, 0.2


def lag_and_loss(cells, *, particles=2, **choices):
    """How late the bar is after a period, over the period, and the share of energy that it loses in one.

    Both between the first period and that PERIODS later. Energies are means over a period: velocity and displacement
    are half a step apart, by which the energy of an instant swings.
    """
    h = LENGTH / cells
    scene, state = mpm.bar(
        LENGTH, SOIL, mpm.Discretisation(h, (h / particles,), **({"cfl": CFL} | choices)), velocity=1e-3
    )
    first = np.arange(1, SAMPLES + 1) / SAMPLES
    times = 2 * np.pi / OMEGA * np.concatenate([first, PERIODS + first])
    snapshots = mpm.solve(scene, state, t_end=times[-1], snapshots=times).raise_if_failed().snapshots
    mode = jnp.sin(WAVE * scene.particles.position[0])

    def phase(s):
        turned = np.arctan2(OMEGA * float(mode @ s.displacement[0]), float(mode @ s.velocity[0]))
        return turned - OMEGA * int(s.step) * float(scene.numerics.time_step)

    late = phase(snapshots[SAMPLES - 1]) - phase(snapshots[-1])
    energy = [float(diagnostics.kinetic_energy(scene, s) + diagnostics.elastic_energy(scene, s)) for s in snapshots]
    remaining = sum(energy[SAMPLES:]) / sum(energy[:SAMPLES])
    return (late / (2 * np.pi) - PERIODS) / PERIODS, 1 - remaining ** (1 / PERIODS)


def measured(**choices):
    lags, losses = np.transpose([lag_and_loss(n, **choices) for n in CELLS])
    return lags, losses, order(1 / np.array(CELLS), np.abs(lags)), order(1 / np.array(CELLS), np.abs(losses))


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("scheme", [mpm.Scheme.MUSL, mpm.Scheme.USF])
@pytest.mark.parametrize("kernel", [mpm.GIMP, mpm.Linear])
def test_dispersion_is_of_order_2_and_nothing_is_dissipated(kernel, scheme):
    lags, losses, order_of_lag, order_of_loss = measured(kernel=kernel, scheme=scheme)
    assert 1.95 < order_of_lag < 2.05
    assert np.all(lags > 0)
    assert lags[-1] < 4e-4
    assert np.all(np.abs(losses) < 1e-5)
    assert order_of_loss > 4


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("kernel", [mpm.GIMP, mpm.Linear])
def test_updating_the_stress_last_dissipates_at_order_3(kernel):
    with (
        pytest.warns(UserWarning, match="kernel = Linear with scheme = USL") if kernel is mpm.Linear else nullcontext()
    ):
        _, losses, order_of_lag, order_of_loss = measured(kernel=kernel, scheme=mpm.Scheme.USL)
    assert 1.95 < order_of_lag < 2.05
    assert 2.8 < order_of_loss < 3.3
    assert 1e-3 < losses[0] < 5e-3
    assert np.all(losses > 50 * np.abs(measured(kernel=kernel, scheme=mpm.Scheme.MUSL)[1]))


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("scheme", list(mpm.Scheme))
def test_dispersion_of_quadratic_splines_is_of_order_1(scheme):
    # At the wall itself the first free node's spline has not come to nothing: the bar acts as longer by a share of
    # the cell, and swings later.
    lags, losses, order_of_lag, order_of_loss = measured(kernel=mpm.QuadraticBSpline, scheme=scheme)
    assert 0.95 < order_of_lag < 1.2
    assert np.all(lags > 0)
    assert order_of_loss > 1.5
    assert np.all(np.abs(losses) < (5e-3 if scheme is mpm.Scheme.USL else 2e-4))


def spread(particles):
    """Half the variance, in cells, of going from nodes to particles and back with hats: the mean of x (1 - x)."""
    x = (np.arange(particles) + 0.5) / particles
    return np.mean(x * (1 - x))


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("particles", "cfl"), [(1, 0.2), (2, 0.2), (2, 0.4), (4, 0.4)])
def test_lag_of_hat_functions_is_that_of_its_three_parts(particles, cfl):
    # (k h)^2 times 1/24 for forces by lumped finite elements, half the spread for accelerations that go to particles
    # and back, less C^2/24 for the central difference in time.
    lag, _ = lag_and_loss(32, kernel=mpm.Linear, particles=particles, cfl=cfl)
    expected = (WAVE * LENGTH / 32) ** 2 * (1 / 24 + spread(particles) / 2 - cfl**2 / 24)
    assert np.isclose(lag, expected, rtol=5e-3)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("pic", [0.01, 0.05])
def test_share_of_pic_dissipates_at_order_1_what_its_averaging_takes(pic):
    # A step takes pic (k h)^2 spread off the velocity, which holds half the energy; a period has 4 n / C steps.
    _, losses, _, order_of_loss = measured(kernel=mpm.Linear, flip=1 - pic)
    cells = np.array(CELLS)
    expected = 1 - np.exp(-pic * (WAVE * LENGTH / cells) ** 2 * spread(2) * 4 * cells / CFL)
    assert 0.9 < order_of_loss < 1.1
    assert np.isclose(losses[-1], expected[-1], rtol=0.02)
