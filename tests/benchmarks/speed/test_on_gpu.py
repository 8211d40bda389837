"""The script for GPUs, on a CPU: what it judges, its table, and its parts on small scenes."""

import json
import shutil
import subprocess

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.speed import on_gpu, on_gpu_calls, on_gpu_rows
from benchmarks.speed.on_gpu_rows import row
from jaxmpm.transfer import native_available
from tests import ROOT

needs_native = pytest.mark.skipif(not native_available(), reason="native kernels were not built")


@pytest.mark.parametrize(
    ("given", "result"),
    [
        (row("a", 1.0), "none"),
        (row("a", 1.0, at_most=1.0), "pass"),
        (row("a", 1.1, at_most=1.0), "fail"),
        (row("a", float("nan"), at_most=1.0), "fail"),
        (row("a", 3.0, 6.0, at_most=0.5, of="ratio"), "pass"),
        (row("a", 3.1, 6.0, at_most=0.5, of="ratio"), "fail"),
        (row("a", 3.0, at_most=0.5, of="ratio"), "fail"),
        (row("a", 0, 0, at_most=0), "pass"),
    ],
)
def test_a_row_is_judged_by_its_bound(given, result):
    assert given["result"] == result
    assert json.loads(json.dumps(given)) == given or np.isnan(given["ours"])


def test_the_exit_code_tells_what_failed_and_what_was_stopped(tmp_path, capsys):
    path = tmp_path / "rows.jsonl"
    assert on_gpu_rows.main(path) == 2
    rows, ends = [row("step", 3.0, 4.0, unit="us", at_most=0.55, of="ratio")], []
    for added in ({"what": "build", "ours": 7, "result": "pass"}, {"what": "tests", "result": "stopped"}, rows[0]):
        with path.open("a") as lines:
            lines.write(json.dumps(added) + "\n")
        ends.append(on_gpu_rows.main(path))
    assert ends == [0, 2, 1]
    lines = capsys.readouterr().out.splitlines()[-4:]
    assert lines[-1].split() == ["step", "us", "3", "4", "0.75", "ratio", "<=", "0.55", "fail"]
    assert (
        len({line.rindex(word) for line, word in zip(lines, ("result", "pass", "stopped", "fail"), strict=True)}) == 1
    )


@given(seed=st.integers(0, 2**32 - 1))
def test_places_keep_their_quarter_of_a_cell_and_keep_off_its_ends(seed):
    rng = np.random.default_rng(seed)
    places = rng.uniform(0, 30, (3, 50))
    moved = on_gpu.off_kinks(rng, places)
    np.testing.assert_array_equal(np.floor(4 * moved), np.floor(4 * places))
    assert np.abs(4 * moved - np.round(4 * moved)).min() > 0.099


@needs_native
def test_steps_compare_the_engines_and_a_case_that_fails_leaves_the_others(monkeypatch):
    sound, asked = on_gpu.measure, []

    def measure(case, built):
        asked.append(built[0].numerics.engine)
        if len(asked) == 1:
            raise RuntimeError("out of memory")
        return sound(case, built)

    monkeypatch.setattr(on_gpu, "measure", measure)
    failed, measured = on_gpu.steps(True, ("refined", "section, 256 lanes"))
    assert failed == {"what": "step, refined: out of memory", "result": "fail"}
    assert asked[1:] == list(on_gpu.ENGINES)
    assert measured["particles"] == 3 * 888
    assert measured["ratio"] == measured["ours"] / measured["XLA's"]
    assert measured["bound"] == "ratio <= 1"


@needs_native
def test_each_kernel_is_called_alone(capsys):
    on_gpu_calls.main()
    printed = capsys.readouterr().out.splitlines()
    assert len(printed) == len(set(printed)) == 2 * 2 * (1 + 2 * 2)
    assert all(line.endswith(": finite") for line in printed)


def test_what_is_promised_is_measured():
    assert on_gpu.AT_MOST.keys() <= on_gpu.STEPS.keys()


@pytest.mark.skipif(shutil.which("sh") is None, reason="there is no shell")
def test_the_script_names_parts_that_there_are():
    script = ROOT / "benchmarks" / "speed" / "on_gpu.sh"
    subprocess.run(["sh", "-n", script], check=True)
    named = [line.split()[1] for line in script.read_text().splitlines() if line.startswith("rows ")]
    assert sorted(named) == sorted(on_gpu.PARTS)
