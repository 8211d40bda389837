"""Files and links in a campaign's folder that nobody wrote as they should be: set aside, and nothing elsewhere read."""

import os
import re
from functools import partial
from pathlib import Path

import pytest

from benchmarks.robustness.hostile_files import Baits, damaged, hand_made, lay_baits
from cooperative.runs import foreign
from cooperative.store import (
    DamagedFile,
    open_store,
    read_rows,
    read_sample,
    read_store,
    sample_path,
    write_aside,
    write_sample,
)
from tests.cooperative.store.test_store import SCENE, assert_same, sample


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The bytes of a true sample file, number 1 of the rough grid."""
    with open_store(tmp_path_factory.mktemp("whole"), SCENE) as store:
        return write_sample(store, "rough", sample(1)).read_bytes()


HAND_MADE = sorted(hand_made(Baits(Path(), Path())))


@pytest.mark.parametrize("name", HAND_MADE)
def test_a_file_that_lies_is_set_aside_reads_nothing_elsewhere_and_hangs_nothing(tmp_path, whole, name):
    baits = lay_baits(tmp_path / "outside")
    with open_store(tmp_path / "campaign", SCENE) as store:
        write_sample(store, "rough", sample(2))
        path = sample_path(store, "rough", 1)
        hand_made(baits)[name](path, whole)
        assert os.path.lexists(path)
        with pytest.raises(DamagedFile, match=r"000001\.h5") as refused:
            read_sample(store, "rough", 1)
        assert str(refused.value).isprintable()
        with pytest.warns(UserWarning, match="set aside, the sample is run again"):
            rows = read_rows(store, "rough")
        assert rows.numbers == [2]
        assert not os.path.lexists(path)
        assert sorted(each.name for each in path.parent.iterdir()) == ["000001.h5.damaged", "000002.h5"]
        assert_same(read_sample(store, "rough", write_again(store)), sample(1))
    assert baits.untouched()


def write_again(store) -> int:
    write_sample(store, "rough", sample(1))
    return 1


def test_every_damaged_copy_is_noticed(tmp_path, whole):
    with open_store(tmp_path, SCENE) as store:
        path = sample_path(store, "rough", 1)
        for how, data in damaged(whole, 400):
            path.write_bytes(data)
            with pytest.raises(DamagedFile):
                pytest.fail(f"{how} was accepted: {read_sample(store, 'rough', 1)}")


def test_folders_of_samples_that_lead_elsewhere_are_set_aside(tmp_path, whole):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "000001.h5").write_bytes(whole)
    folder = tmp_path / "campaign"
    open_store(folder, SCENE).close()
    (folder / "samples/rough").rmdir()
    (folder / "samples/rough").symlink_to(elsewhere)
    rows = read_rows(read_store(folder), "rough")
    assert rows.numbers == []
    assert "leads out of the campaign's folder" in rows.damaged[0]
    with pytest.warns(UserWarning, match="set aside as"), open_store(folder, SCENE) as store:
        write_sample(store, "rough", sample(0))
    assert [each.name for each in elsewhere.iterdir()] == ["000001.h5"]
    assert (folder / "samples/rough.damaged").is_symlink()


def test_a_lock_or_a_scene_that_is_no_file_is_refused(tmp_path):
    bait = tmp_path / "bait"
    bait.write_text("precious")
    for name, make in (("link", lambda path: path.symlink_to(bait)), ("pipe", os.mkfifo)):
        for file in (".lock", "scene.toml"):
            folder = tmp_path / name / file
            open_store(folder, SCENE).close()
            (folder / file).unlink()
            make(folder / file)
            with pytest.raises(ValueError, match=rf"{re.escape(file)} is no regular file|cannot be written"):
                open_store(folder, SCENE)
            if file == "scene.toml":
                with pytest.raises(ValueError, match="no regular file"):
                    read_store(folder)
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
        with pytest.warns(UserWarning, match=r"000010\.h5 is of a sample that the scene, with 10, does not have"):
            assert read_rows(store, "rough", foreign=partial(foreign, 10, None)).numbers == [2]
