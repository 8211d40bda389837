"""Bad input to the fields: each raises a ValueError that names the value and the remedy, or warns."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import kl

BOX = ((0.0, 0.0), (10.0, 5.0))
SE = kl.SquaredExponential
GAUSSIAN = jnp.zeros(3)
NAN = float("nan")


@pytest.fixture(scope="module")
def expansion():
    return kl.expand((SE(10.0), SE(2.0)), *BOX)


def field_points(*columns):
    return jnp.array(columns).T


@pytest.mark.parametrize(
    ("covariance", "options", "message"),
    [
        ((SE(0.0), SE(2.0)), {}, r"correlation length = 0 m: give a finite value above 0; .*Infinite"),
        ((SE(float("nan")), SE(2.0)), {}, r"correlation length = nan"),
        ((SE(jnp.ones(2)), SE(2.0)), {}, r"shape \(2,\): give one number"),
        ((SE(1.0),), {}, r"one number for each of 1 axes"),
        ((SE(1.0),) * 4, {}, r"4 axes: give a covariance for each of 1 to 3"),
        ((SE(10.0), SE(2.0)), {"energy": 0.0}, r"energy = 0.0 is outside \(0, 1\]"),
        ((SE(10.0), SE(2.0)), {"energy": 0.9, "modes": 3}, r"energy = 0.9 and modes = 3: give one"),
        ((SE(10.0), SE(2.0)), {"modes": 0}, r"modes = 0 must be 1 or more"),
        ((SE(10.0), SE(2.0)), {"modes": 99, "solver": kl.axis.Haar(2)}, r"modes = 99 exceeds 16, .* give: raise"),
        (
            (SE(10.0), SE(2.0)),
            {"energy": 0.9999, "solver": kl.axis.Haar(2)},
            r"energy = 0.9999 cannot be reached.*level",
        ),
        ((SE(10.0), SE(2.0)), {"solver": kl.axis.Haar(13)}, r"level = 13 must be 0 to 12"),
        ((SE(10.0), SE(2.0)), {"solver": kl.axis.Nystrom(0)}, r"order = 0 must be 1 to 2000"),
        ((SE(10.0), SE(2.0)), {"solver": kl.axis.ClosedForm()}, r"no closed form for SquaredExponential: use Nystrom"),
        ((SE(10.0), SE(2.0)), {"solver": "nystrom"}, r"solver = 'nystrom' is none of"),
        ((SE(10.0), SE(2.0)), {"solver": (kl.axis.Haar(3),)}, r"1 solvers for 2 axes"),
        ((SE(10.0), SE(2.0)), {"dtype": jnp.float64}, r"float64, but JAX runs in float32"),
        ((SE(10.0), SE(2.0)), {"dtype": jnp.int32}, r"dtype = int32: give float32 or float64"),
        ((kl.Triangular(3.0), SE(2.0)), {"solver": (kl.axis.ClosedForm(), None)}, r"3.0 is below the extent 10.0"),
        ((kl.axis.Periodic(SE(2.0), 9.0), SE(2.0)), {}, r"period = 9.0 must be the extent of its axis, 10.0"),
        ((kl.axis.Periodic(SE(300.0), 10.0), SE(2.0)), {}, r"exceeds 20 periods: use `Infinite"),
        ((kl.axis.Periodic(SE(2.0), 10.0), SE(2.0)), {"solver": kl.axis.Haar(4)}, r"Haar cannot take a Periodic axis"),
        ((SE(1e-3), SE(2.0)), {}, r"correlation length 0.001 m on an axis of \S+ m: give a length of 0.0\d+ m or more"),
        ((SE(10.0), SE(2.0)), {"bedding": kl.Bedding(100.0)}, r"dip = 100.0 degrees is outside \[0, 90\]"),
        ((SE(10.0), SE(2.0)), {"bedding": kl.Bedding(10.0, strike=30.0)}, r"strike = 30.0: in two dimensions"),
    ],
)
def test_expand_refuses(covariance, options, message):
    with pytest.raises(ValueError, match=message):
        kl.expand(covariance, *BOX, **options)


@pytest.mark.parametrize("extent", [(0.0, 5.0), (-1.0, 5.0), (float("inf"), 5.0)])
def test_expand_refuses_empty_boxes(extent):
    with pytest.raises(ValueError, match=r"extent = .* m: give a finite value above 0"):
        kl.expand((SE(10.0), SE(2.0)), (0.0, 0.0), extent)


def test_expand_refuses_traced_lengths_and_names_the_way():
    with pytest.raises(ValueError, match="with_covariance"):
        jax.grad(lambda length: kl.expand((SE(length),), (0.0,), (1.0,)).fractions.sum())(1.0)


def test_expand_refuses_what_is_not_positive_definite():
    hat = kl.axis.Corrected(kl.Triangular(4.0), jnp.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
    with pytest.raises(ValueError, match=r"not positive definite \(negative eigenvalues"):
        kl.expand((hat,), (0.0,), (10.0,), solver=kl.axis.Nystrom(40))


def test_fields_refuse_points_outside_and_wrong_shapes(expansion):
    ones = jnp.ones(expansion.modes)
    with pytest.raises(ValueError, match=r"reach from 1.0 to 10.5 along axis 0.*box that holds all points"):
        kl.field_at(expansion, ones, field_points((1.0, 1.0), (10.5, 1.0)))
    with pytest.raises(ValueError, match=r"points of shape \(3, 2\): give \(2, N\)"):
        kl.field_at(expansion, ones, jnp.ones((3, 2)))
    with pytest.raises(ValueError, match="one for each mode"):
        kl.field_at(expansion, ones[:-1], field_points((1.0, 1.0)))
    with pytest.raises(ValueError, match="1 axes for an expansion of 2"):
        kl.field_on_lattice(expansion, ones, (jnp.ones(3),))
    with pytest.raises(ValueError, match=r"along axis 1"):
        kl.field_on_lattice(expansion, ones, (jnp.ones(3), jnp.array([4.0, 6.0])))
    with pytest.raises(ValueError, match=r"out has shape \(2,\)"):
        kl.field_on_lattice(expansion, ones, (jnp.ones(3), jnp.ones(2)), out=jnp.ones(2))
    inclined = kl.expand((SE(10.0), SE(2.0)), *BOX, bedding=kl.Bedding(10.0))
    with pytest.raises(ValueError, match="use `field_at`"):
        kl.field_on_lattice(inclined, jnp.ones(inclined.modes), (jnp.ones(3), jnp.ones(2)))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda e, c: kl.field_at(e, c, jnp.zeros((2, 0))), r"no points along axis 0: give at least one"),
        (lambda e, c: kl.field_at(e, c, jnp.array([[NAN], [1.0]])), r"points along axis 0 = .*give a finite value"),
        (lambda e, c: kl.field_at(e, c.at[0].set(NAN), jnp.ones((2, 1))), r"coefficients = nan at .*bad at 1 of 14"),
        (lambda e, c: kl.field_on_lattice(e, c, (jnp.ones(3), jnp.ones((2, 2)))), r"shape \(2, 2\) along axis 1"),
        (lambda e, c: kl.field_on_lattice(e, c, (jnp.ones(3), jnp.zeros(0))), r"no points along axis 1"),
        (
            lambda e, c: kl.field.variance_on_lattice(e, (jnp.ones(3), jnp.array([6.0]))),
            r"from 6.0 to 6.0 along axis 1",
        ),
        (lambda e, c: kl.field.variance_on_lattice(e, (jnp.ones(3),)), r"1 axes for an expansion of 2"),
        (lambda e, c: kl.field.variance_at(e, jnp.zeros((2, 0))), r"no points"),
        (lambda e, c: kl.field.rescaled(jnp.ones((2, 3)), jnp.ones(2)), r"variance of shape \(2,\) for a field"),
        (lambda e, c: kl.field.rescaled(jnp.ones(3), jnp.zeros(3)), r"captured variance = .*above 0; keep more modes"),
        (lambda e, c: kl.field.with_residual(jnp.ones(3), -jnp.ones(3), jax.random.key(0)), r"of 0 or more"),
        (lambda e, c: kl.with_covariance(e, (SE(1.0),)), r"of \['SquaredExponential'\] for an expansion"),
        (lambda e, c: kl.with_covariance(e, (SE(1.0), kl.Matern32(1.0))), r"give the same families"),
        (lambda e, c: kl.with_covariance(e, (SE(1.0), SE(-1.0))), r"correlation length = -1 m"),
        (lambda e, c: kl.with_covariance(e, (SE(10.0), SE(0.05))), r"length = 0.05 m takes order .*: expand anew"),
        (lambda e, c: kl.captured_variance(e, probes=1), r"probes = 1"),
        (lambda e, c: kl.field.rotate(kl.Bedding(10.0), jnp.array([[NAN], [1.0]])), r"points = .*give a finite value"),
        (lambda e, c: kl.field.rotate(kl.Bedding(10.0, NAN), jnp.ones((3, 1))), r"strike = nan: give a finite value"),
        (lambda e, c: kl.field.rotate(kl.Bedding(10.0), jnp.ones(3)), r"points of shape \(3,\)"),
        (lambda e, c: kl.expand((SE(1.0),), (NAN,), (1.0,)), r"origin = .*a finite value; it is the lowest corner"),
        (lambda e, c: kl.conditioned(kl.condition(e, jnp.ones((2, 1)), [0.5]), c[:-1]), r"one a mode"),
        (lambda e, c: kl.condition(e, jnp.ones((2, 1)), [0.5], error=[0.1, 0.2]), r"error of shape \(2,\) for 1 data"),
        (lambda e, c: kl.axis.haar_transform(jnp.ones(3)), r"3 values along the last axis: give 2\^level"),
        (lambda e, c: kl.condition(e, jnp.zeros((2, 0)), []), "at least one point"),
        (lambda e, c: kl.axis.from_scale_of_fluctuation(SE, -2.0), r"scale of fluctuation = -2 m"),
        (lambda e, c: kl.axis.scale_of_fluctuation(kl.Infinite()), r"Infinite has no scale of fluctuation"),
        (lambda e, c: kl.field.exact_lattice((SE(1.0),), (np.zeros(0),)), r"coordinates of shape \(0,\): give \(N,\)"),
        (
            lambda e, c: kl.field.exact_lattice((SE(1.0),), (np.array([0.0, NAN]),)),
            r"lattice coordinates = nan at .*bad at 1 of",
        ),
        (lambda e, c: kl.linear_with_depth(jnp.array([1.0, NAN]), 1.0, 2.0), r"depth = nan at .*bad at 1 of"),
        (lambda e, c: kl.monte_carlo(jax.random.key(0), 3, 2, rows=[0.5]), r"type float64: give a list of sample"),
        (lambda e, c: kl.latin_hypercube(jax.random.key(0), 2.5, 2), r"n_samples = 2.5 must be 1 or more, a whole"),
        (lambda e, c: kl.soil.nataf_matrix(np.eye(3), (kl.Normal(1.0, 0.1),) * 2), r"\(3, 3\) for 2 marginals"),
    ],
)
def test_no_public_function_takes_what_it_cannot_use(expansion, call, message):
    with pytest.raises(ValueError, match=message):
        call(expansion, jnp.ones(expansion.modes))


def test_lengths_far_below_the_lattice_are_warned_of(expansion):
    ones = jnp.ones(expansion.modes)
    with pytest.warns(UserWarning, match=r"spacing 5.0 m exceeds twice the correlation length 2.0 m.*refine"):
        kl.field_on_lattice(expansion, ones, (jnp.arange(0.0, 10.0), jnp.array([0.0, 5.0])))
    with pytest.warns(UserWarning, match="exceeds twice"):
        kl.field.exact_lattice((SE(0.2),), (np.arange(4.0),))
    with pytest.warns(UserWarning, match=r"far below the Haar cell of 5.0 m"):
        kl.expand((SE(0.5),), (0.0,), (10.0,), modes=1, solver=kl.axis.Haar(1))


@pytest.mark.parametrize(
    ("marginal", "message"),
    [
        (kl.Normal(1.0, -0.1), r"cov = -0.1 is negative: give a coefficient of variation of 0 or more"),
        (kl.Lognormal(-1.0, 0.1), r"mean = -1.0 must be above 0"),
        (kl.Beta(40.0, 0.3, 0.0, 30.0), r"mean = 40.0 must lie between the beta's bounds 0.0 and 30.0: widen"),
        (kl.Beta(10.0, 1.5, 0.0, 30.0), r"cov = 1.5 must be above 0 and below 1.414.*widen the bounds"),
        (kl.Beta(10.0, 1.5, 5.0, 30.0), r"cov = 1.5 must be above 0 and below 1.0, the most that bounds 5.0 and 30.0"),
        (kl.TruncatedNormal(10.0, 0.3, lower=12.0), r"mean = 10.0 must lie between the bounds 12.0"),
        (kl.TruncatedNormal(10.0, 1.2), r"cannot be had within the bounds 0.0 and None: lower the cov"),
        (kl.Gamma(10.0, 0.3, lower=11.0), r"mean = 10.0 must be above the lower bound 11.0"),
        (kl.Gamma(10.0, 0.0), r"cov = 0.0 must be above 0 for this family"),
        (kl.Gamma(10.0, 0.3, power=0.0), r"power = 0.0 must be above 0"),
        (kl.Weibull(10.0, 0.3, shape=-1.0), r"shape = -1.0 must be above 0"),
        (kl.Normal(25e3, 1e38), r"cov = 1e\+38: values 9 deviations out come to .*float32 holds up to 3.4e\+38: lower"),
        (kl.Lognormal(25e3, 1e30), r"values 9 deviations down come to 1e-.*float32 holds down to .*lower the cov"),
        (kl.Gumbel(25e3, NAN), r"cov = nan: give finite numbers"),
        (kl.Gamma(10.0, 1e30), r"cov = 1e\+30 needs a shape of .*outside 0.01 to 1e8"),
        (kl.Weibull(10.0, 1e30), r"cov = 1e\+30 needs a power of"),
        (kl.Empirical(jnp.array([1.0])), r"n of 2 or more"),
        (kl.Empirical(jnp.array([1.0, jnp.nan])), r"not finite"),
    ],
)
def test_impossible_marginals(marginal, message):
    with pytest.raises(ValueError, match=message):
        marginal.transform(GAUSSIAN)


FAMILIES = [kl.Normal, kl.Lognormal, kl.TruncatedNormal, kl.Uniform, kl.Gumbel, kl.Gamma, kl.Weibull]


@pytest.mark.parametrize("family", FAMILIES)
@given(power_of_ten=st.floats(-2, 38), score=st.floats(-6, 6))
@settings(max_examples=15, deadline=None)
def test_a_marginal_gives_finite_values_or_refuses(family, power_of_ten, score):
    try:
        value = family(25e3, 10**power_of_ten).transform(jnp.array([score]))
    except ValueError:
        return
    assert np.isfinite(value).all()


def test_a_marginal_is_checked_before_it_is_traced():
    for proper in (kl.Lognormal(25e3, 0.3), kl.Normal(1.0, 0.0), kl.Beta(10.0, 0.3, 0.0, 30.0)):
        kl.marginal.check_marginal(proper)
    with pytest.raises(ValueError, match="lower the cov"):
        kl.marginal.check_marginal(kl.Lognormal(25e3, 1e30))
    with pytest.raises(ValueError, match=r"gaussian field = nan at .*bad at 1 of"):
        kl.Lognormal(1.0, 0.1).transform(jnp.array([0.0, NAN]))


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        ([[1.0, 1.2], [1.2, 1.0]], r"not positive definite \(smallest eigenvalue -0.2\)"),
        ([[1.0, 0.2], [0.3, 1.0]], r"not symmetric"),
        ([[2.0, 0.2], [0.2, 1.0]], r"must be 1"),
        ([[1.0]], r"give one row each"),
        ([[1.0, 0.2], [0.2]], r"rows of the correlation matrix differ in length"),
        ([[1.0, 0.2]], r"of shape \(1, 2\): give a square one"),
        ([[1.0, NAN], [NAN, 1.0]], r"correlation matrix = nan at .*bad at 2 of"),
    ],
)
def test_bad_correlation_matrices(matrix, message):
    with pytest.raises(ValueError, match=message):
        kl.correlate(jnp.ones((2, 5)), matrix)


def test_unreachable_correlation_between_marginals():
    with pytest.raises(ValueError, match=r"cannot be had between these marginals"):
        kl.soil.nataf_matrix([[1.0, -0.95], [-0.95, 1.0]], (kl.Lognormal(1.0, 1.0), kl.Lognormal(1.0, 1.0)))


@pytest.mark.parametrize(
    ("points", "values", "error", "message"),
    [
        ([(11.0, 1.0)], [0.0], 0.0, r"reach from 11.0 to 11.0 along axis 0"),
        ([(1.0, 1.0), (2.0, 2.0), (1.0, 1.0)], [0.0, 1.0, 2.0], 0.0, r"data 0 and 2 lie at the same point"),
        ([(1.0, 1.0)], [float("nan")], 0.0, r"a datum is not finite"),
        ([(1.0, 1.0)], [0.0], -1.0, r"error = .*give a finite value of 0 or more"),
        ([(1.0, 1.0)], [0.0, 1.0], 0.0, r"give \(d, n\) and \(n,\)"),
        ([(1.0, 1.0), (1.0, 1.001)], [0.0, 1.0], 0.0, r"cannot be distinguished"),
    ],
)
def test_bad_borehole_data(expansion, points, values, error, message):
    with pytest.raises(ValueError, match=message):
        kl.condition(expansion, field_points(*points), values, error=error)


@pytest.mark.parametrize("design", [kl.monte_carlo, kl.latin_hypercube, kl.sobol])
def test_bad_designs(design):
    key = jax.random.key(0)
    with pytest.raises(ValueError, match="n_samples = 0 must be 1 or more"):
        design(key, 0, 3)
    with pytest.raises(ValueError, match="n_modes = 0 must be 1 or more"):
        design(key, 3, 0)
    with pytest.raises(ValueError, match="rows reach outside 0 to 2"):
        design(key, 3, 3, rows=[3])


def test_sobol_has_a_largest_dimension():
    with pytest.raises(ValueError, match=r"exceeds Sobol's 21201: use latin_hypercube"):
        kl.sobol(jax.random.key(0), 2, 30_000)


def test_bad_strata_and_trends():
    with pytest.raises(ValueError, match="give one fewer than strata"):
        kl.in_strata(jnp.zeros(3), (1.0, 2.0), (GAUSSIAN, GAUSSIAN))
    with pytest.raises(ValueError, match="order from the top"):
        kl.in_strata(jnp.zeros(3), (1.0, 2.0), (GAUSSIAN,) * 3)
    with pytest.raises(ValueError, match=r"deviation of the trend falls below 0"):
        kl.with_trend(kl.Normal(1.0, 0.1), GAUSSIAN, mean=GAUSSIAN, deviation=GAUSSIAN - 1)
    with pytest.raises(ValueError, match=r"field of shape \(2,\) for an elevation of \(3,\)"):
        kl.in_strata(GAUSSIAN, (1.0,), (GAUSSIAN, GAUSSIAN[:2]))
    with pytest.raises(ValueError, match=r"elevation = nan at .*bad at 1 of"):
        kl.in_strata(GAUSSIAN.at[0].set(NAN), (1.0,), (GAUSSIAN, GAUSSIAN))
    with pytest.raises(ValueError, match=r"mean of the trend of shape \(2,\)"):
        kl.with_trend(kl.Normal(1.0, 0.1), GAUSSIAN, mean=GAUSSIAN[:2], deviation=1.0)
    with pytest.raises(ValueError, match=r"does not vary"):
        kl.with_trend(kl.Normal(1.0, 0.0), GAUSSIAN, mean=GAUSSIAN, deviation=1.0)


def test_exact_lattice_and_noise():
    with pytest.raises(ValueError, match=r"noise = nan at"):
        kl.field.exact_field(kl.field.exact_lattice((SE(1.0),), (np.arange(3.0),)), jnp.ones(3) * NAN)
    hat = kl.axis.Corrected(kl.Triangular(4.0), jnp.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
    with pytest.raises(ValueError, match=r"not positive definite on the lattice \(smallest eigenvalue -2\.81e-01\)"):
        kl.field.exact_lattice((hat,), (np.array([0.0, 2.0, 4.0]),))
    with pytest.raises(ValueError, match="1 covariances for 2 axes"):
        kl.field.exact_lattice((SE(1.0),), (np.arange(3.0),) * 2)
    with pytest.raises(ValueError, match=r"noise of shape \(4,\): give \(3,\)"):
        kl.field.exact_field(kl.field.exact_lattice((SE(1.0),), (np.arange(3.0),)), jnp.ones(4))
