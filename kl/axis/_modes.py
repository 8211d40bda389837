"""Eigenpairs of one axis in the three forms that the solvers produce, and their evaluation at any point.

A form's `fractions` (n,) are the eigenvalues divided by the extent of the axis, so they sum to at most 1. Functions
have mean square 1 over the axis. `scaled_functions` multiplies them by the root of their fraction, so the captured
variance at a point is the sum of their squares. A form is a pytree: fractions and coefficients may be differentiated
and vmapped; the axis' origin and extent are static.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from kl._checks import pytree

# Rounding of a coordinate in float32 may put a point on the boundary just outside it.
_SLACK = 1e-5


@pytree
@dataclass(frozen=True)
class LegendreModes:
    """f_m(x) = sum over k of coefficients[m, k] p_k(t), t in [-1, 1] along the axis, p_k of mean square 1.

    Args:
        fractions: (n,) eigenvalues over the extent, largest first.
        coefficients: (n, order) of the polynomials.
        origin: start of the axis (m); static.
        extent: its length (m); static.
    """

    fractions: Array
    coefficients: Array
    origin: float = field(metadata={"static": True})
    extent: float = field(metadata={"static": True})


@pytree
@dataclass(frozen=True)
class CellModes:
    """f_m(x) = levels[m, cell of x]: piecewise constant on equal cells.

    Args:
        fractions: (n,) eigenvalues over the extent, largest first.
        levels: (n, cells) values.
        origin: start of the axis (m); static.
        extent: its length (m); static.
    """

    fractions: Array
    levels: Array
    origin: float = field(metadata={"static": True})
    extent: float = field(metadata={"static": True})


@pytree
@dataclass(frozen=True)
class SineModes:
    """f_m(x) = amplitudes[m] cos(wavenumbers[m] (x - middle of the axis) - phases[m]).

    Args:
        fractions: (n,) eigenvalues over the extent, largest first.
        wavenumbers: (n,), 1/m.
        phases: (n,), radians.
        amplitudes: (n,).
        origin: start of the axis (m); static.
        extent: its length (m); static.
    """

    fractions: Array
    wavenumbers: Array
    phases: Array
    amplitudes: Array
    origin: float = field(metadata={"static": True})
    extent: float = field(metadata={"static": True})


SolvedModes = LegendreModes | CellModes | SineModes


@pytree
@dataclass(frozen=True)
class AveragedModes:
    """Averages of an axis' functions over an interval around each point, as far as it lies on the axis.

    Args:
        modes: of the axis.
        size: length of the interval (m); static.
    """

    modes: SolvedModes
    size: float = field(metadata={"static": True})

    @property
    def fractions(self) -> Array:
        """Eigenvalues over the extent (n,), of the functions that are averaged."""
        return self.modes.fractions

    @property
    def origin(self) -> float:
        """Start of the axis (m)."""
        return self.modes.origin

    @property
    def extent(self) -> float:
        """Its length (m)."""
        return self.modes.extent


AxisModes = SolvedModes | AveragedModes
POINTS = 8
"""Of Gauss-Legendre, over which functions are averaged."""


def legendre(order: int, t: Array) -> Array:
    """Legendre polynomials of degree 0 to order - 1 at `t` (N,), scaled to mean square 1: (order, N)."""
    if order == 1:
        return jnp.ones_like(t)[None]

    def following(pair: tuple[Array, Array], degree: Array) -> tuple[tuple[Array, Array], Array]:
        before, last = pair
        return (last, ((2 * degree + 1) * t * last - degree * before) / (degree + 1)), last

    degrees = jnp.arange(1, order, dtype=t.dtype)
    _, rows = jax.lax.scan(following, (jnp.ones_like(t), t), degrees)
    roots = jnp.asarray(np.sqrt(2 * np.arange(order) + 1), t.dtype)
    return jnp.concatenate([jnp.ones_like(t)[None], rows]) * roots[:, None]


def functions(modes: AxisModes, x: Array) -> Array:
    """Eigenfunctions (n, N), of mean square 1, at x (N,) in metres; NaN outside the axis."""
    t = 2 * (x - modes.origin) / modes.extent - 1  # in [-1, 1] along the axis
    t = jnp.where(jnp.abs(t) <= 1 + _SLACK, t, jnp.nan)
    match modes:
        case LegendreModes():
            return modes.coefficients @ legendre(modes.coefficients.shape[1], t)
        case CellModes():
            cells = modes.levels.shape[1]
            cell = jnp.clip(jnp.floor((t + 1) * (cells / 2)), 0, cells - 1)
            inside = jnp.isfinite(t)
            return jnp.where(inside, modes.levels[:, jnp.where(inside, cell, 0).astype(int)], jnp.nan)
        case SineModes():
            angle = modes.wavenumbers[:, None] * (t * (modes.extent / 2)) - modes.phases[:, None]
            return modes.amplitudes[:, None] * jnp.cos(angle)
        case AveragedModes():
            end = modes.origin + modes.extent
            low, high = (jnp.clip(x + side * modes.size / 2, modes.origin, end) for side in (-1, 1))
            at, weight = np.polynomial.legendre.leggauss(POINTS)
            values = (
                share / 2 * functions(modes.modes, (low + high) / 2 + (high - low) / 2 * place)
                for place, share in zip(at.tolist(), weight.tolist(), strict=True)
            )
            return jnp.where(jnp.isfinite(t), sum(values, jnp.zeros(())), jnp.nan)


def scaled_functions(modes: AxisModes, x: Array) -> Array:
    """Eigenfunctions multiplied by the root of their share of the variance.

    Args:
        modes: n modes of an axis.
        x: (N,) coordinates (m).

    Returns:
        Values (n, N); NaN outside the axis.
    """
    positive = modes.fractions > 0
    root = jnp.where(positive, jnp.sqrt(jnp.where(positive, modes.fractions, 1)), 0)
    return root[:, None] * functions(modes, x)


def leading(modes: AxisModes, count: int) -> AxisModes:
    """The first modes of an axis.

    Args:
        modes: n modes, largest first.
        count: how many of them, at most n.

    Returns:
        `count` modes.
    """
    return jax.tree.map(lambda leaf: leaf[:count], modes)
