"""Many samples of one scene through a fixed number of lanes: a lane that ends takes the next sample at once."""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence, Sized
from dataclasses import replace
from itertools import count, islice, zip_longest
from typing import Any

import jax
import numpy as np
from jax import Array
from tqdm import tqdm

from jaxmpm.run._batch import Batch, Chunk, Hooks, Sample
from jaxmpm.run._checks import check_state
from jaxmpm.run._integrate import Result
from jaxmpm.run._stopping import Condition, Rule, SlidesEnd, check_duration, check_rules
from jaxmpm.setup import check_names, check_scene, check_start, vary
from jaxmpm.support import check
from jaxmpm.types import Scene, State

NO_HOOKS = Hooks()


def solve_each(
    scene: Scene,
    state: State,
    varied: Mapping[str, Iterable[Array]],
    *,
    width: int,
    t_end: float | SlidesEnd,
    numbers: Iterable[int] | None = None,
    rules: Sequence[Rule | Condition] = (),
    every: float = 0.25,
    snapshots: Sequence[float] = (),
    progress: bool = False,
    hooks: Hooks = NO_HOOKS,
) -> Iterator[tuple[int, Result]]:
    """Run every sample and yield each result when its sample ends, not in order.

    A result depends neither on `width` nor on the other samples. On a GPU, where lanes run in parallel, the batch
    shrinks to a quarter of its lanes once the last samples fit into these. A sample with a value that is not finite or
    beyond its limit takes no step and ends as BAD_PARAMETER.

    Args:
        scene: that samples vary.
        state: at which all start; at rest if stiffness or weight vary.
        varied: parameters that differ, name -> one value per sample, () or (N,), of walls () or (nodes,), drawn lazily
            as lanes become free: `{"strength": strengths}`, `{"strength": strengths, "young": moduli}`. Names are those
            of `with_soil`: any parameter of the material, young (Pa), poisson, unit_weight (N/m3), water_level (m),
            pore_pressure (Pa), wall_friction, wall_cohesion (Pa), wall_pressure (Pa). If stiffness, weight, pore
            pressure or the water's level vary, every sample has its own initial stress and time step.
        width: number of lanes.
        t_end: as for `solve`, reached to a few steps; or a `jaxmpm.run.SlidesEnd`, by which samples that slide then go
            on. Their motion before it, and all other samples, do not change.
        numbers: of the samples, drawn with them; by default 0, 1, 2, ...
        rules: as for `solve`.
        every: time between two checks of the rules (s).
        snapshots: times (s); for each a result has the state of the first check from then on, with the time of that
            check. A sample that has ended has its last state.
        progress: show a bar with the samples that have ended.
        hooks: functions that are called on the host before a sample starts and after every chunk of steps.

    Yields:
        Number and result of each sample.

    Raises:
        ValueError: If the width is below 1, a name is no parameter, values have other shapes or numbers, an end of a
            run or the time of a snapshot is invalid, or a number in `scene` itself is beyond its limit.

    Example:
        >>> import jaxmpm as mpm
        >>> soil = mpm.Soil(young=5e6, strength=9e3)
        >>> scene, state = mpm.column(4.0, soil, mpm.Discretisation(cell=1.0, spacing=(0.5,)))
        >>> samples = {"strength": [9e3, 20e3, 30e3]}
        >>> runs = mpm.solve_each(scene, state, samples, width=2, t_end=0.1)
        >>> sorted((number, mpm.Status(int(result.status)).name) for number, result in runs)
        [(0, 'FINISHED'), (1, 'FINISHED'), (2, 'FINISHED')]
    """
    check.whole("width", width)
    slides_end = t_end if isinstance(t_end, SlidesEnd) else None
    t_end = t_end.t_end if isinstance(t_end, SlidesEnd) else t_end
    check_duration(t_end, every)
    outside = [time for time in snapshots if not 0 <= time <= t_end]
    if outside:
        raise ValueError(f"snapshots at {outside} s lie outside the run: give times from 0 to t_end = {t_end} s")
    check_state(scene, state, None)
    checked = check_rules(rules, scene, state)
    check_scene(scene)
    if not isinstance(varied, Mapping) or not varied:
        raise ValueError("varied is empty: give the parameters that samples differ in, as in {'strength': strengths}")
    check_names(scene, varied)
    check_start(state, varied)
    samples = (
        Sample(number, *vary(scene, state, values), hooks.resume)
        for number, values in _numbered_samples(varied, numbers)
    )
    first = list(islice(samples, width))
    if not first:
        return
    sizes = [len(column) for column in varied.values() if isinstance(column, Sized)]
    taken, times = defaultdict[int, list[tuple[float, State]]](list), sorted(snapshots)
    batch = Batch.of(scene, first, checked, t_end=t_end, every=every)
    # A generator that is left half way closes its bar.
    with tqdm(total=min(sizes, default=None), unit="run", disable=not progress) as bar:
        while batch.busy:
            batch = batch.advanced(slides_end)
            if hooks.on_chunk is not None:
                hooks.on_chunk(Chunk(len(batch.numbers), len(batch.busy), int(batch.chunk.max())))
            if hooks.observe is not None:
                for lane in batch.busy:
                    hooks.observe(batch.number(lane), batch.seconds(lane), batch.midway(lane))
            for lane in batch.busy if times else ():
                states, now = taken[batch.number(lane)], batch.seconds(lane)
                due = bisect_right(times, now) - len(states)
                states += [(now, jax.device_get(batch.midway(lane).state))] * due if due > 0 else []
            for lane in batch.ended:
                number, result, end = batch.number(lane), batch.result(lane), batch.seconds(lane)
                if times:
                    seen = taken.pop(number, [])
                    seen += [(end, result.state)] * (len(times) - len(seen))
                    result = replace(
                        result, times=tuple(time for time, _ in seen), snapshots=tuple(state for _, state in seen)
                    )
                bar.update()
                yield number, result
                batch = batch.refill(lane, next(samples, None))
            batch = batch.shrink(len(first))


def _numbered_samples(
    varied: Mapping[str, Iterable[Array]], numbers: Iterable[int] | None
) -> Iterator[tuple[int, dict[str, Array]]]:
    """Number and values of each sample, drawn one by one; ValueError for names with fewer values than others."""
    columns: dict[str, Iterable[Any]] = {**({} if numbers is None else {"numbers": numbers}), **varied}
    sizes = {name: len(column) for name, column in columns.items() if isinstance(column, Sized)}
    if len(set(sizes.values())) > 1:
        raise ValueError(f"varied has unequal numbers of values, {sizes}: give one of each name for each sample")
    none = object()
    shapes: dict[str, tuple[int, ...]] = {}
    for position, values in zip(count(), zip_longest(*columns.values(), fillvalue=none)):
        ended = [name for name, value in zip(columns, values, strict=True) if value is none]
        if ended:
            raise ValueError(f"{ended} has {position} values, other names have more: give one for each sample")
        sample = dict(zip(columns, values, strict=True))
        now = {name: np.shape(sample[name]) for name in varied}
        shapes = shapes or now
        if now != shapes:
            raise ValueError(
                f"sample {position} has values of shapes {now}, the first {shapes}: give all samples the same"
            )
        yield (position if numbers is None else sample.pop("numbers")), sample
