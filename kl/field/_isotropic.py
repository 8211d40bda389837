"""Fields whose correlation depends on the distance alone, as sums of plane waves.

An expansion of `kl.expand` is a product over the axes: at equal lengths its correlation along a diagonal differs from
that along an axis, unless it is squared exponential. Here the wavenumbers are drawn from the spectral density of an
isotropic correlation, once, and each wave has two coefficients. A sample has variance 1 everywhere, is defined at every
point of space, and is Gaussian. Its correlation is the average of cosines over the waves, near the given one.

Sources: Shinozuka and Deodatis (1991), Applied Mechanics Reviews 44, 191-204, doi:10.1115/1.3119501 (spectral
representation); Rasmussen and Williams (2006), Gaussian Processes for Machine Learning, Section 4.2.1 (the spectral
density of a Matern correlation is Student's t distribution of 2 nu degrees of freedom).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax import Array
from jax.typing import ArrayLike

from kl._checks import positive, pytree, require
from kl.field._bedding import Bedding, rotation_matrix

_CHUNK = 2**20
"""Floats of the waves at points that are held at once."""


@pytree
@dataclass(frozen=True)
class Waves:
    """A field of plane waves.

    Args:
        wavenumbers: (d, waves) 1/m.
        gains: what a mean over cells leaves of each wave (waves,); None of the field itself.
    """

    wavenumbers: Array
    gains: Array | None = None

    @property
    def modes(self) -> int:
        """Number of coefficients, two for each wave."""
        return 2 * self.wavenumbers.shape[1]

    @property
    def fractions(self) -> Array:
        """Share of the variance in each term (modes,)."""
        gains = jnp.ones(self.wavenumbers.shape[1]) if self.gains is None else self.gains
        return jnp.tile(gains**2, 2) / self.modes

    def matrix(self, points: ArrayLike) -> Array:
        """Value of each term at points, for `at` and `kl.field.condition_on`.

        Args:
            points: (d, N) m.

        Returns:
            (N, modes).

        Raises:
            ValueError: If points have another dimension.
        """
        at, dimension = jnp.asarray(points), self.wavenumbers.shape[0]
        require(at.ndim == 2 and at.shape[0] == dimension, f"points of shape {at.shape}: give ({dimension}, N)")
        phase = at.T @ self.wavenumbers
        gains = (1 if self.gains is None else self.gains) / math.sqrt(self.wavenumbers.shape[1])
        return jnp.concatenate([gains * jnp.cos(phase), gains * jnp.sin(phase)], axis=1)

    def at(self, coefficients: ArrayLike, points: ArrayLike) -> Array:
        """Standard Gaussian field at points.

        Args:
            coefficients: (modes,) or (B, modes), standard normal, from `kl.monte_carlo` and its kind.
            points: (d, N) m, anywhere.

        Returns:
            Field (N,) or (B, N).

        Raises:
            ValueError: If shapes do not fit.
        """
        numbers, at = jnp.asarray(coefficients), jnp.asarray(points)
        require(
            numbers.ndim in (1, 2) and numbers.shape[-1] == self.modes,
            f"coefficients of shape {numbers.shape}: give ({self.modes},), or a row of as many for each sample",
        )
        dimension = self.wavenumbers.shape[0]
        require(at.ndim == 2 and at.shape[0] == dimension, f"points of shape {at.shape}: give ({dimension}, N)")
        size = max(1, _CHUNK // self.modes)
        values = jax.lax.map(lambda point: numbers @ self.matrix(point[:, None])[0], at.T, batch_size=size)
        return jnp.moveaxis(values, 0, -1)

    def correlation(self, lag: ArrayLike) -> Array:
        """Correlation at lags (d, N) m: (N,)."""
        phase = jnp.asarray(lag).T @ self.wavenumbers
        return jnp.average(jnp.cos(phase), axis=1, weights=None if self.gains is None else self.gains**2)


def isotropic(
    smoothness: float, lengths: Sequence[float], *, waves: int = 1024, seed: int = 0, bedding: Bedding | None = None
) -> Waves:
    """A field of an isotropic Matern correlation c(r), r = |(x/l_x, y/l_y, z/l_z)|.

    Smoothness 1/2 is c = exp(-r), 3/2 is (1 + s) exp(-s) with s = sqrt(3) r, 5/2 likewise, and infinity
    exp(-r^2), each with the length of its family in `kl`. The wavenumbers are points of a scrambled Sobol sequence.

    Args:
        smoothness: nu, above 0; math.inf for the squared exponential.
        lengths: along each axis (d,) m; equal ones make a field that is the same in all directions, inf one that is
            constant along the axis.
        waves: their number, a power of 2. At smoothness 1/2 in 3D the largest error of the correlation over all lags is
            0.12 with 256, 0.06 with 1024 and 0.03 with 4096, its deviation a fifth of that; smoother fields have less.
        seed: of the scrambling.
        bedding: dip and strike of inclined strata; lengths are then along dip, strike and normal.

    Returns:
        The field.

    Raises:
        ValueError: If a number is out of range.

    Example:
        >>> import jax, kl
        >>> field = kl.field.isotropic(0.5, (5.0, 5.0), waves=256)
        >>> xi = kl.monte_carlo(jax.random.key(0), 3, field.modes)
        >>> field.at(xi, [[0.0, 3.0], [0.0, 4.0]]).shape
        (3, 2)
    """
    for name, value in (("length", min(lengths, default=0.0)), ("smoothness", min(smoothness, 1e300))):
        positive(name, value)
    require(isinstance(waves, int) and waves >= 2 and waves & (waves - 1) == 0, f"waves = {waves}: give a power of 2")
    dimension = len(lengths)
    from scipy.stats import qmc  # takes half a second, which nothing else here needs

    uniform = qmc.Sobol(dimension + 1, seed=seed).random(waves)
    uniform = np.clip(uniform, 1e-12, 1 - 1e-12)
    normal = scipy.special.ndtri(uniform[:, :dimension]).T
    if math.isinf(smoothness):
        scale = np.full(waves, math.sqrt(2))
    else:
        # A chi-squared variable of 2 nu degrees of freedom over their number.
        scale = 1 / np.sqrt(scipy.special.gammaincinv(smoothness, uniform[:, -1]) / smoothness)
    wavenumbers = normal * scale / np.asarray(lengths, float)[:, None]
    if bedding is not None:
        wavenumbers = rotation_matrix(bedding, dimension).T @ wavenumbers
    return Waves(jnp.asarray(wavenumbers, jnp.result_type(float)))
