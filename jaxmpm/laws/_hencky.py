"""Finite strains: the elastic Hencky (logarithmic) strain, strained by a step's deformation before a law returns it.

The Kirchhoff stress J s is linear in the elastic strain 1/2 ln b, b the elastic left Cauchy-Green tensor. A return in
logarithmic strains has the form of one in small strains, so every law can be used unchanged; its plastic flow is the
exponential map. Elastic strain follows from the stress, so the state needs no further variable.

Sources: de Souza Neto, Peric and Owen (2008), doi:10.1002/9780470694626, Sections 14.3 to 14.5; Weber and Anand (1990),
doi:10.1016/0045-7825(90)90131-5.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jax import Array

from jaxmpm.laws._spectral import Matrix, isotropic
from jaxmpm.protocols import Component, Tensor
from jaxmpm.tensors import AXES, VOIGT, absent, by_component, placed, row_by_row


def logarithmic(elastic: Tensor, gradient: Sequence[Sequence[Array]], dt: Array) -> Tensor:
    """Elastic strain 1/2 ln(f b f^T) after a step of f = I + dt grad v, all of it elastic; b = exp(2 elastic).

    It computes b - I and its change, never b: in float32 strains of 1e-4 would lose three digits to the 1.

    Args:
        elastic: strain before the step.
        gradient: entries (i, j), the derivative of v_i along axis j (1/s).
        dt: time step (s).

    Returns:
        Strain tensor.
    """
    g: Matrix = [[0.0] * 3 for _ in range(3)]
    for a, i in enumerate(AXES[len(gradient)]):
        for b, j in enumerate(AXES[len(gradient)]):
            g[i][j] = dt * gradient[a][b]
    stretch, _ = isotropic(_stretch, elastic)
    stretch = row_by_row(stretch)
    h: Matrix = [[stretch[VOIGT[i][j]] for j in range(3)] for i in range(3)]
    turned = _sum(g, _product(g, h))  # g b
    twice = _product(turned, _transposed(g))  # g b g^T
    change = _sum(_sum(turned, _transposed(turned)), twice)
    both = placed((VOIGT[i][j], _before_and_after(h[i][j], change[i][j])) for i in range(3) for j in range(i, 3))
    logarithms, _ = isotropic(_logarithm, row_by_row(both))
    # The difference: equal rounding before and after then does not add up over a million steps at rest.
    return by_component(_grown, elastic, row_by_row(logarithms))


def _before_and_after(component: Component, change: Component) -> Component:
    after = _add(component, change)
    return jnp.stack([jnp.broadcast_to(component, after.shape), after]) if isinstance(after, Array) else after


def _grown(component: Component, both: Component) -> Component:
    return component + (both[1] - both[0]) if isinstance(both, Array) else component


def volumetric(gradient: Sequence[Sequence[Array]], dt: Array) -> Array:
    """Change of the logarithm of volume, ln det(I + dt grad v); not finite where the soil would invert.

    Args:
        gradient: entries (i, j), the derivative of v_i along axis j (1/s).
        dt: time step (s).

    Returns:
        (N,) change.
    """
    g = [[dt * entry for entry in row] for row in gradient]
    if len(g) == 1:
        return jnp.log1p(g[0][0])
    trace = sum(g[i][i] for i in range(len(g)))
    minors = sum(g[i][i] * g[j][j] - g[i][j] * g[j][i] for i in range(len(g)) for j in range(i))
    if len(g) == 2:
        return jnp.log1p(trace + minors)
    determinant = sum(
        g[0][i] * (g[1][j] * g[2][k] - g[1][k] * g[2][j]) for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    )
    return jnp.log1p(trace + minors + determinant)


def _stretch(*strains: Array) -> tuple[Array, Array, Array, Array]:
    """Principal values of b - I."""
    x, y, z = (jnp.expm1(2 * strain) for strain in strains)
    return x, y, z, jnp.zeros_like(x)


def _logarithm(*stretches: Array) -> tuple[Array, Array, Array, Array]:
    """Principal strains of principal values of b - I."""
    x, y, z = (jnp.log1p(stretch) / 2 for stretch in stretches)
    return x, y, z, jnp.zeros_like(x)


def _add(a: Component, b: Component) -> Component:
    return b if absent(a) else a if absent(b) else a + b


def _sum(a: Matrix, b: Matrix) -> Matrix:
    return [[_add(x, y) for x, y in zip(*rows, strict=True)] for rows in zip(a, b, strict=True)]


def _transposed(a: Matrix) -> Matrix:
    return [list(column) for column in zip(*a, strict=True)]


def _product(a: Matrix, b: Matrix) -> Matrix:
    result: Matrix = [[0.0] * 3 for _ in range(3)]
    for i in range(3):
        for j in range(3):
            for k in range(3):
                if not (absent(a[i][k]) or absent(b[k][j])):
                    result[i][j] = _add(result[i][j], a[i][k] * b[k][j])
    return result
