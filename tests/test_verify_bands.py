"""The shear band of a softening slope that slides: its width follows the cell, or the internal length if given one."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm

SHAPE = mpm.Slope(crest=8.0, height=4.0, run_per_rise=1.0, toe=8.0, foundation=2.0)
CLAY = mpm.Soil(young=1e7, strength=14e3, softening_modulus=60e3, tension_cutoff=None)


def band(cell, **choices):
    """Largest plastic shear strain, area (m2) that takes half of it, and displacement (m) of a slope that has slid."""
    scene, state = mpm.slope(SHAPE, CLAY, mpm.Discretisation(cell, (cell / 2,) * 2, fbar=True, **choices))
    final = mpm.solve(mpm.reduced(scene, 1.3), state, t_end=1.0).raise_if_failed().state
    strain = np.sort(np.asarray(final.history, float))[::-1]
    area = float(scene.particles.volume[0]) * np.count_nonzero(np.cumsum(strain) <= strain.sum() / 2)
    return np.array([strain[0], area, float(jnp.max(jnp.abs(final.displacement)))])


@pytest.mark.slow
def test_band_follows_the_cell_without_an_internal_length_and_not_with_one():
    cells = 0.5, 0.25
    plain = np.divide(*[band(cell) for cell in cells])
    averaged = np.divide(*[band(cell, internal_length=1.0) for cell in cells])
    # Half the cell: nearly twice the strain in a narrower band, and the slope goes further.
    assert plain[0] < 0.6
    assert plain[1] > 1.2
    assert np.all(np.abs(averaged - 1) < 0.1)
    assert abs(averaged[2] - 1) < 0.5 * abs(plain[2] - 1)
