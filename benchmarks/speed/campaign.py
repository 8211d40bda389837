"""Hours of a whole campaign on this machine until the coefficient of variation of P_f is 10 per cent.

The published slope in 3D with the published particle counts (`hours_to_cov_10`), and with the settings that a scene has
by default (`hours_to_cov_10_default`): set-up, screening, and an audit that asks for classes alone, one worker to a
core. Then as many failures of the first as consequences and modes want slide on to their end (`hours_slides`).
`share_of_time` is that of the published slope, slides included. `expected_hours_to_cov_10` and its default counterpart
are not of this one draw: the seconds of its runs, of as many refined ones as half of the campaigns of `estimators`
take, and its set-up. `--quick` does all of it with the section.

Folders and seconds stand in out/campaign. What is stopped goes on with the next command, and the seconds of all its
lives count, lost runs included; what is not reached yet is null. Each state of the code has folders of its own: the
hours of a campaign that two of them ran would be those of neither.
"""

from __future__ import annotations

import json
import sys
import threading
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measure import ROOT, Report, code_digest, sources
from benchmarks.speed.class_runs import refined_runs_needed
from cooperative import campaign
from cooperative.reporting import progress_of
from cooperative.runs import Stopped, cores_to_use, stop_by_signals
from cooperative.scene import to_toml
from cooperative.store import GRIDS, SLIDES, Store, read_rows, read_store
from jaxmpm.support import files

PLAN: dict[str, Any] = {"samples": 1000, "target_cov": 0.1, "screening_stop": 1.0, "fields": "none"}
"""Of both campaigns. At a P_f of a quarter, and refined runs 45 times as dear as rough ones, 1000 samples cost least in
all. Rough runs end at the failure displacement too."""

PARTS = {"screening": "screening", "audit": "audit", "slides": "slides", "summary": "rest"}
"""Phase of a campaign -> the part of the time that it begins."""


@dataclass(frozen=True)
class Stage:
    """A stretch of a campaign. campaign: whose folder it runs in. scene: in 3D, and in quick. slides: failures of that
    campaign that slide on to their end. before: the phase that the stretch ends before, None for the campaign's end."""

    campaign: str
    scene: tuple[str, str]
    slides: int = 0
    before: str | None = None


STAGES = {
    "hours_to_cov_10": Stage("published", ("paper", "paper_section"), slides=30, before="slides"),
    "hours_to_cov_10_default": Stage("default", ("slope", "section")),
    "hours_slides": Stage("published", ("paper", "paper_section"), slides=30),
}
"""In the order in which they run."""


class _Reached(Exception):
    """The phase before which a stage ends."""


def run(quick: bool) -> Report:
    """Run what is left of the stages; figures of those that have ended."""
    cores = len(cores_to_use())
    texts = {name: scene_text(stage.scene[quick], PLAN | {"slides": stage.slides}) for name, stage in STAGES.items()}
    folder = ROOT / "out" / "campaign" / code_digest(*texts.values(), *sources(run))
    result: dict[str, dict[str, Any]] = {}
    try:
        with stop_by_signals():
            for name, stage in STAGES.items():
                result[name] = measured(folder, name, stage, texts[name], workers=cores)
    except Stopped as stopped:
        print(stopped, file=sys.stderr)
    return report(result)


def scene_text(scene: str, plan: Mapping[str, Any]) -> str:
    """A scene of benchmarks/scenes with this plan."""
    tables = tomllib.loads((ROOT / "benchmarks" / "scenes" / f"{scene}.toml").read_text())
    return to_toml({**tables, "campaign": {**tables["campaign"], **plan}})


def measured(folder: Path, name: str, stage: Stage, text: str, *, workers: int) -> dict[str, Any]:
    """Figures of a stage, run or gone on with unless it has ended: hours of each part, over all lives, and what came
    out. Raises what `campaign.run` raises."""
    folder.mkdir(parents=True, exist_ok=True)
    book, store_folder = folder / f"{name}.json", folder / stage.campaign
    stored = _read(book)
    if "figures" in stored:
        return {**stored["figures"]}
    with counting(book, stored) as begins, suppress(_Reached):

        def on_phase(phase: str) -> None:
            if phase == stage.before:
                begins("rest")
                raise _Reached
            begins(PARTS[phase])

        campaign.run(text, store_folder, workers=workers, progress=sys.stderr.isatty(), on_phase=on_phase)
    done = _read(book)
    figures = {"stage": name, **_outcome(read_store(store_folder), done["seconds"], workers), **done}
    files.write_aside(book, json.dumps({**done, "figures": figures}).encode())
    return figures


@contextmanager
def counting(book: Path, stored: Mapping[str, Any], every: float = 1.0) -> Iterator[Callable[[str], None]]:
    """Add the wall seconds of each part to those that the file has, every so many seconds, so that a process killed at
    any moment loses no more than these. Gives what to call when another part begins; the first is "set-up"."""
    seconds: dict[str, float] = dict(stored["seconds"])
    part, since, turn, ended = "set-up", time.perf_counter(), threading.Lock(), threading.Event()

    def count(then: str | None = None) -> None:
        nonlocal part, since
        with turn:
            now = time.perf_counter()
            seconds[part] = seconds.get(part, 0.0) + now - since
            part, since = then or part, now
            files.write_aside(book, json.dumps({"seconds": seconds, "lives": stored["lives"] + 1}).encode())

    def watch() -> None:
        while not ended.wait(every):
            count()

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield count
    finally:
        ended.set()
        watcher.join()
        count()


def _read(book: Path) -> dict[str, Any]:
    """Seconds by part and lives so far, and the figures of a stage that has ended. ValueError for another file."""
    if not book.exists():
        return {"seconds": {}, "lives": 0}
    try:
        stored = json.loads(files.read_plain(book))
        if not all(float(value) >= 0 for value in stored["seconds"].values()) or int(stored["lives"]) < 1:
            raise ValueError("negative seconds, or no lives")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        why = f"{book} holds no seconds of a campaign ({error})"
        raise ValueError(f"{why}: delete {book.parent} to begin anew") from error
    return dict(stored)


def _outcome(store: Store, seconds: Mapping[str, float], workers: int) -> dict[str, Any]:
    """What the campaign in a folder has come to; `seconds` are those of the stage."""
    progress = progress_of(store.folder)
    if progress.estimate is None:
        raise ValueError(f"{store.folder} holds no result of a campaign that has ended: delete it to begin anew")
    rows = {grid: read_rows(store, grid) for grid in GRIDS}
    result, slid = progress.estimate, read_rows(store, SLIDES)
    return {
        "samples": len(rows["rough"].numbers),
        "refined_runs": result.refined_runs,
        "slides": len(slid.numbers),
        "failures_refined": sum(u > 1.0 for u, _ in rows["refined"].results.values()),
        "probability": result.probability,
        "interval": list(result.interval),
        "cov": float(result.cov),
        **{f"median_{grid}_s": float(np.median(rows[grid].columns["seconds"])) for grid in GRIDS},
        **{f"mean_{grid}_s": float(np.mean(rows[grid].columns["seconds"])) for grid in GRIDS},
        "hours": sum(seconds.values()) / 3600,
        "workers": workers,
    }


def report(result: Mapping[str, Mapping[str, Any]]) -> Report:
    """Named figures of the stages that have ended; null for the others, and where the samples were too few for 10 per
    cent."""
    met = {name: figures for name, figures in result.items() if figures["cov"] <= PLAN["target_cov"]}
    values: dict[str, Any] = {name: met[name]["hours"] if name in met else None for name in STAGES}
    published = result.get("hours_to_cov_10")
    values["refined_runs"] = None if published is None else published["refined_runs"]
    values["share_of_time"] = None if published is None else _shares(result)
    values |= expected_hours(result)
    return Report(values, [dict(figures) for figures in result.values()])


def expected_hours(result: Mapping[str, Mapping[str, Any]]) -> dict[str, float | None]:
    """Hours to the target by the seconds of these runs and the median number of refined runs; null for no result."""
    values: dict[str, float | None] = {}
    for end, runs in refined_runs_needed().items():
        done = result.get(f"hours_to_cov_10{end}")
        values[f"expected_hours_to_cov_10{end}"] = None
        if done is not None:
            of_runs = done["samples"] * done["mean_rough_s"] + runs * done["mean_refined_s"]
            values[f"expected_hours_to_cov_10{end}"] = (of_runs / done["workers"] + done["seconds"]["set-up"]) / 3600
    return values


def _shares(result: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """Of the published slope's campaign: what its slides took is theirs, coming back to the campaign included."""
    spent = dict.fromkeys(("set-up", *PARTS.values()), 0.0) | {**result["hours_to_cov_10"]["seconds"]}
    spent["slides"] += sum(result.get("hours_slides", {"seconds": {}})["seconds"].values())
    return {part: round(seconds / sum(spent.values()), 4) for part, seconds in spent.items()}
