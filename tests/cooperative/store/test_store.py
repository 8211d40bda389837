"""The campaign folder: nothing finished is lost, nothing broken is trusted, one controller at a time."""

import errno
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest

from benchmarks.robustness.hostile_files import Baits, damaged, hand_made, lay_baits, no_files
from cooperative.runs import foreign
from cooperative.store import (
    DamagedFile,
    Sample,
    _disk,
    open_store,
    read_rows,
    read_sample,
    read_store,
    sample_path,
    scene_digest,
    write_aside,
    write_sample,
)
from cooperative.store._disk import read_file, rows_of
from foundation import files
from tests import ROOT

SCENE = '[soil]\nSu_mean = 42000.0\nSu_cov = 0.3\n[campaign]\nsamples = 10\ngrids = ["rough", "refined"]\n'

TICK = 0.02
"""Seconds within which a file system may give two changes of a file the same time."""


def sample(number: int, size: int = 50) -> Sample:
    generator = np.random.default_rng(number)
    return Sample(
        number=number,
        status="settled",
        steps=1000 + number,
        seconds=1.5,
        coefficients=generator.standard_normal(20),
        row={"displacement": generator.random(), "broke_off": False, "mode": "deep"}
        | {"depth": 2.0, "runout": 3.5, "volume": 40.0, "area": 5.0, "my_own": bool(number % 2)},
        fields={"displacement": generator.random((3, size)).astype(np.float32), "empty": np.zeros((3, 0))},
        dtype="float32",
        device="cpu",
    )


def assert_same(left: Sample, right: Sample) -> None:
    assert (left.number, left.status, left.steps, left.seconds) == (
        right.number,
        right.status,
        right.steps,
        right.seconds,
    )
    assert dict(left.row) == dict(right.row)
    np.testing.assert_array_equal(left.coefficients, right.coefficients)
    assert left.fields.keys() == right.fields.keys()
    for name in left.fields:
        np.testing.assert_array_equal(left.fields[name], right.fields[name])
        assert left.fields[name].dtype == right.fields[name].dtype


def test_a_sample_comes_back_as_it_was_written(tmp_path):
    with open_store(tmp_path / "campaign", SCENE) as store:
        write_sample(store, "rough", sample(3))
        back = read_sample(store, "rough", 3)
        assert_same(back, sample(3))
        assert back.versions["numpy"] == np.__version__
        assert (store.folder / "scene.toml").read_text() == SCENE


def test_a_folder_says_what_it_is_once(tmp_path):
    open_store(tmp_path / "new", 'name = "dam\\u001b[31m"\n' + SCENE).close()
    told = tmp_path / "new" / "README.txt"
    said = told.read_text()
    assert said.startswith("dam?[31m\n")
    assert f"numpy {np.__version__}" in said
    assert "jaxmpm resume ." in said
    told.write_text("my own notes")
    open_store(tmp_path / "new", 'name = "dam\\u001b[31m"\n' + SCENE).close()
    assert told.read_text() == "my own notes"


def test_a_folder_from_before_gets_the_text_and_a_link_in_its_place_is_left_alone(tmp_path):
    for name in ("old", "linked"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "scene.toml").write_text(SCENE)
    elsewhere = tmp_path / "elsewhere.txt"
    elsewhere.write_text("theirs")
    (tmp_path / "linked" / "README.txt").symlink_to(elsewhere)
    read_store(tmp_path / "old")
    assert not (tmp_path / "old" / "README.txt").exists()
    for name in ("old", "linked"):
        open_store(tmp_path / name, SCENE).close()
    assert (tmp_path / "old" / "README.txt").read_text().startswith("a campaign\n")
    assert elsewhere.read_text() == "theirs"


def test_the_text_of_a_folder_reads_its_samples_as_it_says(tmp_path, monkeypatch, capsys):
    with open_store(tmp_path, SCENE) as store:
        write_sample(store, "rough", sample(0))
    monkeypatch.chdir(tmp_path)
    text = (tmp_path / "README.txt").read_text()
    block = text[text.index("  import h5py") : text.index("The status is")]
    exec(textwrap.dedent(block), {})
    assert "'displacement': " in capsys.readouterr().out


def test_rows_ascend_and_gaps_are_nan(tmp_path):
    with open_store(tmp_path, SCENE) as store:
        for number in (7, 2):
            write_sample(store, "rough", sample(number))
        row = {"displacement": 0.3, "broke_off": True, "depth_deepest": 1.0}
        write_sample(store, "rough", Sample(4, "not finite", 3, 0.1, np.zeros(2), row))
        rows = read_rows(store, "rough")
    assert rows.numbers == [2, 4, 7]
    np.testing.assert_array_equal(np.isnan(rows.columns["depth"]), [False, True, False])
    np.testing.assert_array_equal(np.isnan(rows.columns["depth_deepest"]), [True, False, True])
    assert rows.columns["mode"].tolist() == ["deep", "", "deep"]
    assert rows.columns["status"].tolist() == ["settled", "not finite", "settled"]


def test_readers_need_no_lock_and_write_nothing(tmp_path):
    with open_store(tmp_path, SCENE) as store:
        write_sample(store, "rough", sample(0))
        reader = read_store(tmp_path)
        assert read_rows(reader, "rough").numbers == [0]
        with pytest.raises(ValueError, match="open for reading"):
            write_sample(reader, "rough", sample(1))
    with pytest.raises(ValueError, match=r"no scene\.toml"):
        read_store(tmp_path / "elsewhere")


def test_finished_samples_are_never_overwritten(tmp_path):
    with open_store(tmp_path, SCENE) as store:
        write_sample(store, "rough", sample(0))
        with pytest.raises(ValueError, match="never overwritten"):
            write_sample(store, "rough", sample(0))


@pytest.mark.parametrize(("grid", "number", "match"), [("fine", 0, "unknown"), ("rough", -1, "negative")])
def test_bad_sample_names(tmp_path, grid, number, match):
    with open_store(tmp_path, SCENE) as store, pytest.raises(ValueError, match=match):
        sample_path(store, grid, number)


def test_the_digest_reads_what_the_scene_says():
    respelt = '# a comment\n[campaign]\nsamples=10\ngrids=["rough","refined"]\n[soil]\nSu_cov=0.30\nSu_mean=42000'
    assert scene_digest(respelt) == scene_digest(SCENE)
    assert scene_digest(SCENE.replace("0.3", "0.4")) != scene_digest(SCENE)
    assert scene_digest("a = [1, 2]") != scene_digest("a = [2, 1]")
    assert scene_digest("a = true") != scene_digest("a = 1")


def test_a_folder_of_another_scene_is_refused_by_name(tmp_path):
    open_store(tmp_path, SCENE).close()
    with pytest.raises(ValueError, match=r"soil\.Su_cov is 0\.3 there and 0\.4 now.*another folder"):
        open_store(tmp_path, SCENE.replace("0.3", "0.4"))
    with pytest.raises(ValueError, match=r"soil\.depth is not set there and 2 now"):
        open_store(tmp_path, SCENE.replace("Su_cov", "depth = 2\nSu_cov"))
    open_store(tmp_path, SCENE).close()


def test_a_folder_of_something_else_is_refused(tmp_path):
    (tmp_path / "thesis.txt").write_text("precious")
    with pytest.raises(ValueError, match=r"thesis\.txt.*new or empty folder"):
        open_store(tmp_path, SCENE)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["thesis.txt"]


def test_an_unwritable_folder_is_refused(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "below", "/proc/campaign"):
        with pytest.raises(ValueError, match=r"cannot be written .*may write to"):
            open_store(folder, SCENE)

    def read_only(*_: object, **__: object) -> int:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(os, "open", read_only)
    with pytest.raises(ValueError, match="Read-only file system"):
        open_store(tmp_path / "new", SCENE)


def test_a_second_controller_is_refused_until_the_first_ends(tmp_path):
    holder = subprocess.Popen(
        [
            sys.executable,
            "-c",
            f"""if True:
            from cooperative.store import open_store
            store = open_store({str(tmp_path)!r}, {SCENE!r})
            print("held", flush=True)
            input()
        """,
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert holder.stdout.readline() == b"held\n"
    with pytest.raises(ValueError, match=f"another controller.*process {holder.pid}"):
        open_store(tmp_path, SCENE)
    holder.kill()
    holder.communicate()
    open_store(tmp_path, SCENE).close()


def test_one_process_cannot_hold_a_folder_twice(tmp_path):
    with open_store(tmp_path, SCENE), pytest.raises(ValueError, match="another controller"):
        open_store(tmp_path, SCENE)
    open_store(tmp_path, SCENE).close()


def test_truncated_flipped_and_foreign_files_are_set_aside_and_redone(tmp_path):
    with open_store(tmp_path / "other", SCENE.replace("0.3", "0.4")) as other:
        foreign = write_sample(other, "rough", sample(5)).read_bytes()
    with open_store(tmp_path / "campaign", SCENE) as store:
        paths = [write_sample(store, "rough", sample(number)) for number in range(5)]
        time.sleep(TICK)
        data = bytearray(paths[1].read_bytes())
        data[data.find(sample(1).fields["displacement"].tobytes()) + 8] ^= 0x10
        paths[0].write_bytes(paths[0].read_bytes()[:-100])
        paths[1].write_bytes(data)
        paths[2].write_bytes(b"")
        paths[3].write_bytes(paths[4].read_bytes())
        sample_path(store, "rough", 5).write_bytes(foreign)
        sample_path(store, "rough", 6).write_bytes(b"a photograph")
        with h5py.File(sample_path(store, "rough", 7), "w") as file:
            file["data"] = np.arange(3)

        assert read_rows(read_store(store.folder), "rough").numbers == [4]
        with pytest.warns(UserWarning, match="set aside, the sample is run again"):
            rows = read_rows(store, "rough")
        assert rows.numbers == [4]
        reasons = dict(zip([0, 1, 2, 3, 5, 6, 7], rows.damaged, strict=True))
        for number, reason in reasons.items():
            assert f"{number:06d}.h5" in reason
        assert "checksum" in reasons[1]
        assert "holds sample 4" in reasons[3]
        assert "another scene" in reasons[5]
        assert sorted(path.name for path in paths[0].parent.iterdir()) == [
            f"{number:06d}.h5" + ("" if number == 4 else ".damaged") for number in range(8)
        ]
        write_sample(store, "rough", sample(1))
        assert_same(read_sample(store, "rough", 1), sample(1))
        assert read_rows(store, "rough").damaged == ()


@pytest.mark.parametrize(
    ("frames", "times"),
    [
        (np.zeros((2, 3, 50), np.float16), [1.0]),
        (np.zeros((1, 2, 50), np.float16), [1.0]),
        (np.zeros((2, 3, 50), np.float16), [2.0, 1.0]),
        (np.zeros((1, 3, 50), np.int16), [1.0]),
        (np.zeros((1, 3, 50), np.float16), None),
        (None, [1.0]),
    ],
    ids=["fewer times", "two components", "backwards", "whole numbers", "no times", "no frames"],
)
def test_frames_that_do_not_fit_their_times_or_the_slope_are_damaged(tmp_path, frames, times):
    given = {"frames": frames, "frame_times": times}
    with open_store(tmp_path, SCENE) as store:
        plain = sample(1)
        fields = {name: np.asarray(values) for name, values in given.items() if values is not None}
        write_sample(store, "rough", replace(plain, fields={**plain.fields, **fields}))
        with pytest.raises(DamagedFile, match=r"000001\.h5 holds frames of shape"):
            read_sample(store, "rough", 1)


def test_every_set_aside_file_is_kept(tmp_path):
    with open_store(tmp_path, SCENE) as store:
        for content in (b"first", b"second"):
            sample_path(store, "refined", 1).write_bytes(content)
            with pytest.warns(UserWarning, match=r"000001\.h5 is not a cooperative sample file"):
                read_rows(store, "refined")
        kept = sorted(path.read_bytes() for path in (tmp_path / "samples/refined").glob("*.damaged"))
    assert kept == [b"first", b"second"]


def test_every_flipped_byte_is_noticed(tmp_path):
    with open_store(tmp_path, SCENE) as store:
        path = write_sample(store, "rough", sample(1, size=4))
        data = path.read_bytes()
        generator = random.Random(0)
        for position in range(0, len(data), 3):
            flipped = bytearray(data)
            flipped[position] ^= 1 << generator.randrange(8)
            path.write_bytes(flipped)
            with pytest.raises(DamagedFile, match=r"000001\.h5"):
                read_sample(store, "rough", 1)
        for length in (0, 100, len(data) - 1):
            path.write_bytes(data[:length])
            with pytest.raises(DamagedFile):
                read_sample(store, "rough", 1)


def test_any_hdf5_reader_opens_a_sample(tmp_path):
    with open_store(tmp_path, SCENE) as store, h5py.File(write_sample(store, "rough", sample(2))) as file:
        assert file.attrs["sample"] == 2
        assert file.attrs["schema"] == 1
        np.testing.assert_array_equal(file["fields/displacement"], sample(2).fields["displacement"])


def test_a_full_disk_says_so_and_leaves_no_half_file(tmp_path, monkeypatch):
    with open_store(tmp_path, SCENE) as store:
        write_sample(store, "rough", sample(0))

        def full(descriptor: int) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        monkeypatch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match=r"000001\.h5 \(No space left on device\): make room") as raised:
            write_sample(store, "rough", sample(1))
        assert raised.value.errno == errno.ENOSPC
        monkeypatch.undo()
        assert os.listdir(tmp_path / "samples/rough") == ["000000.h5"]
        assert read_rows(store, "rough").numbers == [0]


@pytest.mark.slow
def test_a_file_size_limit_stops_the_writer_without_damage(tmp_path):
    script = f"""if True:
        import resource, sys
        sys.path.insert(0, {str(ROOT)!r})
        from tests.cooperative.store.test_store import SCENE, sample
        from cooperative.store import open_store, write_sample
        store = open_store({str(tmp_path)!r}, SCENE)
        write_sample(store, "rough", sample(0))
        resource.setrlimit(resource.RLIMIT_FSIZE, (65536, 65536))
        write_sample(store, "rough", sample(1, size=100_000))
    """
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 1
    assert "000001.h5 (File too large): make room" in done.stderr
    assert os.listdir(tmp_path / "samples/rough") == ["000000.h5"]


def test_what_was_there_survives_a_refused_write(tmp_path, monkeypatch):
    write_aside(tmp_path / "summary.json", b"old")
    monkeypatch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(OSError(errno.EIO, "Input/output error")))
    with pytest.raises(OSError, match="check the disk"):
        write_aside(tmp_path / "summary.json", b"new")
    assert (tmp_path / "summary.json").read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["summary.json"]


WRITER = textwrap.dedent("""
    import sys
    sys.path.insert(0, sys.argv[2])
    from tests.cooperative.store.test_store import SCENE, sample
    from cooperative.store import open_store, read_rows, write_sample
    store = open_store(sys.argv[1], SCENE)
    done = read_rows(store, "rough")
    assert not done.damaged, done.damaged
    for number in range(400):
        if number not in done.numbers:
            write_sample(store, "rough", sample(number, size=20_000))
            print(number, flush=True)
""")


def killed_and_resumed(folder, kills: int, seed: int):
    """The numbers that writers said were done before they were killed, the rows then found, and parts left behind."""
    generator = random.Random(seed)
    promised: set[int] = set()
    for _ in range(kills):
        writer = subprocess.Popen([sys.executable, "-c", WRITER, str(folder), str(ROOT)], stdout=subprocess.PIPE)
        first = writer.stdout.readline()
        time.sleep(generator.uniform(0.0, 0.05))
        writer.send_signal(signal.SIGKILL)
        rest = writer.communicate()[0]
        promised |= {int(line) for line in (first + rest).split()}
    with open_store(folder, SCENE) as store:
        return promised, read_rows(store, "rough"), list((store.folder / "samples/rough").glob(".*.part"))


@pytest.mark.parametrize("kills", [2, pytest.param(100, marks=pytest.mark.slow)])
def test_kill_9_while_writing_loses_nothing_that_was_finished(tmp_path, kills):
    promised, rows, parts = killed_and_resumed(tmp_path, kills, seed=kills)
    assert rows.damaged == ()
    assert promised <= set(rows.numbers)
    assert len(promised) >= min(kills, 400)
    assert parts == []
    with open_store(tmp_path, SCENE) as store:
        for number in rows.numbers[:: max(len(rows.numbers) // 20, 1)]:
            assert_same(read_sample(store, "rough", number), sample(number, size=20_000))


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
        path = sample_path(store, "rough", 1)
        hand_made(baits)[name](path, whole)
        assert os.path.lexists(path)
        with pytest.raises(DamagedFile, match=r"000001\.h5") as said:
            read_sample(store, "rough", 1)
        assert str(said.value).isprintable()
        with pytest.warns(UserWarning, match="set aside, the sample is run again"):
            rows = read_rows(store, "rough")
        assert rows.numbers == []
        assert not os.path.lexists(path)
        assert [each.name for each in path.parent.iterdir()] == ["000001.h5.damaged"]
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
    (tmp_path / ".summary.json.part").symlink_to(bait)
    write_aside(tmp_path / "summary.json", b"new")
    assert bait.read_text() == "precious"
    assert (tmp_path / "summary.json").read_bytes() == b"new"


def test_samples_that_the_scene_does_not_have_are_set_aside(tmp_path):
    with open_store(tmp_path, SCENE) as store:
        for number in (2, 10):
            write_sample(store, "rough", sample(number))
        with pytest.warns(UserWarning, match=r"000010\.h5 is of a sample that the scene, with 10, does not have"):
            assert read_rows(store, "rough", foreign=partial(foreign, 10, None)).numbers == [2]


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
        {"row": {"displacement": float("inf"), "broke_off": True}},
        {"row": {"displacement": 1.0}},
        {"row": {"displacement": 1.0, "broke_off": True, "list": [1]}},
        {"row": {"displacement": 1.0, "broke_off": True, "\x1b[2J": 1.0}},
        {"row": {"displacement": 1.0, "broke_off": True, "mode": "deep\n"}},
        {"row": [1, 2]},
        {"status": 7},
        {"status": "FINISHED\nP_f = 0"},
        {"steps": "many"},
        {"sample": "0"},
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


def test_a_stop_is_seen_before_each_file_and_what_was_verified_is_kept(tmp_path, monkeypatch):
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
