"""Eigenpairs known in closed form: exponential, triangular and periodic covariance.

Both transcendental equations have the form g(w) = w L + 2 arctan(w b) - k pi = 0 (L the extent, w in 1/m), with
one root for each k. g rises and is concave, so Newton's method from the left converges without a safeguard.
One more Newton step outside the loop carries the exact derivative of the root with respect to the length.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from kl.axis._covariance import Exponential, Periodic, Triangular
from kl.axis._modes import SineModes
from kl.types import Parameter

_NEWTON_STEPS = 60


def _roots(extent: float, breadth: Parameter, turns: Array) -> Array:
    """Roots w (n,) above 0 of w extent + 2 arctan(w breadth) = turns * pi, for each of `turns` (n,), 1 or more."""

    def step(w: Array, breadth: Parameter) -> Array:
        value = w * extent + 2 * jnp.arctan(w * breadth) - turns * math.pi
        slope = extent + 2 * breadth / (1 + (w * breadth) ** 2)
        return w - value / slope

    start = (turns - 1) * (math.pi / extent)
    fixed = jax.lax.stop_gradient(breadth)
    w = jax.lax.fori_loop(0, _NEWTON_STEPS, lambda _, w: step(w, fixed), start)
    return step(jax.lax.stop_gradient(w), breadth)


def _sines(fractions: Array, w: Array, origin: float, extent: float) -> SineModes:
    """Functions cos(w x) and sin(w x) in turn, beginning with the even one; x is measured from the middle."""
    number = jnp.arange(w.shape[0])
    even = number % 2 == 0
    mean_square = (1 + jnp.where(even, 1, -1) * jnp.sinc(w * (extent / math.pi))) / 2
    # Positive at the origin, x = -extent / 2; the root lies in (k pi, (k + 1) pi) over the extent.
    phases = jnp.where(even, 0, math.pi / 2).astype(w.dtype)
    at_origin = jnp.cos(-w * (extent / 2) - phases)
    sign = jnp.where(jax.lax.stop_gradient(at_origin) < 0, -1, 1)
    return SineModes(fractions, w, phases, sign / jnp.sqrt(mean_square), origin, extent)


def exponential_modes(covariance: Exponential, count: int, origin: float, extent: float) -> SineModes:
    """Modes of exp(-|t|/l) with the largest eigenvalues.

    With c = 1/l and half extent a, even modes solve c = w tan(w a) and odd ones w = -c tan(w a);
    lambda = 2 c / (w^2 + c^2). Both are w L + 2 arctan(w l) = k pi.

    Source: Ghanem and Spanos (1991), doi:10.1007/978-1-4612-3094-6, Section 2.3.3.

    Args:
        covariance: with length l (m).
        count: number of modes.
        origin: start of the axis (m).
        extent: its length L (m).

    Returns:
        `count` modes, largest first.
    """
    length = jnp.asarray(covariance.length)
    w = _roots(extent, length, jnp.arange(1, count + 1).astype(length.dtype))
    return _sines(2 * length / (1 + (w * length) ** 2) / extent, w, origin, extent)


def triangular_modes(covariance: Triangular, count: int, origin: float, extent: float) -> SineModes:
    """Modes of 1 - |t|/l with the largest eigenvalues, on an axis no longer than l.

    Differentiating the integral equation twice gives f'' + w^2 f = 0 with lambda = 2 / (l w^2). The conditions at its
    ends give w (l - a) tan(w a) = 1 for even modes, a half the extent, and cos(w a) = 0 for odd ones.

    Source: Ghanem and Spanos (1991), doi:10.1007/978-1-4612-3094-6, Section 2.3.3.

    Args:
        covariance: with length l (m).
        count: number of modes.
        origin: start of the axis (m).
        extent: its length (m), at most l.

    Returns:
        `count` modes, largest first.
    """
    length = jnp.asarray(covariance.length)
    number = np.arange(count)
    roots = _roots(extent, length - extent / 2, jnp.asarray(number + 1, length.dtype))
    w = jnp.where(number % 2 == 0, roots, number * (math.pi / extent)).astype(length.dtype)
    return _sines(2 / (length * w**2) / extent, w, origin, extent)


def periodic_modes(covariance: Periodic, count: int, origin: float, extent: float) -> SineModes:
    """Fourier modes of a stationary covariance on its period: the constant, then cosine and sine of each wave.

    Eigenvalues are the spectral density at the wavenumbers 2 pi k / P; each but the first is double.
    """
    length = jnp.asarray(jax.tree.leaves(covariance)[0])
    wave = (np.arange(count) + 1) // 2
    w = jnp.asarray(2 * np.pi / extent * wave, length.dtype)
    sine = np.arange(count) % 2 == 0
    phases = jnp.asarray(np.where(sine & (wave > 0), np.pi / 2, 0), length.dtype)
    amplitudes = jnp.asarray(np.where(wave > 0, math.sqrt(2), 1), length.dtype)
    return SineModes(jnp.asarray(covariance.spectral_density(w)) / extent, w, phases, amplitudes, origin, extent)
