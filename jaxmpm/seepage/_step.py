"""One implicit step of Richards' equation in mixed form, solved by Newton's method and differentiated implicitly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm.grid import static
from jaxmpm.seepage._boundary import AnyCondition, AtSide, Soil, driven
from jaxmpm.seepage._cells import Cells
from jaxmpm.seepage._matrix import Matrix, differentiable, high, inner, low, solved, to_high, to_low
from jaxmpm.support import check
from jaxmpm.support.pytrees import pytree

MOST_ITERATIONS = 25
"""Iterations of Newton's method before a step counts as failed."""

HALVINGS = 6
"""Halvings of a change of Newton's method that does not reduce the residual."""

CLOSED = 1e-8
"""Residual of a step, as a share of the water that moves in it, at which it counts as solved."""

LINEAR = 1e-4
"""Residual of the linear equations of one iteration, as a share of that before."""

EXACT = {"float32": 1e-6, "float64": 1e-12}
"""The same where the linear equations give a derivative."""


@pytree
@dataclass(frozen=True)
class Problem:
    """Flow of water in cells of soil: the equation of Richards (1931), doi:10.1063/1.1745010.

    Args:
        active: of the cells' shape, 1 in soil; None if all are.
        soil: its values are numbers or of the cells' shape.
        conditions: at outer faces; no water crosses those without one.
        source: water that appears per volume and time (1/s), of the cells' shape; None without.
        shape: of the cells; static.
        spacing: edges of a cell (m); static.
        corner: lowest corner of the cells (m); static.
    """

    active: Array | None
    soil: Soil
    conditions: tuple[AnyCondition, ...]
    source: Array | None
    shape: tuple[int, ...] = static()
    spacing: tuple[float, ...] = static()
    corner: tuple[float, ...] = static()

    @property
    def cells(self) -> Cells:
        """The cells, on the host."""
        return Cells(
            self.shape, self.spacing, self.corner, None if self.active is None else np.asarray(self.active) > 0
        )

    @property
    def volume(self) -> Array:
        """Of soil in each cell (m3)."""
        full = jnp.full(self.shape, float(np.prod(self.spacing)), self.soil.conductivity.dtype)
        return full if self.active is None else full * self.active


def problem(cells: Cells, soil: Soil, *conditions: AtSide, source: Array | None = None) -> Problem:
    """Flow of water in cells.

    Args:
        cells: as of `cells` or `cells_under`.
        soil: its values are numbers or of the cells' shape.
        *conditions: as of `open_face`, `held_head`, `free_drainage` and `drain`; without one no water crosses a face.
        source: water that appears per volume and time (1/s), of the cells' shape.

    Returns:
        Problem.

    Raises:
        ValueError: If a value has the wrong shape, or two conditions share a face.
    """
    check.within_limits(soil)
    values = {name: getattr(soil, name) for name in type(soil).PARAMETERS}
    for name, value in values.items():
        if np.shape(value) not in ((), cells.shape):
            raise ValueError(f"{name} has shape {np.shape(value)}: give a number or one a cell, {cells.shape}")
    if source is not None:
        check.finite("source", source, "1/s")
        if np.shape(source) != cells.shape:
            raise ValueError(f"source has shape {np.shape(source)}: give one value a cell, {cells.shape}")
    sides = [condition.side for condition in conditions if condition.side]
    if twice := {side for side in sides if sides.count(side) > 1}:
        raise ValueError(f"two conditions at {', '.join(sorted(twice))}: give each side of the cells one")
    made = tuple(condition.of(cells) for condition in conditions)
    dtype = jnp.result_type(*values.values())

    def floating(value: Array) -> Array:
        return value.astype(dtype) if jnp.issubdtype(value.dtype, jnp.floating) else value

    soil = jax.tree.map(lambda value: jnp.broadcast_to(jnp.asarray(value, dtype), cells.shape), soil)
    return Problem(
        None if cells.active is None else jnp.asarray(cells.active, dtype),
        soil,
        jax.tree.map(floating, made),
        None if source is None else jnp.asarray(source, dtype),
        cells.shape,
        cells.spacing,
        cells.corner,
    )


class Balance(NamedTuple):
    """A step, by the heads at its end.

    Args:
        head: pressure heads (m).
        residual: more water in than stored, of each cell (m3/s).
        size: sum of its amounts (m3/s).
        allowed: what that may be (m3/s).
        saturation: effective one of each cell.
        water: in each cell per volume of soil, with what the specific storage adds.
        inflow: through faces and sources (m3/s).
        outflow: through faces and sinks (m3/s).
    """

    head: Array
    residual: Array
    size: Array
    allowed: Array
    saturation: Array
    water: Array
    inflow: Array
    outflow: Array


class Flowing:
    """The parts of a problem that no iteration changes."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.soil, self.volume = problem, problem.soil, problem.volume
        self.shape = self.soil.shape()
        last = len(problem.shape) - 1
        self.faces, soil = [], self.soil
        for axis in inner(problem.shape):
            h = problem.spacing[axis]
            conductivity = soil.conductivity * (1 if axis == last else soil.anisotropy)
            resistance = 0.5 / low(conductivity, axis) + 0.5 / high(conductivity, axis)
            between = float(np.prod(problem.spacing)) / h**2 / resistance
            if problem.active is not None:
                between = between * low(problem.active, axis) * high(problem.active, axis)
            steep = jnp.maximum(low(soil.steepness, axis), high(soil.steepness, axis))
            self.faces.append((axis, between, steep, h if axis == last else 0.0))
        self.at_faces = [
            jax.tree.map(lambda value, c=condition: value.ravel()[c.places.cell], (soil, self.shape))
            for condition in problem.conditions
        ]

    def inflows(self, head: Array, start: Array, end: Array) -> list[Array]:
        """Inflow (nf,) m3/s through the faces of each condition."""
        flat = head.ravel()
        return [
            condition.inflow(soil, shape, flat[condition.places.cell], start, end)
            for condition, (soil, shape) in zip(self.problem.conditions, self.at_faces, strict=True)
        ]

    def into(self, parts: list[Array]) -> Array:
        """Sums over the faces of each cell, of the cells' shape.

        One face of a cell is added after the other: a GPU would add them in any order.
        """
        total = jnp.zeros(self.volume.size, self.volume.dtype)
        for condition, part in zip(self.problem.conditions, parts, strict=True):
            places = condition.places
            for turn in range(places.turns):
                total = total.at[places.cell].add(jnp.where(places.turn == turn, part, 0))
        return total.reshape(self.volume.shape)

    def balance(self, head: Array, water: Array, start: Array, end: Array, rate: Array) -> Balance:
        """What a step leaves over that ends with pressure heads (m).

        Args:
            head: at its end (m).
            water: in each cell at its start, per volume of soil.
            start: of the step (s).
            end: of the step (s).
            rate: 1 over its duration (1/s); 0 for steady flow.

        Returns:
            Balance.
        """
        saturation, relative = self.soil.curves(head, self.shape)
        content = self.soil.content(saturation) + self.soil.storage * jnp.maximum(head, 0)
        stored = self.volume * (content - water) * rate
        inflows = self.inflows(head, start, end)
        residual = self.into(inflows) - stored
        if self.problem.source is not None:
            source = self.problem.source * self.volume
            residual, inflows = residual + source, [*inflows, source]
        inflow = sum((jnp.sum(jnp.maximum(part, 0)) for part in inflows), jnp.zeros_like(rate))
        outflow = sum((-jnp.sum(jnp.minimum(part, 0)) for part in inflows), jnp.zeros_like(rate))
        passing = jnp.sum(self.volume * content) * rate
        for axis, between, steep, rise in self.faces:
            under, over = low(head, axis), high(head, axis)
            flow = between * driven(under - over - rise, low(relative, axis), high(relative, axis), steep)
            residual = residual - to_low(flow, axis) + to_high(flow, axis)
            most = jnp.maximum(low(relative, axis), high(relative, axis))
            passing = passing + jnp.sum(between * most * (jnp.abs(under) + jnp.abs(over)))
        eps = float(jnp.finfo(head.dtype).eps)
        allowed = max(CLOSED, 8 * eps) * (jnp.sum(jnp.abs(stored)) + inflow + outflow) + 4 * eps * passing
        return Balance(head, residual, jnp.sum(jnp.abs(residual)), allowed, saturation, content, inflow, outflow)

    def matrix(self, head: Array, start: Array, end: Array, rate: Array) -> tuple[Matrix, Array]:
        """Fall of what is left over by head, and change of Newton's variable by head."""
        ones = jnp.ones_like(head)
        (_, relative), (slope, rises) = jax.jvp(lambda value: self.soil.curves(value, self.shape), (head,), (ones,))
        capacity = (self.soil.porosity - self.soil.residual) * slope + jnp.where(head > 0, self.soil.storage, 0)
        scale = self.soil.scale(head, slope, self.shape)
        _, gained = jax.jvp(lambda value: self.inflows(value, start, end), (head,), (ones,))
        diagonal = self.volume * capacity * rate - self.into(gained)
        below, above, slopes = [], [], jax.grad(lambda *arguments: jnp.sum(driven(*arguments)), argnums=(0, 1, 2))
        for axis, between, steep, rise in self.faces:
            ends = low(relative, axis), high(relative, axis)
            fall = low(head, axis) - high(head, axis) - rise
            by_fall, by_first, by_second = slopes(fall, *ends, steep)
            by_under = by_fall + low(rises, axis) * by_first
            by_over = by_fall - high(rises, axis) * by_second
            below.append(between * by_under)
            above.append(between * by_over)
        if self.problem.active is not None:
            # Cells without soil: their equation is 0 = 0, with a diagonal that vanishes beside all others.
            diagonal = jnp.where(self.problem.active > 0, diagonal, float(jnp.finfo(head.dtype).tiny) ** 0.5)
        return Matrix(diagonal, tuple(below), tuple(above)), scale

    def in_soil(self, change: Array) -> Array:
        """A change, none in cells without soil."""
        return change if self.problem.active is None else change * self.problem.active


def newton(
    problem: Problem, water: Array, guess: Array, start: Array, end: Array, rate: Array
) -> tuple[Balance, Array]:
    """Pressure heads at the end of an implicit step.

    Args:
        problem: of flow.
        water: in each cell at its start, per volume of soil.
        guess: of the heads (m).
        start: of the step (s).
        end: of the step (s).
        rate: 1 over its duration (1/s); 0 for steady flow.

    Returns:
        Balance, whose `size` is no more than `allowed` if the method converged, and the number of iterations.
    """
    flowing = Flowing(problem)

    def unsolved(state: tuple[Balance, Array]) -> Array:
        now, number = state
        return (now.size > now.allowed) & (number < MOST_ITERATIONS)

    def iterate(state: tuple[Balance, Array]) -> tuple[Balance, Array]:
        now, number = state
        matrix, scale = flowing.matrix(now.head, start, end, rate)
        change = flowing.in_soil(scale * solved(matrix, now.residual, LINEAR))

        def rises(search: tuple[Balance, Array, Array]) -> Array:
            tried, share, tries = search
            return (tries <= HALVINGS) & ~((tries > 0) & (tried.size <= (1 - 1e-4 * share) * now.size))

        def halve(search: tuple[Balance, Array, Array]) -> tuple[Balance, Array, Array]:
            _, share, tries = search
            share = jnp.where(tries > 0, share / 2, share)
            head = flowing.soil.moved(now.head, now.saturation, share * change, flowing.shape)
            return flowing.balance(head, water, start, end, rate), share, tries + 1

        found, _, _ = jax.lax.while_loop(rises, halve, (now, jnp.ones_like(rate), jnp.asarray(0)))
        return found, number + 1

    first = (flowing.balance(guess, water, start, end, rate), jnp.asarray(0))
    return jax.lax.while_loop(unsolved, iterate, first)


def stored_water(problem: Problem, head: Array) -> Array:
    """Water in each cell per volume of soil, with what the specific storage adds, at pressure heads (m)."""
    soil = problem.soil
    return soil.water_content(head) + soil.storage * jnp.maximum(head, 0)


@jax.custom_jvp
def implicit(problem: Problem, water: Array, guess: Array, start: Array, end: Array, rate: Array) -> Array:
    """Pressure heads of `newton`, differentiated by what the step depends on, not through its iterations."""
    return newton(problem, water, guess, start, end, rate)[0].head


@implicit.defjvp
def _implicit_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Array, Array]:
    problem, water, guess, start, end, rate = primals
    head = implicit(problem, water, guess, start, end, rate)

    def residual(problem: Problem, water: Array) -> Array:
        return Flowing(problem).balance(head, water, start, end, rate).residual

    _, change = jax.jvp(residual, (problem, water), tangents[:2])
    flowing = Flowing(problem)
    matrix, _ = flowing.matrix(head, start, end, rate)
    return head, flowing.in_soil(differentiable(matrix, change, EXACT[str(head.dtype)]))
