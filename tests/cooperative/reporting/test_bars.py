"""What a campaign says of itself while it runs: bars on a terminal, elsewhere lines on stderr and in its folder."""

import os
import re
import signal
import socket
import sys

import pytest

from benchmarks.robustness import invented
from cooperative import run
from cooperative.runs import Stopped
from cooperative.store import open_store

AUDITED = invented.SCENE.replace("samples = 50", "samples = 12").replace("refined_runs = 15", "refined_runs = 10")
pytestmark = pytest.mark.usefixtures("made_up")
LINE = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d (.*)")


def test_the_bar_tells_pace_time_left_and_the_interval(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(type(sys.stderr), "isatty", lambda stream: True, raising=False)
    run(AUDITED, tmp_path / "shown", progress=True)
    assert not (tmp_path / "shown" / "progress.log").exists()
    rough, refined = capsys.readouterr().err.split("refined grid 0/")
    assert re.search(r"rough grid 12/12 .* left, [\d.e+]+ per hour, [\d.]+ fail on the rough grid", rough)
    assert re.search(r"refined grid 10/10 .* per hour, P_f [\d.e-]+ \([\d.e-]+ to [\d.]+\)", refined)


def test_without_a_terminal_lines_tell_it_on_stderr_and_in_the_folder(tmp_path, capsys):
    run(AUDITED, tmp_path / "told", progress=True)
    log = (tmp_path / "told" / "progress.log").read_text().splitlines()
    events = [LINE.fullmatch(line)[1] for line in log]
    assert events[0] == f"begun by process {os.getpid()} on {socket.gethostname()}"
    assert events[-1] == "done"
    assert re.fullmatch(
        r"refined grid 10/10, .* left, [\d.e+]+ per hour, P_f [\d.e-]+ \([\d.e-]+ to [\d.]+\)", events[-2]
    )
    assert len(events) < 8  # a line a minute for each grid, not one a sample
    assert capsys.readouterr().err.splitlines() == log[1:-1]


def test_a_campaign_whose_stderr_is_closed_writes_its_log(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "stderr", None)
    run(AUDITED, tmp_path / "out", progress=True)
    assert (tmp_path / "out" / "progress.log").read_text().endswith("done\n")


def test_the_log_goes_on_tells_an_early_end_and_is_no_link(tmp_path):
    elsewhere = tmp_path / "theirs.txt"
    elsewhere.write_text("theirs")
    open_store(tmp_path / "cut", AUDITED).close()
    (tmp_path / "cut" / "progress.log").symlink_to(elsewhere)

    def stop(phase):
        if phase == "audit":
            raise Stopped(signal.SIGTERM)

    with pytest.raises(Stopped):
        run(AUDITED, tmp_path / "cut", progress=True, on_phase=stop)
    run(AUDITED, tmp_path / "cut", progress=True)
    log = (tmp_path / "cut" / "progress.log").read_text()
    assert "ended early: stopped by SIGTERM; what is finished is kept: the same command goes on from there\n" in log
    assert log.count("begun by process") == 2
    assert log.endswith("done\n")
    assert elsewhere.read_text() == "theirs"
