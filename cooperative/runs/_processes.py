"""Worker processes of this machine: one that is killed costs its own task, whatever it was at, and no other.

A pool of `concurrent.futures` drops all its tasks when one of its processes dies, does not show whose it was, and hangs
where the process died halfway through sending its result. Here every worker has a pipe of its own: what it was given is
known, and a pipe that ends within a message shows its death.
"""

from __future__ import annotations

import ast
import atexit
import linecache
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import warnings
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from multiprocessing import connection
from multiprocessing.context import SpawnProcess
from types import FrameType
from typing import Any, ParamSpec, TypeVar

from cooperative.runs._compiled import VARIABLE, keep_compiled
from cooperative.runs._flags import set_flags
from cooperative.worker import work

ATTEMPTS = 3
"""How often in turn, with no word from another, a worker may end before it has started, and how often a sample alone
may end its worker."""


NAME = "jaxmpm worker"
UNGUARDED = 76
"""Exit code of a worker that runs its controller's script again, and with it the campaign."""
GUARD = (
    "a worker process imports the script that starts it, and the script starts the campaign again there: put what it "
    "does under the line if __name__ == '__main__':, or give workers = 1"
)
CONDITIONS = (ast.If, ast.IfExp, ast.BoolOp, ast.Compare, ast.Match, ast.While, ast.Assert, ast.comprehension)


class WorkerLost(RuntimeError):
    """The worker of a task ended before the task did; other tasks go on."""


P = ParamSpec("P")
T = TypeVar("T")

Task = tuple[Future[Any], bytes]
"""What is asked for, packed, and where its result goes."""


@dataclass(eq=False)
class _Worker:
    """A process.

    pipe: to it. cores: that it is bound to. started: whether it takes tasks. task: that it was given. received:
    whether it has that.
    """

    process: SpawnProcess
    pipe: connection.Connection
    cores: list[int]
    started: bool = False
    task: Task | None = None
    received: bool = False


class Processes(Executor):
    """Worker processes, one for each share of the cores, begun when there are tasks for them.

    A task whose worker dies raises `WorkerLost`; another worker takes the place of the dead one. Workers end when this
    process does, however it ends, and come to an end at the next look (`stop_wanted`) once the pool is shut down. Every
    task raises ValueError where workers cannot be started.
    """

    def __init__(self, shares: Sequence[list[int]]) -> None:
        self.context = multiprocessing.get_context("spawn")
        self.free = list(shares)
        self.workers: list[_Worker] = []
        self.waiting: deque[Task] = deque()
        self.lost_at_start, self.closing, self.lock = 0, False, threading.Lock()
        self.unusable: ValueError | None = None
        self.ending, self.end = self.context.Pipe(duplex=False)
        self.woken, self.wake = self.context.Pipe(duplex=False)
        self.thread = threading.Thread(target=self._serve, daemon=True)
        self.thread.start()
        atexit.register(self.shutdown, wait=False, cancel_futures=True)

    def submit(self, function: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        future: Future[T] = Future()
        task = pickle.dumps((function, args, kwargs))
        with self.lock:
            if self.closing:
                raise RuntimeError("the pool was shut down: make another")
            if self.unusable is not None:
                future.set_exception(self.unusable)
                return future
            self.waiting.append((future, task))
            self.wake.send_bytes(b"")
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        with self.lock:
            while cancel_futures and self.waiting:
                self.waiting.pop()[0].cancel()
            if not self.closing:
                self.closing = True
                self.end.close()
                self.wake.send_bytes(b"")
        if wait:
            self.thread.join()

    def _serve(self) -> None:
        """What the pool's thread does: begins workers, gives them tasks, and receives their results."""
        if hasattr(signal, "pthread_sigmask"):
            # Inherited by the workers: a terminal sends Ctrl-C to all processes, and their controller stops them.
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            while self._send_next():
                ready = connection.wait([self.woken, *(worker.pipe for worker in self.workers)])
                if self.woken in ready:
                    self.woken.recv_bytes()
                for worker in [worker for worker in self.workers if worker.pipe in ready]:
                    self._receive(worker)
        except BaseException as error:
            self._fail(error)
        finally:
            atexit.unregister(self.shutdown)
            for worker in self.workers:
                worker.pipe.close()
                if not worker.started or worker.task is not None:
                    worker.process.kill()
            for worker in self.workers:
                worker.process.join()

    def _send_next(self) -> bool:
        """Give tasks to workers that are free, and begin workers for what waits; whether there is more to come."""
        for worker in [worker for worker in self.workers if worker.started and worker.task is None]:
            with self.lock:
                task = self.waiting.popleft() if self.waiting else None
            if task is None or not (task[0].running() or task[0].set_running_or_notify_cancel()):
                continue
            worker.task, worker.received = task, False
            try:
                worker.pipe.send_bytes(task[1])
            except OSError:
                self._lost(worker)
        starting = sum(not worker.started for worker in self.workers)
        for cores in self.free[: max(len(self.waiting) - starting, 0)]:
            self._begin(cores)
        return not (self.closing and not self.waiting and all(worker.task is None for worker in self.workers))

    def _begin(self, cores: list[int]) -> None:
        here, there = self.context.Pipe()
        begin = pickle.dumps((_begin, (cores,), {}))
        process = self.context.Process(target=work, args=(there, self.ending, begin), daemon=True, name=NAME)
        try:
            process.start()
        except OSError as error:
            self._not_started(str(error))
            return
        finally:
            there.close()
        self.free.remove(cores)
        self.workers.append(_Worker(process, here, cores))

    def _receive(self, worker: _Worker) -> None:
        """Take in what a worker sends: that it has started, then of each task that it has it, and what comes of it."""
        try:
            outcome = worker.pipe.recv()
        except (EOFError, OSError):
            self._lost(worker)
            return
        except Exception as error:  # a result that cannot be read here
            outcome = False, error
        self.lost_at_start = 0
        if worker.task is None:
            worker.started = True
        elif outcome is None:
            worker.received = True
        else:
            (future, _), worker.task = worker.task, None
            well, result = outcome
            (future.set_result if well else future.set_exception)(result)

    def _lost(self, worker: _Worker) -> None:
        worker.process.kill()
        worker.process.join()
        worker.pipe.close()
        self.workers.remove(worker)
        self.free.append(worker.cores)
        why = f"a worker process ended with exit code {worker.process.exitcode}"
        if worker.task is None:
            if worker.process.exitcode == UNGUARDED:
                self.unusable = ValueError(GUARD)
                self._fail(self.unusable)
            elif not worker.started:
                self._not_started(why)
        elif worker.received:
            worker.task[0].set_exception(WorkerLost(why))
        else:  # it was killed while it had no task
            self.waiting.appendleft(worker.task)

    def _not_started(self, why: str) -> None:
        """Count it; tasks end with an error where no worker comes to start."""
        self.lost_at_start += 1
        if self.lost_at_start >= ATTEMPTS and not any(worker.started for worker in self.workers):
            self._fail(ValueError(f"no worker starts, {self.lost_at_start} in turn ({why}): give fewer workers, or 1"))
            self.lost_at_start = 0

    def _fail(self, error: BaseException) -> None:
        """End all tasks with an error."""
        with self.lock:
            futures = [future for future, _ in self.waiting]
            self.waiting.clear()
        for future in [*futures, *(worker.task[0] for worker in self.workers if worker.task is not None)]:
            if future.running() or future.set_running_or_notify_cancel():
                future.set_exception(error)


def refuse_unguarded(workers: int) -> None:
    """Refuse a script without its main guard: a worker process imports it, and it starts the campaign again there.

    Args:
        workers: processes that are to be started.

    Raises:
        ValueError: in the script that is to start workers, and in a process that somebody else has begun; the message
            says what the script lacks.
    """
    process = multiprocessing.current_process()
    if getattr(process, "_inheriting", False):
        if process.name == NAME:
            os._exit(UNGUARDED)
        raise ValueError(GUARD)
    if workers > 1 and _unguarded(sys._getframe()):
        raise ValueError(GUARD)


def _unguarded(frame: FrameType | None) -> bool:
    """Whether this frame runs for a statement of the main script that no condition, there or before it, could stop.

    Any condition might be the guard, and so might one of a library through which the script came here.
    """
    main = sys.modules["__main__"]
    if getattr(main, "__file__", None) is None or str(getattr(main.__spec__, "name", "")).endswith("__main__"):
        return False  # Workers import neither an interactive session nor the __main__.py of a package.
    while frame is not None and not (frame.f_globals is vars(main) and frame.f_code.co_name == "<module>"):
        package = str(frame.f_globals.get("__name__")).partition(".")[0]
        if frame.f_globals is not vars(main) and package not in ("cooperative", *sys.stdlib_module_names):
            return False
        frame = frame.f_back
    if frame is None:
        return False
    try:
        script = ast.parse("".join(linecache.getlines(frame.f_code.co_filename)))
    except SyntaxError:
        return False
    before = [statement for statement in script.body if statement.lineno <= frame.f_lineno]
    return bool(before) and not any(isinstance(node, CONDITIONS) for part in before for node in ast.walk(part))


def process_pool(workers: int) -> Executor:
    """Worker processes, each bound to its own share of the cores, see `Processes`.

    Args:
        workers: how many.

    Raises:
        ValueError: fewer than one.
    """
    if workers < 1:
        raise ValueError(f"workers = {workers}: give 1 or more")
    return Processes(_shares(workers))


def cores_to_use() -> list[int]:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def _shares(workers: int) -> list[list[int]]:
    """The cores of each worker; no cores where the system cannot bind a process to them."""
    if not hasattr(os, "sched_setaffinity"):
        return [[]] * workers
    cores = cores_to_use()
    share = max(1, len(cores) // workers)
    firsts = (worker * share % len(cores) for worker in range(workers))
    return [cores[first : first + share] for first in firsts]


def _begin(cores: list[int]) -> None:
    """What a worker does first: it takes a share of the cores, and the settings of its controller."""
    if VARIABLE in os.environ:
        keep_compiled()
    # The controller has warned of transfers that run on XLA, and of settings without effect.
    warnings.filterwarnings("ignore", message=".* was not built: particle-grid transfers run on XLA")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        set_flags()
    if cores:
        os.sched_setaffinity(0, cores)
