"""The controller: draw samples, screen them, refine those that the estimator asks for, let slides go on, summarise.

Each step is a function from the findings of a campaign to its next findings. A step runs samples through a `Runner` and
writes each sample as it ends, so that a campaign that is stopped goes on from there.

Source: Jiang, Li, Ma and Rezania (2024), Computers and Geotechnics 172, 106413, Section 3.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import TypeAlias

import numpy as np

from cooperative import runs
from cooperative.estimate import Estimator, Phases, Sampling, Screened, Slides, Zone
from cooperative.folder import Results, write_results
from cooperative.scene import Campaign, LongerSlides, Measured, check_samples, in_folder, keep, measure
from cooperative.store import (
    COARSE,
    IN_TIME,
    MOVING,
    SCORES,
    SLIDES,
    FinishedRun,
    Rows,
    Source,
    Store,
    open_store,
    read_sample,
    restart_path,
    store_text,
    stored_text,
    write_sample,
)
from cooperative.summary import Summary, slides_of
from cooperative.summary import summarise as summary_of

Ranks: TypeAlias = Mapping[str, Callable[[Campaign, np.ndarray], np.ndarray]]
"""Functions that rank samples, by name."""
NO_RANKS: Ranks = MappingProxyType({})


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
    ranks: Ranks = NO_RANKS,
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
        verify: read every file of fields and compare it with its checksum, and solve for the stress at rest anew.
        ranks: functions that rank samples, by the names that `coarse` of a scene may have for them:
            `cooperative.tools.safety.RANKS`. `jaxmpm run` gives these.

    Returns:
        The summary.

    Raises:
        ValueError: a scene, a size or a folder that will not do, before anything is run or written.
    """
    runs.refuse_unguarded(workers if executor is None else 1)
    runs.check_flags()
    folder = Path(folder)
    _refuse_in_time(folder)
    campaign, source = in_folder(scene, folder, estimator, refined_runs, slides_t_end)
    pool = _workers(workers, executor)
    _check(campaign, workers if executor is None else 1, ranks)
    with _opened(campaign, source, folder, pool, slides_t_end, progress=progress, verify=verify) as runner:
        on_phase("screening")
        findings = draw(runner, ranks)
        findings = screen(runner, findings)
        on_phase("audit")
        findings = refine(runner, findings)
        on_phase("slides")
        findings = slide(runner, findings)
        on_phase("summary")
        return summarise(runner, findings)


@dataclass(frozen=True)
class Findings:
    """What a campaign has found.

    Args:
        sampling: first phase as the estimator sees it.
        coefficients: of its samples (n, terms), as many as the rough results determine.
        phases: results of both grids.
    """

    sampling: Sampling
    coefficients: np.ndarray
    phases: Phases

    def refined(self, results: Screened) -> Findings:
        """The same first phase with these results of the refined grid, and no others."""
        return replace(self, phases=self.phases.refined(results))


@dataclass(frozen=True)
class Runner:
    """Runs a campaign's samples: on its grids' models in this process, or by workers.

    Args:
        campaign: as measured.
        models: by grid.
        store: the campaign's folder, open for writing.
        workers: that run the samples, None for this process.
        stop: what signals ask for.
        bar: shows progress.
    """

    campaign: Campaign
    models: dict[str, runs.GridModel]
    store: Store
    workers: runs.Workers | None
    stop: runs.Stop
    bar: runs.Bar

    @cached_property
    def packed(self) -> runs.Packed:
        """The campaign for its workers."""
        return runs.packed(self.campaign)

    @cached_property
    def ground(self) -> runs.StoredGround:
        """The ground of the grids."""
        return runs.ground_of(self.models)

    @property
    def at_once(self) -> int:
        """Refined runs under way at once."""
        return self.models["refined"].lanes if self.workers is None else self.workers.count

    def rows(self, grid: str) -> Rows:
        """Rows of a grid in the folder."""
        return runs.rows_reader(self.store, self.ground.samples, self.ground, self.stop.check)(grid)

    def samples(
        self, grid: str, numbers: Iterable[int], coefficients: np.ndarray, *, slides: bool = False
    ) -> Iterator[FinishedRun]:
        """Run these samples on one grid, or on from where they had failed to the end of their slides.

        Yields each sample as it ends. Raises `Stopped` when asked to stop.
        """
        folder = self.store.folder.resolve()
        rules = self.campaign.rules(self.campaign.decided_at(grid, slides=slides))
        if self.workers is not None:
            ended = runs.run_through(
                self.workers, self.packed, grid, numbers, coefficients, rules=rules, slides=slides,
                folder=folder, check=self.stop.check,
            )  # fmt: skip
        else:
            ended = runs.run_samples(
                self.models[grid], coefficients, numbers, rules=rules,
                restart_in=folder if grid == "refined" else None, stop=self.stop.requested, slides=slides,
            )  # fmt: skip
        for sample in ended:
            yield sample
            self.stop.check()


def _refuse_in_time(folder: Path) -> None:
    """ValueError for the folder of samples that are asked in time."""
    if stored_text(folder, IN_TIME) is not None:
        raise ValueError(
            f"folder {folder} has samples that are asked in time: `jaxmpm resume {folder}` goes on with them; give "
            "another folder to a campaign"
        )


def _workers(count: int, executor: Callable[[], Executor] | None) -> runs.Workers | None:
    """What runs so many samples at a time, None for this process; ValueError for none at a time."""
    if count < 1:
        raise ValueError(f"workers = {count}: give 1 or more")
    if executor is None and count == 1:
        return None
    return runs.Workers(executor or partial(runs.process_pool, count), count, ahead=0 if executor else count)


def _check(campaign: Campaign, processes: int, ranks: Ranks) -> None:
    """ValueError for a campaign that cannot be sent, is too large for so many processes or lacks what ranks it."""
    runs.packed(campaign)
    check_samples(campaign)
    runs.check_size(campaign, processes)
    if isinstance(campaign.rank, str) and campaign.rank not in ranks:
        remedy = "give run(..., ranks=cooperative.tools.safety.RANKS), as jaxmpm run does"
        raise ValueError(f"coarse = {campaign.rank!r} is a name, for which there is no function: {remedy}")


@contextmanager
def _opened(
    campaign: Campaign, source: Source, folder: Path, pool: runs.Workers | None, slides_t_end: float | None, *,
    progress: bool, verify: bool,
) -> Iterator[Runner]:  # fmt: skip
    """A campaign ready to run: its grids at rest, its folder open and locked, what is measured before the first run.

    Raises ValueError where slope, soil, field and grids do not fit.
    """
    unmeasured, grids = replace(campaign, measured=Measured(campaign.measured.terms)), tuple(campaign.grids)
    with runs.stop_by_signals() as stop, closing(pool) if pool else nullcontext():
        with stop.at_once():
            if pool:
                pool.prepare(runs.packed(unmeasured), folder.resolve())
            soil = runs.random_soil(unmeasured)
            runs.check_coefficients(unmeasured, soil.modes)
            models = {grid: runs.build(unmeasured, grid, soil, folder=folder) for grid in grids}
            for model in models.values() if verify else ():
                runs.verify_initial(folder, model)
        with open_store(folder, source, verify=verify, check=stop.check) as store, runs.bars(folder, progress) as bar:
            with stop.at_once():
                for model in models.values():
                    runs.keep_initial(folder, model.grid, model.scene, model.state)
                if campaign.raised is not None:
                    keep(store, campaign.raised)
                if slides_t_end is not None:
                    keep(store, LongerSlides(slides_t_end))
                campaign = measure(campaign, store, models["rough"].soil.counts, models)
                models = {grid: model.with_measured(campaign) for grid, model in models.items()}
                runs.keep_ground(folder, models)
            yield Runner(campaign, models, store, pool, stop, bar)


def draw(runner: Runner, ranks: Ranks = NO_RANKS) -> Findings:
    """Draw the first samples of the rough grid; where there is a coarse grid, all run there first, or are ranked.

    Args:
        runner: of the campaign.
        ranks: functions that rank, by name, as of `run`.
    """
    campaign, rough = runner.campaign, runner.rows("rough").results
    sampling = runs.sampling_of(campaign, _zones(runner, ranks))
    phases = Phases.of(campaign.estimator, sampling, rough, {})
    return Findings(sampling, campaign.estimator.coefficients(sampling, rough), phases)


def _zones(runner: Runner, ranks: Ranks) -> dict[int, Zone] | None:
    """What each sample of the rough grid stands for, by number, as the coarse phase draws them; None without one."""
    campaign = runner.campaign
    if campaign.coarse is None:
        return None
    if campaign.rank is not None:
        return runs.draw_by(campaign, runs.screened_by(_scores(runner, ranks)))
    results = runner.rows(COARSE).results
    samples, coefficients = campaign.plan.samples, runs.sampling_of(campaign).draw()
    with runner.bar("coarse grid", samples, len(results)) as bar:
        missing = [number for number in range(samples) if number not in results]
        for sample in runner.samples(COARSE, missing, coefficients):
            write_sample(runner.store, COARSE, sample)
            results[sample.number] = sample.result
            bar.update()
    return runs.draw_by(campaign, results)


def _scores(runner: Runner, ranks: Ranks) -> np.ndarray:
    """The scores of all samples, which the folder keeps: a campaign that goes on has the same ones."""
    campaign, store = runner.campaign, runner.store
    kept = stored_text(store.folder, SCORES)
    if kept is None:
        with runner.stop.at_once():
            scores = runs.scores_of(campaign, runs.sampling_of(campaign).draw(), ranks)
        kept = json.dumps([None if np.isnan(score) else score for score in scores.tolist()])
        store_text(store, SCORES, kept)
    return np.array(json.loads(kept), float)


def screen(runner: Runner, findings: Findings) -> Findings:
    """Run every sample of the first phase on the rough grid; the results may determine further ones.

    Args:
        runner: of the campaign.
        findings: by `draw`.
    """
    estimator, sampling, zones = runner.campaign.estimator, findings.sampling, findings.sampling.zones
    results, coefficients = dict(findings.phases.rough), findings.coefficients

    def share() -> str:
        now = replace(findings.phases, rough=results, population=None).estimate
        return f"{now.probability:.3g} fail on the rough grid"

    def missing() -> list[int]:
        return [n for n in (range(len(coefficients)) if zones is None else sorted(zones)) if n not in results]

    with runner.bar("rough grid", findings.phases.planned, len(results)) as bar:
        while numbers := missing():
            for sample in runner.samples("rough", numbers, coefficients):
                row = {} if zones is None else runs.zone_row(zones[sample.number])
                write_sample(runner.store, "rough", replace(sample, row={**sample.row, **row}))
                results[sample.number] = sample.result
                runs.advance(bar, share)
            coefficients = estimator.coefficients(sampling, results)
    return Findings(sampling, coefficients, Phases.of(estimator, sampling, results, {}))


def refine(runner: Runner, findings: Findings) -> Findings:
    """Run refined what the estimator asks for, until it asks for nothing more.

    Args:
        runner: of the campaign.
        findings: by `screen`.
    """
    results = runner.rows("refined").results

    def next_runs(under_way: Collection[int]) -> list[int]:
        return findings.phases.refined(results).next_runs(runner.at_once, under_way)

    def in_rank_order() -> Iterator[int]:
        # The runner takes a number when it has a lane for it.
        started: set[int] = set()
        while numbers := next_runs(started - results.keys()):
            started.add(numbers[0])
            yield numbers[0]

    def estimate() -> str:
        now = findings.phases.refined(results).estimate
        return "P_f {:.3g} ({:.3g} to {:.3g})".format(now.probability, *now.interval)

    budget = runner.campaign.estimator.budget(findings.phases.planned)
    with runner.bar("refined grid", budget, len(results)) as bar:
        while next_runs(()):
            for sample in runner.samples("refined", in_rank_order(), findings.coefficients):
                write_sample(runner.store, "refined", sample)
                results[sample.number] = sample.result
                _drop_restart_points(runner, findings.phases.refined(results))
                runs.advance(bar, estimate)
    return findings.refined(results)


def _drop_restart_points(runner: Runner, phases: Phases) -> None:
    """Keep no more restart points of failures that wait for the draw than twice the slides to be drawn.

    All are as likely to be drawn. One that is drawn without starts afresh.
    """
    count, folder = runner.campaign.plan.slides, runner.store.folder
    if not count:
        return
    waiting = [n for n, fails in phases.answers.items() if fails and restart_path(folder, SLIDES, n).exists()]
    for number in sorted(waiting)[2 * count :]:
        restart_path(folder, SLIDES, number).unlink()


def slide(runner: Runner, findings: Findings) -> Findings:
    """Let as many failures slide on to their end as the scene asks for, as far as they have not yet.

    A sample that is drawn and has not run refined runs to its end; where it stands, the next is drawn.

    Args:
        runner: of the campaign.
        findings: by `refine`.
    """
    campaign = runner.campaign
    if campaign.plan.slides == 0:
        return findings

    def slid() -> tuple[Findings, Rows, Slides]:
        rows = runner.rows("refined")
        now = findings.refined(rows.results)
        return now, rows, slides_of(campaign, now.phases, rows)

    findings, refined, slides = slid()
    # Without a number of slides all failures of the audit have slid to their end.
    if campaign.plan.slides:
        with runner.bar("slides", slides.planned, int(slides.slid.sum())) as bar:
            while slides.missing:
                for sample in runner.samples("refined", slides.missing, findings.coefficients, slides=True):
                    write_sample(runner.store, SLIDES if sample.number in refined.numbers else "refined", sample)
                    if findings.phases.answer(*sample.result):
                        bar.update()
                findings, refined, slides = slid()
    _slide_longer(runner, findings, refined, slides)
    for number in refined.numbers:
        restart_path(runner.store.folder, SLIDES, number).unlink(missing_ok=True)
    return findings


def _slide_longer(runner: Runner, findings: Findings, refined: Rows, slides: Slides) -> None:
    """Let slides go on that had not come to rest at an earlier end than slides have now.

    One that breaks off while it goes on keeps its row up to the earlier end.
    """
    last = runner.campaign.run.last("refined")
    early = refined.columns.get("time", np.full(len(refined.numbers), np.inf)) < last * (1 - 1e-6)
    moving = np.flatnonzero(slides.slid & early & (refined.columns["status"] == "FINISHED"))
    if not moving.size:
        return
    numbers = [refined.numbers[at] for at in moving]
    with runner.bar("slides that had not come to rest", moving.size, 0) as bar:
        for sample in runner.samples("refined", numbers, findings.coefficients, slides=True):
            if sample.row["broke_off"]:
                # What the slide did up to its earlier end is known, and how it ended.
                earlier = read_sample(runner.store, "refined", sample.number)
                sample = replace(earlier, status=sample.status, seconds=sample.seconds)
            write_sample(runner.store, SLIDES, sample, longer=True)
            if sample.status != "FINISHED":
                restart_path(runner.store.folder, MOVING, sample.number).unlink(missing_ok=True)
            bar.update()


def summarise(runner: Runner, findings: Findings) -> Summary:
    """The campaign in numbers, which the folder keeps.

    Args:
        runner: of the campaign.
        findings: by `slide`.
    """
    rough, refined = runner.rows("rough"), runner.rows("refined")
    summary = summary_of(runner.campaign, rough, refined, findings.refined(refined.results).phases)
    write_results(Results(runner.store, runner.ground, rough, refined, summary), runner.models)
    return summary
