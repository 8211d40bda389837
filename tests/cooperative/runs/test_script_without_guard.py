"""A script that starts a campaign with workers and lacks the guard of its main module is told so at once."""

import multiprocessing
import subprocess
import sys

import pytest

from cooperative import run
from tests.cooperative.campaign.test_campaign import TINY

GUARD = r"put what it does under the line if __name__ == '__main__':, or give workers = 1"


def test_a_run_while_a_process_imports_its_script_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(multiprocessing.current_process(), "_inheriting", True, raising=False)
    with pytest.raises(ValueError, match=GUARD):
        run(TINY, tmp_path / "out")
    assert not (tmp_path / "out").exists()


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
