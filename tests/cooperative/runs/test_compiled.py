"""Compiled programs: read again by the next process and by no other machine's, whole whatever befalls their files, and
released before a process holds too many."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from cooperative.runs import _compiled as compiled
from cooperative.runs import machine
from tests import ROOT

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


def test_what_is_compiled_is_read_again(tmp_path):
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


def test_short_programs_are_kept_in_a_folder_of_the_users_own_too(monkeypatch, tmp_path):
    given = {}
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path))
    for name in ("MIN_COMPILE_TIME_SECS", "MIN_ENTRY_SIZE_BYTES"):
        monkeypatch.delenv(f"JAX_PERSISTENT_CACHE_{name}", raising=False)
    monkeypatch.setattr(compiled.jax.config, "update", given.__setitem__)
    assert compiled.keep_compiled() == tmp_path
    assert given == {
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": 0,
    }


@pytest.mark.parametrize("other", ["processor", "library"])
def test_another_machine_or_another_build_has_another_folder(other, monkeypatch, tmp_path):
    here = machine()
    if other == "processor":
        monkeypatch.setattr(compiled.platform, "processor", lambda: "another")
    else:
        (tmp_path / "another.so").write_bytes(b"another build")
        monkeypatch.setattr(compiled, "native_library", lambda: tmp_path / "another.so")
    assert machine() != here


SCRIPT = """
import json, sys, warnings
from pathlib import Path
import jax
from cooperative.runs import keep_compiled, memory_mappings, release_programs
warnings.simplefilter("error")
keep_compiled(Path(sys.argv[1]))
jax.jit(lambda x: x + 1)(1.0)  # JAX maps memory at its first program

loaded, held, most = [], [memory_mappings()[0]], memory_mappings()[0] + 100
while not release_programs(most) and len(loaded) < 200:
    loaded.append(jax.jit(lambda x, n=len(loaded): n + jax.lax.fori_loop(0, 3, lambda _, y: 2 * y + n, x)))
    loaded[-1](1.0)
    held.append(memory_mappings()[0])
released = memory_mappings()[0]
print(json.dumps({"held": held, "released": released, "most": most, "first": float(loaded[0](1.0))}))
"""


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    """What two processes print that read and write the same programs at the same time."""
    parent = tmp_path_factory.mktemp("programs")
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")}
    environment["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    command = [sys.executable, "-c", SCRIPT, str(parent)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    processes = [subprocess.Popen(command, cwd=ROOT, env=environment, **pipes) for _ in range(2)]
    ends = [process.communicate(timeout=300) for process in processes]
    assert [process.returncode for process in processes] == [0, 0], ends
    return [json.loads(printed) for printed, _ in ends]


@pytest.mark.parametrize(
    "damage", [lambda entry: entry[: len(entry) // 2], lambda entry: b"", lambda entry: entry[:-1]]
)
def test_a_damaged_program_is_deleted_at_the_next_start(tmp_path, damage):
    folder = Path(run(tmp_path))
    whole = {path.name: path.read_bytes() for path in folder.glob("*-cache")}
    path = max(folder.glob("*-cache"), key=lambda each: each.stat().st_size)
    path.write_bytes(damage(path.read_bytes()))
    compiled.delete_damaged(folder)
    assert entries(folder) == whole.keys() - {path.name}
    run(tmp_path)
    assert entries(folder) == whole.keys()
    compiled.delete_damaged(folder)
    assert entries(folder) == whole.keys()


def test_entries_are_looked_at_once(tmp_path):
    old = tmp_path / "old-cache"
    old.write_bytes(b"x damaged")
    os.utime(old, (1, 1))
    (tmp_path / compiled.CHECKED).touch()
    compiled.delete_damaged(tmp_path)
    assert old.exists()


def test_programs_that_are_released_give_their_memory_mappings_back(outcomes):
    for outcome in outcomes:
        held, loaded = outcome["held"], len(outcome["held"]) - 1
        assert outcome["most"] < held[-1] < outcome["most"] + 200
        # Each program loaded on CPU holds several.
        assert held[-1] - held[0] > 3 * loaded
        assert outcome["released"] < held[0] + (held[-1] - held[0]) / 4
        assert outcome["first"] == 8.0
