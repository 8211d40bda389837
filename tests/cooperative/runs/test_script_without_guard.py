"""A script that starts a campaign with workers and lacks the guard of its main module is told so at once."""

import multiprocessing
import runpy
import subprocess
import sys
from contextlib import nullcontext

import pytest

from cooperative import run
from tests.cooperative.campaign.test_campaign import TINY

GUARD = r"put what it does under the line if __name__ == '__main__':, or give workers = 1"


def test_a_run_while_a_process_imports_its_script_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(multiprocessing.current_process(), "_inheriting", True, raising=False)
    with pytest.raises(ValueError, match=GUARD):
        run(TINY, tmp_path / "out")
    assert not (tmp_path / "out").exists()


STARTS = 'from cooperative.runs import refuse_unguarded\n{}refuse_unguarded({})\nprint("started")\n'


@pytest.mark.parametrize(
    ("before", "workers", "refused"),
    [
        ("", 2, True),
        ("", 1, False),
        ("def start():\n    ", 2, False),  # nothing starts
        ("for _ in range(1):\n    ", 2, True),
        ("if __name__ == '__main__':\n    ", 2, False),
        ("if __name__ != '__main__':\n    raise SystemExit\n", 2, False),
        ("globals()['__name__'] == '__main__' and ", 2, False),
        ("import multiprocessing\nif multiprocessing.parent_process() is None:\n    ", 2, False),
    ],
)
def test_a_script_is_refused_where_a_worker_would_start_it_again(before, workers, refused, tmp_path):
    script = tmp_path / "script.py"
    script.write_text(STARTS.format(before, workers))
    with pytest.raises(ValueError, match=GUARD) if refused else nullcontext():
        runpy.run_path(str(script), run_name="__main__")


def test_a_function_of_the_script_is_refused_where_the_script_calls_it_without_the_guard(tmp_path):
    lines = STARTS.format("def start():\n    ", 2).replace("print", "start()\nprint")
    script = tmp_path / "script.py"
    script.write_text(lines)
    with pytest.raises(ValueError, match=GUARD):
        runpy.run_path(str(script), run_name="__main__")
    script = tmp_path / "guarded.py"
    script.write_text(lines.replace("start()\nprint", "if __name__ == '__main__':\n    start()\n    print"))
    runpy.run_path(str(script), run_name="__main__")


def test_a_library_that_guards_its_start_is_left_to_do_so(tmp_path, monkeypatch):
    (tmp_path / "guarding.py").write_text(STARTS.format("def start():\n    if __name__:\n        ", 2))
    monkeypatch.syspath_prepend(tmp_path)
    script = tmp_path / "script.py"
    script.write_text("import guarding\nguarding.start()\nwent_on = True\n")
    assert runpy.run_path(str(script), run_name="__main__")["went_on"]


@pytest.mark.slow
def test_a_script_without_the_guard_ends_with_one_error(tmp_path):
    (tmp_path / "tiny.toml").write_text(TINY.replace("t_end = 4.0", "t_end = 0.2"))
    script = tmp_path / "script.py"
    script.write_text('import cooperative\ncooperative.run("tiny.toml", "out", workers=2)\n')
    done = subprocess.run([sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.count("Traceback") <= 2
    assert GUARD in done.stderr.splitlines()[-1]
    assert "another controller" not in done.stderr
    guarded = script.read_text().replace("cooperative.run", 'if __name__ == "__main__":\n    cooperative.run')
    script.write_text(guarded)
    subprocess.run([sys.executable, str(script)], cwd=tmp_path, check=True)
