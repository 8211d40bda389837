"""Campaigns disturbed while they run, in processes of their own: killed, interrupted, or robbed of their workers.

Their runs are made up, so that the controller, its workers and its folder are tried and not the solver.
"""

from __future__ import annotations

import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.measure import ROOT
from benchmarks.robustness import invented
from benchmarks.robustness.invented import CALIBRATED, LONG, SCENE, SUBSET, SWEEP, TORN, VERIFIED
from cooperative.scene import parse, settled
from cooperative.store import DATABASE, GRIDS, Store, open_store, read_rows, read_sample, read_store
from cooperative.store._database import insert
from cooperative.store._runs import database_row
from jaxmpm.support import files

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
WORKER_KILLS = Case("long", "run", LONG)
"""Whose workers are killed."""


@dataclass
class Toll:
    """What disturbances cost so far: how many there were, what was lost, and who was left. signal_to_end: the longest
    from a signal to the end of its controller (s)."""

    disturbed: int = 0
    lost: list[str] = field(default_factory=list)
    orphans: list[str] = field(default_factory=list)
    signals_lost: list[str] = field(default_factory=list)
    signal_to_end: float = 0.0


class Life:
    """A controller under way in a process group of its own."""

    def __init__(self, case: Case, folder: Path, workers: int, *options: str, **environment: str) -> None:
        folder.parent.mkdir(parents=True, exist_ok=True)
        self.folder, scene = folder, folder.with_suffix(".toml")
        scene.write_text(case.text)
        self.mark = f"{os.getpid()}-{time.time_ns()}"
        command = [
            sys.executable,
            "-m",
            "benchmarks.robustness.hostile_campaign",
            case.command,
            str(scene),
            "--out",
            str(folder),
        ]
        self.process = subprocess.Popen(
            [*command, "--workers", str(workers), *options], cwd=ROOT, env=os.environ | environment | {MARK: self.mark},
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip

    def runs(self) -> bool:
        """Whether it has not ended."""
        return self.process.poll() is None

    def survivors(self) -> list[str]:
        """Processes of it that still run some seconds after it has ended; they are ended then."""
        until = time.monotonic() + SOON
        while (result := list(_marked(self.mark))) and time.monotonic() < until:
            time.sleep(0.1)
        for number, _ in result:
            os.kill(number, signal.SIGKILL)
        return [command for _, command in result]


def _marked(mark: str) -> Iterator[tuple[int, str]]:
    for process in Path("/proc").glob("[0-9]*"):
        try:
            environment = (process / "environ").read_bytes().split(b"\0")
            command = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue
        if f"{MARK}={mark}".encode() in environment and command:
            yield int(process.name), command


def finished(folder: Path) -> set[tuple[Path, str, int]]:
    """Folder, grid and number of the samples that have ended, in all campaigns of a folder."""
    return {
        (path.parent, *row) for path in folder.rglob(DATABASE) for row in queried(path, "SELECT grid, sample FROM run")
    }


def queried(path: Path, statement: str, *values: object) -> list[tuple[Any, ...]]:
    """What a statement gives of a database, whose controller may have been killed as it wrote."""
    uri = f"{path.absolute().as_uri()}?mode=rw"
    with closing(sqlite3.connect(uri, uri=True, timeout=PATIENCE, isolation_level=None)) as database:
        return database.execute(statement, values).fetchall()


def disturb(
    case: Case, workers: int, times: int, end: Callable[[Life, random.Random], bool], folder: Path, seed: int
) -> Toll:
    """Begin a campaign, and end it at a random moment, so many times; then let it go on, and compare.

    end: ends a life; gives whether it did so before that had ended by itself. folder: of all lives, those of other
    disturbances too.
    """
    generator, toll, round_ = random.Random(f"{case.name}-{workers}-{seed}"), Toll(), 0
    undisturbed = undisturbed_of(case, folder)
    while toll.disturbed < times:
        disturbed = folder / f"{case.name}-{workers}-{seed}-{round_}"
        before = set[tuple[Path, str, int]]()
        while toll.disturbed < times:
            life = Life(case, disturbed, workers)
            enough, until = len(before) + generator.randrange(6), time.monotonic() + PATIENCE
            while len(finished(disturbed)) < enough and life.runs() and time.monotonic() < until:
                time.sleep(0.01)
            time.sleep(generator.uniform(0.0, 0.05))
            if not end(life, generator):
                break
            toll.disturbed += 1
            toll.orphans += life.survivors()
            toll.lost += [f"{run} is gone" for run in before - finished(disturbed)]
            before = finished(disturbed)
        toll.orphans += whole(case, disturbed, workers).survivors()
        toll.lost += differences(disturbed, undisturbed)
        round_ += 1
    return toll


def undisturbed_of(case: Case, folder: Path) -> Path:
    """The folder of a campaign that nothing disturbed, run where it is not there yet."""
    undisturbed = folder / f"undisturbed-{case.name}"
    if not undisturbed.exists():
        whole(case, undisturbed, 1)
    return undisturbed


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
        sent = time.monotonic()
        try:
            status = life.process.wait(PATIENCE)
            toll.signal_to_end = max(toll.signal_to_end, time.monotonic() - sent)
        except subprocess.TimeoutExpired:
            toll.signals_lost.append(f"{number.name}: still running after {PATIENCE:g} s")
            return killed(life, generator)
        if status == 0:
            toll.signals_lost.append(f"{number.name}: went on to the end")
        return True

    return end


def kill_workers(case: Case, times: int, folder: Path, seed: int) -> Toll:
    """Kill so many single workers of campaigns that go on by themselves, each once samples have ended since the last,
    and compare: a worker at a random moment, the youngest, which may be starting, or one halfway through sending."""
    generator, toll, round_ = random.Random(seed), Toll(), 0
    undisturbed = undisturbed_of(case, folder)
    while toll.disturbed < times:
        disturbed, torn = folder / f"crews-{round_}", folder / f"torn-{round_}"
        torn.mkdir()
        life, ended = Life(case, disturbed, 2, **{TORN: str(torn)}), 0
        until = time.monotonic() + 10 * PATIENCE
        while life.runs() and time.monotonic() < until:
            time.sleep(generator.uniform(0.0, 0.1))
            if toll.disturbed == times or len(finished(disturbed)) <= ended:
                continue
            ended, way = len(finished(disturbed)), generator.choice(("random", "youngest", "sending"))
            workers = sorted(number for number, command in _marked(life.mark) if "spawn_main" in command)
            if way == "sending":
                (torn / str(ended)).touch()
                toll.disturbed += 1
            elif workers:
                _end(workers[-1] if way == "youngest" else generator.choice(workers))
                toll.disturbed += 1
        toll.disturbed -= len(list(torn.iterdir()))  # there was nothing more to send
        if life.runs() or life.process.returncode:
            toll.lost.append(f"{disturbed} ends with {life.process.poll()}")
            killed(life, generator)
        toll.orphans += life.survivors()
        toll.lost += differences(disturbed, undisturbed)
        round_ += 1
    return toll


def _end(process: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(process, signal.SIGKILL)


def large(count: int, folder: Path) -> dict[str, float]:
    """Seconds until a campaign that has so many samples gives the next one, and from a signal, sent while it verifies
    the files of all their fields, to its end."""
    case = Case("large", "run", SCENE.replace("samples = 50", f"samples = {count + 50}"))
    campaign = parse(case.text)
    coefficients = invented.coefficients_of(campaign, invented.random_soil(campaign))
    made = invented.run_samples(invented.build(campaign, "rough", None), coefficients, range(count))
    with (
        patch.object(files, "write_aside", Path.write_bytes),  # to have the disk sync so many would take minutes
        open_store(folder, settled(case.text, folder)) as store,
        store.writing() as database,
    ):
        for sample in made:
            insert(database, database_row(store, "rough", replace(sample, fields={"small": np.zeros(3)}))[1])
    start = time.monotonic()
    life = Life(case, folder, 1)
    following = "SELECT sample FROM run WHERE grid = 'rough' AND sample = ?"
    _until(lambda: queried(folder / DATABASE, following, count), life)
    resumed = time.monotonic() - start
    killed(life, random.Random())
    looked = folder / "looked"
    life = Life(case, folder, 1, "--verify", **{VERIFIED: str(looked)})
    _until(looked.exists, life)
    life.process.terminate()
    sent = time.monotonic()
    life.process.wait()
    seen = {f"resume_{count}_s": resumed, "signal_while_verifying_s": time.monotonic() - sent}
    if looked.stat().st_size >= count:
        raise RuntimeError(f"the {count} files were verified before the signal came: give more")
    return {name: round(value, 2) for name, value in seen.items()}


def _until(done: Callable[[], object], life: Life) -> None:
    """Wait for a life to do something. Raises RuntimeError where it ends without."""
    while not done():
        if not life.runs():
            raise RuntimeError("the campaign ended early")
        time.sleep(0.02)


def differences(folder: Path, undisturbed: Path) -> list[str]:
    """Where a folder's answer or samples differ from those of an undisturbed campaign, apart from times."""
    wrong = [f"{path} was set aside" for path in folder.rglob("*.damaged")]
    for answer in [path for name in ANSWERS for path in sorted(undisturbed.rglob(name))]:
        other = folder / answer.relative_to(undisturbed)
        if not other.exists() or _without_times(other) != _without_times(answer):
            wrong.append(f"{other} is missing or another")
    for path in sorted(undisturbed.rglob(DATABASE)):
        one, two = read_store(path.parent), read_store(folder / path.parent.relative_to(undisturbed))
        for grid in GRIDS:
            numbers = read_rows(one, grid).numbers
            if numbers != read_rows(two, grid).numbers:
                wrong.append(f"{two.folder}: other {grid} samples")
                continue
            wrong += [f"{two.folder}: {grid} sample {n} is another" for n in numbers if _differ(one, two, grid, n)]
    return wrong


def _without_times(path: Path) -> dict[str, Any]:
    fields = json.loads(path.read_text())
    fields.get("cost", {}).pop("seconds", None)
    return fields


def _differ(one: Store, other: Store, grid: str, number: int) -> bool:
    first, second = (content(store, grid, number) for store in (one, other))
    return first != second


def content(store: Store, grid: str, number: int) -> tuple[Any, ...]:
    """The content of a sample, apart from the seconds it took, so that it can be compared."""
    sample = read_sample(store, grid, number)
    arrays = {"coefficients": sample.coefficients, **sample.fields}
    shown = {name: (str(a.dtype), a.shape, np.ascontiguousarray(a).tobytes()) for name, a in arrays.items()}
    return (sample.number, sample.status, sample.steps, dict(sample.row), shown, sample.dtype, dict(sample.versions))
