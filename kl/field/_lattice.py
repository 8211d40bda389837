"""The exact, untruncated field on a lattice by Kronecker factors of its covariance.

The covariance matrix of a separable field on a lattice is the Kronecker product of the axes' matrices, and so is a
root of it. A sample is white noise multiplied by a small matrix along each axis. It is exact in covariance at the
lattice points but bound to them: noise on another lattice gives another field.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from kl._checks import finite, positive, pytree, require
from kl.axis import Covariance, length_leaves, on_host
from kl.field._evaluation import contracted, warn_if_coarse


@pytree
@dataclass(frozen=True)
class LatticeRoots:
    """Roots of the covariance on a lattice.

    Args:
        roots: d symmetric roots of the axes' covariance matrices, (N_i, N_i) each.
    """

    roots: tuple[Array, ...]


def exact_lattice(covariance: Sequence[Covariance], axes: Sequence[ArrayLike]) -> LatticeRoots:
    """Roots of the covariance on a lattice, computed on the host.

    Args:
        covariance: d correlation functions, one per axis.
        axes: d arrays of coordinates (N_i,) in metres.

    Returns:
        Roots for `exact_field`.

    Raises:
        ValueError: If a covariance is not positive definite on the lattice, a length is not above 0, or coordinates are
            not finite.
    """
    require(len(covariance) == len(axes), f"{len(covariance)} covariances for {len(axes)} axes: give one each")
    roots = []
    for family, axis in zip(covariance, axes, strict=True):
        for length in length_leaves(family):
            positive("correlation length", length, "m", remedy="`Infinite()` is a field constant along an axis")
        x = np.asarray(axis, np.float64)
        require(x.ndim == 1 and x.size > 0, f"coordinates of shape {x.shape}: give (N,) with N of 1 or more")
        finite("lattice coordinates", x)
        warn_if_coarse(family, jnp.asarray(axis))
        shares, vectors = np.linalg.eigh(on_host(family)(np.abs(x[:, None] - x)))
        require(
            shares[0] > -1e-9 * shares[-1],
            f"{type(family).__name__} is not positive definite on the lattice (smallest eigenvalue {shares[0]:.2e})",
        )
        roots.append(jnp.asarray((vectors * np.sqrt(np.maximum(shares, 0))) @ vectors.T, jnp.result_type(float)))
    return LatticeRoots(tuple(roots))


def exact_field(lattice: LatticeRoots, noise: ArrayLike) -> Array:
    """Standard Gaussian field from white noise.

    Args:
        lattice: from `exact_lattice`.
        noise: (N_1, .., N_d) or (B, N_1, .., N_d), standard normal, finite.

    Returns:
        Field of the shape of `noise`.

    Raises:
        ValueError: If the noise has another shape or is not finite.
    """
    white = jnp.asarray(noise)
    shape = tuple(root.shape[0] for root in lattice.roots)
    require(
        white.shape[-len(shape) :] == shape and white.ndim <= len(shape) + 1,
        f"noise of shape {white.shape}: give {shape}, or a batch of it",
    )
    finite("noise", white)
    return _exact_field(lattice, white)


@jax.jit
def _exact_field(lattice: LatticeRoots, noise: Array) -> Array:
    shape = tuple(root.shape[0] for root in lattice.roots)
    fields = jax.lax.map(lambda vector: contracted(vector, lattice.roots), noise.reshape(-1, *shape))
    return fields.reshape(noise.shape)
