"""What a campaign survives: kills of it and of its workers, signals, damaged and hand-made files, scenes that nobody
should write.

Campaigns run in processes of their own with made-up runs, so that the controller, its workers and its folder are tried
and not the solver. `lost`: samples that were finished before a kill or signal and gone after it, and campaigns whose
answer or samples differ from those of an undisturbed one. `orphans`: processes that outlived their controller by more
than ten seconds. `signals_lost`: controllers that SIGTERM or Ctrl-C did not end. `worker_kills`: single workers killed,
at random moments, as they start, and halfway through sending a sample; their campaign goes on by itself.
`resume_20000_s`: from the command to the first new sample of a campaign that has 20,000. `signal_to_end_s`: the longest
from a signal to the end of a campaign; `signal_while_verifying_s`: while it verifies 20,000 files of fields.
`undetected`: damaged databases and files whose changed content was accepted. `escapes`: folders made by hand that were
accepted, or made a reader touch what is outside them. `foreign_faults`:
files of the trade, made to be more than they are called, that led a reader to another file,
to a host or to what is written, or took gigabytes or minutes.
"""

from __future__ import annotations

import random
import shutil
import signal
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.measure import Report
from benchmarks.robustness import foreign_files, hostile_files, hostile_scenes
from benchmarks.robustness.lives import (
    CASES,
    PATIENCE,
    WORKER_KILLS,
    Toll,
    content,
    disturb,
    kill_workers,
    killed,
    large,
    signalled,
    undisturbed_of,
)
from cooperative.store import (
    DATABASE,
    GRIDS,
    DamagedFile,
    open_store,
    read_rows,
    read_sample,
    read_store,
)


def damage(count: int, folder: Path, seed: int) -> tuple[int, list[str]]:
    """Damage the files of a copy of a campaign, one at a time, half of the times its database and else a file of
    fields; gives how many, and those after which samples were read as whole that are others, or lacked unsaid."""
    generator, undetected, tried = random.Random(seed), [], 0
    expected = contents(folder)
    copy = shutil.copytree(folder, folder.with_name(f"{folder.name}-damaged"))
    of_fields = sorted((copy / "fields").glob("*.h5"))
    while tried < count:
        path = generator.choice((copy / DATABASE, generator.choice(of_fields)))
        whole, other = path.read_bytes(), generator.choice(of_fields).read_bytes()
        at = generator.randrange(len(whole))
        mixed = [("mixed with another", whole[:at] + other[at:]), ("a byte less", whole[:at] + whole[at + 1 :])]
        for how, data in [*hostile_files.damaged(whole, 5, seed=generator.randrange(2**32)), *mixed]:
            tried += 1
            path.write_bytes(data)
            if accepted(copy, expected):
                undetected.append(f"{path.name}: {how}")
        path.write_bytes(whole)
    return tried, undetected


def contents(folder: Path) -> dict[tuple[str, int], tuple[Any, ...]]:
    """The content of every sample of a campaign, by grid and number."""
    store = read_store(folder)
    return {(grid, n): content(store, grid, n) for grid in GRIDS for n in read_rows(store, grid).numbers}


def accepted(folder: Path, expected: dict[tuple[str, int], tuple[Any, ...]]) -> bool:
    """Whether the samples of a folder are read as whole although they are others than expected."""
    try:
        store = read_store(folder)
        rows = {grid: read_rows(store, grid) for grid in GRIDS}
        there = {(grid, n): content(store, grid, n) for grid in GRIDS for n in rows[grid].numbers}
    except DamagedFile:
        return False
    return there != expected and not any(grid_rows.damaged for grid_rows in rows.values())


def by_hand(folder: Path, outside: Path) -> tuple[int, list[str]]:
    """Make copies of a campaign's folder lie, each otherwise, and have the controller look; gives how many, and those
    that were accepted, that hung or broke it, or led it outside."""
    baits, escapes = hostile_files.lay_baits(outside), []
    copy, numbers = folder.with_name(f"{folder.name}-made"), read_rows(read_store(folder), GRIDS[0]).numbers
    makers = hostile_files.hand_made(baits)
    for name, make in makers.items():
        shutil.copytree(folder, copy)
        make(copy)
        try:
            with _hurried(name), open_store(copy, read_store(folder).source, verify=True) as store:
                rows = read_rows(store, GRIDS[0])
                if rows.numbers == numbers:
                    read_sample(store, GRIDS[0], 1)
                    escapes.append(f"{name}: accepted")
        except DamagedFile:
            pass
        except Exception as error:
            escapes.append(f"{name}: {error!r}")
        if not baits.untouched():
            escapes.append(f"{name}: changed what is outside")
            hostile_files.lay_baits(outside)
        for leftover in (copy, copy.with_name("moved")):
            shutil.rmtree(leftover, ignore_errors=True)
    return len(makers), escapes


@contextmanager
def _hurried(name: str) -> Iterator[None]:
    """Raise TimeoutError in what takes longer than `PATIENCE`; warnings are what is hoped for, and not shown."""

    def over(*_: Any) -> None:
        raise TimeoutError(f"{name}: hung for {PATIENCE:g} s")

    before = signal.signal(signal.SIGALRM, over)
    signal.alarm(int(PATIENCE))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def fuzzed(count: int, by_command: int, folder: Path, seed: int) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Values and rows of so many scenes tried in process, and a few of those refused tried by command line too."""
    rows, slowest, refused, bad = [], 0.0, [], 0
    for index, (text, answer) in enumerate(hostile_scenes.tried(hostile_scenes.scenes(count, seed))):
        slowest = max(slowest, answer.seconds)
        if answer.how == "refused":
            refused.append(text)
        if not answer.well:
            bad += 1
            rows.append({"scene": index, "seed": seed, "how": answer.how, "said": answer.message[-300:]})
    for text in random.Random(seed).sample(refused, by_command):
        answer = hostile_scenes.by_command_line(text, folder)
        if not answer.well:
            bad += 1
            rows.append({"scene": text[:200], "seed": seed, "how": answer.how, "said": answer.message[-300:]})
    values = {"scenes_fuzzed": count, "by_command_line": by_command, "tracebacks": bad, "slowest_scene_s": slowest}
    return values, rows


def run(quick: bool = False) -> Report:
    """All of it; quick: a fortieth of what is many, and one of each kind of end, by one worker and by two in turn."""
    part = 40 if quick else 1
    kills_of = [(case, workers) for case in CASES for workers in (1, 2)]
    signals_of = kills_of[:2]
    if quick:
        kills_of = list(zip(CASES, (1, 2, 2, 1), strict=True))
        signals_of = signals_of[1:]
    # A shell has what it starts in the background ignore Ctrl-C, and campaigns would inherit that: one that is reached
    # while its libraries load would go on.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    signals = Toll()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        kills = [
            (case, workers, disturb(case, workers, max(13 // part, 1), killed, folder, 0)) for case, workers in kills_of
        ]
        stopped = [
            (case, workers, disturb(case, workers, max(25 // part, 1), signalled(signals), folder, 1))
            for case, workers in signals_of
        ]
        worker_kills = [(WORKER_KILLS, 2, kill_workers(WORKER_KILLS, max(36 // part, 1), folder, 4))]
        seconds = large(2000 if quick else 20_000, folder / "large")
        undisturbed = undisturbed_of(CASES[0], folder)
        damaged, undetected = damage(400 // part, undisturbed, seed=2)
        made, escapes = by_hand(undisturbed, folder / "outside")
        foreign, foreign_faults = foreign_files.tried(folder / "foreign", foreign_files.EVERY if quick else 1)
        scenes, bad = fuzzed(2000 // part, max(20 // part, 1), folder, seed=3)
    tolls = [toll for _, _, toll in (*kills, *stopped, *worker_kills)]
    rows = [
        {"case": case.name, "workers": workers, "end": end, "times": toll.disturbed, "lost": len(toll.lost),
         "orphans": len(toll.orphans)}
        for end, group in (("kill", kills), ("signal", stopped), ("worker kill", worker_kills))
        for case, workers, toll in group
    ]  # fmt: skip
    lines = (
        [line for toll in tolls for line in (*toll.lost, *toll.orphans)]
        + signals.signals_lost
        + undetected
        + escapes
        + foreign_faults
    )
    values = {
        "kills": sum(toll.disturbed for _, _, toll in kills),
        "signals": sum(toll.disturbed for _, _, toll in stopped),
        "worker_kills": sum(toll.disturbed for _, _, toll in worker_kills),
        **seconds,
        "signal_to_end_s": round(max(signals.signal_to_end, seconds["signal_while_verifying_s"]), 2),
        "lost": sum(len(toll.lost) for toll in tolls),
        "orphans": sum(len(toll.orphans) for toll in tolls),
        "signals_lost": len(signals.signals_lost),
        **scenes,
        "damaged_files": damaged,
        "undetected": len(undetected),
        "hand_made_files": made,
        "escapes": len(escapes),
        "foreign_files": foreign,
        "foreign_faults": len(foreign_faults),
    }
    return Report(values, [*rows, *({"what": line[:300]} for line in lines), *bad])
