"""The campaign folder: nothing finished is lost, nothing broken is trusted, one controller at a time."""

import errno
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import textwrap
import time
from contextlib import closing
from dataclasses import replace

import numpy as np
import pandas
import pytest

from cooperative.store import (
    SLIDES,
    FinishedRun,
    Source,
    open_store,
    read_rows,
    read_sample,
    read_store,
    scene_digest,
    store_text,
    stored_text,
    write_aside,
    write_sample,
)
from tests import ROOT

SCENE = '[soil]\nSu_mean = 42000.0\nSu_cov = 0.3\n[campaign]\nsamples = 10\ngrids = ["rough", "refined"]\n'


def sample(number: int, size: int = 50) -> FinishedRun:
    generator = np.random.default_rng(number)
    return FinishedRun(
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


def assert_same(left: FinishedRun, right: FinishedRun) -> None:
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
        assert store.source.text == SCENE
    assert read_store(tmp_path / "campaign").source == Source(SCENE)


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
        open_store(tmp_path / name, SCENE).close()
        (tmp_path / name / "README.txt").unlink()
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
        write_sample(store, "refined", sample(0))
    monkeypatch.chdir(tmp_path)
    text = (tmp_path / "README.txt").read_text()
    block = text[text.index("  import sqlite3") : text.index("The status is")]
    exec(textwrap.dedent(block), {})
    said = capsys.readouterr().out
    assert f"(0, 'settled', {sample(0).row['displacement']})" in said
    assert "(3, 50)" in said


def test_anyone_asks_the_database_by_sql(tmp_path):
    with open_store(tmp_path, SCENE) as store:
        write_sample(store, "rough", sample(1))
        write_sample(store, "rough", replace(sample(2), row={**sample(2).row, "speed_at_house": 2.5}))
        with closing(sqlite3.connect(tmp_path / "campaign.db")) as database:
            rows = pandas.read_sql('select * from run where grid = "rough"', database)
    assert rows["sample"].tolist() == [1, 2]
    np.testing.assert_array_equal(rows["displacement"], [sample(n).row["displacement"] for n in (1, 2)])
    np.testing.assert_array_equal(rows["speed_at_house"], [np.nan, 2.5])
    np.testing.assert_array_equal(np.frombuffer(rows["coefficients"][0]), sample(1).coefficients)
    if shutil.which("sqlite3"):
        command = ["sqlite3", tmp_path / "campaign.db", "select sample, my_own from run order by sample"]
        assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "1|1\n2|0\n"


def test_scalars_keep_their_types_and_columns_that_one_run_adds_are_there_for_the_next(tmp_path):
    row = {"displacement": np.float32(0.5), "broke_off": np.bool_(False), "depth": 2, "onset": float("nan")}
    row |= {"masses": np.int64(2), "flag": True, "name": "straße; drop table run", "area": -0.0}
    with open_store(tmp_path, SCENE) as store:
        write_sample(store, "rough", replace(sample(0), row=row, fields={}))
        write_sample(store, "rough", sample(1))  # whose my_own is a column more
        back = dict(read_sample(store, "rough", 0).row)
        assert back == {name: value for name, value in row.items() if name != "onset"}
        assert [type(back[name]) for name in ("displacement", "broke_off", "depth", "masses", "flag", "name")] == [
            float, bool, float, int, bool, str
        ]  # fmt: skip
        assert read_rows(store, "rough").columns["flag"].tolist()[0] == 1
        for wrong in ({"flag": 2.5}, {"masses": 1.5}, {"name": 1}, {"status": "x"}, {"a b": 1.0}, {"list": [1]}):
            with pytest.raises(ValueError, match=r"sample 2 has .*a row has no such"):
                write_sample(store, "rough", replace(sample(2), row={**sample(2).row, **wrong}))
        assert read_rows(store, "rough").numbers == [0, 1]


def test_columns_are_added_and_read_in_the_order_of_the_row(tmp_path):
    """A set of names has another order in each process."""
    added = [f"own_{letter}" for letter in "qwertyuiop"]
    row = {"displacement": 0.5, "broke_off": False, **dict.fromkeys(added, 1.0)}
    with open_store(tmp_path, SCENE) as store:
        write_sample(store, "rough", replace(sample(0), row=row, fields={}))
        assert [name for name in read_sample(store, "rough", 0).row if name.startswith("own_")] == added
    with sqlite3.connect(tmp_path / "campaign.db") as database:
        columns = [column for _, column, *_ in database.execute("PRAGMA table_info(run)")]
    assert columns[-len(added) :] == added


def test_rows_ascend_and_gaps_are_nan(tmp_path):
    with open_store(tmp_path, SCENE) as store:
        for number in (7, 2):
            write_sample(store, "rough", sample(number))
        row = {"displacement": 0.3, "broke_off": True, "depth_deepest": 1.0}
        write_sample(store, "rough", FinishedRun(4, "not finite", 3, 0.1, np.zeros(2), row))
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
    assert not (tmp_path / "elsewhere").exists()


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


def test_a_slide_that_goes_on_takes_the_place_of_the_one_that_is_there(tmp_path):
    longer = replace(sample(1), status="FINISHED", fields={"displacement": np.ones((3, 50), np.float32)})
    with open_store(tmp_path, SCENE) as store:
        write_sample(store, "refined", sample(1))
        write_sample(store, SLIDES, sample(1))
        with pytest.raises(ValueError, match="never overwritten"):
            write_sample(store, SLIDES, longer)
        write_sample(store, SLIDES, longer, longer=True)
        assert_same(read_sample(store, "refined", 1), longer)
        assert read_rows(store, "refined").columns["status"].tolist() == ["FINISHED"]
        assert sorted(path.name[:14] for path in (tmp_path / "fields").iterdir()) == [
            "refined-000001",
            "slides-000001-",
        ]


def test_texts_are_kept_and_written_once(tmp_path):
    with open_store(tmp_path, SCENE) as store:
        assert stored_text(tmp_path, "measured") is None
        store_text(store, "measured", '{"terms": [3]}')
        before = (tmp_path / "campaign.db").stat().st_mtime_ns
        store_text(store, "measured", '{"terms": [3]}')
        assert (tmp_path / "campaign.db").stat().st_mtime_ns == before
    assert stored_text(tmp_path, "measured") == '{"terms": [3]}'
    with pytest.raises(ValueError, match="open for reading"):
        store_text(read_store(tmp_path), "measured", "{}")


def test_a_folder_that_was_copied_or_moved_goes_on(tmp_path):
    with open_store(tmp_path / "one", SCENE) as store:
        write_sample(store, "rough", sample(0))
        # While a controller holds it, and between its transactions.
        shutil.copytree(tmp_path / "one", tmp_path / "copied")
    (tmp_path / "one").rename(tmp_path / "moved to, 50 % # ?")
    for name in ("copied", "moved to, 50 % # ?"):
        with open_store(tmp_path / name, read_store(tmp_path / name).source) as store:
            write_sample(store, "rough", sample(1))
            assert_same(read_sample(store, "rough", 0), sample(0))
        assert read_rows(read_store(tmp_path / name), "rough").numbers == [0, 1]


def test_a_full_disk_says_so_and_leaves_nothing_of_the_sample(tmp_path, monkeypatch):
    with open_store(tmp_path, SCENE) as store:
        write_sample(store, "rough", sample(0))

        def full(descriptor: int) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        monkeypatch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match=r"000001-\w+\.h5 \(No space left on device\): make room") as raised:
            write_sample(store, "rough", sample(1))
        assert raised.value.errno == errno.ENOSPC
        monkeypatch.undo()
        pages = store.connection.execute("PRAGMA page_count").fetchone()[0]
        store.connection.execute(f"PRAGMA max_page_count = {pages}")
        with pytest.raises(OSError, match=r"campaign\.db \(database or disk is full\): make room") as raised:
            write_sample(store, "rough", replace(sample(1), coefficients=np.zeros(5000)))
        assert raised.value.errno == errno.ENOSPC
        assert read_rows(store, "rough").numbers == [0]
        store.connection.execute("PRAGMA max_page_count = 1000000")
        write_sample(store, "rough", sample(1))
    with open_store(tmp_path, SCENE) as store:
        assert read_rows(store, "rough").numbers == [0, 1]
        assert len(os.listdir(tmp_path / "fields")) == 2


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
    assert promised <= set(read_rows(read_store(tmp_path), "rough").numbers)
    with open_store(tmp_path, SCENE) as store:
        rows = read_rows(store, "rough")
        assert rows.damaged == ()
        assert promised <= set(rows.numbers)
        assert len(promised) >= 2
        assert len(list((tmp_path / "fields").iterdir())) == len(rows.numbers)
        for number in rows.numbers[:: max(len(rows.numbers) // 20, 1)]:
            assert_same(read_sample(store, "rough", number), sample(number, size=20_000))


def test_a_folder_that_was_killed_as_it_began_is_begun_anew(tmp_path):
    (tmp_path / ".campaign.db.123.part").write_bytes(b"half")
    with pytest.raises(ValueError, match="holds no campaign"):
        read_store(tmp_path)
    with open_store(tmp_path, SCENE) as store:
        assert store.digest == scene_digest(SCENE)
    assert not (tmp_path / ".campaign.db.123.part").exists()


def test_what_a_killed_worker_left_of_a_restart_point_goes(tmp_path):
    with open_store(tmp_path, SCENE):
        pass
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    part = tmp_path / "restart" / f".refined-000001.h5.{ended.pid}.part"
    part.parent.mkdir(exist_ok=True)
    part.write_bytes(b"half")
    os.utime(part, (0, 0))
    with open_store(tmp_path, SCENE):
        assert not part.exists()
