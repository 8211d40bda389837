"""Samples through a Dask cluster: the answer of one process, workers that die, tasks that nobody waits for."""

import os
import signal
import sys
import threading
import time
from concurrent.futures import Future

import pytest

from benchmarks.robustness import lives
from cooperative import run, runs
from cooperative.__main__ import main
from cooperative.runs import Workers, dask_executor, packed, run_through
from cooperative.runs import _executors as executors
from cooperative.runs._executors import LOST
from cooperative.runs._processes import WorkerLost
from cooperative.scene import parse
from tests.cooperative.campaign.test_campaign import TINY
from tests.cooperative.runs.test_executors import NOTHING, XI, Breaking


@pytest.fixture
def dask():
    return pytest.importorskip("distributed", reason="extra `dask` is not installed")


def local_cluster(dask, workers, processes=True):
    return dask.LocalCluster(
        n_workers=workers, threads_per_worker=1, processes=processes, dashboard_address=None, silence_logs=50
    )


def test_a_campaign_on_dask_gives_the_answer_of_one_process(dask, tmp_path, tiny_campaign):
    with local_cluster(dask, 2, processes=False) as cluster, dask.Client(cluster) as client:
        run(TINY, tmp_path / "dask", executor=dask_executor(client), workers=2)
        assert client.status == "running"
    assert lives.differences(tmp_path / "dask", tiny_campaign[0]) == []


def test_errors_of_a_run_on_dask_are_errors(dask):
    def failing(number):
        raise ZeroDivisionError(f"in the run of sample {number}")

    with local_cluster(dask, 1, processes=False) as cluster:
        executor = dask_executor(cluster.scheduler_address)()
        with pytest.raises(ZeroDivisionError, match="sample 3"):
            executor.submit(failing, 3).result()
        assert executor.submit(pow, 2, 5).result() == 32
        executor.shutdown(cancel_futures=True)
        assert executor._client.status == "closed"


BEGUN, DROPPED = threading.Event(), threading.Event()


def until_nobody_wants_it():
    BEGUN.set()
    until = time.monotonic() + 60
    while not executors._unwanted() and time.monotonic() < until:
        time.sleep(0.01)
    DROPPED.set()


@pytest.mark.parametrize("how", ["cancelled", "client gone"])
def test_a_dask_task_that_nobody_waits_for_ends_itself(dask, how):
    BEGUN.clear()
    DROPPED.clear()
    with local_cluster(dask, 1, processes=False) as cluster:
        executor = dask_executor(cluster.scheduler_address)()
        executor.submit(until_nobody_wants_it)
        assert BEGUN.wait(30)
        assert not DROPPED.wait(0.2)
        if how == "cancelled":
            executor.shutdown(cancel_futures=True)
        else:
            executor._client.close()
        assert DROPPED.wait(30)


def test_a_sample_that_kills_dask_workers_is_given_up_and_the_others_go_on():
    class Killing(Breaking):
        def submit(self, function, campaign, grid, number, *_):
            future = super().submit(function, campaign, grid, number)
            if future.exception() is not None:
                future = Future()
                future.set_exception(WorkerLost(f"sample {number}"))
            return future

    given_up = pytest.warns(UserWarning, match=r"it did so 3 times alone and is given up")
    with given_up, pytest.warns(UserWarning, match=r"sample 3 lost its worker \(sample 3\): it runs again, alone"):
        got = {
            s.number: s.status for s in run_through(Workers(lambda: Killing({3}), 2), NOTHING, "rough", range(6), XI)
        }
    assert got == {n: LOST if n == 3 else "FINISHED" for n in range(6)}


def test_dask_that_is_not_installed_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ValueError, match=r"pip install distributed"):
        dask_executor("tcp://127.0.0.1:1")


@pytest.mark.slow
def test_the_sample_of_a_killed_dask_worker_is_redone(dask):
    campaign = parse(TINY)
    coefficients = runs.coefficients_of(campaign, runs.random_soil(campaign))
    with local_cluster(dask, 2) as cluster, dask.Client(cluster) as client:
        workers = Workers(dask_executor(client), 2)
        before = client.run(os.getpid)
        got = {}
        for done in run_through(workers, packed(campaign), "rough", range(6), coefficients):
            got[done.number] = done.status
            if len(got) == 1:
                os.kill(next(iter(before.values())), signal.SIGKILL)
        client.wait_for_workers(2, timeout=60)
        assert set(client.run(os.getpid).values()) != set(before.values())
        workers.close()
    assert sorted(got) == list(range(6))
    assert LOST not in got.values()


@pytest.mark.slow
def test_dask_processes_give_the_answer_of_one_process(dask, tmp_path, tiny_campaign):
    with local_cluster(dask, 2) as cluster:
        address = cluster.scheduler_address
        scene = tmp_path / "tiny.toml"
        scene.write_text(TINY)
        assert main(["run", str(scene), "--out", str(tmp_path / "dask"), "--dask", address, "--workers", "2"]) == 0
    assert lives.differences(tmp_path / "dask", tiny_campaign[0]) == []
