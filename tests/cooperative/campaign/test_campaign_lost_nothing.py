"""Nothing is lost: campaigns killed, starved of disk, damaged or doubled end with the answer of an undisturbed one."""

import errno
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.robustness import invented
from benchmarks.robustness.invented import LONG, SCENE
from cooperative import _commands as command
from cooperative import campaign
from cooperative.__main__ import main
from cooperative.store import _disk, open_store, read_rows, read_sample, read_store, sample_path, write_sample
from tests import ROOT


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Made-up runs in place of the solver's."""
    invented.invent(put=monkeypatch.setattr)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """A campaign that nothing happened to: its folder and summary."""
    folder = tmp_path_factory.mktemp("campaign") / "undisturbed"
    with pytest.MonkeyPatch.context() as patched:
        invented.invent(put=patched.setattr)
        summary = campaign.run(SCENE, folder)
    assert set(read_rows(read_store(folder), "rough").columns["steps"]) == {invented.STEPS}
    return folder, summary


def without_times(summary):
    fields = summary if isinstance(summary, dict) else summary.as_json()
    return {name: value for name, value in fields.items() if name not in ("seconds", "checksum")}


def assert_same_folders(first, second):
    stores = read_store(first), read_store(second)
    for grid in ("rough", "refined"):
        numbers = read_rows(stores[0], grid).numbers
        assert numbers == read_rows(stores[1], grid).numbers
        for number in numbers[:: max(len(numbers) // 20, 1)]:
            one, other = (read_sample(store, grid, number) for store in stores)
            assert one.coefficients.tobytes() == other.coefficients.tobytes()
            assert one.fields["displacement"].tobytes() == other.fields["displacement"].tobytes()


def test_a_sample_of_another_field_is_set_aside_and_redone(undisturbed, tmp_path):
    folder = tmp_path / "foreign"
    shutil.copytree(undisturbed[0], folder)
    with open_store(folder, SCENE) as store:
        sample = read_sample(store, "rough", 7)
        sample_path(store, "rough", 7).unlink()
        write_sample(store, "rough", replace(sample, coefficients=sample.coefficients[:3]))
    with pytest.warns(UserWarning, match=r"000007\.h5 holds 3 coefficients of a field that has 20: set aside"):
        summary = campaign.run(SCENE, folder)
    assert without_times(summary) == without_times(undisturbed[1])
    assert_same_folders(folder, undisturbed[0])


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
        again = campaign.run(SCENE, folder)
    messages = " ".join(str(warning.message) for warning in warned)
    for path in (flipped, short, foreign):
        assert path.name in messages
        assert path.with_name(path.name + ".damaged").exists()
    assert without_times(again) == without_times(undisturbed[1])
    assert_same_folders(folder, undisturbed[0])


def test_a_file_that_rotted_unseen_is_redone_when_asked_to_verify(undisturbed, tmp_path, monkeypatch):
    folder = tmp_path / "rotten"
    shutil.copytree(undisturbed[0], folder)
    campaign.run(SCENE, folder)
    path = folder / "samples/rough/000007.h5"
    before, real = _disk.stamp_of(path), _disk.stamp_of
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    # A bit that flips on the disk changes neither size nor times.
    monkeypatch.setattr(_disk, "stamp_of", lambda each: before if each == path else real(each))
    monkeypatch.setattr(command, "report", lambda folder: "")
    assert without_times(campaign.run(SCENE, folder)) == without_times(undisturbed[1])
    assert not path.with_name("000007.h5.damaged").exists()
    with pytest.warns(UserWarning, match=r"000007\.h5 does not match its checksum.*set aside, the sample is run again"):
        assert main(["resume", str(folder), "--workers", "1", "--verify"]) == 0
    assert path.with_name("000007.h5.damaged").exists()
    assert without_times(json.loads((folder / "summary.json").read_text())) == without_times(undisturbed[1])
    assert_same_folders(folder, undisturbed[0])


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
        assert main(["run", str(scene), "--out", str(folder), "--workers", "1"]) == 2
    printed = capsys.readouterr().err.splitlines()[-1]
    assert printed.startswith(f"error: cannot write {written[-1]} (No space left on device): make room and start")
    store = read_store(folder)
    assert not list(folder.rglob("*.part"))
    assert len(read_rows(store, "rough").numbers) + len(read_rows(store, "refined").numbers) == after
    assert not read_rows(store, "rough").damaged
    assert without_times(campaign.run(SCENE, folder)) == without_times(undisturbed[1])
    assert_same_folders(folder, undisturbed[0])


def test_a_second_controller_is_refused_and_harms_nothing(undisturbed, tmp_path, capsys):
    scene, folder = tmp_path / "scene.toml", tmp_path / "doubled"
    scene.write_text(SCENE)
    with open_store(folder, SCENE):
        for command in (["run", str(scene), "--out", str(folder)], ["resume", str(folder)]):
            assert main([*command, "--workers", "1"]) == 2
            assert f"held by another controller (process {os.getpid()}" in capsys.readouterr().err
        assert main(["status", str(folder)]) == 0
    assert without_times(campaign.run(SCENE, folder)) == without_times(undisturbed[1])


LIVES = textwrap.dedent("""
    import os, sys, warnings
    from cooperative import campaign
    from benchmarks.robustness import invented
    warnings.simplefilter("ignore")
    invented.invent(seconds=0.01)
    for _ in sys.stdin:
        life = os.fork()
        if life == 0:
            campaign.run(sys.argv[2], sys.argv[1])
            os._exit(0)
        print(life, flush=True)
        os.waitpid(life, 0)
        print("gone", flush=True)
""")


def kill_again_and_again(text, folder, kills, seed):
    """Start the campaign and kill it after a few samples, `kills` times; returns how many left a file half written."""
    generator = random.Random(seed)
    torn = 0
    command = [sys.executable, "-c", LIVES, str(folder), text]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT, text=True) as lives:
        finished: set[Path] = set()
        for _ in range(kills):
            lives.stdin.write("once more\n")
            lives.stdin.flush()
            life = int(lives.stdout.readline())
            enough = len(finished) + generator.randrange(4)
            deadline = time.monotonic() + 60
            while len(list(folder.glob("samples/*/*.h5"))) < enough and time.monotonic() < deadline:
                time.sleep(0.001)
            time.sleep(generator.uniform(0.0, 0.02))
            os.kill(life, signal.SIGKILL)
            assert lives.stdout.readline() == "gone\n"
            there = set(folder.glob("samples/*/*.h5"))
            assert finished <= there
            finished = there
            torn += bool(list(folder.rglob(".*.part")))
        lives.stdin.close()
    return torn


@pytest.mark.slow
def test_a_campaign_killed_ten_times_loses_nothing(undisturbed, tmp_path):
    kill_again_and_again(SCENE, tmp_path / "killed", 10, seed=0)
    assert without_times(campaign.run(SCENE, tmp_path / "killed")) == without_times(undisturbed[1])
    assert_same_folders(tmp_path / "killed", undisturbed[0])


@pytest.mark.slow
def test_a_campaign_killed_at_a_hundred_random_moments_loses_nothing(tmp_path):
    killed, quiet = tmp_path / "killed", tmp_path / "undisturbed"
    torn = kill_again_and_again(LONG, killed, 100, seed=1)
    assert torn > 0
    assert without_times(campaign.run(LONG, killed)) == without_times(campaign.run(LONG, quiet))
    assert not list(killed.rglob("*.damaged"))
    assert_same_folders(killed, quiet)
