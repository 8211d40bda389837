"""Selection of the products of one-dimensional modes with the most variance, without forming all products.

Host side, NumPy. A mode of the field is a triple (i, j, k) whose share of the variance is the product of
the axes' fractions. Those above a threshold are counted by one binary search for each pair (i, j), and
the threshold is bisected, so the cost is pairs x log(n), not n^3.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jax.typing import ArrayLike

from kl.types import HostArray, HostIndex

LARGEST_NUMBER_OF_MODES = 400_000


class _Products:
    """Products of up to three descending spectra, addressed by pair of the first two and depth in the last."""

    def __init__(self, fractions: list[HostArray]) -> None:
        padded = [np.ones(1) for _ in range(3 - len(fractions))] + fractions
        first, second, self.last = padded
        self.pairs = np.multiply.outer(first, second).ravel()
        self.width = len(second)
        self.ascending = self.last[::-1]
        self.cumulative = np.concatenate([[0.0], np.cumsum(self.last)])

    def depths(self, threshold: float) -> HostIndex:
        """For each pair, how many of the last axis' modes give a product of at least `threshold`."""
        limits = np.divide(threshold, self.pairs, out=np.full_like(self.pairs, np.inf), where=self.pairs > 0)
        return len(self.last) - np.searchsorted(self.ascending, limits, side="left")

    def energy(self, depths: HostIndex) -> float:
        """Sum of the products of the modes down to `depths`."""
        return float(self.pairs @ self.cumulative[depths])

    def triples(self, depths: HostIndex) -> tuple[HostIndex, HostArray]:
        """Indices (3, M) and products (M,) of the modes down to `depths`, largest first."""
        pair = np.repeat(np.arange(len(depths)), depths)
        starts = np.repeat(np.cumsum(depths) - depths, depths)
        third = np.arange(len(pair)) - starts
        products = self.pairs[pair] * self.last[third]
        # Ties (equal axes) in a fixed order, so that coefficients mean the same on every machine. Rounding to
        # a relative 1e-5 makes ties of products that differ by float32 noise.
        tie = np.round(np.log(products) * 1e5)
        order = np.lexsort((third, pair % self.width, pair // self.width, -tie))
        index = np.stack([pair // self.width, pair % self.width, third])
        return index[:, order], products[order]


def select(fractions: Sequence[ArrayLike], *, energy: float | None, modes: int | None) -> tuple[HostIndex, HostArray]:
    """Largest products, by energy or by number.

    Args:
        fractions: per axis (n_i,), eigenvalues over the extent; values below 0, from rounding, count as 0.
        energy: share of the variance in (0, 1], counted exactly, or None.
        modes: number of modes, or None; exactly one of the two is given.

    Returns:
        Numbers (d, M) of the one-dimensional modes and their products (M,), largest first.

    Raises:
        ValueError: If the spectra have less than `energy` or fewer than `modes`, or more modes than
            LARGEST_NUMBER_OF_MODES are needed.
    """
    spectra = [np.maximum(np.asarray(spectrum, np.float64), 0) for spectrum in fractions]
    orders = [np.argsort(-spectrum, kind="stable") for spectrum in spectra]
    products = _Products([spectrum[order] for spectrum, order in zip(spectra, orders, strict=True)])
    available = products.energy(np.full(len(products.pairs), len(products.last)))
    positive = int(np.prod([np.count_nonzero(spectrum) for spectrum in spectra]))
    if modes is not None and modes > positive:
        raise ValueError(
            f"modes = {modes} exceeds {positive}, which the axes' solvers give: raise their order or level"
        )
    # The sum of float32 eigenvalues meets the trace only to rounding.
    target = 0.0 if energy is None else min(energy, available)
    if energy is not None and energy > available + 1e-5:
        raise ValueError(
            f"energy = {energy} cannot be reached, the solvers hold {available:.6f} of the variance: "
            "raise the level, order or count along the axes, or lower the energy"
        )

    def enough(depths: HostIndex) -> bool:
        if modes is not None:
            return int(depths.sum()) >= modes
        return products.energy(depths) >= target * (1 - 1e-12)

    low, high = -90.0, 0.0
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if enough(products.depths(np.exp(middle))) else (low, middle)
        if high - low < 1e-3:
            break
    depths = products.depths(np.exp(low))
    if depths.sum() > LARGEST_NUMBER_OF_MODES and (modes is None or modes > LARGEST_NUMBER_OF_MODES):
        raise ValueError(
            f"{int(depths.sum())} modes hold {energy if modes is None else modes}: more than "
            f"{LARGEST_NUMBER_OF_MODES}; lower the energy, use a smoother covariance or `exact_lattice`"
        )
    index, values = products.triples(depths)
    count = modes if modes is not None else int(np.searchsorted(np.cumsum(values), target * (1 - 1e-12))) + 1
    index, values = index[:, :count], values[:count]
    index = index[3 - len(fractions) :]
    return np.stack([order[row] for order, row in zip(orders, index, strict=True)]), values
