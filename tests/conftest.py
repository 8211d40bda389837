"""Fixtures and settings that all tests share: how programs are compiled and stored, and no process left behind.

Most of the suite's time went into compiling programs that then run for milliseconds. So the session, and every
process that it starts, compiles them without optimisation and with XLA's older code generator, which is three to
five times quicker. `XLA_FLAGS=` (empty) compiles them as for users; `make test-slow` does.

The processes of a session (pytest-xdist's, and those that tests start) share the programs they compile.
"""

import gc
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests import ROOT

SESSION = "JAXMPM_TEST_SESSION"
"""Environment variable by which a session knows the processes that it started, theirs too."""

QUICK = (
    "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
)
"""Flags of XLA for programs that are compiled quickly and run slowly. A program compiled as one part, not as one per
core, takes a tenth less time and a third fewer memory mappings."""


BETWEEN_LOOKS = 5.0
"""Seconds from one look at the memory mappings to the next."""


def knows_flags(flags: str) -> bool:
    """Whether this jaxlib knows the flags: it ends the process where it meets one that it does not know."""
    command = [sys.executable, "-c", "from jaxlib import xla_client; xla_client.CompileOptions()"]
    return subprocess.run(command, env=os.environ | {"XLA_FLAGS": flags}, capture_output=True).returncode == 0


# Where Python may write no bytecode, each process compiles all that it imports: most of what a short child takes.
if sys.dont_write_bytecode:
    os.environ["PYTHONDONTWRITEBYTECODE"] = ""
    sys.pycache_prefix = os.environ.setdefault("PYTHONPYCACHEPREFIX", str(ROOT / ".cache" / "bytecode"))
    sys.dont_write_bytecode = False

# Before jax reads them; what the environment says already stands, here and below.
if "XLA_FLAGS" not in os.environ:
    os.environ["XLA_FLAGS"] = QUICK if knows_flags(QUICK) else ""
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "0")
os.environ.setdefault("JAX_TRACEBACK_IN_LOCATIONS_LIMIT", "0")  # no test reads where in Python an operation was written
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # XLA writes to stderr about tuning flags of entries that it reads
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # on small matrices threads of busy cores wait for each other
STARTED = SESSION not in os.environ
os.environ.setdefault(SESSION, f"{os.getpid()}-{time.time_ns()}")

import jax  # noqa: E402
import pytest  # noqa: E402
from hypothesis import settings  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from benchmarks.robustness.invented import TINY, invent  # noqa: E402
from cooperative import run  # noqa: E402
from cooperative.reporting import _plots  # noqa: E402
from cooperative.runs import keep_compiled, release_programs  # noqa: E402

keep_compiled(ROOT / ".cache")

# JAX keeps what it has traced, millions of objects in the end, and a full collection walks them all.
gc.freeze()
gc.set_threshold(100_000, 20, 100)

# A shell has what it starts in the background ignore Ctrl-C, and so would what tests start and interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A first call compiles, so a deadline per example means nothing; the same examples every time keep main green.
settings.register_profile("project", deadline=None, derandomize=True)
settings.load_profile("project")


@pytest.fixture
def x64() -> Iterator[None]:
    """Run the test in float64."""
    with jax.enable_x64(True):
        yield


@pytest.fixture
def made_up(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Made-up runs in place of the solver's; the fixture `monkeypatch`."""
    invent(put=monkeypatch.setattr)
    return monkeypatch


@pytest.fixture(scope="session")
def tiny_campaign(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A campaign of TINY that has run: its folder, to which no test adds a sample, and its summary."""
    folder = tmp_path_factory.mktemp("campaign") / "tiny"
    return folder, run(TINY, folder)


@pytest.fixture
def unrendered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have figures written as empty files and not laid out, which takes most of a report's time, where a test looks at
    what the report says."""

    def empty(figure: Figure, path: Any, **_: object) -> None:
        path.write(b"") if hasattr(path, "write") else Path(path).write_bytes(b"")

    monkeypatch.setattr(Figure, "savefig", empty)
    monkeypatch.setattr(_plots, "lay_out", lambda figure: None)


def left_behind(session: str, seconds: float = 10.0) -> list[str]:
    """Processes of a session that still run after so many seconds: their commands, and the tests that began them."""
    until = time.monotonic() + seconds
    while (running := list(_running(session))) and time.monotonic() < until:
        time.sleep(0.1)
    return running


def _running(session: str) -> Iterator[str]:
    for process in Path("/proc").glob("[0-9]*"):
        try:
            environment = dict(
                entry.split("=", 1) for entry in (process / "environ").read_text().split("\0") if "=" in entry
            )
            command = (process / "cmdline").read_text().replace("\0", " ")
        except (OSError, UnicodeDecodeError):
            continue
        # A process that has ended and waits for its parent has no command any more; the tracker ends with its owner.
        ours = environment.get(SESSION) == session and int(process.name) != os.getpid()
        if ours and command and "resource_tracker" not in command:
            yield f"process {process.name}, begun by {environment.get('PYTEST_CURRENT_TEST', 'no test')}: {command}"


_looked = 0.0


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown() -> None:
    """Release the programs of tests that ended before they take all memory mappings; a look costs up to 50 ms."""
    global _looked
    if time.monotonic() > _looked + BETWEEN_LOOKS:
        release_programs()
        _looked = time.monotonic()


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail the session if a process that it started outlives it."""
    if STARTED and (lines := left_behind(os.environ[SESSION])):
        reporter = session.config.pluginmanager.get_plugin("terminalreporter")
        for line in lines:
            reporter.write_line(f"left behind: {line[:400]}", red=True)
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
