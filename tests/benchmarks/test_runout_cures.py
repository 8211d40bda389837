"""The noise of a slide: what its particles move by and the grid does not."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from benchmarks.accuracy.runout_cures import CASES, noise
from benchmarks.accuracy.runout_slides import Slide


@pytest.mark.parametrize(("along", "expected"), [([1.0, 1.0], 0.0), ([1.0, -1.0], 1.0)])
def test_noise_is_what_the_grid_does_not_resolve(along, expected):
    """A uniform velocity has none; one that alternates from particle to particle is all noise, but at the edges."""
    choices = mpm.Discretisation(1.0, (0.5, 0.5), kernel=mpm.QuadraticBSpline)
    scene, state = mpm.block(
        (20.0, 20.0),
        mpm.Soil(strength=1e4, unit_weight=2e4, tension_cutoff=0.0),
        choices,
        domain=(24.0, 24.0),
        corner=(2.0, 2.0),
    )
    column = np.rint((np.asarray(scene.particles.position[0]) - 2.25) / 0.5).astype(int)
    velocity = jnp.zeros_like(state.velocity).at[0].set(jnp.asarray(along)[column % 2])
    state = replace(state, velocity=velocity, displacement=jnp.ones_like(velocity))
    assert noise(Slide(scene, state, 0.0, 1.0, 0.5)) == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("cells", [case.cells for case in CASES.values()], ids=CASES)
def test_cells_of_a_case_are_halved(cells):
    assert all(coarse == 2 * fine for coarse, fine in pairwise(cells))
