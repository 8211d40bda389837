"""`jaxmpm`, or `python -m cooperative`. The commands stand in `cooperative._commands`."""

import os
import signal
import sys


def main(arguments: list[str] | None = None) -> int:
    """Run a command. Ctrl-C ends the process without a word while its libraries load, which takes seconds: nothing has
    begun."""
    # XLA writes to stderr about the tuning of programs that it reads from its cache.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        from cooperative import _commands
    finally:
        signal.signal(signal.SIGINT, before)
    return _commands.main(arguments)


if __name__ == "__main__":
    sys.exit(main())
