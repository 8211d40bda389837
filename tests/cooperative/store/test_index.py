"""The index of a folder's samples: what spares reading their files, and what it may not hide."""

import errno
import json
import os
import re
import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from benchmarks.robustness.hostile_files import Baits, lay_baits, no_files
from cooperative.store import (
    DamagedFile,
    _disk,
    open_store,
    read_rows,
    read_sample,
    read_store,
    write_sample,
)
from cooperative.store._disk import read_file, rows_of
from jaxmpm.support import files
from tests.cooperative.store.test_store import SCENE, TICK, sample


def in_campaign(folder, count=5):
    """A folder with so many samples, and the file of each."""
    with open_store(folder, SCENE) as store:
        return [write_sample(store, "rough", sample(number)) for number in range(count)]


def files_read(monkeypatch):
    """The files that are read and verified from now on."""
    read = []

    def noted(store, grid, path):
        read.append(path.name)
        return read_file(store, grid, path)

    monkeypatch.setattr(_disk, "read_file", noted)
    return read


def assert_same_rows(left, right):
    assert left.columns.keys() == right.columns.keys()
    for name, values in left.columns.items():
        assert values.dtype == right.columns[name].dtype
        np.testing.assert_array_equal(values, right.columns[name])


def test_files_that_have_not_changed_are_not_read_again_and_give_the_same_rows(tmp_path, monkeypatch):
    in_campaign(tmp_path)
    indexed = read_rows(read_store(tmp_path), "rough")
    (tmp_path / "samples" / "rough.index").unlink()
    read = files_read(monkeypatch)
    verified = read_rows(read_store(tmp_path), "rough")
    assert len(read) == 5
    assert_same_rows(indexed, verified)
    assert not (tmp_path / "samples" / "rough.index").exists()
    with open_store(tmp_path, SCENE) as store:
        assert_same_rows(read_rows(store, "rough"), verified)
        assert len(read) == 10
        assert_same_rows(read_rows(store, "rough"), verified)
    assert_same_rows(read_rows(read_store(tmp_path), "rough"), verified)
    assert len(read) == 10


@pytest.mark.parametrize("same_times", [True, False])
def test_a_file_that_was_changed_copied_or_replaced_is_verified_anew(tmp_path, same_times, monkeypatch):
    paths = in_campaign(tmp_path)
    about = [path.stat() for path in paths]
    time.sleep(TICK)
    flipped = bytearray(paths[1].read_bytes())
    flipped[-20] ^= 1
    paths[1].write_bytes(flipped)
    shutil.copyfile(paths[3], paths[2])
    os.replace(shutil.copyfile(paths[3], tmp_path / "copy"), paths[3])
    if same_times:
        for path, was in zip(paths, about, strict=True):
            if path != paths[0]:
                os.utime(path, ns=(was.st_atime_ns, was.st_mtime_ns))
    read = files_read(monkeypatch)
    with open_store(tmp_path, SCENE) as store, pytest.warns(UserWarning, match="set aside, the sample is run again"):
        rows = read_rows(store, "rough")
    changed = [path.name for path in (paths[1:] if same_times else paths[1:4])]
    assert read == changed
    assert rows.numbers == [0, 3, 4]
    assert [re.search(r"\d{6}\.h5", line)[0] for line in rows.damaged] == ["000001.h5", "000002.h5"]


def index_lines(folder):
    return (folder / "samples" / "rough.index").read_bytes().splitlines(keepends=True)


@pytest.mark.parametrize("how", ["torn", "flipped", "of another scene", "rubbish", "empty", "of another grid", "twice"])
def test_lines_of_an_index_that_do_not_hold_are_dropped_and_their_files_verified(tmp_path, monkeypatch, how):
    in_campaign(tmp_path / "campaign")
    path, lines = tmp_path / "campaign/samples/rough.index", index_lines(tmp_path / "campaign")
    if how == "torn":
        lines[-1] = lines[-1][:-7]
    elif how == "flipped":
        lines[4] = lines[4].replace(b'"broke_off": false', b'"broke_off": true')
    elif how == "of another scene":
        with open_store(tmp_path / "other", SCENE.replace("0.3", "0.4")) as other:
            write_sample(other, "rough", sample(4))
        lines[4:] = index_lines(tmp_path / "other")
    elif how == "of another grid":
        with open_store(tmp_path / "campaign", SCENE) as store:
            write_sample(store, "refined", sample(4))
        lines[4:] = [(tmp_path / "campaign/samples/refined.index").read_bytes()]
    elif how == "twice":
        lines += lines[:2]
    else:
        lines[4:] = [b""] if how == "empty" else [b"\xff\x00 {[\n", b"\n", b"0 " + b"[" * 100_000 + b"\n"]
    path.write_bytes(b"".join(lines))
    read = files_read(monkeypatch)
    for reads in (0 if how == "twice" else 1, 0):
        read.clear()
        with open_store(tmp_path / "campaign", SCENE) as store:
            rows = read_rows(store, "rough")
            assert rows.numbers == [0, 1, 2, 3, 4]
            assert not rows.damaged
            assert rows.columns["broke_off"].sum() == 0
        assert read == ["000004.h5"] * reads
    assert len(index_lines(tmp_path / "campaign")) == 5


def forged(store, **changes):
    """A line with a checksum that fits and contents that nobody wrote."""
    text = json.dumps(json.loads(index_lines(store.folder)[0].partition(b" ")[2]) | changes).encode()
    return _disk.checked_line(store, "rough", text)


@pytest.mark.parametrize(
    "changes",
    [
        {"row": {"displacement": "far", "broke_off": False}},
        {"row": {"displacement": -1.0, "broke_off": True}},
        {"row": {"displacement": 1.0}},
        {"row": {"displacement": 1.0, "broke_off": True, "list": [1]}},
        {"row": {"displacement": 1.0, "broke_off": True, "\x1b[2J": 1.0}},
        {"row": [1, 2]},
        {"status": "FINISHED\nP_f = 0"},
        {"steps": "many"},
        {"sample": True},
        {"shapes": {}},
        {"shapes": {"coefficients": [2, 3]}},
        {"shapes": {"coefficients": "no"}},
        {"stamp": 7},
    ],
)
def test_a_line_that_lies_is_not_taken(tmp_path, changes, monkeypatch):
    in_campaign(tmp_path, count=1)
    with open_store(tmp_path, SCENE) as store:
        (tmp_path / "samples/rough.index").write_bytes(forged(store))
        read = files_read(monkeypatch)
        assert read_rows(store, "rough").numbers == [0]
        assert not read
        (tmp_path / "samples/rough.index").write_bytes(forged(store, **changes))
        assert_same_rows(read_rows(store, "rough"), rows_of([sample(0).record]))
        assert read == ["000000.h5"]


@pytest.mark.parametrize("what", sorted(no_files(Baits(Path(), Path()))))
def test_an_index_that_is_no_file_is_set_aside_and_leads_nowhere(tmp_path, what):
    baits = lay_baits(tmp_path / "outside")
    in_campaign(tmp_path / "campaign")
    path = tmp_path / "campaign/samples/rough.index"
    path.unlink()
    no_files(baits)[what](path)
    assert read_rows(read_store(tmp_path / "campaign"), "rough").numbers == [0, 1, 2, 3, 4]
    with open_store(tmp_path / "campaign", SCENE) as store:
        with pytest.warns(UserWarning, match=r"rough\.index is no regular file: set aside as"):
            assert read_rows(store, "rough").numbers == [0, 1, 2, 3, 4]
        write_sample(store, "rough", sample(5))
    assert len(index_lines(tmp_path / "campaign")) == 6
    assert baits.untouched()


def test_what_an_index_cannot_see_is_noticed_when_the_file_is_read_and_when_asked_to_verify(tmp_path, monkeypatch):
    paths = in_campaign(tmp_path)
    stamps = {path: _disk.stamp_of(path) for path in paths}
    data = bytearray(paths[2].read_bytes())
    data[-20] ^= 1
    paths[2].write_bytes(data)
    # Bits that flip on the disk change neither size nor times.
    monkeypatch.setattr(_disk, "stamp_of", stamps.__getitem__)
    with open_store(tmp_path, SCENE) as store:
        rows = read_rows(store, "rough")
        assert_same_rows(rows, rows_of([sample(number).record for number in range(5)]))
        with pytest.raises(DamagedFile, match=r"000002\.h5 .*checksum.*resume --verify"):
            read_sample(store, "rough", 2)
    with (
        open_store(tmp_path, SCENE, verify=True) as store,
        pytest.warns(UserWarning, match=r"000002\.h5 .*checksum.*set aside"),
    ):
        assert read_rows(store, "rough").numbers == [0, 1, 3, 4]


def test_a_stop_is_seen_before_each_file_and_what_was_verified_is_stored(tmp_path, monkeypatch):
    in_campaign(tmp_path)
    (tmp_path / "samples/rough.index").unlink()
    looks = []

    def look():
        looks.append(None)
        if len(looks) == 4:
            raise KeyboardInterrupt

    read = files_read(monkeypatch)
    with open_store(tmp_path, SCENE) as store:
        with pytest.raises(KeyboardInterrupt):
            read_rows(store, "rough", look=look)
        assert read == ["000000.h5", "000001.h5", "000002.h5"]
        assert read_rows(store, "rough").numbers == [0, 1, 2, 3, 4]
    assert read == [f"{number:06d}.h5" for number in range(5)]


def test_a_disk_too_full_for_the_index_says_so_and_loses_no_sample(tmp_path, monkeypatch):
    in_campaign(tmp_path, count=1)
    with open_store(tmp_path, SCENE) as store:

        def full(path):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        with monkeypatch.context() as patched:
            patched.setattr(files, "append_to", full)
            with pytest.raises(OSError, match=r"rough\.index \(No space left on device\): make room"):
                write_sample(store, "rough", sample(1))
        assert read_rows(store, "rough").numbers == [0, 1]
    assert len(index_lines(tmp_path)) == 2
