"""Nothing is lost: campaigns starved of disk, damaged or doubled end with the answer of an undisturbed one."""

import errno
import os
import shutil
from contextlib import nullcontext
from dataclasses import replace

import pytest

from benchmarks.robustness import invented, lives
from benchmarks.robustness.invented import SCENE
from cooperative import campaign, reporting
from cooperative.__main__ import main
from cooperative.store import _disk, open_store, read_rows, read_sample, read_store, sample_path, write_sample

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
        sample_path(store, "rough", 7).unlink()
        write_sample(store, "rough", replace(sample, coefficients=sample.coefficients[:3]))
    with pytest.warns(UserWarning, match=r"000007\.h5 holds 3 coefficients of a field that has 20: set aside"):
        campaign.run(SCENE, folder)
    assert_as_undisturbed(folder, undisturbed)


def test_damaged_samples_are_named_and_redone(undisturbed, tmp_path):
    folder = tmp_path / "damaged"
    campaign.run(SCENE, folder)
    store = read_store(folder)
    refined = read_rows(store, "refined").numbers
    flipped = sample_path(store, "rough", 7)
    data = bytearray(flipped.read_bytes())
    data[len(data) // 2] ^= 0x01
    flipped.write_bytes(data)
    short = sample_path(store, "refined", refined[3])
    short.write_bytes(short.read_bytes()[:5000])
    foreign = sample_path(store, "rough", 11)
    foreign.write_bytes(sample_path(store, "rough", 12).read_bytes())
    with pytest.warns(UserWarning, match="run again") as warned:
        campaign.run(SCENE, folder)
    messages = " ".join(str(warning.message) for warning in warned)
    for path in (flipped, short, foreign):
        assert path.name in messages
        assert path.with_name(path.name + ".damaged").exists()
    assert_as_undisturbed(folder, undisturbed)


def test_a_file_that_rotted_unseen_is_redone_when_asked_to_verify(undisturbed, tmp_path, monkeypatch):
    folder = tmp_path / "rotten"
    shutil.copytree(undisturbed, folder)
    campaign.run(SCENE, folder)
    path = folder / "samples/rough/000007.h5"
    before, real = _disk.stamp_of(path), _disk.stamp_of
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    # A bit that flips on the disk changes neither size nor times.
    monkeypatch.setattr(_disk, "stamp_of", lambda each: before if each == path else real(each))
    monkeypatch.setattr(reporting, "report", lambda folder: "")
    campaign.run(SCENE, folder)
    assert not path.with_name("000007.h5.damaged").exists()
    with pytest.warns(UserWarning, match=r"000007\.h5 does not match its checksum.*set aside, the sample is run again"):
        assert main(["resume", str(folder), "--workers", "1", "--verify"]) == 0
    assert path.with_name("000007.h5.damaged").exists()
    assert_as_undisturbed(folder, undisturbed)


@pytest.mark.parametrize("after", [0, 17, 55])
def test_a_full_disk_stops_with_a_message_and_room_lets_it_go_on(after, undisturbed, tmp_path, monkeypatch, capsys):
    scene, folder = tmp_path / "scene.toml", tmp_path / "full"
    scene.write_text(SCENE)
    real, written = os.replace, []

    def replace(part, path):
        if str(path).endswith(".h5"):
            written.append(path)
            if len(written) > after:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(part, path)

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", replace)
        with pytest.warns(UserWarning, match="a slide may reach the end of the ground"):
            assert main(["run", str(scene), "--out", str(folder), "--workers", "1"]) == 2
    printed = capsys.readouterr().err.splitlines()[-1]
    assert printed.startswith(f"error: cannot write {written[-1]} (No space left on device): make room and start")
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
