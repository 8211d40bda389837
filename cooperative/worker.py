"""What a worker process does: one task after the other, while its controller is there.

This loads nothing of ours: libraries load for seconds, on a loaded machine for a minute, and a worker looks for its
controller before. The first task has them load.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
import traceback
from multiprocessing import connection

_stop_wanted = threading.Event()


def stop_wanted() -> bool:
    """In a worker: whether its controller wants it to come to an end."""
    return _stop_wanted.is_set()


def work(pipe: connection.Connection, ending: connection.Connection, begin: bytes) -> None:
    """Do a task first, and then one after the other, until the controller closes the pipe.

    Args:
        pipe: to the controller. It gets None once the worker has begun, None for each task that has come, and its
            outcome: whether it went well, and its result or error.
        ending: a pipe that ends when the controller wants no more.
        begin: the first task, as all others a function, its arguments and keywords, packed by pickle.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_watch, args=(ending,), daemon=True).start()
    function, args, kwargs = pickle.loads(begin)
    function(*args, **kwargs)
    try:
        pipe.send(None)
        while True:
            task = pipe.recv_bytes()
            pipe.send(None)
            pipe.send_bytes(_outcome(task))
    except (EOFError, OSError):
        return


def _outcome(task: bytes) -> bytes:
    """Whether a task went well, and its result, or the error that it ended with."""
    try:
        function, args, kwargs = pickle.loads(task)
        return pickle.dumps((True, function(*args, **kwargs)))
    except BaseException as error:
        error.add_note(traceback.format_exc())
        try:
            return pickle.dumps((False, error))
        except Exception:  # an error that cannot be sent
            return pickle.dumps((False, RuntimeError(traceback.format_exc())))


def _watch(ending: connection.Connection) -> None:
    """Stop the run when the controller wants that, and end the process once the controller is gone.

    It ends even inside a compiled program. A controller that dies closes its pipe too, whatever it died of.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    connection.wait([parent.sentinel, ending])
    _stop_wanted.set()
    connection.wait([parent.sentinel])
    os._exit(1)
