"""Compiled programs kept between commands: found again by the next process, and by no other machine's."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cooperative.runs import _compiled as compiled
from cooperative.runs import machine

ROOT = Path(__file__).resolve().parent.parent

PROGRAM = """
import sys
from pathlib import Path
import jax
from cooperative.runs import keep_compiled
print(keep_compiled(Path(sys.argv[1])))
jax.jit(lambda x: sum(jax.numpy.sin(n * x) for n in range(40)))(1.0)
"""


def run(parent, **variables):
    """Where a process of its own keeps what it compiles, of what takes any time at all."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")}
    environment |= {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0", **variables}
    command = [sys.executable, "-c", PROGRAM, str(parent)]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True).stdout.strip()


def entries(folder):
    return {path.name for path in Path(folder).glob("*-cache")}


def test_what_is_compiled_is_found_again(tmp_path):
    folder = run(tmp_path)
    assert folder == str(tmp_path / machine())
    there = entries(folder)
    assert there
    written = {path: path.stat().st_mtime_ns for path in Path(folder).glob("*-cache")}
    assert run(tmp_path) == folder
    assert entries(folder) == there
    assert {path: path.stat().st_mtime_ns for path in written} == written


@pytest.mark.slow
def test_the_users_own_choice_of_folder_stands_and_off_is_off(tmp_path):
    assert run(tmp_path / "ours", JAX_COMPILATION_CACHE_DIR=str(tmp_path / "own")) == str(tmp_path / "own")
    assert entries(tmp_path / "own")
    assert run(tmp_path / "ours", JAX_ENABLE_COMPILATION_CACHE="0") == "None"
    assert not (tmp_path / "ours").exists()


@pytest.mark.parametrize("other", ["processor", "library"])
def test_another_machine_or_another_build_has_another_folder(other, monkeypatch, tmp_path):
    here = machine()
    if other == "processor":
        monkeypatch.setattr(compiled.platform, "processor", lambda: "another")
    else:
        (tmp_path / "another.so").write_bytes(b"another build")
        monkeypatch.setattr(compiled, "native_library", lambda: tmp_path / "another.so")
    assert machine() != here
