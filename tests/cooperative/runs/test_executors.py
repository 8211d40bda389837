"""Samples through worker processes: the same answer, workers that die, samples that are given up."""

import os
import signal
import threading
import time
import warnings
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import connection

import numpy as np
import pytest

from benchmarks.robustness import lives
from cooperative import run
from cooperative.runs import Packed, Workers, packed, process_pool, run_through
from cooperative.runs import _executors as executors
from cooperative.runs import _processes as processes
from cooperative.runs._executors import LOST
from cooperative.runs._processes import ATTEMPTS, Processes, WorkerLost
from cooperative.scene import parse
from cooperative.store import FinishedRun
from jaxmpm.transfer import native
from tests.cooperative.campaign.test_campaign import TINY
from tests.cooperative.campaign.test_campaign_value import Logged

XI = np.zeros((6, 1))
NOTHING = Packed("", b"")


def sample(number):
    return FinishedRun(number, "FINISHED", 1, 0.0, np.zeros(1), {"displacement": 1.0, "broke_off": False})


class Breaking(Executor):
    """Breaks on the samples named, as a process pool does when a worker is killed."""

    def __init__(self, deadly):
        self.deadly = deadly

    def submit(self, function, campaign, grid, number, *_):
        future: Future = Future()
        if number in self.deadly:
            future.set_exception(BrokenExecutor("killed"))
        else:
            future.set_result(sample(number))
        return future

    def shutdown(self, wait=True, *, cancel_futures=False):
        return None


def test_workers_do_not_repeat_that_transfers_run_on_xla(monkeypatch):
    monkeypatch.setattr(native, "__path__", [])
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        assert not native.available.__wrapped__()
        processes._begin([])
        assert not native.available.__wrapped__()
    assert ["was not built" in str(each.message) for each in warned] == [True]


def test_samples_of_a_killed_worker_are_redone():
    made = []

    def make():
        made.append(Breaking({3} if not made else set()))
        return made[-1]

    with pytest.warns(UserWarning, match=r"sample 3 lost its worker \(killed\): it runs again, alone"):
        got = list(run_through(Workers(make, 2), NOTHING, "rough", range(6), XI))
    assert sorted(s.number for s in got) == list(range(6))
    assert {s.status for s in got} == {"FINISHED"}
    assert len(made) == 3  # after it broke, and for what runs alone


class Crowded(Breaking):
    """Runs its tasks a little later, together; a deadly one breaks it for all of them, and for what is submitted then,
    as the pool of processes of `concurrent.futures` breaks."""

    def __init__(self, deadly, held):
        super().__init__(deadly)
        self.under_way, self.broken, self.held = {}, False, held

    def submit(self, function, campaign, grid, number, *_):
        if self.broken:
            raise BrokenExecutor("was killed")
        future = Future()
        self.under_way[number] = future
        self.held.append(sorted(self.under_way))
        threading.Timer(0.02, self.end).start()
        return future

    def end(self):
        under_way, self.under_way = self.under_way, {}
        self.broken = self.broken or not self.deadly.isdisjoint(under_way)
        for number, future in under_way.items():
            if self.broken:
                future.set_exception(BrokenExecutor("killed"))
            else:
                future.set_result(sample(number))


@pytest.mark.filterwarnings("ignore:sample .* lost its worker")
@pytest.mark.parametrize("workers", [1, 2, 3, 8])
@pytest.mark.parametrize("deadly", [{0}, {3}, {5}, {0, 1, 4}, set(range(6))], ids=str)
def test_healthy_samples_beside_deadly_ones_are_never_given_up(workers, deadly):
    held = []
    pool = Workers(lambda: Crowded(deadly, held), workers)
    got = {s.number: s for s in run_through(pool, NOTHING, "rough", range(6), XI)}
    assert {number: s.status for number, s in got.items()} == {
        number: LOST if number in deadly else "FINISHED" for number in range(6)
    }
    assert all(got[number].row["broke_off"] == (number in deadly) for number in range(6))
    for number in deadly:
        assert held.count([number]) >= ATTEMPTS


@pytest.mark.filterwarnings("ignore:sample .* lost its worker")
def test_a_pool_that_breaks_before_a_task_reaches_it_is_made_anew():
    made = []

    class Gone(Breaking):
        def submit(self, *_):
            raise BrokenExecutor("a worker was killed while it had no task")

    def make():
        made.append(Gone(set()) if len(made) < 2 else Breaking(set()))
        return made[-1]

    got = {s.number: s.status for s in run_through(Workers(make, 1), NOTHING, "rough", range(4), XI)}
    assert got == dict.fromkeys(range(4), "FINISHED")

    class Once(Breaking):
        def submit(self, *task):
            if self.deadly:
                raise BrokenExecutor("a worker was killed while it had no task")
            self.deadly = {None}
            return super().submit(*task)

    got = {s.number: s.status for s in run_through(Workers(lambda: Once(set()), 8), NOTHING, "rough", range(6), XI)}
    assert got == dict.fromkeys(range(6), "FINISHED")
    with pytest.raises(BrokenExecutor, match="had no task"):
        list(run_through(Workers(lambda: Gone(set()), 2), NOTHING, "rough", range(4), XI))


def test_a_worker_that_dies_costs_its_own_task_alone():
    with process_pool(2) as pool:
        dying, resting = pool.submit(os._exit, 9), pool.submit(time.sleep, 0.1)
        with pytest.raises(WorkerLost, match="exit code 9"):
            dying.result(60)
        assert resting.result(60) is None
        assert pool.submit(divmod, 7, 2).result(60) == (3, 1)
        with pytest.raises(ZeroDivisionError) as raised:
            pool.submit(divmod, 7, 0).result(60)
        assert "Traceback" in raised.value.__notes__[0]
        idle = [worker.process.pid for worker in pool.workers]
        for process in idle:
            os.kill(process, signal.SIGKILL)
        assert pool.submit(divmod, 9, 2).result(60) == (4, 1)
    assert not pool.thread.is_alive()
    with pytest.raises(RuntimeError, match="was shut down"):
        pool.submit(divmod, 7, 2)


def half_sent():
    """Kill this worker halfway through sending its result."""
    whole = connection.Connection._send

    def send(self, data, *write):
        whole(self, data[: len(data) // 2], *write)
        os.kill(os.getpid(), signal.SIGKILL)

    connection.Connection._send = send
    return b"\0" * 1_000_000


@pytest.mark.slow
def test_a_worker_killed_while_it_sends_its_result_or_starts_is_replaced():
    with process_pool(1) as pool:
        with pytest.raises(WorkerLost, match="exit code -9"):
            pool.submit(half_sent).result(60)
        begun = pool.submit(divmod, 7, 2)
        while not pool.workers:
            time.sleep(0.001)
        os.kill(pool.workers[0].process.pid, signal.SIGKILL)
        assert begun.result(60) == (3, 1)


def kill_one(pool, started):
    """Kill a worker of a pool that has started, or one that has not, as soon as there is one."""
    while not (found := [worker for worker in pool.workers if worker.started == started]):
        time.sleep(0.001)
    os.kill(found[0].process.pid, signal.SIGKILL)
    while found[0] in pool.workers:
        time.sleep(0.001)


def test_workers_that_die_as_they_start_are_replaced_while_others_work():
    with process_pool(2) as pool:
        assert pool.submit(divmod, 7, 2).result(60) == (3, 1)
        for _ in range(ATTEMPTS + 1):
            resting, waiting = pool.submit(time.sleep, 0.1), pool.submit(divmod, 7, 2)
            kill_one(pool, started=False)
            assert (resting.result(60), waiting.result(60)) == (None, (3, 1))
        kill_one(pool, started=True)
        waiting = pool.submit(divmod, 9, 2)
        kill_one(pool, started=False)
        assert waiting.result(60) == (4, 1)


class Unsent:
    def __reduce__(self):
        raise TypeError("stays here")


def unsent(raises):
    if raises:
        raise ValueError(Unsent())
    return Unsent()


@pytest.mark.slow
def test_what_cannot_be_sent_is_an_error_of_its_task():
    with process_pool(1) as pool:
        with pytest.raises(TypeError, match="stays here"):
            pool.submit(unsent, False).result(60)
        with pytest.raises(RuntimeError, match="stays here"):
            pool.submit(unsent, True).result(60)
        with pytest.raises(TypeError, match="stays here"):
            pool.submit(print, Unsent())


@pytest.mark.slow
def test_workers_that_never_start_are_an_error_and_no_lost_sample():
    with Processes([[10_000]]) as pool, pytest.raises(ValueError, match=r"no worker starts, 3 in turn .*fewer workers"):
        list(run_through(Workers(lambda: pool, 1), NOTHING, "rough", range(3), XI))


def test_errors_of_a_run_are_not_taken_for_dead_workers():
    def failing(*_):
        raise ZeroDivisionError("in the run")

    workers = Workers(lambda: ThreadPoolExecutor(1), 1)
    original, executors.run_sample = executors.run_sample, failing
    try:
        with pytest.raises(ZeroDivisionError):
            list(run_through(workers, NOTHING, "rough", [0], XI))
    finally:
        executors.run_sample = original
        workers.close()


def test_no_workers_are_refused():
    with pytest.raises(ValueError, match="workers = 0: give 1 or more"):
        process_pool(0)


class Counting(ThreadPoolExecutor):
    """Remembers the tasks that had the campaign with them."""

    def __init__(self, workers):
        super().__init__(workers)
        self.sent = []

    def submit(self, function, campaign, grid, number, *rest):
        self.sent += [number] if campaign.content is not None else []
        return super().submit(function, campaign, grid, number, *rest)


def test_a_campaign_goes_once_to_a_worker_however_many_samples_it_runs(monkeypatch):
    seen = []

    def run_samples(model, coefficients, numbers, **_):
        seen.append(model)
        return (sample(number) for number in numbers)

    monkeypatch.setattr(executors, "run_samples", run_samples)
    monkeypatch.setattr(executors, "build", lambda campaign, grid, soil, **_: campaign)
    monkeypatch.setattr(executors, "_campaigns", {})
    executors._prepared.cache_clear()
    first, second = parse(TINY), parse(TINY.replace("cov = 0.4", "cov = 0.3"))
    pool = Workers(lambda: Counting(1), 1)
    for campaign in (first, second, first):
        got = list(run_through(pool, packed(campaign), "rough", range(6), XI))
        assert [each.number for each in got] == list(range(6))
        assert [model.random["strength"].cov for model in seen[-6:]] == [campaign.random["strength"].cov] * 6
    assert pool.executor.sent == [0, 0, 0]
    pool.close()
    executors._prepared.cache_clear()


def test_a_campaign_that_cannot_be_sent_is_refused(tmp_path):
    with (
        open(tmp_path / "log", "w") as file,
        pytest.raises(ValueError, match=r"cannot be sent to a worker .*open file"),
    ):
        packed(replace(parse(TINY), soil=Logged(strength=30e3, log=file)))


@pytest.mark.slow
def test_workers_give_the_answer_of_one_process(tmp_path, tiny_campaign):
    run(TINY, tmp_path / "more", workers=2)
    assert lives.differences(tmp_path / "more", tiny_campaign[0]) == []
