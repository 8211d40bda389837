"""Matrices of flow between the cells of a grid, and their solution by multigrid with upright lines."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array
from jax.scipy.sparse.linalg import bicgstab

from jaxmpm.support.pytrees import pytree

DAMPING = 0.8
"""Share of a solution along upright lines that smoothing takes."""

ITERATIONS = 200
"""Largest number of iterations for one solution."""


def inner(shape: Sequence[int]) -> list[int]:
    """Axes along which cells have inner faces."""
    return [axis for axis, n in enumerate(shape) if n > 1]


def low(value: Array, axis: int) -> Array:
    """Values of the cells below each inner face along an axis."""
    return jax.lax.slice_in_dim(value, 0, value.shape[axis] - 1, axis=axis)


def high(value: Array, axis: int) -> Array:
    """Values of the cells above each inner face along an axis."""
    return jax.lax.slice_in_dim(value, 1, value.shape[axis], axis=axis)


def to_low(value: Array, axis: int) -> Array:
    """Values of inner faces, each at the cell below it."""
    return _padded(value, axis, (0, 1))


def to_high(value: Array, axis: int) -> Array:
    """Values of inner faces, each at the cell above it."""
    return _padded(value, axis, (1, 0))


def _padded(value: Array, axis: int, by: tuple[int, int]) -> Array:
    return jnp.pad(value, [by if axis == k else (0, 0) for k in range(value.ndim)])


@pytree
@dataclass(frozen=True)
class Matrix:
    """Storage and outer faces of cells on the diagonal, and flow from cell to cell, which is lost nowhere.

    Args:
        diagonal: of the cells' shape.
        below: for each of `inner` axes, rise of the flow through inner faces by the variable of the cell below.
        above: for each of them, fall of that flow by the variable of the cell above.
    """

    diagonal: Array
    below: tuple[Array, ...]
    above: tuple[Array, ...]

    def parts(self) -> Iterator[tuple[int, Array, Array]]:
        """Each axis with inner faces, and what they have on it."""
        yield from zip(inner(self.diagonal.shape), self.below, self.above, strict=True)

    def times(self, value: Array, *, turned: bool = False) -> Array:
        """Product with values of the cells' shape, of the transposed matrix if `turned`."""
        product = self.diagonal * value
        for axis, below, above in self.parts():
            under, over = low(value, axis), high(value, axis)
            if turned:
                product = product + to_low(below * (under - over), axis) + to_high(above * (over - under), axis)
            else:
                flow = below * under - above * over
                product = product + to_low(flow, axis) - to_high(flow, axis)
        return product

    def along_lines(self, value: Array, *, turned: bool = False) -> Array:
        """Solution with the flow along upright lines alone, of the transposed matrix if `turned`."""
        main, upright = self.diagonal, value.ndim - 1
        for axis, below, above in self.parts():
            main = main + to_low(below, axis) + to_high(above, axis)
        if value.shape[upright] == 1:
            return value / main
        lower, upper = (self.above[-1], self.below[-1]) if turned else (self.below[-1], self.above[-1])
        solved = jax.lax.linalg.tridiagonal_solve(
            to_high(-lower, upright), main, to_low(-upper, upright), value[..., None]
        )
        return solved[..., 0]

    def coarser(self) -> Matrix:
        """The matrix of cells of twice the width along level axes.

        Flow between wide cells has twice the way, so that half of the sum of the faces remains.
        """
        matrix = self
        for axis in inner(self.diagonal.shape[:-1]):
            diagonal = paired(matrix.diagonal, axis)
            faces = [
                tuple(_every_other(part, axis) / 2 if k == axis else paired(part, axis) for k, part in kept)
                for kept in (
                    [(a, below) for a, below, _ in matrix.parts() if a != axis or diagonal.shape[axis] > 1],
                    [(a, above) for a, _, above in matrix.parts() if a != axis or diagonal.shape[axis] > 1],
                )
            ]
            matrix = Matrix(diagonal, *faces)
        # Cells without soil and without neighbours have no equation of their own.
        total = matrix.diagonal
        for axis, below, above in matrix.parts():
            total = total + to_low(below, axis) + to_high(above, axis)
        return Matrix(jnp.where(total == 0, 1, matrix.diagonal), matrix.below, matrix.above)


def paired(value: Array, axis: int) -> Array:
    """Sums of pairs of cells along an axis; the last cell of an odd number stands alone."""
    n = value.shape[axis]
    even = _padded(value, axis, (0, n % 2))
    split = even.reshape(*value.shape[:axis], -1, 2, *value.shape[axis + 1 :])
    return jnp.sum(split, axis=axis + 1)


def _every_other(faces: Array, axis: int) -> Array:
    """Faces between pairs of cells."""
    return jax.lax.slice_in_dim(faces, 1, None, stride=2, axis=axis)


def _spread(value: Array, shape: tuple[int, ...]) -> Array:
    """Values of wide cells, each at the cells that it is made of."""
    for axis in range(len(shape) - 1):
        if value.shape[axis] < shape[axis]:
            value = jax.lax.slice_in_dim(jnp.repeat(value, 2, axis=axis), 0, shape[axis], axis=axis)
    return value


def _gathered(value: Array) -> Array:
    """Sums over the cells that wide cells are made of."""
    for axis in range(value.ndim - 1):
        value = paired(value, axis) if value.shape[axis] > 1 else value
    return value


def _levels(matrix: Matrix) -> list[Matrix]:
    """The matrix and coarser ones, down to one upright line."""
    levels = [matrix]
    while max(levels[-1].diagonal.shape[:-1], default=1) > 1:
        levels.append(levels[-1].coarser())
    return levels


def _cycle(levels: Sequence[Matrix], value: Array, turned: bool) -> Array:
    """One V-cycle from 0: smoothing along lines, correction by the next coarser level, smoothing."""
    matrix, *rest = levels
    if not rest:
        return matrix.along_lines(value, turned=turned)
    solution = DAMPING * matrix.along_lines(value, turned=turned)
    residual = value - matrix.times(solution, turned=turned)
    solution = solution + _spread(_cycle(rest, _gathered(residual), turned), value.shape)
    residual = value - matrix.times(solution, turned=turned)
    return solution + DAMPING * matrix.along_lines(residual, turned=turned)


def solved(matrix: Matrix, value: Array, tolerance: float, *, turned: bool = False) -> Array:
    """Solution for a right-hand side of the cells' shape.

    Columns are solved directly, sections and solids by stabilised biconjugate gradients after a cycle of multigrid.

    Args:
        matrix: of flow.
        value: right-hand side.
        tolerance: of the residual, as a share of the right-hand side.
        turned: whether to solve with the transposed matrix.

    Returns:
        The solution.
    """
    levels = _levels(matrix)
    if len(levels) == 1:
        return matrix.along_lines(value, turned=turned)
    times: Callable[[Array], Array] = lambda x: matrix.times(x, turned=turned)  # noqa: E731
    solution, _ = bicgstab(
        times, value, M=lambda x: _cycle(levels, x, turned), tol=tolerance, atol=0.0, maxiter=ITERATIONS
    )
    return solution


def differentiable(matrix: Matrix, value: Array, tolerance: float) -> Array:
    """Solution as of `solved` that may be differentiated and transposed by the right-hand side.

    Args:
        matrix: of flow.
        value: right-hand side.
        tolerance: of the residual, as a share of the right-hand side.

    Returns:
        The solution.
    """
    return jax.lax.custom_linear_solve(
        matrix.times,
        value,
        solve=lambda _, b: solved(matrix, b, tolerance),
        transpose_solve=lambda _, b: solved(matrix, b, tolerance, turned=True),
    )
