"""File systems without locks, folders that are read-only, and what killed processes left: named truly, or removed."""

import errno
import fcntl
import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import time
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from cooperative.__main__ import main
from cooperative.exports import export
from cooperative.folder import read_results
from cooperative.store import _database, open_store, read_rows, read_store, write_sample
from jaxmpm.support import files
from tests.cooperative.store.test_store import SCENE, sample


@pytest.mark.parametrize("code", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
def test_a_file_system_without_locks_is_named_as_such(tmp_path, monkeypatch, code):
    def refused(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(fcntl, "flock", refused)
    with pytest.raises(ValueError, match=r"has no locks \(.*\), by which one controller .*: give a folder on a local"):
        open_store(tmp_path / "out", SCENE)


OF_LOCKS = r"no locks: put the folder on a local disk, and start the same command again"


@pytest.mark.parametrize(
    ("code", "number", "remedy"),
    [
        (sqlite3.SQLITE_FULL, errno.ENOSPC, "make room, and start the same command again"),
        (sqlite3.SQLITE_IOERR_WRITE, errno.EIO, "check the disk"),
        (sqlite3.SQLITE_IOERR_FSYNC, errno.EIO, "check the disk"),
        *((code, errno.ENOLCK, OF_LOCKS) for code in _database.OF_LOCKS),
        (sqlite3.SQLITE_READONLY_DIRECTORY, errno.EACCES, "have it and its folder writable, or copy"),
        (sqlite3.SQLITE_CANTOPEN, errno.EACCES, "have it and its folder writable, or copy"),
        (sqlite3.SQLITE_BUSY, errno.EBUSY, "end the other program that has it open, or"),
    ],
)
def test_what_sqlite_refuses_has_an_errno_a_file_and_a_remedy(code, number, remedy, tmp_path):
    error = sqlite3.OperationalError("as SQLite says it")
    error.sqlite_errorcode = code
    with (
        pytest.raises(OSError, match=rf"cannot use .*a\.db \(as SQLite says it\): .*{remedy}") as refused,
        _database.explained(tmp_path / "a.db"),
    ):
        raise error
    assert refused.value.errno == number
    assert refused.value.strerror.isprintable()


def test_a_program_that_reads_for_long_is_named_and_nothing_is_lost(tmp_path, monkeypatch):
    monkeypatch.setattr(_database, "LOCK_TIMEOUT", 0.05)
    with open_store(tmp_path, SCENE) as store:
        write_sample(store, "rough", sample(0))
        with closing(sqlite3.connect(tmp_path / "campaign.db", isolation_level=None)) as other:
            other.execute("begin")
            assert other.execute("select count(*) from run").fetchone() == (1,)
            with pytest.raises(OSError, match=r"database is locked\): end the other program that has it open"):
                write_sample(store, "rough", sample(1))
        assert read_rows(store, "rough").numbers == [0]
        write_sample(store, "rough", sample(1))
        assert read_rows(read_store(tmp_path), "rough").numbers == [0, 1]


@contextmanager
def whoever():
    """As a user who is not root, whom a folder that is read-only would not stop."""
    if os.geteuid():
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


def test_a_folder_that_is_read_only_is_read_and_stays_as_it_is(tiny_campaign, capsys):
    with tempfile.TemporaryDirectory() as outer:
        folder = shutil.copytree(tiny_campaign[0], Path(outer) / "out")
        inside = [Path(outer), folder, *folder.rglob("*")]
        for path in inside:
            path.chmod(0o555 if path.is_dir() else 0o444)
        before = {path: path.stat().st_mtime_ns for path in inside}
        with whoever():
            assert read_results(folder).summary == tiny_campaign[1]
            assert main(["status", str(folder)]) == 0
            assert main(["export", str(folder), "--as", "table"]) == 2
            assert main(["resume", str(folder), "--workers", "1"]) == 2
        assert {path: path.stat().st_mtime_ns for path in (Path(outer), folder, *folder.rglob("*"))} == before
        for path in inside:
            path.chmod(0o755)
    said = capsys.readouterr()
    assert "6 of 6 samples" in said.out
    assert "have it writable, or copy its folder to where you may write" in said.err
    assert "cannot be written (Permission denied): give a folder that you may write to" in said.err


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
    assert main(["check", str(tmp_path / "none.toml"), "--measure", seconds]) == 2
    assert "give more than 0 and at most 3600" in capsys.readouterr().err
