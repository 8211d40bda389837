"""`jaxmpm`, or `python -m cooperative`.

The commands stand in `cooperative._commands`.
"""

import gc
import os
import signal
import sys
from importlib import import_module

from cooperative._arguments import parser

UNREAD = 128 + 13
"""Exit code where nobody reads the output any longer: that of a program which SIGPIPE ends."""


def _open_streams() -> None:
    """Open each standard stream that is closed to nowhere.

    No file opened later then takes its number and with it what libraries print. A letter that an output's encoding
    lacks is printed as its escape.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            number = os.open(os.devnull, os.O_RDWR)
            os.set_inheritable(number, True)
            setattr(sys, name, os.fdopen(number, mode, encoding="utf-8"))
    for stream in (sys.stdout, sys.stderr):
        # A stream that somebody put in place of Python's may have no such method.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def main(arguments: list[str] | None = None) -> int:
    """Run a command. It ends without a word where whoever reads its output leaves, as `head` does.

    Returns:
        The exit code.
    """
    _open_streams()
    try:
        try:
            return _answer(arguments)
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        # Python writes at its end what is still kept of both streams.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (sys.stdout, sys.stderr):
            os.dup2(nowhere, stream.fileno())
        return UNREAD


def _answer(arguments: list[str] | None) -> int:
    """Run a command, and return its exit code.

    Ctrl-C ends the process without a word while its libraries load, which takes seconds: nothing has begun. Whoever
    waits at a terminal reads that they load.
    """
    args = parser().parse_args(arguments)
    # XLA writes to stderr about the tuning of programs that it reads from its cache.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    if args.command == "site":
        # On matrices of 240 rows threads of BLAS wait for each other: two busy cores take 25 times as long.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    before, collects = signal.getsignal(signal.SIGINT), gc.isenabled()
    if before is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        gc.disable()  # what loads stays, and looking for what does not takes a tenth of the time
        from cooperative import _commands

        if args.command in _commands.LIBRARIES and sys.stderr.isatty():
            print(f"jaxmpm {args.command}: loading ...", file=sys.stderr, flush=True)
        for module in _commands.LIBRARIES.get(args.command, ()):
            import_module(module)
        gc.freeze()  # nor does looking through it again, later, free anything
    finally:
        if collects:
            gc.enable()
        signal.signal(signal.SIGINT, before)
    return _commands.execute(args)


if __name__ == "__main__":
    sys.exit(main())
