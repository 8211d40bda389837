"""Restricted likelihood of a Gaussian field with a linear mean, over a grid of correlation lengths and nuggets.

The data y = X b + e have the covariance s^2 R, R = (1 - t) C(lengths) + t I with the nugget t as a share of the
variance. Integrated over the coefficients b and the scale s (prior 1/s^2), the likelihood of the rest is

    |R|^(-1/2) |X' R^-1 X|^(-1/2) (y' Q y)^(-(n - p)/2),   Q = R^-1 - R^-1 X (X' R^-1 X)^-1 X' R^-1,

the restricted likelihood with its scale integrated out. The prior of the lengths is the root of the determinant of
their expected information, so that lengths far beyond the data have little weight although their likelihood does not
fall to 0; that of the nugget is uniform. With the nugget among the information, intervals were wider by a quarter and
lengths too long by a third on made-up sites.

Sources: Patterson and Thompson (1971), doi:10.1093/biomet/58.3.545 (restricted likelihood); Berger, De Oliveira and
Sanso (2001), doi:10.1198/016214501753382282, and Paulo (2005), doi:10.1214/009053604000001264 (priors).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from kl.types import HostArray

Correlation = Callable[[Sequence[float]], HostArray]
"""Correlation (n, n) of the data, nugget apart, at given lengths (m)."""
_STEP = 0.02
"""Of the logarithm of a length, for the derivative of the correlation."""
_ROUNDING = 1e-6
"""Added to the eigenvalues of the correlation: smooth families have some that are lost in rounding, and no instrument
reads a thousandth of the deviation."""


@dataclass(frozen=True)
class Cell:
    """One cell of the grid: lengths, nugget, and what the data give there.

    Args:
        lengths: correlation lengths (m).
        nugget: share of the variance.
        weight: logarithm of likelihood times prior times the size of the cell, up to a constant.
        coefficients: (p,) generalised least squares.
        root: (p, p) with root root' = (X' R^-1 X)^-1.
        square: y' Q y.
    """

    lengths: tuple[float, ...]
    nugget: float
    weight: float
    coefficients: HostArray
    root: HostArray
    square: float


def cells(
    correlation: Correlation,
    lengths: Sequence[HostArray],
    nuggets: HostArray,
    design: HostArray,
    values: HostArray,
) -> list[Cell]:
    """Every cell of the grid.

    Args:
        correlation: of the data.
        lengths: for each length the middles (m) of its cells, of a constant ratio.
        nuggets: edges of the cells of the nugget, from 0 up; one edge alone is a known nugget.
        design: (n, p).
        values: (n,).

    Returns:
        A cell for each combination.
    """
    if len(nuggets) > 1:
        middles, widths = (nuggets[1:] + nuggets[:-1]) / 2, np.diff(nuggets)
    else:
        middles, widths = nuggets, np.ones(1)
    result = []
    for cell in itertools.product(*lengths):
        result += _at(correlation, cell, middles, widths, design, values)
    return result


def _at(
    correlation: Correlation,
    lengths: tuple[float, ...],
    nuggets: HostArray,
    widths: HostArray,
    design: HostArray,
    values: HostArray,
) -> list[Cell]:
    """The cells of one combination of lengths: one decomposition serves all nuggets."""
    matrix = correlation(lengths)
    plain, turns = np.linalg.eigh(matrix)
    plain = np.maximum(plain, 0) + _ROUNDING
    slopes = [turns.T @ (slope @ turns) for slope in _slopes(correlation, lengths)]
    turned, data = turns.T @ design, turns.T @ values
    count, columns = design.shape
    made = []
    for nugget, width in zip(nuggets, widths, strict=True):
        shares = (1 - nugget) * plain + nugget
        scaled = turned / shares[:, None]
        information = turned.T @ scaled
        inverse = np.linalg.inv(information)
        coefficients = inverse @ (scaled.T @ data)
        square = float(((data - turned @ coefficients) ** 2 / shares).sum())
        changes = [(1 - nugget) * slope for slope in slopes]
        likelihood = -0.5 * (
            np.log(shares).sum() + np.linalg.slogdet(information)[1] + (count - columns) * np.log(square)
        )
        prior = _log_prior(changes, shares, scaled, inverse, count - columns)
        root = np.linalg.cholesky(inverse)
        made.append(Cell(lengths, float(nugget), likelihood + prior + np.log(width), coefficients, root, square))
    return made


def _slopes(correlation: Correlation, lengths: tuple[float, ...]) -> list[HostArray]:
    """Derivative of the correlation by the logarithm of each length, by central differences."""
    slopes = []
    for k in range(len(lengths)):
        up, down = (
            correlation([length * np.exp(sign * _STEP * (i == k)) for i, length in enumerate(lengths)])
            for sign in (1, -1)
        )
        slopes.append((up - down) / (2 * _STEP))
    return slopes


def _log_prior(changes: list[HostArray], shares: HostArray, scaled: HostArray, inverse: HostArray, free: int) -> float:
    """Half the logarithm of the determinant of the information of the lengths.

    changes: (n, n) derivatives of R in its own directions. shares: (n,) its eigenvalues. scaled: (n, p) R^-1 X.
    inverse: (p, p) of X' R^-1 X. free: n - p. The entries are tr(W_i W_j) - tr W_i tr W_j / free with W_i = R_i Q.
    """
    over = [change / shares for change in changes]
    changed = [change @ scaled for change in changes]
    inner = [scaled.T @ matrix for matrix in changed]
    traces = np.array([np.trace(matrix) - np.trace(inverse @ part) for matrix, part in zip(over, inner, strict=True)])
    size = len(changes)
    information = np.empty((size, size))
    for i, j in itertools.product(range(size), repeat=2):
        information[i, j] = (
            np.einsum("ab,ba->", over[i], over[j])
            - 2 * np.trace(inverse @ (changed[i].T @ (changed[j] / shares[:, None])))
            + np.trace(inverse @ inner[i] @ inverse @ inner[j])
        )
    information -= np.outer(traces, traces) / free
    sign, log = np.linalg.slogdet(information)
    return 0.5 * log if sign > 0 else -np.inf
