"""Progress of a campaign while it runs.

Bars on a terminal; where there is none, lines with the time on stderr and in `progress.log` in its folder.
"""

from __future__ import annotations

import logging
import os
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from tqdm import tqdm

from jaxmpm.support.files import append_to

LOG = "progress.log"
EVERY = 60.0
"""Seconds from one line to the next of the same bar."""

LAYOUT = "{desc} {n_fmt}/{total_fmt}%s {elapsed}, {remaining} left{postfix}"

Bar = Callable[..., tqdm]
"""Begins a bar: `bar(title, total, done)`, which goes on from `done` samples and shows the time left."""


@contextmanager
def bars(folder: Path, shown: bool) -> Iterator[Bar]:
    """The bars of a campaign; none that shows anything unless asked to.

    Args:
        folder: of the campaign.
        shown: whether they show.

    Raises:
        OSError: the log cannot be written.
    """
    if not shown or (sys.stderr is not None and sys.stderr.isatty()):
        yield partial(_bar, disable=not shown, dynamic_ncols=True, bar_format=LAYOUT % " |{bar:20}|")
        return
    with _log(folder / LOG) as log:
        yield partial(_bar, file=_Lines(log), bar_format=LAYOUT % ",", miniters=1, mininterval=EVERY, maxinterval=EVERY)


def _bar(title: str, total: int | None, done: int, **layout: object) -> tqdm:
    return tqdm(desc=title, total=total, initial=done, **layout)


def advance(bar: tqdm, note: Callable[[], str]) -> None:
    """One more sample: how many there are per hour, and what they show by now.

    Args:
        bar: of the samples.
        note: gives what the runs show by now, in words.
    """
    if not bar.disable:
        hourly = 3600 * (bar.n + 1 - bar.initial) / max(bar.format_dict["elapsed"], 1e-9)
        bar.set_postfix_str(f"{hourly:.3g} per hour, {note()}", refresh=False)
    bar.update()


@contextmanager
def _log(path: Path) -> Iterator[logging.Logger]:
    """Lines on stderr, where it is open, and at the end of a file, which also has how the campaign began and ended."""
    # An own logger, not one by name: campaigns may run beside each other in threads.
    log = logging.Logger("cooperative")
    with append_to(path) as file:
        streams = [(file, logging.DEBUG), *([] if sys.stderr is None else [(sys.stderr, logging.INFO)])]
        for stream, level in streams:
            handler = logging.StreamHandler(stream)
            handler.setFormatter(logging.Formatter("%(asctime)s %(message)s", "%Y-%m-%d %H:%M:%S"))
            handler.setLevel(level)
            log.addHandler(handler)
        log.debug("begun by process %d on %s", os.getpid(), socket.gethostname())
        try:
            yield log
        except BaseException as error:
            log.debug("ended early: %s", str(error) or type(error).__name__)
            raise
        log.debug("done")


class _Lines:
    """What a bar writes to, so that each of its states becomes a line."""

    def __init__(self, log: logging.Logger) -> None:
        self.log, self.last = log, ""

    def write(self, text: str) -> None:
        line = text.strip()
        if line and line != self.last:
            self.log.info(line)
            self.last = line

    def flush(self) -> None:
        """Handlers write at once."""
