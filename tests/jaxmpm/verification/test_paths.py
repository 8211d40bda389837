"""J2 with softening along uniaxial and triaxial paths on a single point: stress and plastic strain in closed form.

Simple shear stands in `test_materials`, the same paths of the frictional laws in `test_materials_frictional`.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm

K, G, PEAK, SLOPE, RATIO, CELL_PRESSURE = 8e6, 3e6, 40e3, 85e3, 0.5, 50e3


def clay():
    soft = mpm.laws.Softening(jnp.asarray(SLOPE), jnp.asarray(RATIO))
    return mpm.laws.J2(jnp.asarray(K), jnp.asarray(G), jnp.asarray(PEAK), soft)


def uniform(value):
    """A stress of equal normal components (Pa)."""
    return (jnp.asarray(value),) * 3 + (jnp.zeros(()),) * 3


def uniaxial(axial, steps):
    """Stress and plastic shear strain after the axial strain, without lateral strain."""
    increment = (0.0, 0.0, axial / steps, 0.0, 0.0, 0.0)
    start = uniform(0.0), jnp.zeros(())
    return jax.lax.scan(lambda carry, _: (clay().update(increment, *carry), None), start, None, steps)[0]


def triaxial(axial, steps):
    """The same under a constant lateral stress, the lateral strain by Newton's method in every step."""

    def one(carry, _):
        def updated(lateral):
            return clay().update((lateral, lateral, axial / steps, 0.0, 0.0, 0.0), *carry)

        def newton(_, lateral):
            value, slope = jax.jvp(lambda e: updated(e)[0][0], (lateral,), (jnp.ones(()),))
            return lateral - (value + CELL_PRESSURE) / slope

        return updated(jax.lax.fori_loop(0, 12, newton, jnp.zeros(()))), None

    return jax.lax.scan(one, (uniform(-CELL_PRESSURE), jnp.zeros(())), None, steps)[0]


def softened(drive, compliance):
    """Shear stress and plastic strain where G (drive - g) = compliance t and t = max(S - H g, r S)."""
    g = max(0.0, (G * drive - compliance * PEAK) / (G - compliance * SLOPE))
    if PEAK - SLOPE * g < RATIO * PEAK:
        g = drive - compliance * RATIO * PEAK / G
    return (G * drive / compliance if g == 0 else max(PEAK - SLOPE * g, RATIO * PEAK)), g


# Elastic, softening and residual.
STRAINS = [0.005, 0.1, 0.3]
SENSES = [(-1, 60), (1, 1), (1, 60)]


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("sign", "steps"), SENSES)
@pytest.mark.parametrize("strain", STRAINS)
def test_uniaxial_strain_keeps_its_bulk_stress_and_softens_in_shear(strain, steps, sign):
    # The deviator keeps its direction: the shear strain is 2/sqrt(3) of the axial one.
    shear, g = softened(2 / np.sqrt(3) * strain, 1.0)
    stress, history = uniaxial(sign * strain, steps)
    assert np.isclose(stress[2], sign * (K * strain + 2 / np.sqrt(3) * shear), rtol=1e-10)
    assert np.allclose(stress[:2], sign * (K * strain - shear / np.sqrt(3)), rtol=1e-10)
    assert np.isclose(history, g, rtol=1e-9, atol=1e-15)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("sign", "steps"), SENSES)
@pytest.mark.parametrize("strain", STRAINS)
def test_triaxial_deviator_is_root_3_times_the_softened_strength(strain, steps, sign):
    # The mean stress follows by t/sqrt(3), elastically; what volume that takes is missing from the shear strain.
    shear, g = softened(np.sqrt(3) * strain, 1 + G / (3 * K))
    stress, history = triaxial(sign * strain, steps)
    assert np.allclose(stress[:2], -CELL_PRESSURE, rtol=1e-9)
    assert np.isclose(stress[2], -CELL_PRESSURE + sign * np.sqrt(3) * shear, rtol=1e-9)
    assert np.isclose(history, g, rtol=1e-8, atol=1e-15)
