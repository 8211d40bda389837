"""What a campaign survives: kills, signals, damaged and hand-made files, scenes that nobody should write.

Campaigns run in processes of their own with made-up runs, so that the controller, its workers and its folder are tried
and not the solver. `lost`: samples that were finished before a kill or signal and gone after it, and campaigns whose
answer or samples differ from those of an undisturbed one. `orphans`: processes that outlived their controller by more
than ten seconds. `signals_lost`: controllers that SIGTERM or Ctrl-C did not end. `undetected`: damaged files whose
changed content was accepted. `escapes`: hand-made files that made a reader touch what is outside the folder.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import hostile_files, hostile_scenes
from benchmarks.invented import CALIBRATED, SCENE, SUBSET, SWEEP
from benchmarks.measure import ROOT, Report
from cooperative.store import GRIDS, DamagedFile, Store, open_store, read_rows, read_sample, read_store, sample_path

MARK = "JAXMPM_ROBUSTNESS"
"""Environment variable by which the processes of a campaign are known, its workers too."""

SOON = 10.0
"""Seconds in which workers have to end after their controller."""

PATIENCE = 60.0
"""Seconds in which a controller has to end after a signal; made-up runs take 0.02 s, but machines are loaded."""


ANSWERS = ("summary.json", "sweep.json")
"""What a command writes last: a campaign, and a sweep of them."""


@dataclass(frozen=True)
class Case:
    """A campaign, or a sweep of them, that is disturbed. text: its scene."""

    name: str
    command: str
    text: str


CASES = (
    Case("plain", "run", SCENE),
    Case("calibrate", "run", CALIBRATED),
    Case("subset", "run", SUBSET),
    Case("sweep", "sweep", SWEEP),
)


@dataclass
class Toll:
    """What disturbances cost so far: how many there were, what was lost, and who was left."""

    disturbed: int = 0
    lost: list[str] = field(default_factory=list)
    orphans: list[str] = field(default_factory=list)
    signals_lost: list[str] = field(default_factory=list)


class Life:
    """A controller under way in a process group of its own."""

    def __init__(self, case: Case, folder: Path, workers: int) -> None:
        folder.parent.mkdir(parents=True, exist_ok=True)
        self.folder, scene = folder, folder.with_suffix(".toml")
        scene.write_text(case.text)
        self.mark = f"{os.getpid()}-{time.time_ns()}"
        command = [sys.executable, "-m", "benchmarks.hostile_campaign", case.command, str(scene), "--out", str(folder)]
        self.process = subprocess.Popen(
            [*command, "--workers", str(workers)], cwd=ROOT, env=os.environ | {MARK: self.mark},
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip

    def runs(self) -> bool:
        """Whether it has not ended."""
        return self.process.poll() is None

    def left(self) -> list[str]:
        """Processes of it that still run some seconds after it has ended; they are ended then."""
        until = time.monotonic() + SOON
        while (found := list(_marked(self.mark))) and time.monotonic() < until:
            time.sleep(0.1)
        for number, _ in found:
            os.kill(number, signal.SIGKILL)
        return [command for _, command in found]


def _marked(mark: str) -> Iterator[tuple[int, str]]:
    for process in Path("/proc").glob("[0-9]*"):
        try:
            environment = (process / "environ").read_bytes().split(b"\0")
            command = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue
        if f"{MARK}={mark}".encode() in environment and command:
            yield int(process.name), command


def finished(folder: Path) -> set[Path]:
    """Files of the samples that have ended, in all campaigns of a folder."""
    return set(folder.rglob("samples/*/*.h5"))


def disturb(
    case: Case, workers: int, times: int, end: Callable[[Life, random.Random], bool], folder: Path, seed: int
) -> Toll:
    """Begin a campaign, and end it at a random moment, so many times; then let it go on, and compare.

    end: ends a life; gives whether it did so before that had ended by itself.
    """
    generator, toll, round_ = random.Random(f"{case.name}-{workers}-{seed}"), Toll(), 0
    undisturbed = folder / "undisturbed"
    whole(case, undisturbed, 1)
    while toll.disturbed < times:
        disturbed, before = folder / f"disturbed-{round_}", set[Path]()
        while toll.disturbed < times:
            life = Life(case, disturbed, workers)
            enough, until = len(before) + generator.randrange(6), time.monotonic() + PATIENCE
            while len(finished(disturbed)) < enough and life.runs() and time.monotonic() < until:
                time.sleep(0.002)
            time.sleep(generator.uniform(0.0, 0.05))
            if not end(life, generator):
                break
            toll.disturbed += 1
            toll.orphans += life.left()
            toll.lost += [f"{path} is gone" for path in before - finished(disturbed)]
            before = finished(disturbed)
        toll.orphans += whole(case, disturbed, workers).left()
        toll.lost += differences(disturbed, undisturbed)
        round_ += 1
    return toll


def whole(case: Case, folder: Path, workers: int) -> Life:
    """A campaign that is left to end by itself. Raises RuntimeError where that is no good end: nothing could then be
    compared."""
    life = Life(case, folder, workers)
    if life.process.wait():
        raise RuntimeError(f"{case.name} with {workers} workers ends with {life.process.returncode}: see {folder}")
    return life


def killed(life: Life, generator: random.Random) -> bool:
    """End it by SIGKILL."""
    ran = life.runs()
    life.process.kill()
    life.process.wait()
    return ran


def signalled(toll: Toll) -> Callable[[Life, random.Random], bool]:
    """Ends lives by SIGTERM, or by Ctrl-C as a terminal sends it, to all processes of a group; those that do not end
    are written into `toll` and killed."""

    def end(life: Life, generator: random.Random) -> bool:
        number = generator.choice((signal.SIGTERM, signal.SIGINT))
        # With its answer written, a controller has nothing left to stop.
        if not life.runs() or any((life.folder / name).exists() for name in ANSWERS):
            life.process.wait()
            return False
        if number == signal.SIGINT:
            os.killpg(life.process.pid, number)
        else:
            life.process.send_signal(number)
        try:
            status = life.process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            toll.signals_lost.append(f"{number.name}: still running after {PATIENCE:g} s")
            return killed(life, generator)
        if status == 0:
            toll.signals_lost.append(f"{number.name}: went on to the end")
        return True

    return end


def differences(folder: Path, undisturbed: Path) -> list[str]:
    """Where a folder's answer or samples differ from those of an undisturbed campaign, apart from times."""
    wrong = [f"{path} was set aside" for path in folder.rglob("*.damaged")]
    for answer in [path for name in ANSWERS for path in sorted(undisturbed.rglob(name))]:
        other = folder / answer.relative_to(undisturbed)
        if not other.exists() or _without_times(other) != _without_times(answer):
            wrong.append(f"{other} is missing or another")
    for path in sorted(undisturbed.rglob("scene.toml")):
        one, two = read_store(path.parent), read_store(folder / path.parent.relative_to(undisturbed))
        for grid in GRIDS:
            numbers = read_rows(one, grid).numbers
            if numbers != read_rows(two, grid).numbers:
                wrong.append(f"{two.folder}: other {grid} samples")
                continue
            wrong += [f"{sample_path(two, grid, n)} is another" for n in numbers if _differ(one, two, grid, n)]
    return wrong


def _without_times(path: Path) -> dict[str, Any]:
    return {name: value for name, value in json.loads(path.read_text()).items() if name not in ("seconds", "checksum")}


def _differ(one: Store, other: Store, grid: str, number: int) -> bool:
    first, second = (content(store, grid, number) for store in (one, other))
    return first != second


def content(store: Store, grid: str, number: int) -> tuple[Any, ...]:
    """What a sample's file says, apart from the seconds it took, so that it can be compared."""
    sample = read_sample(store, grid, number)
    arrays = {"coefficients": sample.coefficients, **sample.fields}
    shown = {name: (str(a.dtype), a.shape, np.ascontiguousarray(a).tobytes()) for name, a in arrays.items()}
    return (sample.number, sample.status, sample.steps, dict(sample.row), shown, sample.dtype, dict(sample.versions))


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
            if believed(store, grid, number, expected):
                undetected.append(f"{grid} {number}: {how}")
        path.write_bytes(whole)
    return tried, undetected


def believed(store: Store, grid: str, number: int, expected: tuple[Any, ...]) -> bool:
    """Whether a sample's file is read as whole and says something else than expected."""
    try:
        return content(store, grid, number) != expected
    except DamagedFile:
        return False


def by_hand(folder: Path, outside: Path) -> tuple[int, list[str]]:
    """Put what was made by hand in place of a sample's file, one after the other, and have the controller look; gives
    how many, and those that were believed, that hung or broke it, or led it outside."""
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
                escapes.append(f"{name}: believed")
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
            rows.append({"scene": index, "seed": seed, "how": answer.how, "said": answer.said[-300:]})
    for text in random.Random(seed).sample(refused, by_command):
        answer = hostile_scenes.by_command_line(text, folder)
        if not answer.well:
            bad += 1
            rows.append({"scene": text[:200], "seed": seed, "how": answer.how, "said": answer.said[-300:]})
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
        damaged, undetected = damage(400 // part, folder / "plain-1" / "undisturbed", seed=2)
        made, escapes = by_hand(folder / "plain-1" / "undisturbed", folder / "outside")
        scenes, bad = fuzzed(2000 // part, 20 // part, folder, seed=3)
    tolls = [toll for _, _, toll in (*kills, *stopped)]
    rows = [
        {"case": case.name, "workers": workers, "end": end, "times": toll.disturbed, "lost": len(toll.lost),
         "orphans": len(toll.orphans)}
        for end, group in (("kill", kills), ("signal", stopped))
        for case, workers, toll in group
    ]  # fmt: skip
    said = (
        [line for toll in tolls for line in (*toll.lost, *toll.orphans)] + signals.signals_lost + undetected + escapes
    )
    values = {
        "kills": sum(toll.disturbed for _, _, toll in kills),
        "signals": sum(toll.disturbed for _, _, toll in stopped),
        "lost": sum(len(toll.lost) for toll in tolls),
        "orphans": sum(len(toll.orphans) for toll in tolls),
        "signals_lost": len(signals.signals_lost),
        **scenes,
        "damaged_files": damaged,
        "undetected": len(undetected),
        "hand_made_files": made,
        "escapes": len(escapes),
    }
    return Report(values, [*rows, *({"what": line[:300]} for line in said), *bad])
