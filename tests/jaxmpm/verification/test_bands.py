"""Bands of softening clay: the work that one takes follows the cell, or a length if given one.

A layer in simple shear has a closed form. It slips within one cell; from peak to residual strength the slip is what a
plastic strain of (peak - residual) / modulus makes over the band's thickness, and the work that softening takes is
(peak - residual) / 2 times that. A slope that slides shows the same in the field.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm import diagnostics
from jaxmpm.grid import Wall

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
    cells = 0.5, 0.25, 0.125

    def changes(**choices):
        bands = np.array([band(cell, **choices) for cell in cells])
        return bands[1:] / bands[:-1] - 1

    plain, averaged = changes(), changes(internal_length=1.0)
    # Half the cell: the slip of a band one cell wide makes twice the strain, and the slope goes further.
    assert np.all(np.abs(plain[:, 0] - 1) < 0.2)
    assert np.all(plain[:, 1] < -0.2)
    assert np.all(plain[:, 2] > 0)
    assert np.all(np.abs(averaged) < 0.25 * np.abs(plain))
    # Strain and displacement converge, in the first order at least: their second change is half the first or less.
    strain, displacement = np.abs(averaged[:, [0, 2]]).T
    assert strain[1] < 0.5 * strain[0]
    assert displacement[1] < 0.5 * displacement[0]


HEIGHT, LENGTH = 3.0, 0.2  # of the layer, and of its softening, m
PEAK, MODULUS, SPEED, PULL = 14e3, 1e6, 7e-3, 6.5e-3  # Pa, Pa, m/s, m
WEAKER = 0.9  # strength of the cells in which the band forms
FALL = WEAKER * PEAK / 2  # from peak to residual strength


def softening_work(cell, *, softening_length=None, **choices):
    """Work (J/m2) that softening takes in a layer sheared to residual strength, and the weaker cells' share of slip.

    The lower face is fixed and the upper one is driven by clay of great mass. All nodes keep their height, so that
    simple shear is exact whatever the layer's length. The work is what the drive loses, less what is stored and what
    the slip takes at residual strength.
    """
    soil = mpm.Soil(strength=PEAK, softening_modulus=MODULUS, tension_cutoff=None, softening_length=softening_length)
    scene, state = mpm.block(
        (cell, HEIGHT + 0.5),
        soil,
        mpm.Discretisation(cell, (cell / 2,) * 2, **choices),
        domain=(3 * cell, HEIGHT + 1.0),
        corner=(cell, 0.0),
        speed=1.0,
    )
    z = scene.particles.position[1]
    drive, weaker = z > HEIGHT, z // cell == round(HEIGHT / cell) // 2
    scene = replace(
        scene,
        particles=replace(scene.particles, mass=jnp.where(drive, 1e4, 1.0) * scene.particles.mass),
        material=replace(scene.material, strength=jnp.where(drive, 1e3, jnp.where(weaker, WEAKER, 1.0)) * PEAK),
        boundary=replace(
            scene.boundary, walls=(Wall(1, "low", 1, "fixed"), Wall(1, "low", scene.grid.shape[1] - 2, "roller"))
        ),
    )
    start = replace(state, velocity=state.velocity.at[0].set(SPEED * jnp.minimum(z / HEIGHT, 1.0)))
    end = mpm.solve(scene, start, t_end=PULL / SPEED).raise_if_failed().state
    lost = diagnostics.kinetic_energy(scene, start) - diagnostics.kinetic_energy(scene, end)
    work = float(lost - diagnostics.elastic_energy(scene, end)) / cell
    slip = scene.particles.volume * end.history / cell
    return work - FALL * float(jnp.sum(slip)), float(jnp.sum(slip * weaker) / jnp.sum(slip))


@pytest.mark.slow
def test_work_of_a_band_is_that_of_the_softening_length_whatever_the_cell(x64):
    for cell in (0.5, 0.25, 0.125):
        work, share = softening_work(cell, softening_length=LENGTH)
        assert share > 0.999
        assert abs(work / (FALL**2 * LENGTH / (2 * MODULUS)) - 1) < 0.01


@pytest.mark.slow
def test_work_of_a_band_falls_like_the_cell_without_a_length(x64):
    for cell in (0.5, 0.25, 0.125):
        work, share = softening_work(cell)
        assert share > 0.999
        assert abs(work / (FALL**2 * cell / (2 * MODULUS)) - 1) < 0.01


@pytest.mark.slow
def test_work_of_a_band_is_that_of_the_internal_length_whatever_the_cell(x64):
    # The averaged strain in the band is the slip times the peak of the bell. A whole number of filters makes a bell
    # whose variance is off by up to cell^2 / 4, and its peak by half that share of the variance.
    for cell in (0.125, 0.0625):
        bound = 0.01 + cell**2 / (8 * LENGTH**2)
        work, _ = softening_work(cell, internal_length=LENGTH)
        assert abs(work / (FALL**2 * np.sqrt(2 * np.pi) * LENGTH / (2 * MODULUS)) - 1) < bound
        # A soil that knows its own band takes that one's work, however thick the average makes it.
        work, _ = softening_work(cell, internal_length=LENGTH, softening_length=0.3)
        assert abs(work / (FALL**2 * 0.3 / (2 * MODULUS)) - 1) < bound


@pytest.mark.parametrize("cell", [2.0, 1.0, 0.5])
def test_cell_independent_choices_give_bands_the_thickness_that_the_soil_asks_for(cell):
    clay = replace(CLAY, softening_length=2.4)
    numerics = mpm.cell_independent(mpm.Discretisation(cell, (cell / 2,) * 2), clay)
    assert numerics.cell_average
    shape = mpm.Slope(crest=8.0, height=8.0, run_per_rise=1.0, toe=8.0, foundation=2.0)
    modulus = float(mpm.slope(shape, clay, numerics, at_rest=False)[0].material.softening.modulus)
    if cell > 1.5:  # too large for an average: the band is a cell thick
        assert numerics.internal_length is None
        assert np.isclose(modulus, CLAY.softening_modulus * cell / 2.4)
    else:
        assert np.isclose(numerics.internal_length * np.sqrt(2 * np.pi), 2.4)
        assert np.isclose(modulus, CLAY.softening_modulus)


def test_cell_independent_choices_leave_out_what_a_soil_cannot_have():
    numerics = mpm.Discretisation(0.5, (0.25, 0.25))
    for soil in (CLAY, replace(CLAY, softening_modulus=None, softening_length=2.4), mpm.Soil()):
        assert mpm.cell_independent(numerics, soil) == replace(numerics, cell_average=True)
        for own in (replace(numerics, fbar=True), replace(numerics, cell_average=False)):
            given = mpm.cell_independent(own, soil)
            assert (given.cell_average, given.fbar) == (False, own.fbar)
    assert not mpm.cell_independent(mpm.Discretisation(0.5, (0.25,)), CLAY).cell_average
