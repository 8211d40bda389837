"""Compiled programs: read again by the next process and by no other machine's, whole whatever befalls their files, and
released before a process holds too many."""

import hashlib
import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
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
folder = keep_compiled(Path(sys.argv[1]))

def program(x):
    return sum(jax.numpy.sin(n * x) for n in range(8))

def once_more():
    jax.clear_caches()
    return float(jax.jit(program)(1.0))

damages = {
    "truncated": lambda entry: entry[: len(entry) // 2],
    "flipped": lambda entry: bytes(byte ^ 64 for byte in entry[:200]) + entry[200:],
    "without its SHA-256": lambda entry: entry[:-32],
    "empty": lambda entry: b"",
}
answer, same = once_more(), {}
(path,) = folder.glob("jit_program-*-cache")
for name, damaged in damages.items():
    path.write_bytes(damaged(path.read_bytes()))
    same[name] = once_more() == answer

loaded, held, most = [], [memory_mappings()[0]], memory_mappings()[0] + 100
while not release_programs(most) and len(loaded) < 200:
    loaded.append(jax.jit(lambda x, n=len(loaded): n + jax.lax.fori_loop(0, 3, lambda _, y: 2 * y + n, x)))
    loaded[-1](1.0)
    held.append(memory_mappings()[0])
released = memory_mappings()[0]
print(json.dumps({"same": same, "held": held, "released": released, "most": most, "first": float(loaded[0](1.0))}))
"""


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    """What two processes print that damage, read and write the same programs at the same time; and their folder."""
    parent = tmp_path_factory.mktemp("programs")
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")}
    environment["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    command = [sys.executable, "-c", SCRIPT, str(parent)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    processes = [subprocess.Popen(command, cwd=ROOT, env=environment, **pipes) for _ in range(2)]
    ends = [process.communicate(timeout=300) for process in processes]
    assert [process.returncode for process in processes] == [0, 0], ends
    return [json.loads(printed) for printed, _ in ends], parent / machine()


def test_a_damaged_program_is_compiled_again_without_a_warning_and_its_file_is_whole_afterwards(outcomes):
    for outcome in outcomes[0]:
        assert set(outcome["same"].values()) == {True}
        assert len(outcome["same"]) == 4
    assert list(outcomes[1].glob("jit_program-*-cache"))
    for path in outcomes[1].iterdir():
        content = path.read_bytes()
        assert path.name.endswith("-cache")
        assert content[-32:] == hashlib.sha256(content[:-32]).digest()


def test_programs_that_are_released_give_their_memory_mappings_back(outcomes):
    for outcome in outcomes[0]:
        held, loaded = outcome["held"], len(outcome["held"]) - 1
        assert outcome["most"] < held[-1] < outcome["most"] + 200
        # Each program loaded on CPU holds several.
        assert held[-1] - held[0] > 3 * loaded
        assert outcome["released"] < held[0] + (held[-1] - held[0]) / 4
        assert outcome["first"] == 8.0


def test_programs_that_threads_write_at_once_are_read_whole_or_not_at_all(tmp_path):
    entries = compiled._Entries(str(tmp_path))
    programs = {bytes([n]) * (100_000 + n) for n in range(4)}
    assert entries.get("key") is None

    def write_and_read(program):
        for _ in range(50):
            entries.put("key", program)
            yield entries.get("key")

    with ThreadPoolExecutor(4) as threads:
        for seen in threads.map(lambda program: set(write_and_read(program)), programs):
            assert seen <= programs
    assert [path.name for path in tmp_path.iterdir()] == ["key-cache"]


def test_jax_reads_and_writes_a_folder_that_it_compares(tmp_path):
    assert isinstance(compiled._entries(str(tmp_path))[0], compiled._Entries)
    jax.config.update("jax_compilation_cache_check_contents", True)
    try:
        assert not isinstance(compiled._entries(str(tmp_path))[0], compiled._Entries)
    finally:
        jax.config.update("jax_compilation_cache_check_contents", False)
