"""Commands end well into streams of any encoding, and say the same there in letters that it has."""

import io
import shutil
import sys

import pytest

from cooperative.__main__ import main
from cooperative.folder import read_results
from cooperative.reporting._sentences import words

ENCODINGS = ["ascii", "gbk", "cp932", "cp1251", "cp437", "utf-16"]
COMMANDS = {
    "status": ["done"],
    "report": ["done"],
    "resume": ["done", "--workers", "1"],
    "export": ["done", "--as", "table"],
    "example": ["demo", "--out", "Böschung № 3 – 坡.toml"],
    "new": ["--kind", "section", "--out", "Böschung.toml"],
    "check": ["坡.toml"],
    "draw": ["坡.toml"],
    "fos": ["坡.toml"],
    "site": ["坡.gef", "--out", "site"],
    "run": ["坡.toml", "--out", "坡"],
    "sweep": ["坡.toml", "--out", "坡"],
}


@pytest.fixture(scope="module")
def folder(tiny_campaign, tmp_path_factory):
    folder = tmp_path_factory.mktemp("encodings")
    shutil.copytree(tiny_campaign[0], folder / "done")
    return folder


def printed(command, encoding, monkeypatch):
    """What a command prints into strict streams of an encoding, and its exit code."""
    streams = [io.TextIOWrapper(io.BytesIO(), encoding=encoding, errors="strict") for _ in range(2)]
    with monkeypatch.context() as patched:
        patched.setattr(sys, "stdout", streams[0])
        patched.setattr(sys, "stderr", streams[1])
        code = main([command, *COMMANDS[command]])
    for stream in streams:
        stream.flush()
    return code, "".join(stream.buffer.getvalue().decode(encoding) for stream in streams)


@pytest.mark.usefixtures("unrendered")
@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_prints_into_ascii(folder, command, monkeypatch):
    monkeypatch.chdir(folder)
    code, said = printed(command, "ascii", monkeypatch)
    # Of those that are given a file that is not there the message is what is looked at.
    assert code == (2 if "坡" in COMMANDS[command][0] else 0)
    assert said


@pytest.mark.usefixtures("unrendered")
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_finished_campaign_is_reported_into_any_encoding(folder, encoding, monkeypatch):
    monkeypatch.chdir(folder)
    for command in ("status", "report", "example"):
        (code, said), (_, known) = (printed(command, each, monkeypatch) for each in (encoding, "utf-8"))
        assert code == 0
        assert said == known or command == "example"
        for path in folder.glob("*.toml"):
            path.unlink()


def test_numbers_and_units_need_no_letter_beyond_ascii(tiny_campaign):
    text = words(read_results(tiny_campaign[0]))
    assert text.isascii()
    assert "(m3 per metre of width)" in text
    assert "3.2 m2 of the section" in text
