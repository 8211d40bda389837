"""What a campaign survives: kills of it and of its workers, signals, damaged and hand-made files, scenes that nobody
should write.

Campaigns run in processes of their own with made-up runs, so that the controller, its workers and its folder are tried
and not the solver. `lost`: samples that were finished before a kill or signal and gone after it, and campaigns whose
answer or samples differ from those of an undisturbed one. `orphans`: processes that outlived their controller by more
than ten seconds. `signals_lost`: controllers that SIGTERM or Ctrl-C did not end. `worker_kills`: single workers killed,
at random moments, as they start, and halfway through sending a sample; their campaign goes on by itself.
`resume_20000_s`: from the command to the first new sample of a campaign that has 20,000. `signal_to_end_s`: the longest
from a signal to the end of a campaign; `signal_while_verifying_s`: while it reads 20,000 files. `undetected`: damaged
files whose changed content was accepted. `escapes`: hand-made files that made a reader touch what is outside the
folder. `foreign_faults`: files of the trade, made to be more than they are called, that led a reader to another file,
to a host or to what is written, or took gigabytes or minutes.
"""

from __future__ import annotations

import os
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
)
from cooperative.store import (
    GRIDS,
    DamagedFile,
    Store,
    open_store,
    read_rows,
    read_store,
    sample_path,
)


def damage(count: int, folder: Path, seed: int) -> tuple[int, list[str]]:
    """Damage sample files of a campaign, one at a time; gives how many, and those that were read as if they were whole
    although their content had changed."""
    generator, undetected, tried = random.Random(seed), [], 0
    store = read_store(folder)
    there = [(grid, number) for grid in GRIDS for number in read_rows(store, grid).numbers]
    while tried < count:
        grid, number = generator.choice(there)
        path, expected = sample_path(store, grid, number), content(store, grid, number)
        whole, other = path.read_bytes(), sample_path(store, *generator.choice(there)).read_bytes()
        at = generator.randrange(len(whole))
        mixed = [("mixed with another", whole[:at] + other[at:]), ("a byte less", whole[:at] + whole[at + 1 :])]
        for how, data in [*hostile_files.damaged(whole, 5, seed=generator.randrange(2**32)), *mixed]:
            tried += 1
            path.write_bytes(data)
            if accepted(store, grid, number, expected):
                undetected.append(f"{grid} {number}: {how}")
        path.write_bytes(whole)
    return tried, undetected


def accepted(store: Store, grid: str, number: int, expected: tuple[Any, ...]) -> bool:
    """Whether a sample's file is read as whole and holds something else than expected."""
    try:
        return content(store, grid, number) != expected
    except DamagedFile:
        return False


def by_hand(folder: Path, outside: Path) -> tuple[int, list[str]]:
    """Put what was made by hand in place of a sample's file, one after the other, and have the controller look; gives
    how many, and those that were accepted, that hung or broke it, or led it outside."""
    baits, escapes = hostile_files.lay_baits(outside), []
    makers = hostile_files.hand_made(baits)
    path = sample_path(read_store(folder), GRIDS[0], 0)
    whole = path.read_bytes()
    for name, put in makers.items():
        path.unlink()
        put(path, whole)
        try:
            with open_store(folder, (folder / "scene.toml").read_text()) as store, _hurried(name):
                rows = read_rows(store, GRIDS[0])
            if 0 in rows.numbers or os.path.lexists(path):
                escapes.append(f"{name}: accepted")
        except Exception as error:
            escapes.append(f"{name}: {error!r}")
        if not baits.untouched():
            escapes.append(f"{name}: changed what is outside")
            hostile_files.lay_baits(outside)
        for left in path.parent.glob(f"{path.name}*"):
            shutil.rmtree(left) if left.is_dir() and not left.is_symlink() else left.unlink()
        path.write_bytes(whole)
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
    """All of it; quick: a tenth."""
    part = 10 if quick else 1
    # A shell has what it starts in the background ignore Ctrl-C, and campaigns would inherit that: one that is reached
    # while its libraries load would go on.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    signals = Toll()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        kills = [
            (
                case,
                workers,
                disturb(case, workers, 13 if not quick else 2, killed, folder / f"{case.name}-{workers}", 0),
            )
            for case in CASES
            for workers in (1, 2)
        ]
        stopped = [
            (case, workers, disturb(case, workers, 25 // part, signalled(signals), folder / f"signals-{workers}", 1))
            for case, workers in ((CASES[0], 1), (CASES[0], 2))
        ]
        worker_kills = [(WORKER_KILLS, 2, kill_workers(WORKER_KILLS, 36 // part, folder / "crews", 4))]
        seconds = large(20_000 // part, folder / "large")
        damaged, undetected = damage(400 // part, folder / "plain-1" / "undisturbed", seed=2)
        made, escapes = by_hand(folder / "plain-1" / "undisturbed", folder / "outside")
        foreign, foreign_faults = foreign_files.tried(folder / "foreign", foreign_files.EVERY if quick else 1)
        scenes, bad = fuzzed(2000 // part, 20 // part, folder, seed=3)
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
