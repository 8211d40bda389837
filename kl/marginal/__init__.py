"""Marginal distributions by equiprobable transform, and what the transform does to correlation."""

from kl.marginal._gamma_beta import Beta, Gamma, Weibull
from kl.marginal._marginals import (
    Empirical,
    Gumbel,
    Lognormal,
    Marginal,
    Normal,
    TruncatedNormal,
    Uniform,
    check_marginal,
)
from kl.marginal._nataf import NatafError, hermite_coefficients, nataf_corrected, nataf_correlation, nataf_error
from kl.marginal._quantiles import from_both_tails

__all__ = [
    "Beta",
    "Empirical",
    "Gamma",
    "Gumbel",
    "Lognormal",
    "Marginal",
    "NatafError",
    "Normal",
    "TruncatedNormal",
    "Uniform",
    "Weibull",
    "check_marginal",
    "from_both_tails",
    "hermite_coefficients",
    "nataf_corrected",
    "nataf_correlation",
    "nataf_error",
]
