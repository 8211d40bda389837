"""The linear model behind the estimates: the trend made linear, the marginal taken off, the correlation by lag."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kl.axis import Scaled
from kl.marginal import Lognormal
from kl.types import HostArray

SAME_POSITION = 0.5
"""Horizontal distance (m) below which values are of one sounding."""


@dataclass(frozen=True)
class Model:
    """The linear model of the data.

    Args:
        points: (d, n) m.
        depth: (n,) m, None without a trend.
        values: (n,) in the property's unit.
        marginal: class, `Lognormal` or `Normal`.
        correlation: class of the correlation along each axis.
        middle: depth (m) at which the linear mean is anchored.
        slope: first estimate of the trend over the mean at that depth (1/m).
    """

    points: HostArray
    depth: HostArray | None
    values: HostArray
    marginal: type
    correlation: type[Scaled]
    middle: float = 0.0
    slope: float = 0.0

    def grown(self, depth: HostArray | None) -> HostArray | float:
        """Mean over that at the middle, by the first estimate.

        Args:
            depth: (m,) m, None without a trend.
        """
        return 1.0 if depth is None else 1 + self.slope * (depth - self.middle)

    def design(self, depth: HostArray | None, count: int) -> HostArray:
        """Matrix (count, p) of the linear mean.

        Args:
            depth: (count,) m, None without a trend.
            count: number of points.
        """
        if depth is None:
            return np.ones((count, 1))
        return np.stack([np.ones(count), (depth - self.middle) / self.grown(depth)], axis=1)

    def linear(self, values: HostArray, depth: HostArray | None) -> HostArray:
        """Values as the linear model has them: less the first trend, and in logarithms where lognormal.

        Args:
            values: (m,) in the property's unit.
            depth: (m,) m, None without a trend.
        """
        scaled = values / self.grown(depth)
        return np.log(scaled) if self.marginal is Lognormal else scaled

    def between(self, first: HostArray, second: HostArray, lengths: Sequence[float]) -> HostArray:
        """Correlation (n, m) of the field between points.

        Without a horizontal length it is 0 between soundings: one informs the other of mean and spread alone.

        Args:
            first: (d, n) m.
            second: (d, m) m.
            lengths: horizontal, if there is one, and vertical (m).
        """
        along = self.along(first, second, lengths[0] if len(lengths) > 1 else None)
        return self.upright(first, second, lengths[-1]) * along

    def upright(self, first: HostArray, second: HostArray, length: float) -> HostArray:
        """Correlation (n, m) of the vertical distance of points.

        Args:
            first: (d, n) m.
            second: (d, m) m.
            length: vertical (m).
        """
        return np.asarray(self.correlation(float(length))(first[-1][:, None] - second[-1][None, :]))

    def along(self, first: HostArray, second: HostArray, length: float | None) -> HostArray | float:
        """Correlation (n, m) of the horizontal distance of points, 1 where they have none.

        Args:
            first: (d, n) m.
            second: (d, m) m.
            length: horizontal (m); None for no correlation between soundings.
        """
        product: HostArray | float = 1.0
        for one, other in zip(first[:-1], second[:-1], strict=True):
            lag = one[:, None] - other[None, :]
            near = np.abs(lag) <= SAME_POSITION if length is None else self.correlation(float(length))(lag)
            product = product * np.asarray(near, float)
        return product
