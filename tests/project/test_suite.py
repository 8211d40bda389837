"""The suite's own tools: what the cache of compiled programs holds, and what is left behind, are as they should be."""

import subprocess
import sys

from tests import conftest
from tests.conftest import SESSION, knows_flags, left_behind


def test_flags_that_jaxlib_does_not_know_are_recognised():
    assert knows_flags("--xla_backend_optimization_level=0")
    assert not knows_flags("--xla_no_such_flag=0")


def test_bytecode_is_kept_for_the_next_process():
    child = [sys.executable, "-c", "import sys; print(sys.dont_write_bytecode, sys.pycache_prefix)"]
    printed = subprocess.run(child, capture_output=True, text=True, check=True).stdout
    assert printed == f"{sys.dont_write_bytecode} {sys.pycache_prefix}\n" == f"False {sys.pycache_prefix}\n"


def test_programs_are_released_between_tests_but_not_looked_at_after_each(monkeypatch):
    looks = []
    monkeypatch.setattr(conftest, "release_programs", lambda: looks.append(conftest._looked))
    monkeypatch.setattr(conftest, "_looked", -conftest.BETWEEN_LOOKS)
    for _ in range(3):
        conftest.pytest_runtest_teardown()
    assert looks == [-conftest.BETWEEN_LOOKS]


def test_a_process_left_behind_is_named():
    session = "of this test"
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE, env={SESSION: session}) as left:
        (line,) = left_behind(session, seconds=0.2)
        assert f"process {left.pid}" in line
        assert "input()" in line
        left.communicate(b"\n")
    assert left_behind(session, seconds=5.0) == []
