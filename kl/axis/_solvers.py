"""Methods that solve for the eigenpairs of an axis; they are static and determine the program."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Nystrom:
    """Gauss-Legendre quadrature of the integral.

    It converges spectrally for a smooth kernel (squared exponential), with second order for one with a kink at lag 0.
    Eigenfunctions are the polynomials through the quadrature points, so no small eigenvalue is divided by.

    Source: Betz, Papaioannou and Straub (2014), doi:10.1016/j.cma.2013.12.010, Section 3.1.

    Args:
        order: number of quadrature points; None raises it until none of the leading half of the eigenvalues, over the
            extent, changes by more than `tolerance` when the order grows by a quarter.
        tolerance: largest change of an eigenvalue, as a share of the variance.
        largest: order at which the search ends with a warning.
    """

    order: int | None = None
    tolerance: float = 1e-8
    largest: int = 400


@dataclass(frozen=True)
class Legendre:
    """Legendre-Galerkin with the inner integral split at lag 0, where most kernels have a kink.

    Gauss's rule integrates a smooth function on both parts, so the method stays spectral for the Matern, Markov and
    cosine-exponential families.

    Args:
        order: number of polynomials; None raises it as in `Nystrom`, and until the basis holds the variance that the
            truncation requires.
        tolerance: largest change of an eigenvalue, as a share of the variance.
        largest: order at which the search ends with a warning.
    """

    order: int | None = None
    tolerance: float = 1e-8
    largest: int = 160


@dataclass(frozen=True)
class Haar:
    """Haar wavelet-Galerkin with 2^level functions.

    The Haar functions up to a level span the piecewise constants on 2^level equal cells. The fast wavelet transform is
    the orthogonal map between the two bases: it turns the matrix of cell averages into the wavelet matrix and
    eigenvectors back, and leaves eigenvalues and eigenfunctions unchanged. So the eigenproblem is solved on the cells;
    `haar_transform` is needed only to see wavelet coefficients. The method is of second order in the cell size, and the
    captured variance lies below the exact one.

    Sources: Phoon, Huang and Quek (2002), doi:10.1016/S0266-8920(02)00013-9; Jiang et al. (2024),
    doi:10.1016/j.compgeo.2024.106413, Eqs. 7 to 14.

    Args:
        level: 0 to 12.
    """

    level: int


@dataclass(frozen=True)
class ClosedForm:
    """Roots of the characteristic equation: Exponential, Periodic, and Triangular at least as long as the axis.

    Args:
        count: number of modes; None takes as many as the truncation may need.
        largest: limit of that number.
    """

    count: int | None = None
    largest: int = 4000


@dataclass(frozen=True)
class Constant:
    """The single mode of an axis along which the field does not vary."""


Solver = Nystrom | Legendre | Haar | ClosedForm | Constant
