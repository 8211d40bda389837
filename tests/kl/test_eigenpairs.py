"""Eigenpairs of one axis against closed forms, tabulated values, each other, and their orders of convergence."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import kl
from kl.axis import _fredholm, all_axis_modes, scaled_functions
from kl.axis._matrices import haar_matrix
from kl.axis._modes import functions
from tests import ROOT

REFERENCE = json.loads((ROOT / "tests" / "reference" / "verification.json").read_text())["kl_eigenvalues"]
SMOOTH = kl.SquaredExponential(2.0)
FAMILIES = (
    kl.SquaredExponential,
    kl.Exponential,
    kl.Matern32,
    kl.Matern52,
    kl.SecondOrderMarkov,
    kl.CosineExponential,
    kl.Triangular,
)


def axis_modes(covariance, solver, origin, extent):
    return all_axis_modes((covariance,), (solver,), (origin,), (extent,))[0]


def test_exponential_against_tabulated_values_and_scalar_roots(x64):
    modes = axis_modes(kl.Exponential(1.0), kl.axis.ClosedForm(count=12), 0.0, 1.0)
    table = REFERENCE["exponential_exp(-|t|)_on_length_1"]
    np.testing.assert_allclose(modes.fractions[:5], table["lambda"], atol=1e-6)
    np.testing.assert_allclose(modes.wavenumbers[:3], table["omega"], atol=1e-6)
    # The table's own relations, solved one root at a time.
    half, tiny = 0.5, 1e-12
    roots = []
    for k in range(6):
        roots.append(brentq(lambda w: np.cos(w * half) - w * np.sin(w * half), k * 2 * np.pi, (2 * k + 1) * np.pi))
        roots.append(
            brentq(lambda w: w * np.cos(w * half) + np.sin(w * half), (2 * k + 1) * np.pi + tiny, (2 * k + 2) * np.pi)
        )
    exact = 2 / (np.array(roots) ** 2 + 1)
    np.testing.assert_allclose(modes.fractions, exact, rtol=1e-10)


@pytest.mark.parametrize(("axis", "length", "extent"), [("x", 60.0, 96.0), ("z", 2.0, 24.0)])
def test_published_axes_by_nystrom_and_haar(axis, length, extent):
    table = REFERENCE[f"paper_axis_{axis}_squared_exponential_l_{length:.0f}_on_length_{extent:.0f}_over_L"]
    nystrom = kl.expand((kl.SquaredExponential(length),), (0.0,), (extent,), modes=4)
    haar = kl.expand((kl.SquaredExponential(length),), (0.0,), (extent,), modes=4, solver=kl.axis.Haar(9))
    np.testing.assert_allclose(nystrom.fractions, table, atol=2e-6)
    np.testing.assert_allclose(haar.fractions, table, atol=1e-4)


def test_haar_variance_by_level():
    for level, captured in REFERENCE["haar_captured_variance_z_l_2_length_24_by_level"].items():
        modes = axis_modes(SMOOTH, kl.axis.Haar(int(level)), 0.0, 24.0)
        assert abs(float(modes.fractions.sum()) - captured) < 6e-4


def test_haar_is_of_order_two_from_below(x64):
    exact = axis_modes(SMOOTH, kl.axis.Nystrom(80), 0.0, 24.0).fractions[:6]
    errors = jnp.stack(
        [exact - axis_modes(SMOOTH, kl.axis.Haar(level), 0.0, 24.0).fractions[:6] for level in (6, 7, 8)]
    )
    assert (errors > 0).all()
    np.testing.assert_allclose(jnp.log2(errors[:-1] / errors[1:]), 2, atol=0.05)


def test_nystrom_converges_faster_than_any_power(x64):
    exact = axis_modes(SMOOTH, kl.axis.Nystrom(100), 0.0, 24.0).fractions[:10]
    orders = (24, 32, 40, 48)
    errors = [
        float(jnp.abs(axis_modes(SMOOTH, kl.axis.Nystrom(n), 0.0, 24.0).fractions[:10] - exact).max()) for n in orders
    ]
    slopes = -np.diff(np.log(errors)) / np.diff(np.log(orders))
    assert slopes[0] > 8
    assert errors[-1] < 1e-8


OFTEN = (kl.Exponential, kl.SquaredExponential)
"""The least smooth and the smoothest run with every change, the others with the slow tests."""


@pytest.mark.parametrize(
    "family", [pytest.param(each, marks=[] if each in OFTEN else pytest.mark.slow) for each in FAMILIES]
)
def test_solvers_agree_and_chosen_order_holds_its_tolerance(x64, family):
    covariance, extent = family(3.0), 3.0
    best = kl.expand((covariance,), (0.0,), (extent,), modes=6)
    fine = axis_modes(covariance, kl.axis.Haar(10), 0.0, extent)
    np.testing.assert_allclose(best.fractions, fine.fractions[:6], atol=3e-6)
    x = jnp.linspace(0.01, extent - 0.01, 41)
    # Same signs too, so that coefficients mean the same whatever the solver.
    np.testing.assert_allclose(scaled_functions(best.axes[0], x), scaled_functions(fine, x)[:6], atol=6e-3)


@pytest.mark.parametrize("family", [kl.Matern32, kl.SecondOrderMarkov, kl.Matern52, kl.CosineExponential])
def test_split_galerkin_is_spectral_where_the_kernel_has_a_kink(x64, family):
    exact = axis_modes(family(4.0), kl.axis.Legendre(60), 0.0, 12.0).fractions[:4]
    split = axis_modes(family(4.0), kl.axis.Legendre(28), 0.0, 12.0).fractions[:4]
    np.testing.assert_allclose(split, exact, atol=1e-10)


def test_split_galerkin_against_the_exponential_closed_form(x64):
    exact = axis_modes(kl.Exponential(1.0), kl.axis.ClosedForm(count=8), 0.0, 1.0)
    split = axis_modes(kl.Exponential(1.0), kl.axis.Legendre(40), 0.0, 1.0)
    np.testing.assert_allclose(split.fractions[:8], exact.fractions, rtol=1e-10)


def test_triangular_closed_form_solves_its_equation(x64):
    modes = axis_modes(kl.Triangular(5.0), kl.axis.ClosedForm(count=6), 1.0, 4.0)
    split = axis_modes(kl.Triangular(5.0), kl.axis.Legendre(40), 1.0, 4.0)
    np.testing.assert_allclose(split.fractions[:6], modes.fractions, rtol=1e-10)
    x = jnp.linspace(1.0, 5.0, 17)
    np.testing.assert_allclose(functions(split, x)[:6], functions(modes, x), atol=1e-7)


@pytest.mark.parametrize("solver", [kl.axis.Nystrom(50), kl.axis.Legendre(40), kl.axis.Haar(6)])
def test_eigenfunctions_are_orthonormal(x64, solver):
    modes = axis_modes(SMOOTH, solver, -3.0, 12.0)
    points, weights = np.polynomial.legendre.leggauss(12)
    cells = np.linspace(-3.0, 9.0, 65)
    x = (cells[:-1, None] + np.diff(cells)[:, None] * (points + 1) / 2).ravel()
    weight = np.tile(weights / 2 / 64, 64)
    values = functions(modes, jnp.asarray(x))[:12]
    np.testing.assert_allclose((values * weight) @ values.T, np.eye(12), atol=1e-10)


def test_haar_transform_is_orthogonal_and_keeps_eigenvalues(x64):
    wavelets = kl.axis.haar_transform(jnp.eye(32)).T
    np.testing.assert_allclose(wavelets @ wavelets.T, np.eye(32), atol=1e-12)
    matrix = haar_matrix(5, 24.0, SMOOTH)
    in_wavelets = wavelets @ matrix @ wavelets.T
    np.testing.assert_allclose(jnp.linalg.eigvalsh(in_wavelets), jnp.linalg.eigvalsh(matrix), atol=1e-12)


@pytest.mark.parametrize("family", FAMILIES)
def test_spectral_density_and_scale_of_fluctuation_are_integrals_of_the_correlation(family):
    covariance = family(1.5)
    points, weights = np.polynomial.legendre.leggauss(20)
    panels = np.arange(0.0, 60.0, 0.5)
    lag = (panels[:, None] + (points + 1) / 4).ravel()
    weight = np.tile(weights / 4, len(panels))
    for wavenumber in (0.0, 0.7, 3.0):
        integral = 2 * np.sum(weight * covariance(lag) * np.cos(wavenumber * lag))
        np.testing.assert_allclose(covariance.spectral_density(np.float64(wavenumber)), integral, rtol=1e-6)
    np.testing.assert_allclose(kl.axis.scale_of_fluctuation(covariance), covariance.spectral_density(np.float64(0)))
    assert kl.axis.from_scale_of_fluctuation(family, 2.0).length * family.fluctuation == pytest.approx(2.0)


@pytest.mark.parametrize("family", [kl.SquaredExponential, kl.Exponential, kl.CosineExponential])
def test_periodic_axis_has_its_own_correlation(x64, family):
    period = 10.0
    wrapped = kl.axis.Periodic(family(2.0), period)
    modes = axis_modes(wrapped, kl.axis.ClosedForm(count=4001), 0.0, period)
    x = jnp.linspace(0.0, period, 21)
    values = scaled_functions(modes, x)
    np.testing.assert_allclose(values.T @ values, wrapped(x[:, None] - x), atol=2e-3)
    assert float(wrapped(jnp.array(0.3))) == pytest.approx(float(wrapped(jnp.array(period - 0.3))), abs=1e-9)


@pytest.mark.parametrize("energy", [0.9, 0.99])
def test_a_periodic_axis_takes_the_fewest_waves_that_hold_the_energy(energy):
    wrapped = kl.axis.Periodic(kl.SquaredExponential(2.0), 10.0)
    fractions = np.asarray(kl.expand((wrapped,), (0.0,), (10.0,), energy=energy).fractions)
    # Each wave has a sine and a cosine of its spectral density over the period.
    waves = 2 * np.pi * np.array([0, *np.repeat(np.arange(1, 20), 2)]) / 10.0
    exact = np.asarray(wrapped.spectral_density(waves)) / 10.0
    np.testing.assert_allclose(fractions, exact[: fractions.size], rtol=1e-4)
    assert fractions.sum() >= energy > exact[: fractions.size - 2].sum()


def test_infinite_length_is_constant_along_its_axis():
    expansion = kl.expand((SMOOTH, kl.Infinite()), (0.0, 0.0), (8.0, 5.0))
    field = kl.field_on_lattice(expansion, jnp.ones(expansion.modes), (jnp.linspace(0, 8, 5), jnp.linspace(0, 5, 4)))
    assert float(jnp.ptp(field, axis=1).max()) == 0
    assert expansion.variance_mean == pytest.approx(0.999, abs=1e-3)


@pytest.mark.parametrize("length", [1.0, 1e5])
def test_derivatives_are_finite_where_eigenvalues_repeat(x64, length):
    # A length far below the cells makes the matrix a multiple of the identity, or nothing at all.
    def field(length):
        modes = axis_modes(kl.SquaredExponential(length), kl.axis.Haar(3), 0.0, 1e7)
        return scaled_functions(modes, jnp.array([3e6])).sum() + modes.fractions.sum()

    assert jnp.isfinite(jax.grad(field)(length))


def test_closed_form_derivative_by_length(x64):
    def value(length):
        modes = axis_modes(kl.Exponential(length), kl.axis.ClosedForm(count=5), 0.0, 2.0)
        return scaled_functions(modes, jnp.array([0.3, 1.7])).sum() + (modes.fractions**2).sum()

    numerical = (value(1.0 + 1e-5) - value(1.0 - 1e-5)) / 2e-5
    np.testing.assert_allclose(jax.grad(value)(1.0), numerical, rtol=1e-8)


def test_one_program_serves_boxes_of_any_position_and_size():
    def compiled(origin, extent):
        modes = axis_modes(kl.SquaredExponential(extent / 4), kl.axis.Nystrom(23), origin, extent)
        return modes, _fredholm._all_from_zero._cache_size()

    one, before = compiled(0.0, 8.0)
    other, after = compiled(-3.0, 24.0)
    assert after == before
    assert (other.origin, other.extent) == (-3.0, 24.0)
    # Stationary: the spectrum depends on the length over the extent alone.
    np.testing.assert_allclose(other.fractions, one.fractions, atol=2e-7)
