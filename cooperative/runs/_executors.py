"""Samples through worker processes, or through any `concurrent.futures.Executor`.

A task is a campaign's checksum, a grid, a sample's number and its coefficients. A worker that does not know the
campaign returns None, and the task goes out again with the campaign itself: once per worker, whatever executor it
belongs to. The worker builds each grid once and sends back the finished sample. Only the controller writes samples; a
worker that sees the campaign's folder keeps the restart point of its long run there.

A campaign is packed by cloudpickle, so that classes of a script or a notebook's cell go with it. Only what the
controller of a campaign has sent is unpickled, never what a folder holds.
"""

from __future__ import annotations

import hashlib
import io
import pickle
import sys
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cloudpickle
import numpy as np

from cooperative.runs._built import build
from cooperative.runs._model import GridModel
from cooperative.runs._processes import ATTEMPTS, P, T, WorkerLost
from cooperative.runs._random_soil import random_soil
from cooperative.runs._samples import run_samples
from cooperative.scene import Campaign
from cooperative.store import FinishedRun
from cooperative.worker import stop_wanted
from jaxmpm.run import Rule
from jaxmpm.support.pytrees import PYTREES, pytree
from jaxmpm.support.values import by_value

LOST = "WORKER_LOST"
"""Status of a sample that ended its worker as often as it was tried alone."""

LOOK = 0.2
"""Seconds between two looks at whether a stop was asked for, while samples run elsewhere."""


def _unwanted() -> bool:
    """Whether the run of this worker has nobody left who wants it."""
    return stop_wanted() or _dropped_by_dask()


def _dropped_by_dask() -> bool:
    """Whether this is a task of a Dask worker that was cancelled, by its client or because that is gone."""
    distributed = sys.modules.get("distributed")
    if distributed is None:
        return False
    try:
        worker = distributed.get_worker()
        key = worker.get_current_task()
    except (ValueError, AttributeError, KeyError):
        return False
    task = worker.state.tasks.get(key)
    return task is None or task.state == "cancelled"


@by_value
@dataclass(frozen=True)
class Packed:
    """A campaign in a task.

    Args:
        key: checksum of its bytes, by which a worker knows the campaign.
        content: these bytes, None where the worker is to know it already.
    """

    key: str
    content: bytes | None = None


class _Pickler(cloudpickle.Pickler):
    """Collects the pytrees whose classes go along: where these are made again, they have to be registered again."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file)
        self.pytrees: list[type] = []

    def reducer_override(self, obj: object) -> object:
        reduced = super().reducer_override(obj)
        if reduced is not NotImplemented and isinstance(obj, type) and obj in PYTREES:
            self.pytrees.append(obj)
        return reduced


def packed(campaign: Campaign) -> Packed:
    """A campaign for its workers.

    Args:
        campaign: the campaign.

    Raises:
        ValueError: one that holds what cannot be sent to another process.
    """
    file = io.BytesIO()
    pickler = _Pickler(file)
    try:
        # The list is pickled last, when it is complete.
        pickler.dump((campaign, pickler.pytrees))
    except (pickle.PicklingError, TypeError, AttributeError, RecursionError, ValueError) as error:
        raise ValueError(
            f"the campaign cannot be sent to a worker ({error}): let its ground, soil and estimator hold numbers, "
            "texts, arrays and dataclasses of these, no open file, lock or generator"
        ) from error
    content = file.getvalue()
    return Packed(hashlib.sha256(content).hexdigest(), content)


def unpacked(content: bytes) -> Campaign:
    """The campaign that a controller has sent."""
    campaign, pytrees = pickle.loads(content)
    for kind in pytrees:
        if kind not in PYTREES:
            pytree(kind)
    return campaign


def run_sample(
    campaign: Packed,
    grid: str,
    number: int,
    coefficients: np.ndarray,
    rules: Sequence[Rule] | None,
    slides: bool = False,
    folder: Path | None = None,
) -> FinishedRun | None:
    """Run one sample of a campaign on one of its grids; what a worker does.

    Args:
        campaign: packed.
        grid: "rough" or "refined".
        number: of the sample.
        coefficients: of the sample (terms,).
        rules: see `run_samples`.
        slides: see `run_samples`.
        folder: of the campaign, for the grid's initial stress and restart points of refined runs.

    Returns:
        None where the campaign is not known here and did not come along.
    """
    if campaign.content is not None and campaign.key not in _campaigns:
        _campaigns.clear()
        _campaigns[campaign.key] = unpacked(campaign.content)
    if campaign.key not in _campaigns:
        return None
    one, model = {number: coefficients}, _prepared(campaign.key, grid, folder)
    restart_in = folder if grid == "refined" else None
    return next(
        run_samples(model, one, one, width=1, rules=rules, restart_in=restart_in, stop=_unwanted, slides=slides)
    )


_campaigns: dict[str, Campaign] = {}
"""The campaign that this worker runs samples of, by its checksum."""


def prepare(campaign: Packed, folder: Path) -> None:
    """Build a worker's first grid before its first sample, so that what that takes to compile is there then.

    Args:
        campaign: packed with its content; not yet measured.
        folder: of the campaign.
    """
    assert campaign.content is not None
    unmeasured = unpacked(campaign.content)
    soil = random_soil(unmeasured)
    build(unmeasured, next(iter(unmeasured.grids)), soil, folder=folder).varied(np.zeros(soil.modes, np.float32))


@lru_cache(maxsize=3)
def _prepared(key: str, grid: str, folder: Path | None) -> GridModel:
    campaign = _campaigns[key]
    return build(campaign, grid, random_soil(campaign), folder=folder)


@dataclass
class Workers:
    """An executor that is made when first needed, used from one stage to the next, and made anew when it breaks.

    Args:
        make: gives an executor.
        count: samples given to it at a time.
        ahead: further samples that wait for a worker, where their order is fixed; one for each process of this
            machine, 0 for other executors.
        executor: the one in use, None before the first.
    """

    make: Callable[[], Executor]
    count: int
    ahead: int = 0
    executor: Executor | None = None

    def opened(self) -> Workers:
        """Itself, with its executor, so that one that cannot be made is known before anything is written."""
        if self.executor is None:
            self.executor = self.make()
        return self

    def prepare(self, campaign: Packed, folder: Path) -> None:
        """Open the executor, and have the processes of this machine build the first grid before their samples.

        Nobody waits for it, and an error in it shows again in the samples.

        Args:
            campaign: packed with its content; not yet measured.
            folder: of the campaign.
        """
        self.opened()
        for _ in range(self.ahead):
            self.submit(prepare, campaign, folder)

    def submit(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Submit a task to the executor, which is made if there is none."""
        executor = self.executor = self.executor or self.make()
        return executor.submit(function, *args, **kwargs)

    def close(self) -> None:
        """Let the executor go: tasks not started are dropped, and those under way end soon, with restart points."""
        if self.executor is not None:
            self.executor.shutdown(wait=True, cancel_futures=True)
            self.executor = None


class _Refused(BrokenExecutor):
    """An executor had broken before a task reached it."""


def run_through(
    workers: Workers,
    campaign: Packed,
    grid: str,
    numbers: Iterable[int],
    coefficients: np.ndarray,
    *,
    rules: Sequence[Rule] | None = None,
    slides: bool = False,
    folder: Path | None = None,
    check: Callable[[], None] = lambda: None,
) -> Iterator[FinishedRun]:
    """Run the samples with these numbers, rows of `coefficients`, through an executor; yields each as it ends.

    Numbers are drawn one by one as places become free. A sample whose worker was killed, or whose executor broke, may
    be the cause or not, so it runs again once the others have ended, alone. One that ends its worker three times while
    it runs alone is given back with status WORKER_LOST, so that it is reported, not tried for ever.

    Args:
        workers: that run them.
        campaign: with its content, which goes to each worker that asks for it.
        grid: "rough" or "refined".
        numbers: of the samples.
        coefficients: of all samples (n, terms).
        rules: see `run_samples`.
        slides: as for `run_sample`.
        folder: of the campaign, where workers find the initial stress and keep restart points; one that does not see it
            solves for the stress, and keeps none.
        check: called several times a second, may raise to stop.

    Raises:
        BrokenExecutor: three executors in turn do not take a task.
    """
    waiting = iter(numbers)
    suspects: deque[int] = deque()
    deaths: Counter[int] = Counter()
    pending: dict[Future[FinishedRun | None], int] = {}
    alone, broken, refused = workers.count == 1, False, 0
    # The estimator chooses refined samples by what is known, so none of these may wait.
    places = workers.count + (0 if grid == "refined" else workers.ahead)

    key_alone = Packed(campaign.key)

    def submit(number: int, packed: Packed = key_alone) -> None:
        nonlocal broken, refused
        try:
            future = workers.submit(run_sample, packed, grid, number, coefficients[number], rules, slides, folder)
            refused = 0
        except BrokenExecutor as error:
            broken, refused = True, refused + 1
            if refused == ATTEMPTS:
                raise
            future = Future()
            future.set_exception(_Refused(str(error)))
        pending[future] = number

    while True:
        check()
        while len(pending) < places and not broken and (number := next(waiting, None)) is not None:
            submit(number)
        if not pending:
            if not suspects:
                return
            if not alone:
                workers.close()  # what idle workers hold of the memory is free then
                alone = True
            submit(suspects.popleft())
        done, _ = wait(pending, timeout=LOOK, return_when=FIRST_COMPLETED)
        for future in done:
            number = pending.pop(future)
            try:
                sample = future.result()
            except Exception as error:
                # Dask raises `KilledWorker` for one that kills more workers than its `allowed-failures`.
                lost = isinstance(error, WorkerLost | BrokenExecutor) or type(error).__name__ == "KilledWorker"
                if not lost:
                    raise
                broken = broken or isinstance(error, BrokenExecutor)
                deaths[number] += alone and not isinstance(error, _Refused)
                again = deaths[number] < ATTEMPTS
                then = "it runs again, alone" if again else f"it did so {ATTEMPTS} times alone and is given up"
                warnings.warn(f"sample {number} lost its worker ({error}): {then}", stacklevel=2)
                if again:
                    suspects.append(number)
                    continue
                sample = FinishedRun(number, LOST, 0, 0.0, np.zeros(0), {"displacement": 0.0, "broke_off": True})
            if sample is None:
                submit(number, campaign)
            else:
                yield sample
        check()
        if broken:
            # It drops all it held, and does not report whose worker died.
            suspects += pending.values()
            pending.clear()
            workers.close()
            broken = False
