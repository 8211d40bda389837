"""Random fields of soil properties by Kronecker-factored Karhunen-Loeve expansion.

Figures are in `kl.plots`, which is imported by name only.
"""

from kl.conditioning import Conditioning, condition, conditioned, kriging_variance, mode_matrix
from kl.covariance import (
    Corrected,
    CosineExponential,
    Exponential,
    Infinite,
    Matern32,
    Matern52,
    Periodic,
    SecondOrderMarkov,
    SquaredExponential,
    Triangular,
    from_scale_of_fluctuation,
    scale_of_fluctuation,
)
from kl.expansion import Expansion, expand, field_at, field_on_lattice, with_covariance
from kl.fredholm import ClosedForm, Haar, Legendre, Nystrom, haar_transform
from kl.lattice import LatticeRoots, exact_field, exact_lattice
from kl.marginals import (
    Beta,
    Empirical,
    Gamma,
    Gumbel,
    Lognormal,
    Normal,
    TruncatedNormal,
    Uniform,
    Weibull,
)
from kl.nataf import NatafError, hermite_coefficients, nataf_corrected, nataf_correlation, nataf_error
from kl.rotation import Bedding, rotate
from kl.sampling import latin_hypercube, monte_carlo, sobol
from kl.soil import correlate, in_strata, linear_with_depth, nataf_matrix, with_trend
from kl.store import load, save
from kl.truncation import (
    CapturedVariance,
    captured_variance,
    rescaled,
    variance_at,
    variance_on_lattice,
    with_residual,
)

__all__ = [
    "Bedding",
    "Beta",
    "CapturedVariance",
    "ClosedForm",
    "Conditioning",
    "Corrected",
    "CosineExponential",
    "Empirical",
    "Expansion",
    "Exponential",
    "Gamma",
    "Gumbel",
    "Haar",
    "Infinite",
    "LatticeRoots",
    "Legendre",
    "Lognormal",
    "Matern32",
    "Matern52",
    "NatafError",
    "Normal",
    "Nystrom",
    "Periodic",
    "SecondOrderMarkov",
    "SquaredExponential",
    "Triangular",
    "TruncatedNormal",
    "Uniform",
    "Weibull",
    "captured_variance",
    "condition",
    "conditioned",
    "correlate",
    "exact_field",
    "exact_lattice",
    "expand",
    "field_at",
    "field_on_lattice",
    "from_scale_of_fluctuation",
    "haar_transform",
    "hermite_coefficients",
    "in_strata",
    "kriging_variance",
    "latin_hypercube",
    "linear_with_depth",
    "load",
    "mode_matrix",
    "monte_carlo",
    "nataf_corrected",
    "nataf_correlation",
    "nataf_error",
    "nataf_matrix",
    "rescaled",
    "rotate",
    "save",
    "scale_of_fluctuation",
    "sobol",
    "variance_at",
    "variance_on_lattice",
    "with_covariance",
    "with_residual",
    "with_trend",
]
