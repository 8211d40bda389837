"""Symmetric tensors as six components, and the few components that 1D and 2D need.

A component that a dimension cannot have is the Python number 0.0, which vanishes when the program is traced.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array

from jaxmpm.protocols import Component, Tensor
from jaxmpm.storage import stored

# Axes of space (x, y, z = 0, 1, 2) that a 1D, 2D or 3D grid spans.
AXES: dict[int, tuple[int, ...]] = {1: (0,), 2: (0, 2), 3: (0, 1, 2)}

# Index of the component (i, j) of a symmetric tensor in xx, yy, zz, xy, yz, xz.
VOIGT = ((0, 3, 5), (3, 1, 4), (5, 4, 2))

# Components of the stress that the state has in 1D, 2D and 3D, and those among them that act on the grid.
CARRIED: dict[int, tuple[int, ...]] = {1: (0, 1, 2), 2: (0, 1, 2, 5), 3: (0, 1, 2, 3, 4, 5)}
ACTING: dict[int, tuple[int, ...]] = {1: (0,), 2: (0, 2, 5), 3: (0, 1, 2, 3, 4, 5)}


def rows(array: Array) -> list[Array]:
    """The entries of an array along its first axis.

    An index is transposed to a sum with zero padding, a split to a concatenation: reverse mode through a material is
    three times faster with a split.

    Args:
        array: (n, ...).

    Returns:
        n arrays (...).
    """
    return [row.reshape(array.shape[1:]) for row in jax.lax.split(array, (1,) * len(array))]


@partial(jax.custom_jvp, nondiff_argnums=(1, 2))
def spread(array: Array, count: int, axis: int) -> Array:
    """Repeat an array of length 1 along an axis.

    Args:
        array: of length 1 along `axis`.
        count: its new length.
        axis: number of the axis.

    Returns:
        Array of length `count` along `axis`.
    """
    return jnp.broadcast_to(array, [count if i == axis else n for i, n in enumerate(array.shape)])


@spread.defjvp
def _(count: int, axis: int, primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    # Transposed, a concatenation adds slices; a broadcast sums along a short axis, at ten times the time in XLA.
    return spread(*primals, count, axis), jnp.concatenate(tangents * count, axis=axis)


def expand(components: Array, dimension: int) -> Tensor:
    """The full tensor of the components that a state has, absent ones as 0.0.

    Args:
        components: (s, N).
        dimension: 1, 2 or 3.

    Returns:
        Six components.
    """
    return placed(zip(CARRIED[dimension], rows(components), strict=True))


def placed(components: Iterable[tuple[int, Component]]) -> Tensor:
    """The tensor with given components, the others absent.

    Args:
        components: pairs of index in xx, yy, zz, xy, yz, xz and component; a later pair replaces an earlier one.

    Returns:
        Six components.
    """
    full: list[Component] = [0.0] * 6
    for index, component in components:
        full[index] = component
    xx, yy, zz, xy, yz, xz = full
    return xx, yy, zz, xy, yz, xz


def by_component(function: Callable[..., Component], *tensors: Tensor) -> Tensor:
    """Apply a function to the components of tensors.

    Args:
        function: of one component of each tensor.
        *tensors: its arguments.

    Returns:
        Tensor of the results.
    """
    xx, yy, zz, xy, yz, xz = map(function, *tensors)
    return xx, yy, zz, xy, yz, xz


def entries(gradient: Array) -> list[list[Array]]:
    """The entries of a gradient, row by row.

    Args:
        gradient: (d, d, N).

    Returns:
        d lists of d arrays (N,).
    """
    d = len(gradient)
    flat = rows(gradient.reshape(d * d, *gradient.shape[2:]))
    return [flat[i * d : (i + 1) * d] for i in range(d)]


def compress(tensor: Tensor, dimension: int) -> Array:
    """The components that a state of this dimension has, stacked.

    Args:
        tensor: six components.
        dimension: 1, 2 or 3.

    Returns:
        (s, N).
    """
    return jnp.stack([tensor[index] for index in CARRIED[dimension]])


def acting(components: Array, dimension: int) -> Array:
    """The components that act on the grid.

    Args:
        components: those of a state (s, N).
        dimension: d, 1, 2 or 3.

    Returns:
        (d (d + 1) / 2, N).
    """
    if ACTING[dimension] == CARRIED[dimension]:
        return components
    full = expand(components, dimension)
    return jnp.stack([full[index] for index in ACTING[dimension]])


def strain_increment(gradient: Sequence[Sequence[Array]], dt: Array) -> Tensor:
    """Symmetric part of the velocity gradient times dt; shear components are tensorial.

    Args:
        gradient: entries (i, j), the derivative of v_i along axis j (1/s).
        dt: time step (s).

    Returns:
        Strain tensor.
    """
    axes = AXES[len(gradient)]
    return placed(
        (VOIGT[i][j], 0.5 * dt * (gradient[a][b] + gradient[b][a]) if a < b else dt * gradient[a][a])
        for a, i in enumerate(axes)
        for b, j in enumerate(axes)
        if a <= b
    )


def rotate(stress: Tensor, gradient: Sequence[Sequence[Array]], dt: Array) -> Tensor:
    """Rotate a stress by the Jaumann rate, s + dt (w s - s w) with w the spin of the velocity gradient.

    Args:
        stress: tensor (Pa).
        gradient: entries (i, j), the derivative of v_i along axis j (1/s).
        dt: time step (s).

    Returns:
        Tensor (Pa).
    """
    dimension = len(gradient)
    if dimension == 1:
        return stress
    axes = AXES[dimension]
    spin: list[list[Component]] = [[0.0] * 3 for _ in range(3)]
    for a, i in enumerate(axes):
        for b, j in enumerate(axes):
            if a < b:
                spin[i][j] = 0.5 * dt * (gradient[a][b] - gradient[b][a])
                spin[j][i] = -spin[i][j]

    def component(i: int, j: int) -> Component:
        return stress[VOIGT[i][j]]

    rotated = list(enumerate(stress))
    for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)):
        change: Component = 0.0
        for k in range(3):
            for s, t in ((spin[i][k], component(k, j)), (spin[j][k], component(k, i))):
                if not absent(s) and not absent(t):
                    change = change + s * t
        if not absent(change):
            rotated.append((VOIGT[i][j], component(i, j) + change))
    return placed(rotated)


def absent(component: Component) -> bool:
    """Whether a component is the number 0.0, which marks one that the dimension cannot have.

    Args:
        component: of a tensor.

    Returns:
        Whether it is absent.
    """
    return isinstance(component, float) and component == 0.0


def row_by_row(tensor: Tensor) -> Tensor:
    """The same tensor, with each component stored before any is used.

    It is for costly components. A step stacks them, and XLA on CPU would compute all that any of them needs in one
    loop, which it does not vectorise: a step with Mohr-Coulomb took seventy times as long.

    Args:
        tensor: six components.

    Returns:
        The same tensor.
    """
    present = [k for k in range(6) if not absent(tensor[k])]
    return placed(zip(present, stored(jnp.broadcast_arrays(*(tensor[k] for k in present))), strict=True))


def mean(tensor: Tensor) -> Array:
    """Mean of the normal components, a third of the trace.

    Args:
        tensor: six components.

    Returns:
        (N,).
    """
    return jnp.asarray((tensor[0] + tensor[1] + tensor[2]) / 3.0)


def deviator(tensor: Tensor) -> Tensor:
    """The tensor minus its mean.

    Args:
        tensor: six components.

    Returns:
        Tensor with trace 0.
    """
    m = mean(tensor)
    return (tensor[0] - m, tensor[1] - m, tensor[2] - m, tensor[3], tensor[4], tensor[5])


def with_mean(tensor: Tensor, value: Component) -> Tensor:
    """The tensor with another mean and the same deviator.

    Args:
        tensor: six components.
        value: new mean, (N,).

    Returns:
        Tensor.
    """
    change = value - mean(tensor)
    xx, yy, zz, xy, yz, xz = tensor
    return (xx + change, yy + change, zz + change, xy, yz, xz)


def second_invariant(deviatoric: Sequence[Component]) -> Component:
    """Second invariant J2 = s:s / 2 of a deviator.

    Args:
        deviatoric: tensor s of trace 0.

    Returns:
        (N,).
    """
    xx, yy, zz, xy, yz, xz = deviatoric
    return 0.5 * (xx * xx + yy * yy + zz * zz) + xy * xy + yz * yz + xz * xz


def dot(a: Array, b: Array) -> Array:
    """Sum of the products of components, in their order.

    XLA adds along an axis in an order that depends on the length of the others: sums at nodes would depend on how many
    of these are stored.

    Args:
        a: (..., d).
        b: (..., d), or (d,).

    Returns:
        (...).
    """
    return functools.reduce(operator.add, (a[..., k] * b[..., k] for k in range(a.shape[-1])))


@jax.custom_jvp
def safe_sqrt(x: Array) -> Array:
    """Square root of x >= 0 whose derivative at 0 is 0, not infinite.

    Args:
        x: of any shape.

    Returns:
        Array of the same shape.
    """
    # The root comes last: XLA computes a root once, but would recompute what a selection by x needs for every use.
    return jnp.sqrt(jnp.maximum(x, 0))


@safe_sqrt.defjvp
def _(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    # XLA computes a division once, but would recompute a product for every component that uses it.
    root, positive = safe_sqrt(*primals), primals[0] > 0
    return root, jnp.where(positive, tangents[0] / jnp.where(positive, 2 * root, 1.0), 0.0)
