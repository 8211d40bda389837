"""One cell of particles taken along uniaxial, simple shear and triaxial paths by whole steps: stress in closed form.

Affine transfers carry a linear velocity field to the nodes without error, whatever the body's edges are, and the
scheme that updates the stress first strains particles before forces change that field.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from tests.verification import order

# So soft, in Pa, that its own forces do not move it within the second of a path.
YOUNG, POISSON, STRENGTH, SOFTENING, RATIO = 1e-3, 0.3, 3e-5, 1e-4, 0.5
SHEAR = YOUNG / (2 * (1 + POISSON))
LAME = 2 * SHEAR * POISSON / (1 - 2 * POISSON)
ELASTIC = mpm.Soil(young=YOUNG, poisson=POISSON, unusual=True)
CLAY = replace(ELASTIC, strength=STRENGTH, softening_modulus=SOFTENING, residual_ratio=RATIO, tension_cutoff=None)


@jax.jit
def led(scene, state, rate, steps):
    """The state after one second in which the particles move by a velocity gradient about the middle of their cell."""

    def one(_, state):
        x = scene.particles.position + state.displacement - 4.5
        field = jnp.broadcast_to(rate[..., None], (*rate.shape, x.shape[1]))
        return mpm.step(scene, replace(state, velocity=rate @ x, affine=field), 1 / steps)

    return jax.lax.fori_loop(0, steps, one, state)


def after(soil, gradient, steps):
    """Stress (s, N) and history after one second at a constant velocity gradient (1/s)."""
    d = len(gradient)
    scene, state = mpm.block(
        (1.0,) * d,
        soil,
        mpm.Discretisation(
            1.0, (0.5,) * d, kernel=mpm.QuadraticBSpline, scheme=mpm.Scheme.USF, apic=True, flip=0.0, dtype="float64"
        ),
        domain=(9.0,) * d,
        corner=(4.0,) * d,
        speed=1.0,
    )
    state = led(scene, state, jnp.asarray(gradient), steps)
    volume = np.trace(gradient)
    np.testing.assert_allclose(state.volume_ratio, np.exp(volume), rtol=volume**2 / steps + 1e-9)
    return np.asarray(state.stress), state.history


@pytest.mark.parametrize("strain", [-0.2, 0.1])
def test_uniaxial_strain_has_the_stress_of_the_logarithmic_strain(x64, strain):
    stress, _ = after(ELASTIC, [[0.0, 0.0], [0.0, strain]], 50)
    expected = np.array([LAME, LAME, LAME + 2 * SHEAR, 0.0]) * strain
    np.testing.assert_allclose(stress, expected[:, None] + 0 * stress, rtol=1e-9, atol=1e-9 * SHEAR)


def test_simple_shear_has_the_sines_of_the_jaumann_rate(x64):
    angle, counts = 1.0, np.array([50, 100, 200])
    expected = SHEAR * np.array([1 - np.cos(angle), 0.0, np.cos(angle) - 1, np.sin(angle)])
    errors = [np.max(np.abs(after(ELASTIC, [[0.0, angle], [0.0, 0.0]], n)[0] - expected[:, None])) for n in counts]
    assert order(1 / counts, errors) > 0.95
    assert errors[-1] < 0.01 * SHEAR


@pytest.mark.parametrize("shortening", [0.02, 0.1, 0.4])
def test_triaxial_compression_yields_softens_and_ends_at_the_residual_strength(x64, shortening):
    # Volume stays: the shear strain is root 3 of the shortening, the difference of the stresses root 3 of the strength.
    gradient = np.diag([shortening / 2, shortening / 2, -shortening])
    stress, g = after(CLAY, gradient.tolist(), 50)
    drive = np.sqrt(3) * shortening
    plastic = max((SHEAR * drive - STRENGTH) / (SHEAR - SOFTENING), 0.0)
    strength = STRENGTH - SOFTENING * plastic
    if strength < RATIO * STRENGTH:
        strength, plastic = RATIO * STRENGTH, drive - RATIO * STRENGTH / SHEAR
    shear = SHEAR * drive if plastic == 0 else strength
    np.testing.assert_allclose(stress[0] - stress[2], np.sqrt(3) * shear, rtol=1e-9)
    np.testing.assert_allclose(stress[:3].sum(axis=0), 0, atol=1e-9 * SHEAR)
    np.testing.assert_allclose(g, plastic, rtol=1e-9, atol=1e-12)
