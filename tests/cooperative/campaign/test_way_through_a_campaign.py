"""A scene's way through a campaign: which steps the controller takes, and which rooms each of them enters."""

import sys
from functools import cache
from itertools import groupby
from pathlib import Path

import pytest

import cooperative
from benchmarks.robustness import invented
from benchmarks.robustness.invented import CALIBRATED, SUBSET
from cooperative import campaign

HOUSE = Path(cooperative.__file__).parent
RUNS = {"estimate", "runs", "store"}
ENDED = RUNS | {"scene"}
"""Of steps whose runs end by the rules that the scene gives."""
STEPS = {
    "draw": RUNS,
    "screen": ENDED,
    "refine": ENDED,
    "slide": ENDED | {"summary"},
    "summarise": RUNS | {"summary", "folder"},
}
"""Of each step of a campaign, in order, the rooms that it may enter."""


def room_of(code):
    """The room that a function belongs to, None outside the package; made-up runs stand for those of the solver."""
    return room_of_file(code.co_filename)


@cache
def room_of_file(name):
    """Asked for every call of a campaign, of which most are in a few hundred files."""
    path = Path(name)
    if path == Path(invented.__file__):
        return "runs"
    return path.relative_to(HOUSE).parts[0].removesuffix(".py") if path.is_relative_to(HOUSE) else None


def callers(frame):
    """Functions under way in the package, the innermost first; none while a context is left."""
    codes, leaves = [], frame.f_code.co_name == "__exit__"
    while frame := frame.f_back:
        leaves |= not codes and frame.f_code.co_name == "__exit__"
        if room_of(frame.f_code) is not None:
            codes.append(frame.f_code)
    return [] if leaves else codes


def trace(does):
    """Rooms that the controller enters in order, each step as one; and the rooms that a step enters."""
    way, steps = [], {name: set() for name in STEPS}

    def entered(frame, event, _):
        if event != "call":
            return
        room = room_of(frame.f_code)
        if room in (None, "campaign"):
            return
        outer = callers(frame)
        if not outer or room_of(outer[0]) != "campaign":
            return
        step = next((code.co_name for code in outer if room_of(code) == "campaign" and code.co_name in STEPS), None)
        way.append(step or room)
        if step is not None:
            steps[step].add(room)

    sys.setprofile(entered)
    try:
        does()
    finally:
        sys.setprofile(None)
    return [room for room, _ in groupby(way)], steps


@pytest.mark.parametrize(
    ("scene", "choices"), [(CALIBRATED, {"refined_runs": 20}), (SUBSET, {})], ids=["calibrated", "subset"]
)
def test_the_controller_goes_from_scene_to_folder_through_its_rooms(tmp_path, monkeypatch, scene, choices):
    invented.invent(put=monkeypatch.setattr)
    way, steps = trace(lambda: campaign.run(scene, tmp_path / "out", **choices))
    assert way[:3] == ["runs", "store", "scene"]  # settings of JAX first, then what the folder holds
    assert [room for room in way if room in STEPS] == list(STEPS)
    assert set(way) - set(STEPS) <= {"scene", "estimate", "runs", "store"}
    assert {name: rooms - STEPS[name] for name, rooms in steps.items()} == {name: set() for name in STEPS}
    assert steps["screen"] == steps["refine"] == ENDED
    assert {"summary", "folder"} <= steps["summarise"]
