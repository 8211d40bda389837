"""One axis: covariance functions and the eigenpairs of their operators."""

from kl.axis._corrected import Corrected, gaussian_correlation, transformed_correlation
from kl.axis._covariance import (
    CosineExponential,
    Covariance,
    Exponential,
    Infinite,
    Matern32,
    Matern52,
    Periodic,
    Scaled,
    SecondOrderMarkov,
    SquaredExponential,
    Triangular,
    from_scale_of_fluctuation,
    length_leaves,
    on_host,
    scale_of_fluctuation,
)
from kl.axis._fredholm import all_axis_modes
from kl.axis._matrices import haar_transform
from kl.axis._modes import AveragedModes, AxisModes, CellModes, LegendreModes, SineModes, leading, scaled_functions
from kl.axis._resolution import check_resolves, resolved
from kl.axis._solvers import ClosedForm, Constant, Haar, Legendre, Nystrom, Solver

__all__ = [
    "AveragedModes",
    "AxisModes",
    "CellModes",
    "ClosedForm",
    "Constant",
    "Corrected",
    "CosineExponential",
    "Covariance",
    "Exponential",
    "Haar",
    "Infinite",
    "Legendre",
    "LegendreModes",
    "Matern32",
    "Matern52",
    "Nystrom",
    "Periodic",
    "Scaled",
    "SecondOrderMarkov",
    "SineModes",
    "Solver",
    "SquaredExponential",
    "Triangular",
    "all_axis_modes",
    "check_resolves",
    "from_scale_of_fluctuation",
    "gaussian_correlation",
    "haar_transform",
    "leading",
    "length_leaves",
    "on_host",
    "resolved",
    "scale_of_fluctuation",
    "scaled_functions",
    "transformed_correlation",
]
