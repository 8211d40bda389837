"""The controller: screen every sample on the rough grid, run those refined that the estimator asks for, estimate.

Source: Jiang, Li, Ma and Rezania (2024), Computers and Geotechnics 172, 106413, Section 3.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import Executor
from contextlib import closing, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from cooperative import runs
from cooperative.estimate import Estimator, Phases, Screened, Slides
from cooperative.folder import Results, write_results
from cooperative.scene import Campaign, Measured, in_folder, measure, write_budget, write_slides_end
from cooperative.store import (
    COARSE,
    MOVING,
    SLIDES,
    Rows,
    Sample,
    Source,
    Store,
    open_store,
    restart_path,
    write_sample,
)
from cooperative.summary import summary_of
from cooperative.values import Summary


def run(
    scene: Campaign | Source | str | Path,
    folder: str | Path,
    *,
    workers: int = 1,
    executor: Callable[[], Executor] | None = None,
    refined_runs: int | None = None,
    slides_t_end: float | None = None,
    progress: bool = False,
    estimator: Estimator | None = None,
    on_phase: Callable[[str], None] = lambda phase: None,
    verify: bool = False,
) -> Summary:
    """Run the campaign of a scene in its folder, or go on where it was.

    Ctrl-C and SIGTERM end it between two chunks of steps, with `runs.Stopped`; the same call goes on from there. The
    answer depends on neither `workers` nor `executor`.

    Args:
        scene: a campaign, or its scene in TOML as text or file.
        folder: of the campaign.
        workers: 1 runs in this process, more in as many processes, each bound to its share of the cores.
        executor: makes another `concurrent.futures.Executor` (Dask's, for a cluster) that takes `workers` samples at a
            time.
        refined_runs: allow so many, which is more than the scene does; the folder stores that.
        slides_t_end: let slides that had not come to rest go on until then (s), later than the scene does; the folder
            stores that. No run is repeated whose restart point is there.
        progress: show bars on a terminal; where there is none, lines on stderr and in the folder's progress.log.
        estimator: a frozen dataclass with the methods of `cooperative.Estimator`, in place of one that the scene names.
            The folder stores it in words: whoever goes on with it, reports it or reads its progress has to give the
            same one.
        on_phase: called as "screening", "audit", "slides" and "summary" begin; it may raise, and the campaign ends
            there.
        verify: read and verify every sample's file anew, those too that have not changed since they were verified, and
            solve for the stress at rest anew.

    Returns:
        The summary.

    Raises:
        ValueError: a scene, a size or a folder that will not do, before anything is run or written.
    """
    runs.refuse_within_import()
    runs.check_flags()
    folder = Path(folder)
    campaign, source = in_folder(scene, folder, estimator, refined_runs, slides_t_end)
    unmeasured, grids = replace(campaign, measured=Measured(campaign.measured.terms)), tuple(campaign.grids)
    if workers < 1:
        raise ValueError(f"workers = {workers}: give 1 or more")
    runs.packed(campaign)  # nothing is written for one that cannot be sent
    runs.check_size(campaign, workers if executor is None else 1)
    with runs.stop_by_signals() as stop:
        alone, own = executor is None and workers == 1, 0 if executor else workers
        pool = None if alone else runs.Workers(executor or partial(runs.process_pool, workers), workers, own)
        with closing(pool) if pool else nullcontext():
            with stop.at_once():
                if pool:
                    pool.prepare(runs.packed(unmeasured), folder.resolve())
                models = _models(unmeasured, grids, folder)
                for model in models.values() if verify else ():
                    runs.verify_initial(folder, model)
            with (
                open_store(folder, source, verify=verify, grids=grids) as store,
                runs.bars(folder, progress) as bar,
            ):
                with stop.at_once():
                    for model in models.values():
                        runs.keep_initial(folder, model.grid, model.scene, model.state)
                    if campaign.raised is not None:
                        write_budget(folder, campaign.raised)
                    if slides_t_end is not None:
                        write_slides_end(folder, slides_t_end)
                    campaign = measure(campaign, folder, models["rough"].soil.counts, models)
                    models = {grid: model.with_measured(campaign) for grid, model in models.items()}
                    runs.keep_ground(folder, models)
                return _ran(_Runs(campaign, models, pool, stop, folder.resolve(), bar), store, on_phase)


def _models(campaign: Campaign, grids: tuple[str, ...], folder: Path) -> dict[str, runs.GridModel]:
    """The grids of a campaign, at rest by what its folder keeps.

    Raises ValueError where slope, soil, field and grids do not fit.
    """
    soil = runs.random_soil(campaign)
    runs.check_coefficients(campaign, soil.modes)
    return {grid: runs.build(campaign, grid, soil, folder=folder) for grid in grids}


@dataclass(frozen=True)
class _Runs:
    """Runs a campaign's samples: on its grids' models in this process, or by workers."""

    campaign: Campaign
    models: dict[str, runs.GridModel]
    workers: runs.Workers | None
    stop: runs.Stop
    folder: Path
    bar: runs.Bar

    @cached_property
    def packed(self) -> runs.Packed:
        """The campaign for its workers."""
        return runs.packed(self.campaign)

    @property
    def at_once(self) -> int:
        """Refined runs under way at once."""
        return self.campaign.plan.look_ahead if self.workers is None else self.workers.count

    def samples(
        self, grid: str, numbers: Iterable[int], coefficients: np.ndarray, *, slides: bool = False
    ) -> Iterator[Sample]:
        """Run these samples on one grid, or on from where they had failed to the end of their slides.

        Yields each as it ends. Raises `Stopped` when asked to stop.
        """
        plan = self.campaign.plan
        limit = plan.screening_stop if grid == "rough" else None
        # A coarse run gives a rank alone, a refined one its class unless it slides.
        if grid == COARSE or (grid == "refined" and plan.slides is not None and not slides):
            limit = self.campaign.run.failure_displacement
        if self.workers is not None:
            return runs.run_through(
                self.workers, self.packed, grid, numbers, coefficients, stop_at=limit, slides=slides,
                folder=self.folder, look=self.stop.look,
            )  # fmt: skip
        return runs.run_samples(
            self.models[grid], coefficients, numbers, width=plan.look_ahead if grid == "refined" else plan.lanes,
            stop_at=limit, restart_in=self.folder if grid == "refined" else None, stop=self.stop.asked, slides=slides,
        )  # fmt: skip


def _ran(runner: _Runs, store: Store, on_phase: Callable[[str], None]) -> Summary:
    """Both phases, and the summary, which is written too."""
    campaign = runner.campaign
    ground = runs.ground_of(runner.models)
    rows = runs.rows_reader(store, ground.samples, ground, runner.stop.look)
    on_phase("screening")
    coefficients, screened = _screen(runner, store, rows)
    on_phase("audit")
    _refine(runner, store, rows, screened, coefficients)
    on_phase("slides")
    _slide_on(runner, store, rows, screened, coefficients)
    on_phase("summary")
    rough, refined = rows("rough"), rows("refined")
    summary = summary_of(campaign, screened.refined(refined.results), rough, refined)
    write_results(Results(store, ground, rough, refined, summary), runner.models)
    return summary


def _screen(runner: _Runs, store: Store, rows: Callable[[str], Rows]) -> tuple[np.ndarray, Phases]:
    """Run every sample of the first phase that is not there yet; the coefficients of all (n, modes), and that phase."""
    campaign, known = runner.campaign, rows("rough").results
    zones = None if campaign.coarse is None else runs.draw_by(campaign, _on_coarse_grid(runner, store, rows))
    estimator, sampling = campaign.estimator, runs.sampling_of(campaign, zones)
    planned = estimator.rough_runs(sampling)

    def share() -> str:
        now = Phases(estimator, sampling.failure_displacement, known, planned=planned, zones=zones).estimate
        return f"{now.probability:.3g} fail on the rough grid"

    with runner.bar("rough grid", planned, len(known)) as bar:
        while True:
            coefficients = estimator.coefficients(sampling, known)
            asked = range(len(coefficients)) if zones is None else sorted(zones)
            missing = [number for number in asked if number not in known]
            if not missing:
                return coefficients, Phases.known(estimator, sampling, known, {})
            for sample in runner.samples("rough", missing, coefficients):
                if zones is not None:
                    sample = replace(sample, row={**sample.row, **runs.row_of(zones[sample.number])})
                write_sample(store, "rough", sample)
                known[sample.number] = sample.result
                runs.advance(bar, share)
                runner.stop.look()


def _on_coarse_grid(runner: _Runs, store: Store, rows: Callable[[str], Rows]) -> Screened:
    """Run every sample on the coarse grid that has not run there yet; the results of all."""
    campaign, known = runner.campaign, rows(COARSE).results
    samples, coefficients = campaign.plan.samples, runs.sampling_of(campaign).draw()
    with runner.bar("coarse grid", samples, len(known)) as bar:
        missing = [number for number in range(samples) if number not in known]
        for sample in runner.samples(COARSE, missing, coefficients):
            write_sample(store, COARSE, sample)
            known[sample.number] = sample.result
            bar.update()
            runner.stop.look()
    return known


def _refine(
    runner: _Runs, store: Store, rows: Callable[[str], Rows], screened: Phases, coefficients: np.ndarray
) -> None:
    """Run refined what the estimator asks for, until it asks for nothing more."""
    known = rows("refined").results

    def wanted(under_way: Collection[int]) -> list[int]:
        return screened.refined(known).next_runs(runner.at_once, under_way)

    def estimate() -> str:
        now = screened.refined(known).estimate
        return "P_f {:.3g} ({:.3g} to {:.3g})".format(now.probability, *now.interval)

    with runner.bar("refined grid", runner.campaign.estimator.budget(screened.planned), len(known)) as bar:
        while wanted(()):
            for sample in runner.samples("refined", _in_rank_order(wanted, known), coefficients):
                write_sample(store, "refined", sample)
                known[sample.number] = sample.result
                _drop_restart_points(runner, store, screened.refined(known))
                runs.advance(bar, estimate)
                runner.stop.look()


def _drop_restart_points(runner: _Runs, store: Store, phases: Phases) -> None:
    """Keep no more restart points of failures that wait for the draw than twice the slides to be drawn.

    All are as likely to be drawn. One that is drawn without starts afresh.
    """
    count = runner.campaign.plan.slides
    if not count:
        return
    waiting = [n for n, fails in phases.answers.items() if fails and restart_path(store.folder, SLIDES, n).exists()]
    for number in sorted(waiting)[2 * count :]:
        restart_path(store.folder, SLIDES, number).unlink()


def _slide_on(
    runner: _Runs, store: Store, rows: Callable[[str], Rows], screened: Phases, coefficients: np.ndarray
) -> None:
    """Let as many failures slide on to their end as are asked for, as far as they have not yet.

    A sample that is drawn and has not run refined runs to its end; where it stands, the next is drawn.
    """
    plan = runner.campaign.plan
    if plan.slides == 0:
        return

    def known() -> tuple[list[int], Slides]:
        refined = rows("refined")
        phases = screened.refined(refined.results)
        return refined.numbers, Slides.of(phases, refined.numbers, refined.ended, plan.slides, plan.seed)

    numbers, so_far = known()
    # Without a number of slides all failures of the audit have slid to their end.
    if plan.slides:
        with runner.bar("slides", so_far.planned, int(so_far.slid.sum())) as bar:
            while so_far.wanted:
                for sample in runner.samples("refined", so_far.wanted, coefficients, slides=True):
                    write_sample(store, SLIDES if sample.number in numbers else "refined", sample)
                    if screened.answer(*sample.result):
                        bar.update()
                    runner.stop.look()
                numbers, so_far = known()
    _slide_longer(runner, store, rows, so_far, coefficients)
    for number in numbers:
        restart_path(store.folder, SLIDES, number).unlink(missing_ok=True)


def _slide_longer(
    runner: _Runs, store: Store, rows: Callable[[str], Rows], slides: Slides, coefficients: np.ndarray
) -> None:
    """Let slides go on that had not come to rest at an earlier end than slides have now."""
    refined, last = rows("refined"), runner.campaign.run.last("refined")
    early = refined.columns.get("time", np.full(len(refined.numbers), np.inf)) < last * (1 - 1e-6)
    moving = np.flatnonzero(slides.slid & early & (refined.columns["status"] == "FINISHED"))
    if not moving.size:
        return
    with runner.bar("slides that had not come to rest", moving.size, 0) as bar:
        for sample in runner.samples("refined", [refined.numbers[at] for at in moving], coefficients, slides=True):
            write_sample(store, SLIDES, sample, longer=True)
            if sample.status != "FINISHED":
                restart_path(store.folder, MOVING, sample.number).unlink(missing_ok=True)
            bar.update()
            runner.stop.look()


def _in_rank_order(wanted: Callable[[Collection[int]], list[int]], known: Screened) -> Iterator[int]:
    """Numbers of the samples to run refined, each asked for when there is a lane for it."""
    started: set[int] = set()
    while numbers := wanted(started - known.keys()):
        started.add(numbers[0])
        yield numbers[0]
