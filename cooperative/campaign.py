"""The controller: screen every sample on the rough grid, run those refined that the estimator asks for, estimate.

Source: Jiang, Li, Ma and Rezania (2024), Computers and Geotechnics 172, 106413, Section 3.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import Executor
from contextlib import closing, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cooperative import runs
from cooperative.estimate import Estimator, Phases, Screened, Slides, wilson_interval
from cooperative.scene import (
    Campaign,
    allowing,
    at_limit_load,
    calibrated,
    keep_field_modes,
    measured,
    measured_limit_load,
    parse,
    with_defaults,
    with_kept_field_modes,
    write_budget,
)
from cooperative.store import GRIDS, SLIDES, Rows, Sample, Store, open_store, restart_path, write_aside, write_sample
from cooperative.summary import summarise


def run(
    text: str,
    folder: str | Path,
    *,
    workers: int = 1,
    executor: Callable[[], Executor] | None = None,
    refined_runs: int | None = None,
    progress: bool = False,
    estimator: Estimator | None = None,
    on_phase: Callable[[str], None] = lambda phase: None,
    verify: bool = False,
) -> dict[str, Any]:
    """Run the campaign of a scene (TOML text) in its folder, or go on where it was; returns the summary.

    workers: 1 runs in this process, more in as many processes, each bound to its share of the cores. executor: makes
    another `concurrent.futures.Executor` (Dask's, for a cluster) that takes `workers` samples at a time. The answer
    depends on neither. progress: show bars on a terminal; where there is none, lines on stderr and in the folder's
    progress.log. refined_runs: allow so many, which is more than the scene does; the folder keeps that.
    estimator: a frozen dataclass with the methods of `cooperative.Estimator`, in place of one that the scene names. The
    folder remembers it in words: whoever goes on with it, reports it or asks for its progress has to give the same one.
    on_phase: told that "screening", "audit", "slides" and "summary" begin; it may raise, and the campaign ends there.
    verify: read and verify every sample's file anew, those too that have not changed since they were verified.
    Ctrl-C and SIGTERM end it between two chunks of steps, with `runs.Stopped`; the same call goes on from there.
    Raises ValueError for a scene, a size or a folder that will not do, before anything is run or written.
    """
    folder = Path(folder)
    kept = folder / "scene.toml"
    campaign = parse(with_defaults(text, kept), estimator, begun=kept.exists())
    campaign = allowing(campaign, folder, refined_runs)
    counted = with_kept_field_modes(campaign, folder)
    if workers < 1:
        raise ValueError(f"workers = {workers}: give 1 or more")
    runs.check_size(counted, workers if executor is None else 1)
    with runs.heeding() as stop:
        with stop.at_once():
            models = _models(counted, folder)
        crew = None if executor is None and workers == 1 else runs.Workers(executor or partial(_pool, workers), workers)
        holding = closing(crew.opened()) if crew else nullcontext()
        with holding, open_store(folder, campaign.text, verify=verify) as store:
            with stop.at_once():
                if campaign.raised is not None:
                    write_budget(folder, campaign.raised)
                counted = keep_field_modes(campaign, folder, models["rough"].soil.counts)
                models = {grid: replace(model, campaign=counted) for grid, model in models.items()}
                ready = _calibrated(models, folder)
                for model in models.values():
                    runs.keep_initial(folder, model.grid, model.scene, model.state)
            with runs.bars(folder, progress) as bar:
                return _ran(_Hands(ready["rough"].campaign, ready, crew, stop, folder.resolve(), bar), store, on_phase)


def _models(campaign: Campaign, folder: Path) -> dict[str, runs.GridModel]:
    """Both grids of a campaign, at rest by what its folder keeps. Raises ValueError where slope, soil, field and grids
    do not fit."""
    soil = runs.random_soil(campaign)
    runs.check_coefficients(campaign, soil.modes)
    return {grid: runs.build(campaign, grid, soil, folder=folder) for grid in GRIDS}


def _calibrated(models: dict[str, runs.GridModel], folder: Path) -> dict[str, runs.GridModel]:
    """The same grids, with the failure displacement and the factors of safety in their scene where that asks for
    them."""
    models = _at_limit_load(models, folder)
    campaign = models["rough"].campaign
    if not campaign.plan.calibrate or campaign.calibration is not None:
        return models
    found = measured(campaign, folder, models)
    ready = {grid: replace(model, campaign=calibrated(campaign, found)) for grid, model in models.items()}
    return ready | {"rough": ready["rough"].weakened(found.factor)}


def _at_limit_load(models: dict[str, runs.GridModel], folder: Path) -> dict[str, runs.GridModel]:
    """The same grids, whose samples fail from the displacement that the limit load tells, where it is to."""
    campaign = models["refined"].campaign
    if campaign.run.failure != "limit load" or campaign.limit_load is not None:
        return models
    ready = at_limit_load(campaign, measured_limit_load(campaign, folder, models["refined"]))
    return {grid: replace(model, campaign=ready).looking() for grid, model in models.items()}


def _pool(workers: int) -> Executor:
    return runs.process_pool(workers)


@dataclass(frozen=True)
class _Hands:
    """What runs a campaign's samples: its grids' models in this process, or a crew of workers."""

    campaign: Campaign
    models: dict[str, runs.GridModel]
    crew: runs.Workers | None
    stop: runs.Stop
    folder: Path
    bar: runs.Bar

    @property
    def places(self) -> int:
        """Refined runs under way at once."""
        return self.campaign.plan.look_ahead if self.crew is None else self.crew.count

    def samples(
        self, grid: str, numbers: Iterable[int], coefficients: np.ndarray, *, slides: bool = False
    ) -> Iterator[Sample]:
        """Run these samples on one grid, or on from where they had failed to the end of their slides; yields each as it
        ends. Raises `Stopped` when asked to stop."""
        plan = self.campaign.plan
        limit = plan.screening_stop if grid == "rough" else None
        if grid == "refined" and plan.slides is not None and not slides:
            limit = self.campaign.run.failure_displacement
        restart_in = self.folder if grid == "refined" else None
        if self.crew is not None:
            return runs.run_through(
                self.crew, self.campaign.text, grid, numbers, coefficients, stop_at=limit, restart_in=restart_in,
                slides=slides, folder=self.folder, look=self.stop.look,
            )  # fmt: skip
        return runs.run_samples(
            self.models[grid], coefficients, numbers, width=plan.lanes if grid == "rough" else plan.look_ahead,
            stop_at=limit, restart_in=restart_in, stop=self.stop.asked, slides=slides,
        )  # fmt: skip


def _ran(hands: _Hands, store: Store, on_phase: Callable[[str], None]) -> dict[str, Any]:
    """Both phases, and the summary, which is written too."""
    campaign = hands.campaign
    rows = runs.rows_reader(campaign, store, hands.models, hands.stop.look)
    on_phase("screening")
    coefficients, screened = _screen(hands, store, rows)
    on_phase("audit")
    _refine(hands, store, rows, screened, coefficients)
    on_phase("slides")
    _slide_on(hands, store, rows, screened, coefficients)
    on_phase("summary")
    summary = summarise(campaign, rows("rough"), rows("refined"))
    write_aside(store.folder / "summary.json", json.dumps(summary, indent=1).encode())
    return summary


def _screen(hands: _Hands, store: Store, rows: Callable[[str], Rows]) -> tuple[np.ndarray, Phases]:
    """Run every sample of the first phase that is not there yet; the coefficients of all (n, modes), and that phase."""
    campaign, known = hands.campaign, rows("rough").results
    estimator, sampling = campaign.estimator, runs.sampling_of(campaign)

    def share() -> str:
        fails = sum(
            broke_off or displacement > campaign.run.failure_displacement for displacement, broke_off in known.values()
        )
        return "{:.3f} fail ({:.3f} to {:.3f})".format(fails / len(known), *wilson_interval(fails, len(known)))

    with hands.bar("rough grid", estimator.rough_runs(sampling), len(known)) as bar:
        while True:
            coefficients = estimator.coefficients(sampling, known)
            missing = [number for number in range(len(coefficients)) if number not in known]
            if not missing:
                return coefficients, Phases.known(estimator, sampling, known, {})
            for sample in hands.samples("rough", missing, coefficients):
                write_sample(store, "rough", sample)
                known[sample.number] = sample.result
                runs.advance(bar, share)
                hands.stop.look()


def _refine(
    hands: _Hands, store: Store, rows: Callable[[str], Rows], screened: Phases, coefficients: np.ndarray
) -> None:
    """Run refined what the estimator asks for, until it asks for nothing more."""
    known = rows("refined").results

    def wanted(under_way: Collection[int]) -> list[int]:
        return screened.refined(known).next_runs(hands.places, under_way)

    def estimate() -> str:
        found = screened.refined(known).estimate
        return "P_f {:.3f} ({:.3f} to {:.3f})".format(found.probability, *found.interval)

    with hands.bar("refined grid", hands.campaign.estimator.budget(len(coefficients)), len(known)) as bar:
        while wanted(()):
            for sample in hands.samples("refined", _in_rank_order(wanted, known), coefficients):
                write_sample(store, "refined", sample)
                known[sample.number] = sample.result
                _drop_restart_points(hands, store, screened.refined(known))
                runs.advance(bar, estimate)
                hands.stop.look()


def _drop_restart_points(hands: _Hands, store: Store, phases: Phases) -> None:
    """Failures that wait for the draw of slides keep no more restart points than twice the slides to be drawn: all are
    as likely to be drawn. One that is drawn without starts afresh."""
    count = hands.campaign.plan.slides
    if not count:
        return
    waiting = [n for n, fails in phases.answers.items() if fails and restart_path(store.folder, SLIDES, n).exists()]
    for number in sorted(waiting)[2 * count :]:
        restart_path(store.folder, SLIDES, number).unlink()


def _slide_on(
    hands: _Hands, store: Store, rows: Callable[[str], Rows], screened: Phases, coefficients: np.ndarray
) -> None:
    """Let as many failures slide on to their end as are asked for, as far as they have not yet. A sample that is drawn
    and has not run refined runs to its end; where it stands, the next is drawn."""
    plan = hands.campaign.plan
    if not plan.slides:
        return

    def known() -> tuple[list[int], Slides]:
        refined = rows("refined")
        phases = screened.refined(refined.results)
        return refined.numbers, Slides.of(phases, refined.numbers, refined.ended, plan.slides, plan.seed)

    numbers, so_far = known()
    with hands.bar("slides", so_far.planned, int(so_far.slid.sum())) as bar:
        while so_far.wanted:
            for sample in hands.samples("refined", so_far.wanted, coefficients, slides=True):
                write_sample(store, SLIDES if sample.number in numbers else "refined", sample)
                if screened.answer(*sample.result):
                    bar.update()
                hands.stop.look()
            numbers, so_far = known()
    for number in numbers:
        restart_path(store.folder, SLIDES, number).unlink(missing_ok=True)


def _in_rank_order(wanted: Callable[[Collection[int]], list[int]], known: Screened) -> Iterator[int]:
    """Numbers of the samples to run refined, each asked for when there is a lane for it."""
    started: set[int] = set()
    while numbers := wanted(started - known.keys()):
        started.add(numbers[0])
        yield numbers[0]
