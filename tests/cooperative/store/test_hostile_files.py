"""Databases, files and links in a campaign's folder that lie: they are noticed, and nothing outside it is read."""

import os
import re
import shutil
import sqlite3
import warnings
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from benchmarks.robustness.hostile_files import Baits, damaged, hand_made, lay_baits, lie
from cooperative.runs import rows_reader
from cooperative.store import (
    DamagedFile,
    open_store,
    read_rows,
    read_sample,
    read_store,
    write_aside,
    write_sample,
)
from tests.cooperative.store.test_store import SCENE, assert_same, sample


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A campaign with rough runs 1 and 2, both with fields."""
    folder = tmp_path_factory.mktemp("whole") / "campaign"
    with open_store(folder, SCENE) as store:
        for number in (1, 2):
            write_sample(store, "rough", sample(number))
    return folder


HAND_MADE = sorted(hand_made(Baits(Path(), Path())))
OF_THE_FILE = ("fields: ", "row: fields elsewhere")
"""What is only read with the fields of a run."""


@pytest.mark.parametrize("name", HAND_MADE)
def test_a_folder_that_lies_is_noticed_reads_nothing_elsewhere_and_hangs_nothing(tmp_path, whole, name):
    baits, folder = lay_baits(tmp_path / "outside"), tmp_path / "campaign"
    shutil.copytree(whole, folder)
    hand_made(baits)[name](folder)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        refused = refusal(lambda: read_store(folder))
        if refused is None:
            said = refusal(lambda: read_sample(read_store(folder), "rough", 1))
            assert said is not None
            assert said.isprintable()
            rows = read_rows(read_store(folder), "rough")
            assert all(line.isprintable() for line in rows.damaged)
            if not name.startswith("fields: "):
                assert rows.numbers in ([2], [])
            with open_store(folder, SCENE, verify=True) as store:
                if name.startswith("fields: ") and len(read_rows(store, "rough").numbers) == 2:
                    # The checksum is right, and what it is of is not: only whoever reads it can tell.
                    with pytest.raises(DamagedFile, match=r"resume --verify"):
                        read_sample(store, "rough", 1)
                else:
                    assert 1 not in read_rows(store, "rough").numbers
                    write_sample(store, "rough", sample(1))
                    assert_same(read_sample(store, "rough", 1), sample(1))
        else:
            assert refused.isprintable()
            assert refusal(lambda: open_store(folder, SCENE).close()) is not None
    assert baits.untouched()


def refusal(read) -> str | None:
    """Why it refuses, None where it does not."""
    try:
        read()
    except ValueError as error:
        return str(error)
    return None


def test_every_damaged_copy_of_a_database_is_noticed_or_means_nothing(tmp_path, whole):
    folder = tmp_path / "campaign"
    shutil.copytree(whole, folder)
    path, content, noticed = folder / "campaign.db", (whole / "campaign.db").read_bytes(), 0
    for how, data in damaged(content, 300):
        path.write_bytes(data)
        try:
            store = read_store(folder)
            rows = read_rows(store, "rough")
            for number in rows.numbers:
                assert_same(read_sample(store, "rough", number), sample(number))
            assert (store.source.text, len(rows.numbers) + len(rows.damaged)) == (SCENE, 2), how
            noticed += bool(rows.damaged)
        except DamagedFile:
            noticed += 1
    # The rest of a page that no row fills may hold anything.
    assert noticed > 100


def test_a_controller_keeps_what_is_whole_of_a_damaged_database_and_runs_the_rest_again(tmp_path):
    folder, count = tmp_path / "campaign", 60
    with open_store(folder, SCENE) as store:
        for number in range(count):
            write_sample(store, "rough", sample(number) if number == 7 else without_fields(number))
    content = bytearray((folder / "campaign.db").read_bytes())
    at = content.rfind(sample(30).coefficients.tobytes()) // 4096 * 4096
    content[at : at + 4096] = os.urandom(4096)
    (folder / "campaign.db").write_bytes(content)
    with pytest.warns(UserWarning, match=r"is damaged \(.*\): copied to campaign.db.damaged; .* runs are whole"):
        store = open_store(folder, SCENE)
    with store:
        rows = read_rows(store, "rough")
        assert not rows.damaged
        assert 30 not in rows.numbers
        assert count // 2 < len(rows.numbers) < count
        for number in set(range(count)) - set(rows.numbers):
            write_sample(store, "rough", without_fields(number))
        assert read_rows(store, "rough").numbers == list(range(count))
        assert_same(read_sample(store, "rough", 7), sample(7))
    assert (folder / "campaign.db.damaged").read_bytes() == content


def without_fields(number: int):
    return sample(number, size=0).__class__(**{**vars(sample(number)), "fields": {}})


def test_a_row_that_was_changed_is_copied_aside_and_run_again(tmp_path, whole):
    folder = tmp_path / "campaign"
    shutil.copytree(whole, folder)
    for again in ("", ".1"):
        with closing(sqlite3.connect(folder / "campaign.db")) as database, database:
            database.execute("update run set displacement = 0.1 where sample = 2")
        assert read_rows(read_store(folder), "rough").numbers == [1]
        with open_store(folder, SCENE) as store:
            with pytest.warns(
                UserWarning, match=r"sample 2 of the rough grid does not match its checksum: set aside in"
            ):
                (why,) = read_rows(store, "rough").damaged
            assert why.startswith(str(folder / "campaign.db"))
            assert read_rows(store, "rough").damaged == ()
            write_sample(store, "rough", sample(2))
        assert (folder / f"campaign.db{again}.damaged").exists()


def test_a_damaged_or_missing_file_of_fields_is_run_again(tmp_path, whole):
    folder = tmp_path / "campaign"
    shutil.copytree(whole, folder)
    (first,), (second,) = (list((folder / "fields").glob(f"rough-00000{n}-*")) for n in (1, 2))
    first.unlink()
    second.write_bytes(second.read_bytes()[:-7])
    assert read_rows(read_store(folder), "rough").numbers == [2]
    with pytest.raises(DamagedFile, match=r"sample 2 .*fields that do not match their checksum.*resume --verify"):
        read_sample(read_store(folder), "rough", 2)
    with open_store(folder, SCENE) as store, pytest.warns(UserWarning, match=f"sample 1 .*lacks its file {first.name}"):
        assert read_rows(store, "rough").numbers == [2]
    looks = []
    with pytest.warns(UserWarning, match=f"{second.name} does not match its checksum: set aside"):
        store = open_store(folder, SCENE, verify=True, check=lambda: looks.append(1))
    with store, pytest.warns(UserWarning, match=f"sample 2 .*lacks its file {second.name}"):
        assert read_rows(store, "rough").numbers == []
    assert looks == [1]
    assert second.with_name(second.name + ".damaged").exists()


def test_a_journal_that_was_left_is_undone_and_one_in_a_folder_that_is_read_only_is_named(tmp_path, whole, monkeypatch):
    folder = tmp_path / "campaign"
    shutil.copytree(whole, folder)
    with closing(sqlite3.connect(folder / "campaign.db", isolation_level=None)) as database:
        database.execute("pragma cache_size = 1")
        database.execute("begin immediate")
        database.execute("update run set displacement = 0.1")
        database.execute("update run set coefficients = zeroblob(100000)")
        shutil.copytree(folder, tmp_path / "killed")
    assert (tmp_path / "killed" / "campaign.db-journal").stat().st_size > 512
    opened = sqlite3.connect
    with monkeypatch.context() as patched:
        patched.setattr(sqlite3, "connect", lambda name, **how: opened(name.replace("=rw", "=ro"), **how))
        with pytest.raises(OSError, match=r"cannot use .*campaign.db .*copy the folder to where you may write"):
            read_store(tmp_path / "killed")
    assert_same(read_sample(read_store(tmp_path / "killed"), "rough", 1), sample(1))


def test_a_lock_that_is_no_file_is_refused(tmp_path):
    bait = tmp_path / "bait"
    bait.write_text("precious")
    for name, make in (("link", lambda path: path.symlink_to(bait)), ("pipe", os.mkfifo)):
        folder = tmp_path / name
        open_store(folder, SCENE).close()
        (folder / ".lock").unlink()
        make(folder / ".lock")
        with pytest.raises(ValueError, match=rf"{re.escape('.lock')} is no regular file|cannot be written"):
            open_store(folder, SCENE)
    assert bait.read_text() == "precious"


def test_a_left_over_part_that_is_a_link_is_not_written_through(tmp_path):
    bait = tmp_path / "bait"
    bait.write_text("precious")
    (tmp_path / f".summary.json.{os.getpid()}.part").symlink_to(bait)
    write_aside(tmp_path / "summary.json", b"new")
    assert bait.read_text() == "precious"
    assert (tmp_path / "summary.json").read_bytes() == b"new"


def test_samples_that_the_scene_does_not_have_are_set_aside(tmp_path):
    with open_store(tmp_path, SCENE) as store:
        for number in (2, 10):
            write_sample(store, "rough", sample(number))
        reason = r"sample 10 of the rough grid is of a sample that the scene, with 10, does not have"
        with pytest.warns(UserWarning, match=reason):
            assert rows_reader(store, 10)("rough").numbers == [2]


def test_what_a_lie_is_made_of_is_read_where_it_is_none(tmp_path, whole):
    folder = tmp_path / "campaign"
    shutil.copytree(whole, folder)
    lie(folder, displacement=0.25)
    assert read_sample(read_store(folder), "rough", 1).row["displacement"] == 0.25
    lie(folder, coefficients=np.zeros(3).tobytes())
    assert read_sample(read_store(folder), "rough", 1).coefficients.size == 3
