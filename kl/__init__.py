"""Random fields of soil properties by Kronecker-factored Karhunen-Loeve expansion.

Figures are in `kl.plots`, which has to be imported by its name.
"""

from kl import axis, estimation, field, marginal, soil
from kl.axis import (
    CosineExponential,
    Exponential,
    Infinite,
    Matern32,
    Matern52,
    SecondOrderMarkov,
    SquaredExponential,
    Triangular,
)
from kl.field import (
    Bedding,
    Expansion,
    captured_variance,
    condition,
    conditioned,
    expand,
    field_at,
    field_on_lattice,
    with_covariance,
)
from kl.marginal import Beta, Empirical, Gamma, Gumbel, Lognormal, Normal, TruncatedNormal, Uniform, Weibull
from kl.sampling import latin_hypercube, monte_carlo, sobol
from kl.soil import correlate, in_strata, linear_with_depth, with_trend

__all__ = [
    "Bedding",
    "Beta",
    "CosineExponential",
    "Empirical",
    "Expansion",
    "Exponential",
    "Gamma",
    "Gumbel",
    "Infinite",
    "Lognormal",
    "Matern32",
    "Matern52",
    "Normal",
    "SecondOrderMarkov",
    "SquaredExponential",
    "Triangular",
    "TruncatedNormal",
    "Uniform",
    "Weibull",
    "axis",
    "captured_variance",
    "condition",
    "conditioned",
    "correlate",
    "estimation",
    "expand",
    "field",
    "field_at",
    "field_on_lattice",
    "in_strata",
    "latin_hypercube",
    "linear_with_depth",
    "marginal",
    "monte_carlo",
    "sobol",
    "soil",
    "with_covariance",
    "with_trend",
]
