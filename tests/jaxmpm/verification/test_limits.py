"""Collapse loads against limit analysis, and the cures: F-bar against locking, averaged strain against the mesh."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm

# A vertical cut of height H in clay of unit weight w stands while w H / S_u < 3.776 (lower bound of Martin (2011),
# 3.7764 to 3.7776), which is a factor of safety of 1 for this strength.
HEIGHT, WEIGHT = 4.0, 20e3
CUT = mpm.Slope(crest=8.0, height=HEIGHT, run_per_rise=0.0, toe=8.0, foundation=2.0)
STRENGTH = WEIGHT * HEIGHT / 3.777


def cut_factor(cell, *, fbar, poisson=0.3):
    soil = mpm.Soil(unit_weight=WEIGHT, young=2e7, poisson=poisson, strength=STRENGTH, tension_cutoff=None)
    scene, state = mpm.slope(CUT, soil, mpm.Discretisation(cell, (cell / 2,) * 2, fbar=fbar))
    result = mpm.factor_of_safety(
        scene, state, failure_displacement=0.1, bracket=(0.5, 2.5), resolution=0.02, t_end=3.0, batch=4
    )
    return result.fails


@pytest.mark.slow
def test_vertical_cut_with_fbar_stands_as_limit_analysis_says_and_locks_without():
    plain, cured = (cut_factor(0.5, fbar=fbar) for fbar in (False, True))
    assert abs(cured - 1) < 0.1
    assert plain > cured + 0.04


@pytest.mark.slow
def test_vertical_cut_comes_to_limit_analysis_with_refinement():
    coarse, fine = (cut_factor(cell, fbar=True) for cell in (0.5, 0.25))
    assert abs(fine - 1) < 0.05
    assert abs(fine - 1) <= abs(coarse - 1)


@pytest.mark.slow
def test_locking_near_incompressibility_is_what_fbar_cures():
    plain, cured = (cut_factor(0.5, fbar=fbar, poisson=0.49) for fbar in (False, True))
    assert plain > 1.4
    assert cured < 1.25


def softened_band(cell, **choices):
    """Largest plastic shear strain of a slope that has begun to slide, and its sum over the section (m2)."""
    shape = mpm.Slope(crest=8.0, height=4.0, run_per_rise=1.0, toe=8.0, foundation=2.0)
    soil = mpm.Soil(young=1e7, strength=14e3, softening_modulus=60e3, tension_cutoff=None)
    scene, state = mpm.slope(shape, soil, mpm.Discretisation(cell, (cell / 2,) * 2, **choices))
    final = mpm.solve(mpm.reduced(scene, 1.2), state, t_end=0.6).raise_if_failed().state
    return float(jnp.max(final.history)), float(jnp.sum(scene.particles.volume * final.history))


@pytest.mark.slow
def test_averaged_plastic_strain_peaks_less_and_its_sum_stays():
    local, total = softened_band(0.5)
    averaged, averaged_total = softened_band(0.5, internal_length=1.0)
    assert averaged < 0.8 * local
    assert 0.3 < averaged_total / total < 1.5


def test_average_over_neighbours_keeps_a_constant_and_widens_a_spike_to_its_length():
    from jaxmpm.equations import Maps

    length, cell = 2.0, 0.5
    soil = mpm.Soil(strength=1e4, softening_modulus=1e4, tension_cutoff=0.0)
    numerics = mpm.Discretisation(cell, (cell / 2,), internal_length=length)
    scene, _ = mpm.block((40.0,), soil, numerics, domain=(40.0,), corner=(0.0,))
    x = scene.particles.position

    def average(values):
        return np.asarray(Maps(scene, x).average(values, scene.numerics.nonlocal_passes))

    assert np.allclose(average(jnp.ones_like(x[0])), 1, atol=1e-5)
    spike = average(jnp.zeros_like(x[0]).at[80].set(1.0))
    centre = float(x[0, 80])
    deviation = np.sqrt(np.sum(spike * (np.asarray(x[0]) - centre) ** 2) / np.sum(spike))
    assert np.isclose(np.sum(spike), 1, rtol=1e-3)
    assert np.isclose(deviation, length, rtol=0.05)


@pytest.mark.parametrize("scheme", mpm.Scheme)
def test_the_next_step_adds_the_average_of_the_plastic_strain(scheme, x64):
    from jaxmpm.equations import Maps, grid_position

    soil = mpm.Soil(young=1e7, strength=5e3, softening_modulus=60e3, tension_cutoff=None)
    numerics = mpm.Discretisation(1.0, (0.5, 0.5), internal_length=1.0, scheme=scheme, dtype="float64")
    scene, state = mpm.slope(CUT, soil, numerics)
    before = mpm.advance(scene, state, 30)
    after = mpm.advance(scene, before, 1)
    average = Maps(scene, grid_position(scene, before)).average(before.unaveraged, scene.numerics.nonlocal_passes)
    assert float(jnp.max(average)) > 1e-5
    assert np.allclose(after.history, before.history + average, rtol=1e-12, atol=1e-15)
    with pytest.raises(ValueError, match="averages the change of the history"):
        mpm.solve(scene, replace(state, unaveraged=None), t_end=1.0)


def test_softening_scaled_by_the_cell_takes_the_same_work_per_band():
    soil = mpm.Soil(strength=4e4, softening_modulus=85e3, softening_length=1.0, tension_cutoff=0.0)
    for cell, modulus in ((0.5, 42.5e3), (1.0, 85e3)):
        scene, _ = mpm.slope(CUT, soil, mpm.Discretisation(cell, (cell / 2,) * 2), at_rest=False)
        assert np.isclose(scene.material.softening.modulus, modulus)


@pytest.mark.parametrize(
    ("soil", "numerics", "message"),
    [
        ({}, {"internal_length": 0.1}, "less than cells of 0.5 m resolve"),
        ({"softening_modulus": None, "strain_95": 0.1, "softening_length": 1.0}, {"internal_length": 0.0}, "= 0 m"),
        ({"softening_modulus": None}, {"internal_length": 2.0}, "does not soften"),
        ({"strain_95": 0.1}, {}, "both softening_modulus and strain_95"),
        ({"softening_modulus": None, "strain_95": 1e-3}, {}, "snaps back"),
        ({"rate_coefficient": -0.1}, {}, "rate_coefficient = -0.1"),
        ({}, {"apic": True}, "give kernel = QuadraticBSpline and flip = 0"),
    ],
)
def test_bad_cures_are_refused(soil, numerics, message):
    clay = mpm.Soil(**({"strength": 4e4, "softening_modulus": 85e3} | soil))
    with pytest.raises(ValueError, match=message):
        mpm.slope(CUT, clay, mpm.Discretisation(0.5, (0.25,) * 2, **numerics))


@pytest.mark.parametrize(
    ("soil", "message"),
    [
        ({"friction": 70.0}, "friction = 70"),
        ({"dilation": 40.0}, "dilation = 40"),
        ({"cohesion": 0.0, "friction": 0.0}, "give at least one"),
        ({"softening_strain": 0.1, "residual_cohesion": 2e4}, "residual_cohesion = 20000"),
        ({"residual_friction": 8.0}, "residual_friction has no effect without softening_strain"),
        ({"law": mpm.laws.J2}, "give MohrCoulomb or DruckerPrager"),
    ],
)
def test_bad_frictional_soils_are_refused(soil, message):
    with pytest.raises(ValueError, match=message):
        mpm.column(
            4.0,
            mpm.FrictionalSoil(**({"cohesion": 1e4, "friction": 30.0} | soil)),
            mpm.Discretisation(0.5, (0.25, 0.25)),
        )


def test_fbar_is_refused_where_strength_depends_on_the_mean_stress():
    with pytest.raises(ValueError, match="fbar = True with a frictional soil"):
        mpm.slope(CUT, mpm.FrictionalSoil(cohesion=1e3, friction=30.0), mpm.Discretisation(0.5, (0.25,) * 2, fbar=True))


@pytest.mark.parametrize(
    "criterion", [pytest.param(mpm.laws.MohrCoulomb, marks=pytest.mark.slow), mpm.laws.DruckerPrager]
)
def test_frictional_slope_has_the_factor_of_safety_of_its_infinite_slope_bound(criterion):
    # Without cohesion a slope of 1:2 fails at tan(phi) = 1/2 near its surface; with a little cohesion a little later.
    shape = mpm.Slope(crest=6.0, height=4.0, run_per_rise=2.0, toe=8.0, foundation=2.0)
    soil = mpm.FrictionalSoil(cohesion=1e3, friction=30.0, law=criterion, young=2e7)
    scene, state = mpm.slope(shape, soil, mpm.Discretisation(1.0, (0.5, 0.5)))
    result = mpm.factor_of_safety(
        scene, state, bracket=(0.6, 3.0), resolution=0.1, t_end=4.0, batch=4, failure_displacement=0.2
    )
    assert np.tan(np.radians(30)) / 0.5 - 0.1 < result.fails < 2.2
