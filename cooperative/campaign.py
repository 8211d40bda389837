"""The controller: screen every sample on the rough grid, run those refined that the estimator asks for, estimate.

Source: Jiang, Li, Ma and Rezania (2024), Computers and Geotechnics 172, 106413, Section 3.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import Executor
from contextlib import closing, nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from cooperative.estimate import Answers, Estimator, wilson_interval
from cooperative.runs import Workers, build, expansion_of, process_pool, run_samples, run_through, sampling_of
from cooperative.scene import Config, calibrated, measured, parse
from cooperative.store import Sample, Store, open_store, read_rows, write_aside, write_sample
from cooperative.summary import answer, estimate_of, next_runs, phases_of, refined_answers, screened, summarise


def run(
    text: str,
    folder: str | Path,
    *,
    workers: int = 1,
    executor: Callable[[], Executor] | None = None,
    progress: bool = False,
    estimator: Estimator | None = None,
) -> dict[str, Any]:
    """Run the campaign of a scene (TOML text) in its folder, or go on where it was; returns the summary.

    workers: 1 runs in this process, more in as many processes, each bound to its share of the cores. executor: makes
    another `concurrent.futures.Executor` (Dask's, for a cluster) that takes `workers` samples at a time. The answer
    depends on neither. estimator: a frozen dataclass with the methods of `cooperative.Estimator`, in place of one that
    the scene names. The folder remembers it in words: whoever goes on with it, reports it or asks for its progress
    has to give the same one.
    Raises ValueError for a scene or a folder that will not do, before anything is run or written.
    """
    config = parse(text, estimator)
    expansion, chosen = expansion_of(config), config.estimator
    models = {grid: build(config, grid, expansion) for grid in ("rough", "refined")}
    crew = None if executor is None and workers == 1 else Workers(executor or partial(process_pool, workers), workers)
    stop_at = {"rough": config.plan.screening_stop, "refined": None}
    width = {"rough": config.plan.lanes, "refined": config.plan.look_ahead}
    ahead = config.plan.look_ahead if crew is None else workers

    def samples(grid: str, numbers: Iterable[int], coefficients: np.ndarray) -> Iterator[Sample]:
        limit, restart_in = stop_at[grid], Path(folder).resolve() if grid == "refined" else None
        if crew is not None:
            return run_through(crew, config.text, grid, numbers, coefficients, stop_at=limit, restart_in=restart_in)
        return run_samples(models[grid], coefficients, numbers, width=width[grid], stop_at=limit, restart_in=restart_in)

    with open_store(folder, config.text) as store, closing(crew) if crew else nullcontext():
        if config.plan.calibrate and config.calibration is None:
            config = calibrated(config, measured(config, Path(folder)))
            models["rough"] = build(config, "rough", expansion)
        coefficients = _screen(config, store, samples, progress)
        rough = read_rows(store, "rough")
        first = screened(rough)
        answers = refined_answers(config, read_rows(store, "refined"))

        def wanted(under_way: Collection[int]) -> list[int]:
            return next_runs(config, phases_of(config, first, answers), ahead, under_way)

        def known() -> str:
            found = estimate_of(config, phases_of(config, first, answers))
            return "P_f {:.3f} ({:.3f} to {:.3f})".format(found.probability, *found.interval)

        with _bar("refined grid", chosen.budget(len(first)), len(answers), progress) as bar:
            while wanted(()):
                for sample in samples("refined", _in_rank_order(wanted, answers), coefficients):
                    write_sample(store, "refined", sample)
                    answers[sample.number] = answer(
                        config, float(sample.row["displacement"]), bool(sample.row["broke_off"])
                    )
                    _advance(bar, known)

        summary = summarise(config, rough, read_rows(store, "refined"))
        write_aside(Path(folder) / "summary.json", json.dumps(summary, indent=1).encode())
    return summary


def _screen(
    config: Config,
    store: Store,
    samples: Callable[[str, Iterable[int], np.ndarray], Iterator[Sample]],
    progress: bool,
) -> np.ndarray:
    """Run every sample of the first phase that is not there yet, and give the coefficients of all (n, modes)."""
    estimator, sampling, known = config.estimator, sampling_of(config), screened(read_rows(store, "rough"))

    def share() -> str:
        fails = sum(
            broke_off or displacement > config.run.failure_displacement for displacement, broke_off in known.values()
        )
        return "{:.3f} fail ({:.3f} to {:.3f})".format(fails / len(known), *wilson_interval(fails, len(known)))

    with _bar("rough grid", estimator.rough_runs(sampling), len(known), progress) as bar:
        while True:
            coefficients = estimator.coefficients(sampling, known)
            missing = [number for number in range(len(coefficients)) if number not in known]
            if not missing:
                return coefficients
            for sample in samples("rough", missing, coefficients):
                write_sample(store, "rough", sample)
                known[sample.number] = float(sample.row["displacement"]), bool(sample.row["broke_off"])
                _advance(bar, share)


def _bar(title: str, total: int | None, done: int, progress: bool) -> tqdm:
    """A bar that goes on from `done` samples and tells the time left."""
    return tqdm(
        desc=title, total=total, initial=done, disable=not progress, dynamic_ncols=True,
        bar_format="{desc} {n_fmt}/{total_fmt} |{bar:20}| {elapsed}, {remaining} left{postfix}",
    )  # fmt: skip


def _advance(bar: tqdm, known: Callable[[], str]) -> None:
    """One more sample: how many there are per hour, and what is known by now."""
    bar.update()
    if not bar.disable:
        hourly = 3600 * (bar.n - bar.initial) / max(bar.format_dict["elapsed"], 1e-9)
        bar.set_postfix_str(f"{hourly:.3g} per hour, {known()}")


def _in_rank_order(wanted: Callable[[Collection[int]], list[int]], answers: Answers) -> Iterator[int]:
    """Numbers of the samples to run refined, each asked for when there is a lane for it."""
    started: set[int] = set()
    while numbers := wanted(started - answers.keys()):
        started.add(numbers[0])
        yield numbers[0]
