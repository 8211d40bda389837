"""Coefficients of samples: standard normal, (n_samples, n_modes), one row for each sample.

A row depends on the key, the number of its sample and the size of the design, never on the batch it is drawn in:
`rows` picks samples by number and gives the same rows as the whole design. Nor does it depend on the precision of JAX:
every draw is one of single precision, given in the default one.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax import Array
from jax.typing import ArrayLike

from kl._checks import require
from kl.marginal import from_both_tails
from kl.types import HostIndex

_SOBOL_BITS = 53
_DRAWN = jnp.float32
"""Precision of every draw, whatever the default of JAX."""
Rows: TypeAlias = ArrayLike | Sequence[int]


def _numbers(n_samples: int, n_modes: int, rows: Rows | None) -> HostIndex:
    for name, count in (("n_samples", n_samples), ("n_modes", n_modes)):
        whole = isinstance(count, int | np.integer)
        require(whole and count >= 1, f"{name} = {count} must be 1 or more, a whole number")
    if rows is None:
        return np.arange(n_samples)
    numbers = np.asarray(rows)
    require(
        numbers.ndim == 1 and (numbers.size == 0 or np.issubdtype(numbers.dtype, np.integer)),
        f"rows of shape {numbers.shape} and type {numbers.dtype}: give a list of sample numbers",
    )
    require((numbers >= 0) & (numbers < n_samples), f"rows reach outside 0 to {n_samples - 1}: give numbers of samples")
    return numbers


def monte_carlo(key: Array, n_samples: int, n_modes: int, *, rows: Rows | None = None) -> Array:
    """Independent standard normal coefficients.

    Args:
        key: a typed key.
        n_samples: size of the design.
        n_modes: number of coefficients of a sample.
        rows: numbers of the samples to draw, None for all.

    Returns:
        Coefficients (n_samples, n_modes), or (len(rows), n_modes).

    Raises:
        ValueError: If a size is not a whole number above 0, or a row lies outside the design.
    """
    return _normal_rows(key, jnp.asarray(_numbers(n_samples, n_modes, rows)), n_modes)


@partial(jax.jit, static_argnames="n_modes")
def _normal_rows(key: Array, numbers: Array, n_modes: int) -> Array:
    scores = jax.vmap(lambda number: jax.random.normal(jax.random.fold_in(key, number), (n_modes,), _DRAWN))(numbers)
    return scores.astype(jnp.result_type(float))


def latin_hypercube(key: Array, n_samples: int, n_modes: int, *, rows: Rows | None = None) -> Array:
    """Latin hypercube: in every mode one sample in each of n_samples equiprobable strata, at random within it.

    Each mode has its own stream, so a design with more modes begins with the columns of one with fewer.

    Source: McKay, Beckman and Conover (1979), doi:10.1080/00401706.1979.10489755.

    Args:
        key: a typed key.
        n_samples: size of the design.
        n_modes: number of coefficients of a sample.
        rows: numbers of the samples to draw, None for all.

    Returns:
        Coefficients (n_samples, n_modes), or (len(rows), n_modes).

    Raises:
        ValueError: If a size is not a whole number above 0, or a row lies outside the design.

    Example:
        >>> import jax, kl
        >>> from jax.scipy.stats import norm
        >>> coefficients = kl.latin_hypercube(jax.random.key(0), 4, 2)
        >>> sorted((4 * norm.cdf(coefficients[:, 0])).astype(int).tolist())  # one in each quarter
        [0, 1, 2, 3]
    """
    return _stratified_rows(key, jnp.asarray(_numbers(n_samples, n_modes, rows)), n_samples, n_modes)


@partial(jax.jit, static_argnames=("n_samples", "n_modes"))
def _stratified_rows(key: Array, numbers: Array, n_samples: int, n_modes: int) -> Array:
    def column(mode: Array) -> Array:
        order_key, within_key = jax.random.split(jax.random.fold_in(key, mode))
        stratum = jax.random.permutation(order_key, n_samples)[numbers]
        within = jax.random.uniform(within_key, (n_samples,), _DRAWN, 1e-6, 1 - 1e-6)[numbers]
        below = (stratum.astype(_DRAWN) + within) / n_samples
        above = ((n_samples - 1 - stratum).astype(_DRAWN) + (1 - within)) / n_samples
        return from_both_tails(below, above)

    return jax.lax.map(column, jnp.arange(n_modes)).T.astype(jnp.result_type(float))


def sobol(key: Array, n_samples: int, n_modes: int, *, rows: Rows | None = None) -> Array:
    """Scrambled Sobol points as normal scores, best at a power of 2 of samples.

    The most important modes should come first.

    Sources: scrambling: Owen (1998), doi:10.1006/jcom.1998.0487; directions: Joe and Kuo (2008), doi:10.1137/070709359.

    Args:
        key: a typed key.
        n_samples: size of the design.
        n_modes: number of coefficients of a sample, at most 21,201.
        rows: numbers of the samples to draw, None for all.

    Returns:
        Coefficients (n_samples, n_modes), or (len(rows), n_modes).

    Raises:
        ValueError: If a size is not a whole number above 0, a row lies outside the design, or there are too many modes.
    """
    numbers = _numbers(n_samples, n_modes, rows)
    from scipy.stats import qmc  # takes half a second and 60 MB, which nothing else here needs

    require(n_modes <= qmc.Sobol.MAXDIM, f"n_modes = {n_modes} exceeds Sobol's {qmc.Sobol.MAXDIM}: use latin_hypercube")
    seed = np.asarray(jax.random.key_data(key)).ravel()
    engine = qmc.Sobol(n_modes, scramble=True, bits=_SOBOL_BITS, rng=np.random.default_rng(seed))
    # Padding to a power of 2 does not change the sequence: its first n points are the same.
    points = engine.random_base2(max(0, int(n_samples - 1).bit_length()))[numbers]
    centred = points + 0.5 ** (_SOBOL_BITS + 1)
    return jnp.asarray(scipy.special.ndtri(centred), _DRAWN).astype(jnp.result_type(float))
