"""Samples through worker processes: the same answer, workers that die, samples that are given up."""

import os
import signal
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor

import numpy as np
import pytest

from cooperative import campaign, executors, screening
from cooperative.config import parse
from cooperative.executors import ATTEMPTS, LOST, Workers, process_pool, run_through
from cooperative.store import Sample
from tests.test_campaign import TINY

XI = np.zeros((6, 1))


def sample(number):
    return Sample(number, "FINISHED", 1, 0.0, np.zeros(1), {"displacement": 1.0, "broke_off": False})


class Breaking(Executor):
    """Breaks on the samples named, as a process pool does when a worker is killed."""

    def __init__(self, deadly):
        self.deadly = deadly

    def submit(self, function, text, grid, number, *_):
        future: Future = Future()
        if number in self.deadly:
            future.set_exception(BrokenExecutor("killed"))
        else:
            future.set_result(sample(number))
        return future

    def shutdown(self, wait=True, *, cancel_futures=False):
        return None


def test_samples_of_a_killed_worker_are_redone():
    made = []

    def make():
        made.append(Breaking({3} if not made else set()))
        return made[-1]

    got = list(run_through(Workers(make, 2), "", "rough", range(6), XI))
    assert sorted(s.number for s in got) == list(range(6))
    assert {s.status for s in got} == {"FINISHED"}
    assert len(made) == 2


def test_a_sample_that_kills_its_worker_three_times_is_reported():
    made = []

    def make():
        made.append(None)
        return Breaking({3})

    got = {s.number: s for s in run_through(Workers(make, 1), "", "rough", range(5), XI)}
    assert got[3].status == LOST
    assert got[3].row["broke_off"]
    assert sorted(got) == list(range(5))
    assert {s.status for n, s in got.items() if n != 3} == {"FINISHED"}
    assert len(made) == ATTEMPTS + 1


def test_errors_of_a_run_are_not_taken_for_dead_workers():
    def failing(*_):
        raise ZeroDivisionError("in the run")

    workers = Workers(lambda: ThreadPoolExecutor(1), 1)
    original, executors.run_sample = executors.run_sample, failing
    try:
        with pytest.raises(ZeroDivisionError):
            list(run_through(workers, "", "rough", [0], XI))
    finally:
        executors.run_sample = original
        workers.close()


def test_no_workers_are_refused():
    with pytest.raises(ValueError, match="workers = 0: give 1 or more"):
        process_pool(0)


def test_a_killed_worker_process_is_replaced_and_its_sample_redone():
    pools = []

    def make():
        pools.append(process_pool(1))
        return pools[-1]

    crew = Workers(make, 1)
    got = []
    config = parse(TINY)
    coefficients = screening.coefficients_of(config, screening.expansion_of(config))
    for done in run_through(crew, TINY, "rough", range(3), coefficients):
        got.append(done.number)
        if len(got) == 1:
            os.kill(next(iter(pools[0]._processes)), signal.SIGKILL)
    crew.close()
    assert sorted(got) == [0, 1, 2]
    assert len(pools) == 2


@pytest.mark.slow
@pytest.mark.parametrize("workers", [2, 4])
def test_workers_give_the_answer_of_one_process(workers, tmp_path):
    alone = campaign.run(TINY, tmp_path / "one")
    together = campaign.run(TINY, tmp_path / "more", workers=workers)
    for key in ("probability_of_failure", "failures_rough", "failures_refined", "consequences_of_failures"):
        assert together[key] == alone[key]
