"""Stopping by Ctrl-C or SIGTERM: a flag that runs look at between chunks of steps, so that no signal is lost.

An exception that a handler raises is dropped where it falls into a destructor or a callback of HDF5, and a handler in
Python waits as long as a compiled program runs. So the system writes the signal's number into a socket, which a thread
reads at once, whatever the rest of the process does.
"""

from __future__ import annotations

import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)

STOP_TIMEOUT = 30.0
"""Seconds between a signal and the end of a command that does not come to look: it is compiling, or in a long chunk."""

HOW_TO_GO_ON = "what is finished is kept: the same command goes on from there"


Asked = Callable[[], bool]
"""Whether a stop was asked for."""


class Stopped(KeyboardInterrupt):
    """A run ended because it was asked to, by the signal of this number."""

    def __init__(self, number: int = signal.SIGINT) -> None:
        super().__init__(number)
        self.number = number

    def __str__(self) -> str:
        return f"{self.by}; {HOW_TO_GO_ON}"

    @property
    def by(self) -> str:
        """By which signal, in words, without how to go on."""
        return f"stopped by {signal.Signals(self.number).name}"

    @property
    def exit_code(self) -> int:
        """What a process that a signal ended leaves behind: 130 for Ctrl-C, 143 for SIGTERM."""
        return 128 + self.number


class Stop:
    """Whether a stop was asked for.

    number: of the signal, None while there was none.
    """

    def __init__(self) -> None:
        self.number: int | None = None
        self.nothing_to_save = False

    def requested(self) -> bool:
        """Whether to come to an end."""
        return self.number is not None

    def check(self) -> None:
        """Raise `Stopped` if a stop was asked for."""
        if self.number is not None:
            raise Stopped(self.number)

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """A stretch in which nobody looks and nothing would be lost: a signal ends it there and then."""
        self.nothing_to_save = True
        try:
            self.check()
            yield
        finally:
            self.nothing_to_save = False


_current: Stop | None = None


@contextmanager
def stop_by_signals(*, ends_process: bool = False) -> Iterator[Stop]:
    """Have SIGINT and SIGTERM ask for a stop, instead of interrupting whatever runs; gives what to look at.

    A second signal ends at once. Within another one, or outside the main thread, nothing changes. Signals that the
    process was started to ignore stay ignored.

    Args:
        ends_process: the second signal ends the process even inside a compiled program, and so does a first one that
            nobody looks at for `STOP_TIMEOUT` seconds; otherwise, for scripts and notebooks, the second raises
            `Stopped` where it falls.

    Raises:
        Stopped: at the end if a signal came after the last look.
    """
    global _current
    if _current is not None or threading.current_thread() is not threading.main_thread():
        yield _current or Stop()
        return
    stop, seen = Stop(), 0

    def handle(number: int, _: FrameType | None) -> None:
        nonlocal seen
        seen += 1
        stop.number = number
        if not ends_process and (seen > 1 or stop.nothing_to_save):
            raise Stopped(number)

    before = {number: signal.getsignal(number) for number in SIGNALS}
    taken = [number for number, handler in before.items() if handler not in (signal.SIG_IGN, None)]
    reader, writer = socket.socketpair()
    writer.setblocking(False)
    listener = threading.Thread(target=_listen, args=(reader, taken, stop, ends_process), daemon=True)
    listener.start()
    wakeup = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    for number in taken:
        signal.signal(number, handle)
    _current = stop
    try:
        yield stop
    except Stopped as stopped:
        raise Stopped(stop.number or stopped.number) from None
    finally:
        _current = None
        for number in taken:
            signal.signal(number, before[number])
        signal.set_wakeup_fd(wakeup)
        writer.close()
        listener.join()
        reader.close()
    stop.check()


def _listen(reader: socket.socket, numbers: list[int], stop: Stop, ends_process: bool) -> None:
    """Note the first signal; where that is asked for, end the process at the second, or when patience is out."""
    while True:
        try:
            heard = reader.recv(1)
        except TimeoutError:
            _end(stop.number or signal.SIGTERM)
        if not heard:
            return
        if heard[0] not in numbers:
            continue
        again = stop.number is not None and reader.gettimeout() is not None
        stop.number = heard[0]
        if ends_process:
            if again or stop.nothing_to_save:
                _end(heard[0])
            reader.settimeout(STOP_TIMEOUT)


def _end(number: int) -> None:
    """End the process, whatever its other threads do; workers notice, and the system frees the folder's lock."""
    os.write(2, f"\n{Stopped(number)}\n".encode())
    os._exit(Stopped(number).exit_code)
