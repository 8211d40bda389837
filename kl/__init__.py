"""Random fields of soil properties by Kronecker-factored Karhunen-Loeve expansion.

Figures are in `kl.plots`, conversion from and to GSTools in `kl.gstools`; both are loaded when first named.
"""

from importlib import import_module
from types import ModuleType

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

_WHEN_NAMED = ("gstools", "plots")
"""Modules that load packages which fields alone do without."""


def __getattr__(name: str) -> ModuleType:
    """The modules of figures and of GSTools."""
    if name in _WHEN_NAMED:
        return import_module(f"kl.{name}")
    raise AttributeError(f"module 'kl' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_WHEN_NAMED})
