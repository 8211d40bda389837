"""Stopping: no signal is lost, commands end within seconds, and no worker outlives its controller."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.robustness.invented import SCENE
from cooperative import campaign, worker
from cooperative.__main__ import main
from cooperative.runs import Stopped, process_pool, stop_by_signals
from cooperative.store import read_rows, read_store
from tests import ROOT


class Dying:
    """Asks for a stop in its destructor, where Python drops whatever a signal's handler raises."""

    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        sum(range(10_000))


def see_one_die(stop):
    assert not stop.requested()
    Dying()
    assert stop.requested()
    stop.check()
    pytest.fail("nobody looked")


def test_a_signal_within_a_destructor_is_not_lost():
    with pytest.raises(Stopped, match="SIGINT"), stop_by_signals() as stop:
        see_one_die(stop)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_that_nobody_looked_at_stops_in_the_end(number, code):
    before = signal.getsignal(number)
    with pytest.raises(Stopped, match="the same command goes on from there") as stopped, stop_by_signals():
        os.kill(os.getpid(), number)
    assert stopped.value.exit_code == code
    assert signal.getsignal(number) is before


def falls(number):
    """Whether a signal raises where it falls."""
    try:
        os.kill(os.getpid(), number)
        sum(range(10_000))
    except Stopped:
        return True
    return False


def test_a_second_signal_ends_where_it_falls_and_the_first_where_nothing_would_be_lost():
    seen = []
    with pytest.raises(Stopped), stop_by_signals():
        seen += [falls(signal.SIGINT), falls(signal.SIGINT)]
    with pytest.raises(Stopped), stop_by_signals() as stop, stop.at_once():
        seen += [falls(signal.SIGTERM)]
    assert seen == [False, True, True]


def test_within_another_one_and_in_other_threads_nothing_changes():
    with stop_by_signals() as outer:
        handler = signal.getsignal(signal.SIGTERM)
        with stop_by_signals() as inner:
            assert inner is outer
        assert signal.getsignal(signal.SIGTERM) is handler
    asked = []

    def elsewhere():
        with stop_by_signals() as stop:
            asked.append(stop.requested())

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    assert asked == [False]


def controller(script, **options):
    """A process that runs a script, whose output can be read."""
    command = [sys.executable, "-c", textwrap.dedent(script)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT, **options)


LONG = """
    import hashlib
    from cooperative.runs import stop_by_signals
    with stop_by_signals(ends_process=True):
        print("begun", flush=True)
        hashlib.pbkdf2_hmac("sha256", b"", b"", 2_000_000_000)
"""


def test_the_second_signal_ends_a_command_even_within_a_long_call():
    with controller(LONG) as process:
        assert process.stdout.readline() == "begun\n"
        process.send_signal(signal.SIGTERM)
        time.sleep(0.5)
        assert process.poll() is None
        process.send_signal(signal.SIGTERM)
        _, printed = process.communicate(timeout=60)
    assert process.returncode == 143
    assert printed.strip().startswith("stopped by SIGTERM")


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="looks at what is loaded by /proc")
def test_ctrl_c_while_the_libraries_load_ends_without_a_word():
    command = [sys.executable, "-m", "cooperative", "status", "nowhere"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT) as process:
        while process.poll() is None and "numpy" not in Path(f"/proc/{process.pid}/maps").read_text():
            time.sleep(0.001)
        process.send_signal(signal.SIGINT)
        assert process.communicate(timeout=60) == ("", "")
    assert process.returncode == -signal.SIGINT


POOL = """
    import time
    from cooperative.runs import process_pool
    if __name__ == "__main__":
        pool = process_pool(2)
        tasks = [pool.submit(time.sleep, 1000) for _ in range(4)]
        while len(pool.workers) < 2:
            time.sleep(0.01)
        print(*(worker.process.pid for worker in pool.workers), flush=True)
        tasks[0].result()
"""


def ended(process):
    """Whether a process is gone, or dead and not yet fetched by its parent."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except OSError:
        return True


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes by /proc")
@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_no_worker_outlives_its_controller(number):
    with controller(POOL) as process:
        workers = [int(worker) for worker in process.stdout.readline().split()]
        assert len(workers) == 2
        process.send_signal(number)
        # The workers have its output open too: it ends with the last of them.
        process.communicate(timeout=120)
    assert process.returncode == -number
    assert all(ended(worker) for worker in workers)


LOADING = """
    import multiprocessing, pickle, time
    from cooperative.worker import work
    if __name__ == "__main__":
        context = multiprocessing.get_context("spawn")
        (_, there), (ending, _) = context.Pipe(), context.Pipe(duplex=False)
        begin = pickle.dumps((time.sleep, (1000,), {}))
        worker = context.Process(target=work, args=(there, ending, begin))
        worker.start()
        print(worker.pid, flush=True)
        worker.join()
"""


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes by /proc")
def test_no_worker_outlives_its_controller_while_its_libraries_load():
    with controller(LOADING) as process:
        worker = int(process.stdout.readline())
        process.kill()
        process.communicate(timeout=120)
    assert ended(worker)


def test_a_worker_watches_before_it_loads_a_library():
    code = "import sys, cooperative.worker; print({'jax', 'numpy', 'scipy'} & sys.modules.keys())"
    assert subprocess.check_output([sys.executable, "-c", code], text=True, cwd=ROOT).strip() == "set()"


def wait_for_stop():
    return worker._stop_wanted.wait(300)


@pytest.mark.slow
def test_a_pool_that_shuts_down_stops_its_workers():
    pool = process_pool(1)
    task = pool.submit(wait_for_stop)
    while not task.running():
        time.sleep(0.01)
    pool.shutdown(cancel_futures=True)
    assert task.result(timeout=0)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize("after", [3, 58])
def test_a_campaign_stops_by_signal_and_goes_on(number, code, after, made_up, tmp_path, capsys):
    scene, folder = tmp_path / "scene.toml", tmp_path / "out"
    scene.write_text(SCENE)
    written = []

    def write_sample(*arguments):
        written.append(real(*arguments))
        if len(written) == after:
            os.kill(os.getpid(), number)

    with made_up.context() as patched:
        real = campaign.write_sample
        patched.setattr(campaign, "write_sample", write_sample)
        with pytest.warns(UserWarning, match="a slide may reach the end of the ground"):
            assert main(["run", str(scene), "--out", str(folder), "--workers", "1"]) == code
    printed = capsys.readouterr().err
    assert f"stopped by {signal.Signals(number).name}; what is finished is kept" in printed
    assert "Traceback" not in printed
    store = read_store(folder)
    assert sum(len(read_rows(store, grid).numbers) for grid in ("rough", "refined")) == len(written)
    assert after <= len(written) <= after + 1
    assert not (folder / "summary.json").exists()
    there = campaign.run(SCENE, folder)
    alone = campaign.run(SCENE, tmp_path / "alone")
    assert replace(there, cost=replace(there.cost, seconds=alone.cost.seconds)) == alone
