"""What `benchmarks robustness` tries, in small, and that each of its checks finds what it is there for."""

import random
import socket
import time
from pathlib import Path

import pytest

from benchmarks.robustness import foreign_files, hostile_scenes, lives, robustness
from benchmarks.robustness.invented import SCENE
from cooperative import _commands, campaign
from cooperative.scene import parse
from cooperative.store import _database
from tests.databases import by_sql, delete

SMALL = SCENE.replace("samples = 50", "samples = 16").replace("refined_runs = 15", "refined_runs = 10")


@pytest.fixture
def finished(tmp_path, made_up) -> Path:
    """A finished campaign of made-up runs."""
    campaign.run(SMALL, tmp_path / "finished")
    return tmp_path / "finished"


def test_a_dozen_hostile_scenes_end_in_a_campaign_or_one_line(tmp_path):
    values, rows = robustness.fuzzed(12, 1, tmp_path, seed=0)
    assert (rows, values["tracebacks"]) == ([], 0)


def test_hostile_scenes_come_to_a_campaign_now_and_then():
    texts = list(hostile_scenes.scenes(100, seed=5))
    assert texts == list(hostile_scenes.scenes(100, seed=5))
    accepted = [text for text in texts if refusal(text) is None]
    assert 5 < len(accepted) < 60


def refusal(text):
    try:
        parse(text)
    except ValueError as error:
        return error
    return None


@pytest.mark.parametrize(
    ("does", "how"),
    [
        (lambda given: print("error: one line", file=hostile_scenes.sys.stderr) or exit(2), "traceback"),
        (lambda given: {}["key"], "traceback"),
        (lambda given: raised(ValueError("two\nlines")), "refused"),  # the command masks what would break its line
        (lambda given: raised(ValueError("\x1b[2J")), "refused"),
        (lambda given: (print("more", file=hostile_scenes.sys.stderr), raised(ValueError("one line"))), "noise"),
        (lambda given: (given.out.mkdir(), (given.out / "campaign.db").touch(), raised(ValueError("late"))), "noise"),
        (lambda given: raised(ValueError("one line")), "refused"),
        (lambda given: raised(hostile_scenes.Began()), "began"),
    ],
)
def test_an_answer_differs_from_a_traceback_noise_and_a_folder_left_behind(does, how, tmp_path, monkeypatch):
    monkeypatch.setitem(_commands.COMMANDS, "run", does)
    assert hostile_scenes.answer_in_process("", tmp_path).how == how


def raised(error):
    raise error


def test_no_damage_to_a_campaign_goes_undetected(finished):
    assert robustness.damage(80, finished, seed=0) == (84, [])


def test_damage_would_show_if_checksums_were_not_looked_at(finished, monkeypatch):
    expected = robustness.contents(finished)
    by_sql(finished, "update run set displacement = displacement + 1 where sample = 3")
    assert not robustness.accepted(finished, expected)
    by_sql(finished, "update run set sha256 = '' where sample = 3")
    monkeypatch.setattr(_database, "checksum", lambda digest, row: row["sha256"])
    assert robustness.accepted(finished, expected)


def test_a_sample_that_lacks_unsaid_would_show(finished):
    expected = robustness.contents(finished)
    delete(finished, "rough", 3)
    assert robustness.accepted(finished, expected)


def test_nothing_made_by_hand_is_accepted_or_leads_outside(finished, tmp_path):
    made, escapes = robustness.by_hand(finished, tmp_path / "outside")
    assert made >= 30
    assert escapes == []


def test_what_is_lost_is_named(finished, tmp_path):
    other = tmp_path / "other"
    campaign.run(SMALL, other)
    assert lives.differences(other, finished) == []
    (other / "summary.json").write_text((finished / "summary.json").read_text().replace("0", "1"))
    delete(other, "rough", 4)
    assert len(lives.differences(other, finished)) == 2


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("case", lives.CASES, ids=lambda case: case.name)
def test_kills_lose_nothing_and_leave_nobody(case, workers, tmp_path):
    toll = lives.disturb(case, workers, 3, lives.killed, tmp_path, seed=7)
    assert (toll.disturbed, toll.lost, toll.orphans) == (3, [], [])


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_signals_at_random_moments_end_campaigns_and_lose_nothing(workers, tmp_path):
    signals = lives.Toll()
    toll = lives.disturb(lives.CASES[0], workers, 25, lives.signalled(signals), tmp_path, seed=8)
    assert (toll.disturbed, toll.lost, toll.orphans, signals.signals_lost) == (25, [], [], [])


@pytest.mark.slow
def test_a_campaign_whose_workers_are_killed_goes_on_to_the_same_answer(tmp_path):
    toll = lives.kill_workers(lives.WORKER_KILLS, 5, tmp_path, seed=9)
    assert (toll.disturbed, toll.lost, toll.orphans) == (5, [], [])


@pytest.mark.slow
def test_a_large_folder_goes_on_and_a_signal_ends_its_verification(tmp_path):
    assert lives.large(1500, tmp_path / "large").keys() == {"resume_1500_s", "signal_while_verifying_s"}


@pytest.mark.slow
def test_workers_end_with_a_controller_that_is_killed(tmp_path):
    life = lives.Life(lives.CASES[0], tmp_path / "killed", workers=2)
    until = time.monotonic() + lives.PATIENCE
    while not lives.finished(tmp_path) and time.monotonic() < until:
        time.sleep(0.01)
    assert len(list(lives._marked(life.mark))) >= 3
    assert lives.killed(life, random.Random(0))
    assert life.survivors() == []


def test_files_of_the_trade_are_what_they_are_called_or_refused(tmp_path):
    count, found = foreign_files.tried(tmp_path)  # all of them: each is another way out
    assert count > 200
    assert found == []


FAULTS = {
    "read another file": lambda path, outside: (outside.folder / "bait.csv").read_text(),
    "wrote ": lambda path, outside: path.with_name("more").touch(),
    "changed what is outside": lambda path, outside: (outside.folder / "written.db").touch(),
    "called a host": lambda path, outside: socket.create_connection(outside.host.getsockname()).close(),
    "hung": lambda path, outside: time.sleep(60),
    "MemoryError": lambda path, outside: bytearray(8 * 2**30),
    "KeyError": lambda path, outside: {}["key"],
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_a_reader_may_not_do_is_named(fault, tmp_path, monkeypatch):
    monkeypatch.setattr(foreign_files, "PATIENCE", 1)
    outside = foreign_files.Outside(tmp_path / "outside")
    monkeypatch.setattr(foreign_files, "read", lambda path: str(FAULTS[fault](path, outside)))
    with outside.host:
        name, _, put = next(foreign_files.made())
        assert [each for each in foreign_files.faults(name, put, outside) if fault in each]
