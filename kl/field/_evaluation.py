"""Values of an expansion on a lattice and at points."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from kl._checks import finite, is_traced, require
from kl.axis import Covariance, length_leaves, scaled_functions
from kl.field._bedding import rotate
from kl.field._expansion import Expansion
from kl.field._isotropic import Waves

# Floats of one chunk's intermediate: fits the second-level cache of a core.
_CHUNK_FLOATS = 2**16


def field_on_lattice(
    expansion: Expansion, coefficients: ArrayLike, axes: Sequence[ArrayLike], *, out: Array | None = None
) -> Array:
    """Standard Gaussian field on a lattice, by one contraction per axis.

    It warns if the lattice is too coarse for the correlation lengths.

    Args:
        expansion: without bedding (rotated strata have no lattice of products: use `field_at`).
        coefficients: (M,) or (B, M), standard normal.
        axes: d arrays of coordinates (N_1,), ..., (N_d,) in metres.
        out: array of the result's shape and dtype whose memory is reused; it is donated. Fresh memory costs more than
            the field.

    Returns:
        Field (N_1, .., N_d) or (B, N_1, .., N_d).

    Raises:
        ValueError: If the number of coefficients or axes does not fit, a coordinate lies outside the box, or the
            expansion has bedding.

    Example:
        >>> import jax, kl, numpy as np
        >>> lengths = (kl.SquaredExponential(20.0), kl.SquaredExponential(5.0))
        >>> expansion = kl.expand(lengths, (0.0, 0.0), (40.0, 10.0))
        >>> coefficients = kl.monte_carlo(jax.random.key(0), 3, expansion.modes)
        >>> kl.field_on_lattice(expansion, coefficients, (np.linspace(0, 40, 9), np.linspace(0, 10, 5))).shape
        (3, 9, 5)
    """
    if expansion.bedding is not None:
        raise ValueError("an expansion with bedding is separable only along the strata: use `field_at`")
    lattice = lattice_in_box(expansion, axes)
    for covariance, axis in zip(expansion.covariance, lattice, strict=True):
        warn_if_coarse(covariance, axis)
    batch = _batch_checked(expansion, coefficients)
    if out is None:
        return lattice_sum(expansion, batch, lattice)
    shape = (*batch.shape[:-1], *(axis.shape[0] for axis in lattice))
    require(out.shape == shape, f"out has shape {out.shape}, the result {shape}: give an array of that shape")
    return _lattice_sum_into(expansion, batch, lattice, out)


def lattice_in_box(expansion: Expansion, axes: Sequence[ArrayLike]) -> tuple[Array, ...]:
    """Coordinates `axes` (N_1,), ..., (N_d,) as arrays (m); ValueError if one lies outside the box."""
    require(len(axes) == len(expansion.axes), f"{len(axes)} axes for an expansion of {len(expansion.axes)}: give each")
    lattice = tuple(jnp.asarray(axis) for axis in axes)
    for number, axis in enumerate(lattice):
        require(axis.ndim == 1, f"coordinates of shape {axis.shape} along axis {number}: give (N,)")
        _require_inside(expansion, number, axis)
    return lattice


@partial(jax.jit, static_argnames="power")
def lattice_sum(expansion: Expansion, coefficients: Array, axes: tuple[Array, ...], power: int = 1) -> Array:
    """Sum over modes of coefficients times the modes to a power, on a lattice.

    Power 1 gives the field; power 2 with coefficients of 1 gives the captured variance.

    Args:
        expansion: without bedding.
        coefficients: (..., M).
        axes: d arrays of coordinates (N_1,), ..., (N_d,) in metres.
        power: 1 or 2; static.

    Returns:
        Sum (..., N_1, .., N_d).
    """
    factors = [(scaled_functions(modes, x) ** power).T for modes, x in zip(expansion.axes, axes, strict=True)]
    flat = coefficients.reshape(-1, coefficients.shape[-1])
    # One sample at a time: the intermediates then fit in cache.
    fields = jax.lax.map(lambda vector: contracted(coefficient_tensor(expansion, vector), factors), flat)
    return fields.reshape(*coefficients.shape[:-1], *fields.shape[1:])


def contracted(tensor: Array, factors: Sequence[Array]) -> Array:
    """A tensor (n_1, .., n_d) contracted along each axis with a matrix (N, n): (N_1, .., N_d)."""
    # Last axis first: the full lattice then appears only in the last, cheapest contraction, unpermuted.
    after = 1
    for factor in reversed(factors):
        tensor = factor @ tensor.reshape(-1, factor.shape[1], after)
        after *= factor.shape[0]
    return tensor.reshape([factor.shape[0] for factor in factors])


@partial(jax.jit, donate_argnums=3, keep_unused=True)
def _lattice_sum_into(expansion: Expansion, coefficients: Array, axes: tuple[Array, ...], out: Array) -> Array:
    return lattice_sum(expansion, coefficients, axes)


def warn_if_coarse(covariance: Covariance, x: Array) -> None:
    """Warn if the spacing of lattice coordinates `x` (N,) exceeds twice a correlation length."""
    length = jnp.asarray([float("inf"), *length_leaves(covariance)]).min()
    if is_traced(x, length) or x.shape[0] < 2:
        return
    spacing = float(jnp.abs(jnp.diff(x)).min())
    if spacing > 2 * float(length):
        warnings.warn(
            f"lattice spacing {spacing} m exceeds twice the correlation length {float(length)} m: neighbouring points "
            "are independent and cells hold no average; refine the lattice",
            stacklevel=3,
        )


def field_at(expansion: Expansion | Waves, coefficients: ArrayLike, points: ArrayLike) -> Array:
    """Standard Gaussian field at scattered points, chunk by chunk.

    Args:
        expansion: of dimension d, or the waves of `isotropic`.
        coefficients: (M,) or (B, M), standard normal.
        points: (d, N) in metres.

    Returns:
        Field (N,) or (B, N); NaN at traced points outside the box.

    Raises:
        ValueError: If the number of coefficients or rows does not fit, there are no points, or a point whose value is
            known lies outside the box.

    Example:
        >>> import jax
        >>> import jax.numpy as jnp
        >>> import kl
        >>> covariance = kl.Exponential(20.0), kl.SquaredExponential(2.0)
        >>> field = kl.expand(covariance, origin=(0.0, 0.0), extent=(40.0, 10.0), energy=0.95)
        >>> xi = kl.latin_hypercube(jax.random.key(1), 4, field.modes)
        >>> points = jnp.asarray([[1.0, 20.0, 39.0], [2.0, 5.0, 8.0]])
        >>> kl.field_at(field, xi, points).shape
        (4, 3)
    """
    if isinstance(expansion, Waves):
        return expansion.at(coefficients, points)
    return point_sum(expansion, _batch_checked(expansion, coefficients), points_in_box(expansion, points))


def points_in_box(expansion: Expansion, points: ArrayLike) -> Array:
    """Points (d, N) in the axes of the expansion's box (m); ValueError if one lies outside it."""
    inside = jnp.asarray(points)
    dimension = len(expansion.origin)
    require(inside.ndim == 2 and inside.shape[0] == dimension, f"points of shape {inside.shape}: give ({dimension}, N)")
    if expansion.bedding is not None:
        inside = rotate(expansion.bedding, inside)
    for number in range(dimension):
        _require_inside(expansion, number, inside[number])
    return inside


@partial(jax.jit, static_argnames="power")
def point_sum(expansion: Expansion, coefficients: Array, points: Array, power: int = 1) -> Array:
    """As `lattice_sum`, at scattered points (d, N) of the box: (..., N)."""
    batch = coefficients.shape[:-1]
    shape = tuple(axis.fractions.shape[0] for axis in expansion.axes)
    tensor = coefficient_tensor(expansion, coefficients).reshape(-1, shape[-1])

    def chunk(block: Array) -> Array:
        factors = [scaled_functions(axis, x) ** power for axis, x in zip(expansion.axes, block, strict=True)]
        # The barrier keeps the compiler from computing this again for each of its uses.
        sums = jax.lax.optimization_barrier(tensor @ factors[-1])
        for number in reversed(range(len(shape) - 1)):
            stack = sums.reshape(-1, shape[number], block.shape[1])
            # Term by term: XLA's reduction is not vectorised here.
            sums = sum(weight * stack[:, n] for n, weight in enumerate(factors[number]))
        return sums

    values = _in_chunks(chunk, points, _CHUNK_FLOATS // tensor.shape[0])
    return values.reshape(*batch, points.shape[1])


def _in_chunks(function: Callable[[Array], Array], points: Array, size: int) -> Array:
    """`function` (d, n) -> (..., n) over the columns of `points` (d, N), about `size` at a time."""
    count = points.shape[1]
    chunks = max(1, -(-count // max(64, size)))
    size = -(-count // chunks)
    # The last chunk is filled up with copies of the last point.
    padded = jnp.pad(points, ((0, 0), (0, chunks * size - count)), mode="edge")
    blocks = jnp.moveaxis(padded.reshape(points.shape[0], chunks, size), 1, 0)
    values = jnp.moveaxis(jax.lax.map(function, blocks), 0, -2)
    return values.reshape(*values.shape[:-2], chunks * size)[..., :count]


def _batch_checked(expansion: Expansion, coefficients: ArrayLike) -> Array:
    batch = jnp.asarray(coefficients)
    require(
        batch.ndim in (1, 2) and batch.shape[-1] == expansion.modes,
        f"coefficients of shape {batch.shape}: give ({expansion.modes},) or (B, {expansion.modes}), one for each mode",
    )
    finite("coefficients", batch)
    return batch


def _require_inside(expansion: Expansion, axis: int, x: Array) -> None:
    require(x.size > 0, f"no points along axis {axis}: give at least one")
    if is_traced(x):
        return
    finite(f"points along axis {axis}", x)
    low, size = expansion.origin[axis], expansion.extent[axis]
    least, most = float(x.min()), float(x.max())
    slack = 5e-6 * size
    require(
        low - slack <= least and most <= low + size + slack,
        f"points reach from {least} to {most} along axis {axis}, the expansion from {low} to {low + size}: "
        "expand on a box that holds all points",
    )


def coefficient_tensor(expansion: Expansion, coefficients: Array) -> Array:
    """Coefficients (..., M) scattered into the tensor of the axes' modes (..., n_1, .., n_d)."""
    shape = tuple(axis.fractions.shape[0] for axis in expansion.axes)
    flat = jnp.zeros((*coefficients.shape[:-1], int(np.prod(shape))), coefficients.dtype)
    position = jnp.ravel_multi_index(tuple(expansion.index), shape, mode="clip")
    return flat.at[..., position].set(coefficients, unique_indices=True).reshape(*coefficients.shape[:-1], *shape)
