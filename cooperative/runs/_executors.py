"""Samples through worker processes, or through any `concurrent.futures.Executor`.

A task is a scene's text, a grid, a sample's number and its coefficients: a worker makes everything else again from
these, once per scene and grid, and sends back the finished sample. Only the controller writes samples; a worker that
sees the campaign's folder keeps the restart point of its long run there.
"""

from __future__ import annotations

import multiprocessing
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from cooperative.runs import _model as screening
from cooperative.scene import parse
from cooperative.store import Sample

ATTEMPTS = 3
"""How often a sample is tried before it is given up and reported."""

LOST = "WORKER_LOST"
"""Status of a sample whose worker died at every attempt."""


def process_pool(workers: int) -> ProcessPoolExecutor:
    """Worker processes, each bound to its own share of the cores, so that they do not fight for them."""
    if workers < 1:
        raise ValueError(f"workers = {workers}: give 1 or more")
    cores = sorted(os.sched_getaffinity(0))
    share = max(1, len(cores) // workers)
    context = multiprocessing.get_context("spawn")
    shares: Any = context.SimpleQueue()
    for worker in range(workers):
        first = worker * share % len(cores)
        shares.put(cores[first : first + share])
    return ProcessPoolExecutor(workers, mp_context=context, initializer=_bind, initargs=(shares,))


def _bind(shares: Any) -> None:
    """Take a share of the cores; a worker that replaces a dead one finds none left and takes all."""
    if not shares.empty():
        os.sched_setaffinity(0, shares.get())


def run_sample(
    text: str, grid: str, number: int, coefficients: np.ndarray, stop_at: float | None, restart_in: Path | None
) -> Sample:
    """Run one sample of a scene on one of its grids; what a worker does. restart_in: see `screening.run_samples`."""
    one, model = {number: coefficients}, _prepared(text, grid)
    return next(iter(screening.run_samples(model, one, one, width=1, stop_at=stop_at, restart_in=restart_in)))


@lru_cache(maxsize=2)
def _prepared(text: str, grid: str) -> screening.GridModel:
    config = parse(text)
    return screening.build(config, grid, screening.expansion_of(config))


class WorkerLost(RuntimeError):
    """Every worker that was given a task died of it, as often as its executor allows; other tasks go on."""


@dataclass
class Workers:
    """An executor that is made when first needed, kept from one stage to the next, and made anew when it breaks.

    make: gives an executor. count: samples handed out to it at a time.
    """

    make: Callable[[], Executor]
    count: int
    executor: Executor | None = None

    def submit(self, *task: Any) -> Future[Sample]:
        """Hand out one sample, as `run_sample` takes it."""
        if self.executor is None:
            self.executor = self.make()
        return self.executor.submit(run_sample, *task)

    def close(self) -> None:
        """Let the executor go; tasks not started are dropped."""
        if self.executor is not None:
            self.executor.shutdown(wait=True, cancel_futures=True)
            self.executor = None


def run_through(
    workers: Workers,
    text: str,
    grid: str,
    numbers: Iterable[int],
    coefficients: np.ndarray,
    *,
    stop_at: float | None = None,
    restart_in: Path | None = None,
) -> Iterator[Sample]:
    """Run the samples with these numbers, rows of `coefficients`, through an executor; yields each as it ends.

    Numbers are drawn one by one as places become free. The samples of a worker that was killed are handed out again;
    one whose worker dies three times is given back with status WORKER_LOST, so that it is reported, not tried for ever.
    """
    waiting = iter(numbers)
    tries: Counter[int] = Counter()
    pending: dict[Future[Sample], int] = {}

    def submit(number: int) -> None:
        tries[number] += 1
        pending[workers.submit(text, grid, number, coefficients[number], stop_at, restart_in)] = number

    while True:
        for number in islice(waiting, workers.count - len(pending)):
            submit(number)
        if not pending:
            return
        done, _ = wait(pending, return_when=FIRST_COMPLETED)
        lost: list[int] = []
        for future in done:
            number = pending.pop(future)
            try:
                sample = future.result()
            except WorkerLost:
                sample = _given_up(number)
            except BrokenExecutor:
                lost.append(number)
                continue
            yield sample
        if lost:
            # A broken pool drops all it held, and does not say whose worker died.
            lost += pending.values()
            pending.clear()
            workers.close()
            for number in lost:
                if tries[number] < ATTEMPTS:
                    submit(number)
                else:
                    yield _given_up(number)


def dask_executor(client: Any) -> Callable[[], Executor]:
    """Makes the executor that runs samples on a Dask cluster, for `campaign.run(..., executor=...)`.

    client: a `distributed.Client`, which stays open, or the address of a scheduler, "tcp://host:8786". Dask itself runs
    the sample of a dead worker again, on another one; a sample that kills as many as Dask's `allowed-failures` is given
    back with status WORKER_LOST. Needs the extra `dask`; raises ValueError where that is not installed.
    """
    try:
        import distributed
    except ImportError as error:
        raise ValueError("Dask is not installed: install jaxmpm[dask]") from error

    def make() -> Executor:
        if isinstance(client, str):
            return _DaskExecutor(distributed.Client(client), owned=True)
        return _DaskExecutor(client, owned=False)

    return make


class _DaskExecutor(Executor):
    """A Dask client as `concurrent.futures` knows executors. owned: whether the client ends with it."""

    def __init__(self, client: Any, *, owned: bool) -> None:
        self.client, self.owned = client, owned
        self.tasks: set[Any] = set()

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        task = self.client.submit(function, *args, **kwargs, pure=False)
        # Dask drops a task that nobody holds.
        self.tasks.add(task)

        def hand_over(task: Any) -> None:
            self.tasks.discard(task)
            error = None if task.cancelled() else task.exception()
            if task.cancelled():
                future.cancel()
                future.set_running_or_notify_cancel()
            elif type(error).__name__ == "KilledWorker":
                future.set_exception(WorkerLost(str(error)))
            elif error is not None:
                future.set_exception(error)
            else:
                future.set_result(task.result())

        task.add_done_callback(hand_over)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        if cancel_futures:
            self.client.cancel(list(self.tasks))
        if self.owned:
            self.client.close()


def _given_up(number: int) -> Sample:
    row: dict[str, float | int | bool | str] = {"displacement": 0.0, "broke_off": True}
    return Sample(number, LOST, 0, 0.0, np.zeros(0), row)
