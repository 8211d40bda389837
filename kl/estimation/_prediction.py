"""The property at other points, with the uncertainty of all that was estimated."""

from __future__ import annotations

import numpy as np

from kl._checks import require
from kl.estimation._fit import FieldFit
from kl.marginal import Lognormal
from kl.types import HostArray


def predicted(
    fit: FieldFit, points: HostArray, depth: HostArray | None = None, *, draws: int = 100, seed: int = 0
) -> HostArray:
    """Draws of the property at other points, given the data, with the uncertainty of all estimates.

    Args:
        fit: of the data.
        points: (d, m) m.
        depth: (m,) m where the fit has a trend.
        draws: number of draws K.
        seed: of the draws.

    Returns:
        Values (K, m) in the property's unit, of the field and its nugget; their quantiles are bands.

    Raises:
        ValueError: points of other axes, or depths where the fit has no trend or none where it has one.
    """
    model, posterior = fit.model, fit.draws
    points = np.asarray(points, np.float64)
    require(
        points.ndim == 2 and len(points) == len(model.points),
        f"points of shape {points.shape}: give ({len(model.points)}, m) as in the data",
    )
    require((depth is None) == (model.depth is None), "give depths exactly where the fit has them, for its trend")
    random = np.random.default_rng(seed)
    data = model.linear(model.values, model.depth)
    designs = model.design(model.depth, data.size), model.design(depth, points.shape[1])
    made = np.empty((draws, points.shape[1]))
    for row, k in enumerate(random.choice(posterior.mean.size, draws)):
        share, coefficients = 1 - posterior.nugget[k], posterior.coefficients[:, k]
        lengths = posterior.lengths[:, k].tolist()
        here = _with_nugget(share * model.between(model.points, model.points, lengths), 1 - share)
        there = _with_nugget(share * model.between(points, points, lengths), 1 - share)
        across = share * model.between(model.points, points, lengths)
        gain = np.linalg.solve(here, across)
        mean = designs[1] @ coefficients + gain.T @ (data - designs[0] @ coefficients)
        root = np.linalg.cholesky(_with_nugget(there - across.T @ gain, 0.0))
        made[row] = mean + posterior.scale[k] * (root @ random.standard_normal(mean.size))
    return (np.exp(made) if model.marginal is Lognormal else made) * model.grown(depth)


def _with_nugget(matrix: HostArray, nugget: float) -> HostArray:
    """A covariance with a nugget, and with what rounding takes from it."""
    return matrix + (nugget + 1e-6) * np.eye(len(matrix))
