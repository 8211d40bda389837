"""Fields: products of the axes' modes, selected by energy, evaluated at any point, conditioned and saved."""

from kl.field._averages import averaged
from kl.field._bedding import Bedding, rotate
from kl.field._conditioning import Conditioning, condition, condition_on, conditioned, kriging_variance, mode_matrix
from kl.field._evaluation import field_at, field_on_lattice
from kl.field._expansion import Expansion, expand, with_covariance
from kl.field._isotropic import Waves, isotropic
from kl.field._lattice import LatticeRoots, exact_field, exact_lattice
from kl.field._truncation import (
    CapturedVariance,
    captured_variance,
    rescaled,
    variance_at,
    variance_on_lattice,
    with_residual,
)

__all__ = [
    "Bedding",
    "CapturedVariance",
    "Conditioning",
    "Expansion",
    "LatticeRoots",
    "Waves",
    "averaged",
    "captured_variance",
    "condition",
    "condition_on",
    "conditioned",
    "exact_field",
    "exact_lattice",
    "expand",
    "field_at",
    "field_on_lattice",
    "isotropic",
    "kriging_variance",
    "mode_matrix",
    "rescaled",
    "rotate",
    "variance_at",
    "variance_on_lattice",
    "with_covariance",
    "with_residual",
]
