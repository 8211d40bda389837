"""File systems without locks, folders that are read-only, and what killed processes left: named truly, or removed."""

import errno
import fcntl
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cooperative.__main__ import main
from cooperative.reporting._exports import export
from cooperative.store import open_store
from jaxmpm.support import files
from tests.cooperative.store.test_store import SCENE


@pytest.mark.parametrize("code", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
def test_a_file_system_without_locks_is_named_as_such(tmp_path, monkeypatch, code):
    def refused(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(fcntl, "flock", refused)
    with pytest.raises(ValueError, match=r"has no locks \(.*\), by which one controller .*: give a folder on a local"):
        open_store(tmp_path / "out", SCENE)


@pytest.mark.parametrize("code", [errno.EROFS, errno.EACCES])
@pytest.mark.parametrize("refuses", ["mkdir", "write_bytes"])
def test_an_export_into_a_folder_that_is_read_only_says_so(tiny_campaign, tmp_path, monkeypatch, capsys, code, refuses):
    folder = shutil.copytree(tiny_campaign[0], tmp_path / "out")

    def refused(path, *_, **__):
        raise OSError(code, os.strerror(code), str(path))

    monkeypatch.setattr(Path, refuses, refused)
    assert main(["export", str(folder), "--as", "table" if refuses == "write_bytes" else "particles"]) == 2
    said = capsys.readouterr().err
    assert "Errno" not in said
    assert f"({os.strerror(code)}): have it writable, or copy its folder to where you may write" in said


def test_what_a_killed_export_left_is_removed_by_the_next_one(tiny_campaign, tmp_path):
    folder = shutil.copytree(tiny_campaign[0], tmp_path / "out")
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    parts = {
        "dead": folder / f".campaign.nc.{ended.pid}.part",
        "running": folder / f".campaign.nc.{os.getpid()}.part",
        "writing elsewhere": folder / f".table.csv.{ended.pid}.part",
        "of a series": folder / "series" / f".rough-000001.vtkhdf.{ended.pid}.part",
    }
    (folder / "series").mkdir(exist_ok=True)
    for name, path in parts.items():
        path.write_bytes(b"half")
        if name != "writing elsewhere":
            os.utime(path, times=(time.time() - 2 * files.STILL,) * 2)
    list(export(folder, ["table"]))
    assert {name for name, path in parts.items() if path.exists()} == {"running", "writing elsewhere"}


@pytest.mark.parametrize("seconds", ["inf", "nan", "0", "-1", "1e9"])
def test_a_trial_without_end_is_refused(tmp_path, seconds, capsys):
    assert main(["check", str(tmp_path / "none.toml"), "--seconds", seconds]) == 2
    assert "give more than 0 and at most 3600" in capsys.readouterr().err
