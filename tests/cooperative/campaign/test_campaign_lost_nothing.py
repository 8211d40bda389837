"""Nothing is lost: campaigns starved of disk, damaged or doubled end with the answer of an undisturbed one."""

import os
import shutil
from contextlib import nullcontext
from dataclasses import replace

import pytest

from benchmarks.robustness import invented, lives
from benchmarks.robustness.invented import SCENE
from cooperative import campaign, reporting
from cooperative.__main__ import main
from cooperative.store import _database, open_store, read_rows, read_sample, read_store, write_sample
from tests.databases import delete, fields_file, finished, spoil

pytestmark = pytest.mark.usefixtures("made_up")


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """Folder of a campaign that nothing happened to."""
    folder = tmp_path_factory.mktemp("campaign") / "undisturbed"
    with pytest.MonkeyPatch.context() as patched:
        invented.invent(put=patched.setattr)
        campaign.run(SCENE, folder)
    assert set(read_rows(read_store(folder), "rough").columns["steps"]) == {invented.STEPS}
    return folder


def assert_as_undisturbed(folder, undisturbed):
    assert [line for line in lives.differences(folder, undisturbed) if "aside" not in line] == []


def test_a_sample_of_another_field_is_set_aside_and_redone(undisturbed, tmp_path):
    folder = tmp_path / "foreign"
    shutil.copytree(undisturbed, folder)
    with open_store(folder, SCENE) as store:
        sample = read_sample(store, "rough", 7)
        delete(folder, "rough", 7)
        write_sample(store, "rough", replace(sample, coefficients=sample.coefficients[:3]))
    with pytest.warns(UserWarning, match=r"sample 7 of .* holds 3 coefficients of a field that has 20: set aside"):
        campaign.run(SCENE, folder)
    assert_as_undisturbed(folder, undisturbed)


def test_damaged_samples_are_named_and_redone(undisturbed, tmp_path):
    folder = tmp_path / "damaged"
    campaign.run(SCENE, folder)
    refined = read_rows(read_store(folder), "refined").numbers
    spoil(folder, "rough", 7)
    fields_file(folder, "refined", refined[3]).unlink()
    with pytest.warns(UserWarning, match="run again") as warned:
        campaign.run(SCENE, folder)
    messages = " ".join(str(warning.message) for warning in warned)
    assert "sample 7 of the rough grid does not match its checksum: set aside in campaign.db.damaged" in messages
    assert f"sample {refined[3]} of the refined grid lacks its file" in messages
    assert (folder / "campaign.db.damaged").exists()
    assert_as_undisturbed(folder, undisturbed)


def test_a_damaged_database_gives_what_is_whole_and_the_rest_runs_again(undisturbed, tmp_path):
    folder = tmp_path / "damaged"
    campaign.run(SCENE, folder)
    data = bytearray((folder / "campaign.db").read_bytes())
    at = data.rfind(read_sample(read_store(folder), "rough", 7).coefficients.tobytes()) // 4096 * 4096
    data[at : at + 4096] = bytes(4096)
    (folder / "campaign.db").write_bytes(data)
    with pytest.warns(UserWarning, match=r"campaign\.db is damaged .*runs are whole, the others are run again"):
        campaign.run(SCENE, folder)
    assert_as_undisturbed(folder, undisturbed)


def test_a_file_that_rotted_unseen_is_redone_when_asked_to_verify(undisturbed, tmp_path, monkeypatch):
    folder = tmp_path / "rotten"
    shutil.copytree(undisturbed, folder)
    path = fields_file(folder, "rough", next(iter(finished(folder, "rough"))))
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    monkeypatch.setattr(reporting, "report", lambda folder: "")
    campaign.run(SCENE, folder)
    assert path.read_bytes() == data
    with pytest.warns(UserWarning, match=rf"{path.name} does not match its checksum: set aside") as warned:
        assert main(["resume", str(folder), "--workers", "1", "--verify"]) == 0
    assert any("the sample is run again" in str(warning.message) for warning in warned)
    assert path.with_name(f"{path.name}.damaged").exists()
    assert_as_undisturbed(folder, undisturbed)


@pytest.mark.parametrize("after", [0, 17, 55])
def test_a_full_disk_stops_with_a_message_and_room_lets_it_go_on(after, undisturbed, tmp_path, monkeypatch, capsys):
    scene, folder = tmp_path / "scene.toml", tmp_path / "full"
    scene.write_text(SCENE)
    real, written = _database.insert, []

    def insert(database, row):
        pages = database.execute("PRAGMA page_count").fetchone()[0]
        database.execute(f"PRAGMA max_page_count = {pages if len(written) == after else 10**6}")
        real(database, row | {"coefficients": bytes(10**6)} if len(written) == after else row)
        written.append(row)

    with monkeypatch.context() as patched:
        patched.setattr(_database, "insert", insert)
        with pytest.warns(UserWarning, match="a slide may reach the end of the ground"):
            assert main(["run", str(scene), "--out", str(folder), "--workers", "1"]) == 2
    printed = capsys.readouterr().err.splitlines()[-1]
    assert printed.startswith(
        f"error: cannot use {folder}/campaign.db (database or disk is full): make room, and start"
    )
    store = read_store(folder)
    assert not list(folder.rglob("*.part"))
    assert len(read_rows(store, "rough").numbers) + len(read_rows(store, "refined").numbers) == after
    assert not read_rows(store, "rough").damaged
    campaign.run(SCENE, folder)
    assert_as_undisturbed(folder, undisturbed)


def test_a_second_controller_is_refused_and_harms_nothing(undisturbed, tmp_path, capsys):
    scene, folder = tmp_path / "scene.toml", tmp_path / "doubled"
    scene.write_text(SCENE)
    with open_store(folder, SCENE):
        for command in (["run", str(scene), "--out", str(folder)], ["resume", str(folder)]):
            with (
                pytest.warns(UserWarning, match="a slide may reach the end of the ground")
                if command[0] == "run"
                else nullcontext()
            ):
                assert main([*command, "--workers", "1"]) == 2
            assert f"held by another controller (process {os.getpid()}" in capsys.readouterr().err
        assert main(["status", str(folder)]) == 0
    campaign.run(SCENE, folder)
    assert_as_undisturbed(folder, undisturbed)
