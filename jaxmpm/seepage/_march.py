"""Flow in time: steps whose length follows from their error, their replay for derivatives, and the steady state."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from jaxmpm.ground import WATER_WEIGHT
from jaxmpm.seepage._boundary import Series
from jaxmpm.seepage._sample import Heads
from jaxmpm.seepage._step import Flowing, Problem, implicit, newton, stored_water
from jaxmpm.support import check
from jaxmpm.support.pytrees import pytree
from jaxmpm.support.text import shown

GROWTH, CUT = 3.0, 0.2
"""Largest growth of a step, and the share that remains of one that failed."""

SAFETY = 0.9
"""Share of the step that would just meet the tolerance."""

SHORTEST = 1e-12
"""Shortest step, as a share of the whole time."""

STEADY_STEPS = 60
"""Most growing steps towards the steady state."""


class FlowStatus(enum.IntEnum):
    """How the flow of a lane ended."""

    RUNNING = 0
    DONE = 1
    NO_CONVERGENCE = 2
    OUT_OF_STEPS = 3


class FlowRecord(NamedTuple):
    """One row a step; unused rows are 0.

    Args:
        duration: (steps,) s.
        rain: (steps,) that falls (m3).
        inflow: (steps,) through all faces and sources (m3).
        outflow: (steps,) through all faces and sinks (m3).
        stored: (steps,) change of the water in the soil (m3).
        iterations: (steps,) of Newton's method.
    """

    duration: Array
    rain: Array
    inflow: Array
    outflow: Array
    stored: Array
    iterations: Array


@pytree
@dataclass(frozen=True)
class Flow:
    """Pressure heads at times, with the balance of the water.

    Args:
        problem: that was solved.
        times: (n,) s.
        head: pressure heads (n, ...) m of the cells; at times that the flow did not reach those of the last step.
        status: () of `FlowStatus`.
        record: what each step did.
        steps: () number of steps.
        tries: () number of steps, those repeated included.
        reached: (n,) steps up to each time.
        stopped: () time of the last step (s).
        worst: () number of the cell with the largest residual in a step that did not converge.
    """

    problem: Problem
    times: Array
    head: Array
    status: Array
    record: FlowRecord
    steps: Array
    tries: Array
    reached: Array
    stopped: Array
    worst: Array

    @property
    def durations(self) -> np.ndarray:
        """Durations of the steps (steps,) s, of one lane on the host, for `replay`."""
        return np.asarray(self.record.duration)[: int(self.steps)]

    @property
    def balance_error(self) -> Array:
        """Water that each step so far has lost or gained (steps,), as a share of what has crossed faces by then."""
        record = self.record
        lost = jnp.abs(jnp.cumsum(record.stored - record.inflow + record.outflow))
        crossed = jnp.maximum(jnp.cumsum(record.inflow), jnp.cumsum(record.outflow))
        return jnp.where(crossed > 0, lost / jnp.where(crossed > 0, crossed, 1), 0)

    @property
    def runoff(self) -> Array:
        """Rain () m3 that has not entered where it fell.

        Seepage and what enters from pools are no part of it if rain is the only inflow.
        """
        return jnp.sum(self.record.rain - jnp.minimum(self.record.inflow, self.record.rain))

    def raise_if_failed(self) -> Flow:
        """The flow itself.

        Raises:
            ValueError: If it did not reach its end, in any lane: where, when, and what to change.
        """
        failed = np.flatnonzero(np.atleast_1d(np.asarray(self.status)) != FlowStatus.DONE)
        if not failed.size:
            return self
        lane = int(failed[0])
        status, time, worst, steps = (
            np.atleast_1d(np.asarray(leaf))[lane] for leaf in (self.status, self.stopped, self.worst, self.steps)
        )
        cells = self.problem.cells
        at = ", ".join(f"{x:.4g}" for x in cells.centres().reshape(len(cells.shape), -1)[:, int(worst)])
        of = f" in lane {lane} ({failed.size} lanes failed)" if np.ndim(self.status) else ""
        if status == FlowStatus.OUT_OF_STEPS:
            raise ValueError(
                f"the flow took all of its max_steps to {time:.4g} s, {int(steps)} of them good{of}: raise max_steps "
                "or the tolerance"
            )
        raise ValueError(
            f"the flow did not converge after {time:.4g} s{of}, worst at ({at}) m: give the soil there an air_entry "
            "above 0 or smaller cells, begin from a wetter state, or take float64"
        )

    def pressure(self, position: ArrayLike, time: ArrayLike, unit_weight: float = WATER_WEIGHT) -> Array:
        """Pore pressure at points at a time, linear between times and cells.

        Args:
            position: (d, N) m.
            time: () s, within the times.
            unit_weight: of water (N/m3).

        Returns:
            (N,) Pa, below 0 under suction.
        """
        return unit_weight * self.heads(time).at(position)

    def heads(self, time: ArrayLike) -> Heads:
        """Pressure heads at a time, linear between the times.

        Args:
            time: () s.

        Returns:
            Heads, which give values at points.

        Raises:
            ValueError: If the time lies outside the times.
        """
        ends = float(self.times[0]), float(self.times[-1])
        if not check.is_traced(time):
            check.between("time", float(np.asarray(time)), *ends, ends=True)
        at = jnp.asarray(time)
        if len(self.times) == 1:
            return Heads.of(self.problem, self.head[0])
        number = jnp.clip(jnp.searchsorted(self.times, at, side="right") - 1, 0, len(self.times) - 2)
        share = (at - self.times[number]) / (self.times[number + 1] - self.times[number])
        return Heads.of(self.problem, (1 - share) * self.head[number] + share * self.head[number + 1])


def hydrostatic(problem: Problem, level: ArrayLike) -> Array:
    """Pressure heads of water at rest.

    Args:
        problem: of flow.
        level: height of the water table (m), a number or one an upright line of cells.

    Returns:
        Heads of the cells' shape (m).
    """
    z = problem.cells.centres()[-1]
    return jnp.asarray(jnp.asarray(level)[..., None] - z, problem.soil.conductivity.dtype)


def run(
    problem: Problem,
    initial: ArrayLike,
    times: Sequence[float],
    *,
    tolerance: float = 0.005,
    first_step: float | None = None,
    max_steps: int = 2000,
) -> Flow:
    """Solve the flow from an initial state.

    Steps are implicit. Their length keeps the error of each in water content below the tolerance. `run` repeats a step
    that does not converge with a shorter one. Steps end at the times given, and at those at which rain changes.

    Args:
        problem: of flow.
        initial: pressure heads of the cells' shape, or one number (m), at time 0.
        times: rising, above 0 or beginning with 0 (s).
        tolerance: error of a step in water content.
        first_step: to try (s); by default a ten-thousandth of the first interval.
        max_steps: largest number of steps, those repeated included.

    Returns:
        Flow, whose status says whether it reached the end. No error is raised: see `Flow.raise_if_failed`.

    Raises:
        ValueError: If an argument is outside its limit.
    """
    at = np.asarray(times, float)
    if (
        at.ndim != 1
        or not at.size
        or at[0] < 0
        or np.any(np.diff(at) <= 0)
        or not np.all(np.isfinite(at))
        or at[-1] <= 0
    ):
        raise ValueError(f"times = {list(at.ravel())} s: give rising times, the last one above 0")
    check.positive("tolerance", tolerance)
    check.whole("max_steps", max_steps)
    head = _initial(problem, initial)
    breaks = [
        np.asarray(series.times, float)
        for condition in problem.conditions
        for series in (
            getattr(condition, "rain", None),
            getattr(condition, "level", None),
            getattr(condition, "head", None),
        )
        if isinstance(series, Series)
    ]
    stops = np.unique(np.concatenate([at, *breaks]))
    stops = stops[(stops > 0) & (stops <= at[-1])]
    after = at[at > 0]
    first = (stops[0] if first_step is None else first_step) * (1e-4 if first_step is None else 1)
    check.positive("first_step", first, "s")
    number = np.full(stops.size, -1)
    number[np.searchsorted(stops, after)] = np.arange(after.size)
    dtype = head.dtype
    flow = _run(
        problem,
        head,
        jnp.asarray(stops, dtype),
        jnp.asarray(number, jnp.int32),
        jnp.asarray(tolerance, dtype),
        jnp.asarray(first, dtype),
        outputs=after.size,
        max_steps=max_steps,
    )
    if after.size < at.size:
        at_start = jnp.zeros_like(flow.reached[:1])
        flow = replace(
            flow, head=jnp.concatenate([head[None], flow.head]), reached=jnp.concatenate([at_start, flow.reached])
        )
    return replace(flow, times=jnp.asarray(at, dtype))


def _initial(problem: Problem, initial: ArrayLike) -> Array:
    """Heads of the cells' shape, checked."""
    check.finite("initial", initial, "m")
    if np.shape(initial) not in ((), problem.shape):
        raise ValueError(f"initial has shape {np.shape(initial)}: give one number or {problem.shape}, one a cell")
    soil = problem.soil
    head = jnp.broadcast_to(jnp.asarray(initial, soil.conductivity.dtype), problem.shape)
    check.require(
        soil.saturation(head) > 1e4 * jnp.finfo(head.dtype).tiny,
        f"initial = {shown(initial)} m leaves soil without water in {head.dtype}: begin wetter, or take float64",
    )
    return head


class _State(NamedTuple):
    time: Array
    step: Array
    head: Array
    water: Array
    content: Array
    rate: Array
    stop: Array
    output: Array
    reached: Array
    status: Array
    record: FlowRecord
    steps: Array
    tries: Array
    worst: Array


@partial(jax.jit, static_argnames=("outputs", "max_steps"))
def _run(
    problem: Problem,
    head: Array,
    stops: Array,
    number: Array,
    tolerance: Array,
    first: Array,
    *,
    outputs: int,
    max_steps: int,
) -> Flow:
    """The loop over steps; one carry for all of it, so that lanes do not wait for each other at the stops."""
    flowing, soil = Flowing(problem), problem.soil
    dtype = head.dtype

    def running(state: _State) -> Array:
        return (state.status == FlowStatus.RUNNING) & (state.tries < max_steps)

    def step(state: _State) -> _State:
        end = stops[state.stop]
        remaining = end - state.time
        h = jnp.where(
            state.step >= remaining, remaining, jnp.where(2 * state.step > remaining, remaining / 2, state.step)
        )
        until = jnp.where(h == remaining, end, state.time + h)
        solution, iterations = newton(problem, state.water, state.head, state.time, until, 1 / h)
        solves = solution.size <= solution.allowed
        content = soil.content(solution.saturation)
        rate = (content - state.content) / h
        error = 0.5 * h * jnp.max(jnp.abs(rate - state.rate) * (flowing.volume > 0))
        tiny = h <= SHORTEST * stops[-1]
        good = solves & ((error <= tolerance) | tiny)
        factor = jnp.clip(SAFETY * jnp.sqrt(tolerance / jnp.maximum(error, 1e-3 * tolerance)), CUT, GROWTH)
        longer = jnp.where(h < state.step, jnp.maximum(state.step, factor * h), factor * h)
        next_step = jnp.where(good, longer, jnp.where(solves, factor, CUT) * h)
        offered = sum((c.offered(state.time, until) for c in problem.conditions), jnp.zeros((), dtype))
        row = FlowRecord(
            h,
            h * offered,
            h * solution.inflow,
            h * solution.outflow,
            jnp.sum(flowing.volume * (solution.water - state.water)),
            iterations.astype(dtype),
        )
        at = jnp.where(good, state.steps, max_steps)
        record = jax.tree.map(lambda rows, value: rows.at[at].set(value, mode="drop"), state.record, row)
        arrived = good & (until == end)
        out = jnp.where(arrived & (number[state.stop] >= 0), number[state.stop], outputs)
        steps = state.steps + good
        status = jnp.where(~solves & tiny, FlowStatus.NO_CONVERGENCE, FlowStatus.RUNNING)
        status = jnp.where(arrived & (state.stop == len(stops) - 1), FlowStatus.DONE, status)
        return _State(
            time=jnp.where(good, until, state.time),
            step=next_step,
            head=jnp.where(good, solution.head, state.head),
            water=jnp.where(good, solution.water, state.water),
            content=jnp.where(good, content, state.content),
            rate=jnp.where(good, rate, state.rate),
            stop=jnp.minimum(state.stop + arrived, len(stops) - 1),
            output=state.output.at[out].set(solution.head, mode="drop"),
            reached=state.reached.at[out].set(steps, mode="drop"),
            status=status,
            record=record,
            steps=steps,
            tries=state.tries + 1,
            worst=jnp.where(solves, state.worst, jnp.argmax(jnp.abs(solution.residual))),
        )

    zero = jnp.asarray(0)
    start = _State(
        time=jnp.zeros((), dtype),
        step=first,
        head=head,
        water=stored_water(problem, head),
        content=soil.water_content(head),
        rate=jnp.zeros_like(head),
        stop=zero,
        output=jnp.broadcast_to(head, (outputs, *head.shape)),
        reached=jnp.zeros(outputs, zero.dtype),
        status=jnp.full_like(zero, FlowStatus.RUNNING),
        record=FlowRecord(*(jnp.zeros(max_steps, dtype) for _ in FlowRecord._fields)),
        steps=zero,
        tries=zero,
        worst=zero,
    )
    done = jax.lax.while_loop(running, step, start)
    status = jnp.where(done.status == FlowStatus.RUNNING, FlowStatus.OUT_OF_STEPS, done.status)
    return Flow(
        problem, stops, done.output, status, done.record, done.steps, done.tries, done.reached, done.time, done.worst
    )


def replay(problem: Problem, initial: ArrayLike, durations: ArrayLike) -> Array:
    """Solve the flow in given steps; differentiable by the numbers of the problem.

    The derivative of each step is that of the implicit function theorem. The length of a step is a constant.

    Args:
        problem: of flow, whose numbers may be traced.
        initial: pressure heads of the cells' shape, or one number (m), at time 0.
        durations: of the steps (n,) s, such as `Flow.durations`.

    Returns:
        Pressure heads (n, ...) m at the end of each step.
    """
    check.positive("durations", durations, "s")
    head = _initial(problem, initial)
    return _replayed(problem, head, jnp.asarray(durations, head.dtype))


@jax.jit
def _replayed(problem: Problem, head: Array, durations: Array) -> Array:
    def step(state: tuple[Array, Array], h: Array) -> tuple[tuple[Array, Array], Array]:
        head, time = state
        end = implicit(problem, stored_water(problem, head), head, time, time + h, 1 / h)
        return (end, time + h), end

    _, heads = jax.lax.scan(step, (head, jnp.zeros((), head.dtype)), durations)
    return heads


def steady(problem: Problem, initial: ArrayLike, *, time: float = 0.0) -> tuple[Array, Array]:
    """Solve for steady flow under the rain, levels and heads of one time.

    Steps of growing length lead from the initial state to it; the last one is of infinite length. The answer is
    differentiable, and does not depend on the initial state.

    Args:
        problem: of flow.
        initial: pressure heads of the cells' shape (m), or one number.
        time: of rain, levels and heads (s).

    Returns:
        Pressure heads of the cells' shape (m), and whether the last step converged, () bool.
    """
    head = _initial(problem, initial)
    return _steady(problem, head, jnp.asarray(time, head.dtype))


@jax.jit
def _steady(problem: Problem, head: Array, time: Array) -> tuple[Array, Array]:
    fixed, guess = jax.lax.stop_gradient((problem, head))
    # Water of one cell through saturated soil: a time by which nothing has moved yet.
    quick = min(problem.spacing) / jnp.max(fixed.soil.conductivity) * 0.1
    last = quick * 1e12

    def moves(state: tuple[Array, Array, Array]) -> Array:
        _, step, tries = state
        return (step < last) & (tries < STEADY_STEPS)

    def move(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        head, step, tries = state
        solution, iterations = newton(fixed, stored_water(fixed, head), head, time, time, 1 / step)
        good = solution.size <= solution.allowed
        factor = jnp.where(good, jnp.where(iterations <= 4, 20.0, 4.0), CUT)
        factor = jnp.where(iterations == 0, last / step, factor)
        return jnp.where(good, solution.head, head), step * factor.astype(head.dtype), tries + 1

    near, *_ = jax.lax.while_loop(moves, move, (guess, quick, jnp.asarray(0)))
    never = jnp.zeros((), head.dtype)
    water = stored_water(fixed, near)
    found, _ = newton(fixed, water, near, time, time, never)
    return implicit(problem, water, found.head, time, time, never), found.size <= found.allowed


def infiltration(problem: Problem, head: Array, time: float = 0.0) -> list[Array]:
    """Flow through the faces of each condition.

    Args:
        problem: of flow.
        head: pressure heads of the cells' shape (m).
        time: of rain, levels and heads (s).

    Returns:
        For each condition (nf,) m3/s, positive inwards.
    """
    at = jnp.asarray(time, head.dtype)
    return Flowing(problem).inflows(head, at, at)
