"""Principal values and axes of symmetric tensors, and isotropic functions of them that differentiate everywhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeAlias

import jax
import jax.numpy as jnp
from jax import Array

from jaxmpm.protocols import Component, Tensor
from jaxmpm.storage import stored
from jaxmpm.tensors import VOIGT, absent, placed

SWEEPS = 5
"""Rounds of Jacobi's method: it converges quadratically, and after 5 a 3 x 3 matrix is diagonal to rounding."""

Matrix: TypeAlias = list[list[Component]]


def principal(tensor: Tensor) -> tuple[list[Array], Matrix]:
    """Principal values and axes of a symmetric tensor, by Jacobi's cyclic rotations.

    There are no branches, and equal values are as accurate in float32 as distinct ones. An absent shear component costs
    nothing; plane strain needs one rotation only.

    Source: Golub and Van Loan (2013), Matrix Computations, 4th ed., Section 8.5.

    Args:
        tensor: six components, each (N,) or absent.

    Returns:
        Three values (N,) in falling order, and the axes as columns of a 3 x 3 list.
    """
    a: Matrix = [[tensor[VOIGT[i][j]] for j in range(3)] for i in range(3)]
    axes: Matrix = [[1.0 if i == j else 0.0 for j in range(3)] for i in range(3)]
    for _ in range(SWEEPS):
        for p, q, r in ((0, 2, 1), (0, 1, 2), (1, 2, 0)):
            if not absent(a[p][q]):
                _rotate(a, axes, p, q, r)
    values = [jnp.asarray(a[i][i]) for i in range(3)]
    for i, j in ((0, 1), (1, 2), (0, 1)):
        swap = values[i] < values[j]
        values[i], values[j] = jnp.where(swap, values[j], values[i]), jnp.where(swap, values[i], values[j])
        for row in axes:
            row[i], row[j] = jnp.where(swap, row[j], row[i]), jnp.where(swap, row[i], row[j])
    return values, axes


def _rotate(a: Matrix, axes: Matrix, p: int, q: int, r: int) -> None:
    """Rotate in the plane (p, q) so that a[p][q] vanishes."""
    off, gap = a[p][q], a[q][q] - a[p][p]
    side = jnp.where(gap < 0, -1.0, 1.0)
    below = gap + side * jnp.sqrt(gap * gap + 4 * off * off)
    tangent = jnp.where(below == 0, 0, 2 * off / jnp.where(below == 0, 1, below))
    cosine = 1 / jnp.sqrt(1 + tangent * tangent)
    sine = tangent * cosine
    a[p][p], a[q][q] = a[p][p] - tangent * off, a[q][q] + tangent * off
    a[p][q] = a[q][p] = 0.0
    first, second = a[r][p], a[r][q]
    if not (absent(first) and absent(second)):
        a[r][p] = a[p][r] = cosine * first - sine * second
        a[r][q] = a[q][r] = sine * first + cosine * second
    for row in axes:
        row[p], row[q] = cosine * row[p] - sine * row[q], sine * row[p] + cosine * row[q]


def isotropic(function: Callable[..., tuple[Array, ...]], tensor: Tensor, *parameters: object) -> tuple[Tensor, Array]:
    """An isotropic tensor function, and a scalar that it also returns.

    The derivative is that of the tensor function, not of the axes, so it stays finite where principal values are equal.

    Sources: Carlson and Hoger (1986), doi:10.1090/qam/860898; de Souza Neto, Peric and Owen (2008),
    doi:10.1002/9780470694626, Appendix A.

    Args:
        function: function(x1, x2, x3, *parameters) takes the principal values in falling order and returns the three
            principal values of the result (on the same axes) and the scalar, elementwise.
        tensor: six components, each (N,) or absent.
        *parameters: pytrees of arrays, () or (N,).

    Returns:
        The resulting tensor and the scalar (N,).
    """
    present = tuple(k for k in range(6) if not absent(tensor[k]))
    components, scalar = _isotropic(function, present, tuple(tensor[k] for k in present), parameters)
    return placed(zip(present, components, strict=True)), scalar


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _isotropic(
    function: Callable[..., tuple[Array, ...]],
    present: tuple[int, ...],
    components: Sequence[Array],
    parameters: Sequence[object],
) -> tuple[tuple[Component, ...], Array]:
    values, axes = principal(placed(zip(present, components, strict=True)))
    *mapped, scalar = function(*values, *parameters)
    return tuple(_component(axes, mapped, k) for k in present), scalar


@_isotropic.defjvp
def _isotropic_jvp(
    function: Callable[..., tuple[Array, ...]],
    present: tuple[int, ...],
    primals: tuple[Sequence[Array], Sequence[object]],
    tangents: tuple[Sequence[Array], Sequence[object]],
) -> tuple[tuple[tuple[Component, ...], Array], tuple[tuple[Component, ...], Array]]:
    (components, parameters), (component_tangents, parameter_tangents) = primals, tangents
    # Stored, as XLA on CPU would compute all of it anew for each component and cotangent.
    x, axes = _stored_principal(*principal(placed(zip(present, components, strict=True))))
    *y, scalar = stored(function(*x, *parameters))
    out = tuple(_component(axes, y, k) for k in present), scalar
    tangent = placed(zip(present, component_tangents, strict=True))
    # The tangent on the principal axes.
    t = [
        stored(
            [
                jnp.asarray(sum(axes[k][i] * tangent[VOIGT[k][l]] * axes[l][j] for k in range(3) for l in range(3)))
                for j in range(3)
            ]
        )
        for i in range(3)
    ]
    _, direct = jax.jvp(lambda p: function(*x, *p), (parameters,), (parameter_tangents,))
    one, zero = jnp.ones_like(x[0]), jnp.zeros_like(x[0])
    slopes = [
        stored(
            jax.jvp(lambda *v: function(*v, *parameters), tuple(x), tuple(one if i == k else zero for i in range(3)))[1]
        )
        for k in range(3)
    ]
    along = [direct[i] + sum(slopes[k][i] * t[k][k] for k in range(3)) for i in range(4)]
    turned: Matrix = [[along[i] if i == j else 0.0 for j in range(3)] for i in range(3)]
    near = jnp.sqrt(jnp.finfo(x[0].dtype).eps) * (abs(x[0]) + abs(x[2]))
    for i, j in ((0, 1), (1, 2), (0, 2)):
        gap = x[i] - x[j]
        equal = gap <= near
        limit = (slopes[i][i] - slopes[j][i] + slopes[j][j] - slopes[i][j]) / 2
        ratio = jnp.where(equal, limit, (y[i] - y[j]) / jnp.where(equal, 1, gap))
        turned[i][j] = turned[j][i] = ratio * t[i][j]
    pairs = [(i, j) for i in range(3) for j in range(3)]
    positions = [_ENTRY[k] for k in present]
    result = tuple(sum(axes[m][i] * turned[i][j] * axes[n][j] for i, j in pairs) for m, n in positions)
    return out, (result, along[3])


def _stored_principal(values: Sequence[Array], axes: Matrix) -> tuple[list[Array], Matrix]:
    """Principal values and those entries of the axes that are arrays, stored before any use."""
    at = [(i, j) for i in range(3) for j in range(3) if not isinstance(axes[i][j], float)]
    kept = stored([*values, *(jnp.asarray(axes[i][j]) for i, j in at)])
    axes = [[*row] for row in axes]
    for (i, j), entry in zip(at, kept[3:], strict=True):
        axes[i][j] = entry
    return kept[:3], axes


_ENTRY = {0: (0, 0), 1: (1, 1), 2: (2, 2), 3: (0, 1), 4: (1, 2), 5: (0, 2)}


def _component(axes: Matrix, values: Sequence[Component], k: int) -> Component:
    row, column = _ENTRY[k]
    return sum(axes[row][i] * values[i] * axes[column][i] for i in range(3))
