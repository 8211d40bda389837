"""Correlation functions of lag along one axis; a field's covariance is their product over the axes.

Each family is a frozen dataclass whose `length` may be differentiated. Called with a lag it gives the correlation;
`spectral_density` gives its Fourier transform S(w) = integral of c(t) exp(-i w t) dt. Lengths of different families
are not comparable. Engineers state the scale of fluctuation theta = S(0) = 2 * integral of c over positive lags;
the class attribute `fluctuation` converts: theta = fluctuation * length. `smoothness` is nu of the families that are
Matern's.

Lags are in metres, arrays of NumPy (host, always float64) or JAX of any shape.

Sources: formulae and scales: Vanmarcke (2010), Random Fields, World Scientific, Table 5.1; Cami, Javankhoshdel, Phoon
and Ching (2020), doi:10.1061/AJRUA6.0001083, Table 1. Matern family: Rasmussen and Williams (2006), Gaussian
Processes for Machine Learning, Section 4.2.1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from types import ModuleType
from typing import ClassVar, Protocol, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from kl._checks import positive, pytree
from kl.types import EitherArray, Parameter

_IMAGES = 2000


class Covariance(Protocol):
    """The correlation at a lag and its spectral density: all that an axis needs."""

    def __call__(self, lag: EitherArray) -> EitherArray:
        """Correlation at a lag (m) of any shape, in [-1, 1]."""

    def spectral_density(self, wavenumber: EitherArray) -> EitherArray:
        """Fourier transform of the correlation (m) at a wavenumber (1/m) of any shape."""


def _namespace(array: EitherArray | float) -> ModuleType:
    return jnp if isinstance(array, jax.Array) else np


@pytree
@dataclass(frozen=True)
class SquaredExponential:
    """c(t) = exp(-(t/l)^2), without a factor 2 under the square; theta = sqrt(pi) l.

    Args:
        length: correlation length l (m).
    """

    length: Parameter
    fluctuation: ClassVar[float] = math.sqrt(math.pi)
    smoothness: ClassVar[float] = math.inf

    def __call__(self, lag: EitherArray) -> EitherArray:
        ratio = lag / self.length
        return _namespace(ratio).exp(-(ratio**2))

    def spectral_density(self, wavenumber: EitherArray) -> EitherArray:
        """S(w) = sqrt(pi) l exp(-(w l)^2 / 4), in m."""
        phase = wavenumber * self.length
        return math.sqrt(math.pi) * self.length * _namespace(phase).exp(-(phase**2) / 4)


@pytree
@dataclass(frozen=True)
class Exponential:
    """c(t) = exp(-|t|/l), first-order Markov; theta = 2 l.

    Args:
        length: correlation length l (m).
    """

    length: Parameter
    fluctuation: ClassVar[float] = 2.0
    smoothness: ClassVar[float] = 0.5

    def __call__(self, lag: EitherArray) -> EitherArray:
        ratio = _namespace(lag).abs(lag) / self.length
        return _namespace(ratio).exp(-ratio)

    def spectral_density(self, wavenumber: EitherArray) -> EitherArray:
        """S(w) = 2 l / (1 + (w l)^2), in m."""
        return 2 * self.length / (1 + (wavenumber * self.length) ** 2)


@pytree
@dataclass(frozen=True)
class Matern32:
    """c(t) = (1 + s) exp(-s) with s = sqrt(3) |t|/l, smoothness 3/2; theta = 4 l / sqrt(3).

    Args:
        length: correlation length l (m).
    """

    length: Parameter
    fluctuation: ClassVar[float] = 4 / math.sqrt(3)
    smoothness: ClassVar[float] = 1.5

    def __call__(self, lag: EitherArray) -> EitherArray:
        return SecondOrderMarkov(self.length / math.sqrt(3))(lag)

    def spectral_density(self, wavenumber: EitherArray) -> EitherArray:
        """S(w) = 4 b / (1 + (w b)^2)^2 with b = l / sqrt(3), in m."""
        return SecondOrderMarkov(self.length / math.sqrt(3)).spectral_density(wavenumber)


@pytree
@dataclass(frozen=True)
class Matern52:
    """c(t) = (1 + s + s^2/3) exp(-s) with s = sqrt(5) |t|/l, smoothness 5/2; theta = 16 l / (3 sqrt(5)).

    Args:
        length: correlation length l (m).
    """

    length: Parameter
    fluctuation: ClassVar[float] = 16 / (3 * math.sqrt(5))
    smoothness: ClassVar[float] = 2.5

    def __call__(self, lag: EitherArray) -> EitherArray:
        ratio = math.sqrt(5) * _namespace(lag).abs(lag) / self.length
        return (1 + ratio + ratio**2 / 3) * _namespace(ratio).exp(-ratio)

    def spectral_density(self, wavenumber: EitherArray) -> EitherArray:
        """S(w) = 16/3 b / (1 + (w b)^2)^3 with b = l / sqrt(5), in m."""
        scale = self.length / math.sqrt(5)
        return 16 / 3 * scale / (1 + (wavenumber * scale) ** 2) ** 3


@pytree
@dataclass(frozen=True)
class SecondOrderMarkov:
    """c(t) = (1 + |t|/l) exp(-|t|/l), Matern 3/2 with Vanmarcke's length; theta = 4 l.

    Args:
        length: correlation length l (m).
    """

    length: Parameter
    fluctuation: ClassVar[float] = 4.0

    def __call__(self, lag: EitherArray) -> EitherArray:
        ratio = _namespace(lag).abs(lag) / self.length
        return (1 + ratio) * _namespace(ratio).exp(-ratio)

    def spectral_density(self, wavenumber: EitherArray) -> EitherArray:
        """S(w) = 4 l / (1 + (w l)^2)^2, in m."""
        return 4 * self.length / (1 + (wavenumber * self.length) ** 2) ** 2


@pytree
@dataclass(frozen=True)
class CosineExponential:
    """c(t) = exp(-|t|/l) cos(t/l), negative at lags of half a bed's thickness; theta = l.

    Args:
        length: correlation length l (m).
    """

    length: Parameter
    fluctuation: ClassVar[float] = 1.0

    def __call__(self, lag: EitherArray) -> EitherArray:
        ratio = _namespace(lag).abs(lag) / self.length
        return _namespace(ratio).exp(-ratio) * _namespace(ratio).cos(ratio)

    def spectral_density(self, wavenumber: EitherArray) -> EitherArray:
        """S(w) = l / (1 + (w l - 1)^2) + l / (1 + (w l + 1)^2), in m."""
        phase = wavenumber * self.length
        return self.length / (1 + (phase - 1) ** 2) + self.length / (1 + (phase + 1) ** 2)


@pytree
@dataclass(frozen=True)
class Triangular:
    """c(t) = max(0, 1 - |t|/l); theta = l.

    Args:
        length: correlation length l (m).
    """

    length: Parameter
    fluctuation: ClassVar[float] = 1.0

    def __call__(self, lag: EitherArray) -> EitherArray:
        ratio = _namespace(lag).abs(lag) / self.length
        return _namespace(ratio).maximum(1 - ratio, 0)

    def spectral_density(self, wavenumber: EitherArray) -> EitherArray:
        """S(w) = l (sin(w l / 2) / (w l / 2))^2, in m."""
        phase = wavenumber * self.length / 2
        return self.length * _namespace(phase).sinc(phase / math.pi) ** 2


@pytree
@dataclass(frozen=True)
class Infinite:
    """c(t) = 1: the field does not vary along this axis (plane strain)."""

    def __call__(self, lag: EitherArray) -> EitherArray:
        return _namespace(lag).ones_like(lag)

    def spectral_density(self, wavenumber: EitherArray) -> EitherArray:
        """Raise ValueError: the density is a point mass at 0, not a function."""
        raise ValueError("Infinite has no spectral density: it has one mode along its axis, the constant")


@pytree
@dataclass(frozen=True)
class Periodic:
    """c(t) = sum over k of b(t + kP) / sum over k of b(kP), for a family b and a period P.

    Wrapping keeps the correlation positive definite: its Fourier coefficients are samples of b's spectral density.
    `expand` raises ValueError if P is not the extent of the axis or b's length exceeds 20 P.

    Args:
        base: the family b.
        period: P (m); static.
    """

    base: Covariance
    period: float = field(metadata={"static": True})

    def _images(self, lag: EitherArray) -> EitherArray:
        shifts = np.arange(-_IMAGES, _IMAGES + 1) * self.period
        return self.base(lag[..., None] + shifts).sum(-1)

    def __call__(self, lag: EitherArray) -> EitherArray:
        return self._images(lag) / self.variance()

    def variance(self) -> EitherArray:
        """Sum of the images at lag 0, by which the wrapped sum is divided."""
        namespace = _namespace(jax.tree.leaves(self.base)[0])
        return self._images(namespace.zeros(()))

    def spectral_density(self, wavenumber: EitherArray) -> EitherArray:
        """Fourier integral over one period (m); valid at multiples of 2 pi / P only."""
        return self.base.spectral_density(wavenumber) / self.variance()


class Scaled(Covariance, Protocol):
    """A family with a correlation `length` (m), of which its scale of fluctuation is a fixed multiple."""

    fluctuation: ClassVar[float]

    def __init__(self, length: Parameter) -> None: ...

    @property
    def length(self) -> Parameter:
        """Correlation length (m)."""


_Family = TypeVar("_Family", bound=Scaled)


_Some = TypeVar("_Some", bound=Covariance)


def from_scale_of_fluctuation(family: type[_Family], scale: Parameter) -> _Family:
    """Covariance of a family with a given scale of fluctuation.

    Args:
        family: class such as `Exponential`.
        scale: scale of fluctuation (m), above 0.

    Returns:
        The covariance, with length scale / fluctuation.

    Raises:
        ValueError: If the scale is not above 0.
    """
    positive("scale of fluctuation", scale, "m")
    return family(scale / family.fluctuation)


def scale_of_fluctuation(covariance: Scaled) -> Parameter:
    """Scale of fluctuation (m): 2 * integral of the correlation over positive lags.

    Args:
        covariance: of a family with a length.

    Returns:
        Scale of fluctuation (m).

    Raises:
        ValueError: If the covariance has no such scale, as `Infinite`.
    """
    if not hasattr(covariance, "fluctuation"):
        raise ValueError(f"{type(covariance).__name__} has no scale of fluctuation: give a family with a length")
    return covariance.fluctuation * covariance.length


def length_leaves(covariance: Covariance) -> list[Parameter]:
    """Correlation length of a covariance, that of the base for a wrapped family.

    Args:
        covariance: of an axis.

    Returns:
        List with the length, empty for `Infinite`.
    """
    return jax.tree.leaves(getattr(covariance, "base", covariance))


def on_host(covariance: _Some) -> _Some:
    """The same covariance with NumPy numbers, to evaluate on the host in float64.

    Args:
        covariance: of an axis, not traced.

    Returns:
        The same family.
    """
    return jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), covariance)
