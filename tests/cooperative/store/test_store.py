"""The campaign folder: nothing finished is lost, nothing broken is trusted, one controller at a time."""

import errno
import os
import random
import signal
import subprocess
import sys
import textwrap
import time
from dataclasses import replace

import h5py
import numpy as np
import pytest

from cooperative import campaign
from cooperative.scene import settled
from cooperative.store import (
    DamagedFile,
    Sample,
    open_store,
    read_rows,
    read_sample,
    read_store,
    sample_path,
    scene_digest,
    write_aside,
    write_sample,
)
from tests import ROOT
from tests.cooperative.campaign.test_campaign import TINY

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
    for name in ("number", "status", "steps", "seconds"):
        assert getattr(left, name) == getattr(right, name)
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
    path = tmp_path / "new" / "README.txt"
    text = path.read_text()
    assert text.startswith("dam?[31m\n")
    assert f"numpy {np.__version__}" in text
    assert "jaxmpm resume ." in text
    path.write_text("my own notes")
    open_store(tmp_path / "new", 'name = "dam\\u001b[31m"\n' + SCENE).close()
    assert path.read_text() == "my own notes"


def test_a_folder_without_its_text_gets_it_and_a_link_of_that_name_is_left_alone(tmp_path):
    for name in ("old", "linked"):
        (tmp_path / name / "samples").mkdir(parents=True)
        (tmp_path / name / "scene.toml").write_text(SCENE)
        (tmp_path / name / "campaign.json").write_text("{}")
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
    with pytest.raises(ValueError, match="holds no campaign"):
        read_store(tmp_path / "elsewhere")


@pytest.mark.parametrize(
    ("grid", "number", "match"), [("rough", 0, "never overwritten"), ("fine", 0, "unknown"), ("rough", -1, "negative")]
)
def test_samples_that_are_there_or_cannot_be_are_not_written(tmp_path, grid, number, match):
    with open_store(tmp_path, SCENE) as store:
        write_sample(store, "rough", sample(0))
        with pytest.raises(ValueError, match=match):
            write_sample(store, grid, replace(sample(0), number=number))


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


def test_the_folder_of_a_scene_that_never_ran_is_no_campaign(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    with pytest.raises(ValueError, match=r"holds 'scene\.toml', and no campaign has begun there: give a new or empty"):
        open_store(tmp_path, SCENE)
    with pytest.raises(ValueError, match="holds no campaign"):
        read_store(tmp_path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["scene.toml"]


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
    script = f"""if True:
        from cooperative.store import open_store
        store = open_store({str(tmp_path)!r}, {SCENE!r})
        print("held", flush=True)
        input()
    """
    holder = subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert holder.stdout.readline() == b"held\n"
    with pytest.raises(ValueError, match=f"another controller.*process {holder.pid}"):
        open_store(tmp_path, SCENE)
    holder.kill()
    holder.communicate()
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


def test_an_edited_scene_sets_no_samples_aside(tmp_path):
    """Days of runs are not renamed because someone changed a number in the folder's scene."""
    with open_store(tmp_path, SCENE) as store:
        paths = [write_sample(store, "rough", sample(number)) for number in range(2)]
    (tmp_path / "scene.toml").write_text(SCENE.replace("0.3", "0.4"))
    for opened in (read_store(tmp_path), open_store(tmp_path, read_store(tmp_path).source)):
        with (
            opened as store,
            pytest.raises(ValueError, match=r"holds 2 samples of another scene, .* put back the"),
        ):
            read_rows(store, "rough")
    assert all(path.exists() for path in paths)


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


def test_every_set_aside_file_stays(tmp_path):
    with open_store(tmp_path, SCENE) as store:
        for content in (b"first", b"second"):
            sample_path(store, "refined", 1).write_bytes(content)
            with pytest.warns(UserWarning, match=r"000001\.h5 is not a cooperative sample file"):
                read_rows(store, "refined")
        aside = sorted(path.read_bytes() for path in (tmp_path / "samples/refined").glob("*.damaged"))
    assert aside == [b"first", b"second"]


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


def test_kill_9_while_writing_loses_nothing_that_was_finished(tmp_path):
    generator, promised = random.Random(2), set()
    for _ in range(2):
        writer = subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path), str(ROOT)], stdout=subprocess.PIPE)
        first = writer.stdout.readline()
        time.sleep(generator.uniform(0.0, 0.05))
        writer.send_signal(signal.SIGKILL)
        promised |= {int(line) for line in (first + writer.communicate()[0]).split()}
    with open_store(tmp_path, SCENE) as store:
        rows = read_rows(store, "rough")
        assert rows.damaged == ()
        assert promised <= set(rows.numbers)
        assert len(promised) >= 2
        assert list((store.folder / "samples/rough").glob(".*.part")) == []
        for number in rows.numbers[:: max(len(rows.numbers) // 20, 1)]:
            assert_same(read_sample(store, "rough", number), sample(number, size=20_000))


@pytest.mark.parametrize("content", ["[1.0", "[]", "\x00", "[" * 100_000])
def test_a_damaged_file_beside_a_scene_is_named(tmp_path, content):
    with open_store(tmp_path, settled(TINY, tmp_path)):
        pass
    (tmp_path / "campaign.json").write_text(content)
    for opened in (lambda: read_store(tmp_path), lambda: campaign.run(TINY, tmp_path)):
        with pytest.raises(ValueError, match=r"campaign\.json is damaged .*put back the file"):
            opened()


def test_a_folder_that_was_killed_as_it_began_is_begun_anew(tmp_path):
    (tmp_path / "campaign.json").write_text('{"files": {}}')
    with pytest.raises(ValueError, match="holds no campaign"):
        read_store(tmp_path)
    with open_store(tmp_path, TINY) as store:
        assert store.digest == scene_digest(TINY)
