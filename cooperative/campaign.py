"""The controller: screen every sample on the rough grid, rank, run the worst refined, estimate.

Source: Jiang, Li, Ma and Rezania (2024), Computers and Geotechnics 172, 106413, Section 3.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import closing, nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from cooperative import screening
from cooperative.audit import AuditPlan
from cooperative.config import Config, Plan, parse
from cooperative.estimators import Estimate, published
from cooperative.executors import Workers, process_pool, run_through
from cooperative.ranking import next_refined, rank_samples, stopping_rank
from cooperative.store import Rows, Sample, Store, open_store, read_rows, write_aside, write_sample
from cooperative.twophase import Population, next_audit, two_phase

NOT_BROKEN = ("FINISHED", "SETTLED", "DECIDED")


def run(
    text: str,
    folder: str | Path,
    *,
    workers: int = 1,
    executor: Callable[[], Executor] | None = None,
    progress: bool = False,
) -> dict[str, Any]:
    """Run the campaign of a scene (TOML text) in its folder, or go on where it was; returns the summary.

    workers: 1 runs in this process, more in as many processes, each bound to its share of the cores. executor: makes
    another `concurrent.futures.Executor` (Dask's, for a cluster) that takes `workers` samples at a time. The answer
    depends on neither.
    Raises ValueError for a scene or a folder that will not do, before anything is run or written.
    """
    config = parse(text)
    expansion = screening.expansion_of(config)
    coefficients = screening.coefficients_of(config, expansion)
    models = {grid: screening.build(config, grid, expansion) for grid in ("rough", "refined")}
    crew = None if executor is None and workers == 1 else Workers(executor or partial(process_pool, workers), workers)
    stop_at = {"rough": config.plan.screening_stop, "refined": None}
    width = {"rough": config.plan.lanes, "refined": config.plan.look_ahead}
    ahead = config.plan.look_ahead if crew is None else workers

    def samples(grid: str, numbers: Iterable[int]) -> Iterator[Sample]:
        limit, restart_in = stop_at[grid], Path(folder) if grid == "refined" else None
        if crew is not None:
            return run_through(crew, text, grid, numbers, stop_at=limit, restart_in=restart_in)
        return screening.run_samples(
            models[grid], coefficients, numbers, width=width[grid], stop_at=limit, restart_in=restart_in
        )

    with open_store(folder, text) as store, closing(crew) if crew else nullcontext():
        missing = sorted(set(range(config.plan.samples)) - set(read_rows(store, "rough").numbers))
        for _ in _keep(store, "rough", samples("rough", missing), "screening, rough grid", len(missing), progress):
            pass

        displacement, broke_off = (read_rows(store, "rough").columns[name] for name in ("displacement", "broke_off"))
        answers = refined_answers(config, read_rows(store, "refined"))

        def wanted(under_way: Collection[int]) -> list[int]:
            if config.plan.estimator == "published":
                return next_refined(
                    displacement, answers, config.plan.k_t, ahead, failed_lanes=broke_off, under_way=under_way
                )
            asked = next_audit(Population(displacement, broke_off), answers, audit_plan(config.plan))
            return [number for number in asked if number not in under_way]

        while wanted(()):
            ranked = samples("refined", _in_rank_order(wanted, answers))
            for sample in _keep(store, "refined", ranked, "ranked runs, refined grid", None, progress):
                answers[sample.number] = answer(
                    config, float(sample.row["displacement"]), bool(sample.row["broke_off"])
                )

        summary = summarise(config, read_rows(store, "rough"), read_rows(store, "refined"))
        write_aside(Path(folder) / "summary.json", json.dumps(summary, indent=1).encode())
    return summary


def _keep(
    store: Store, grid: str, samples: Iterable[Sample], title: str, total: int | None, progress: bool
) -> Iterator[Sample]:
    """Write every sample as it comes, and pass it on."""
    with tqdm(samples, desc=title, total=total, unit="run", disable=not progress) as bar:
        for sample in bar:
            write_sample(store, grid, sample)
            bar.set_postfix_str(f"sample {sample.number}: {sample.row['displacement']:.3g} m")
            yield sample


def _in_rank_order(wanted: Callable[[Collection[int]], list[int]], answers: Mapping[int, bool | None]) -> Iterator[int]:
    """Numbers of the samples to run refined, each asked for when there is a lane for it."""
    started: set[int] = set()
    while numbers := wanted(started - answers.keys()):
        started.add(numbers[0])
        yield numbers[0]


def refined_answers(config: Config, refined: Rows) -> dict[int, bool | None]:
    """Sample -> whether it failed on the refined grid; None where the run broke off before it could tell."""
    columns = refined.columns
    displacement, broke_off = columns.get("displacement", ()), columns.get("broke_off", ())
    return {n: answer(config, u, b) for n, u, b in zip(refined.numbers, displacement, broke_off, strict=True)}


def answer(config: Config, displacement: float, broke_off: float | bool) -> bool | None:
    """Whether a run says that its sample fails; a run that broke off can say yes, but not no."""
    fails = bool(displacement > config.run.failure_displacement)
    return fails if fails or not broke_off else None


def audit_plan(plan: Plan) -> AuditPlan:
    """How the two-phase estimator spends its refined runs; without a ranked prefix, which costs more than it tells."""
    runs = min(plan.refined_runs or max(20, plan.samples // 5), plan.samples)
    return AuditPlan(runs, seed=plan.seed, target_cov=plan.target_cov)


def estimates(config: Config, rough: Rows, refined: Rows) -> list[Estimate]:
    """Probability of failure from what is known: by the estimator asked for, and n/N where its rule is met."""
    displacement, broke_off = rough.columns["displacement"], rough.columns["broke_off"].astype(bool)
    answers = refined_answers(config, refined)
    by_rule = published(displacement, answers, config.plan.k_t, failed_lanes=broke_off)
    if config.plan.estimator == "published":
        return [by_rule]
    found = two_phase(Population(displacement, broke_off), answers, audit_plan(config.plan))
    met = stopping_rank(rank_samples(displacement, broke_off).order, answers, config.plan.k_t) is not None
    return [found, by_rule] if met else [found]


def summarise(config: Config, rough: Rows, refined: Rows) -> dict[str, Any]:
    """The campaign in numbers, ready for JSON: probability, counts, consequences, time, and what to beware of."""
    found, *others = estimates(config, rough, refined)
    answers = refined_answers(config, refined)
    failed = np.asarray([answers[number] is True for number in refined.numbers], bool)
    limit = config.run.failure_displacement
    measures = {
        name: _spread(refined.columns[name][failed])
        for name in ("displacement", "depth", "runout", "volume", "area")
        if failed.any()
    }
    return {
        "name": config.name,
        "probability_of_failure": found.probability,
        "interval": list(found.interval),
        "level": found.level,
        "estimator": found.method,
        "coefficient_of_variation": found.cov if np.isfinite(found.cov) else None,
        "other_estimates": {e.method: {"probability": e.probability, "interval": list(e.interval)} for e in others},
        "samples": len(rough.numbers),
        "failures_rough": int(np.sum(rough.columns["displacement"] > limit)),
        "refined_runs": len(refined.numbers),
        "failures_refined": int(failed.sum()),
        "status": {"rough": _counts(rough), "refined": _counts(refined)},
        "broke_off": {grid: _broken(rows) for grid, rows in (("rough", rough), ("refined", refined))},
        "consequences_of_failures": measures,
        "seconds": {
            grid: float(np.sum(rows.columns["seconds"])) for grid, rows in (("rough", rough), ("refined", refined))
        },
        "notes": [*found.notes, *_warnings(config, refined, failed)],
    }


def _warnings(config: Config, refined: Rows, failed: np.ndarray) -> list[str]:
    if not failed.any():
        return []
    reach = config.slope.toe - config.grids["refined"].cell
    stopped = int(np.sum(refined.columns["runout"][failed] >= reach))
    if not stopped:
        return []
    return [
        f"run-out reached the wall {config.slope.toe:g} m beyond the toe, which held it, in {stopped} refined runs: "
        "lengthen [slope] toe"
    ]


def _counts(rows: Rows) -> dict[str, int]:
    return dict(Counter(rows.columns["status"].tolist()))


def _broken(rows: Rows) -> dict[str, str]:
    """Samples whose run broke off: why, and at which step."""
    columns = rows.columns
    return {
        str(number): f"{status} at step {steps}"
        for number, status, steps in zip(rows.numbers, columns["status"], columns["steps"], strict=True)
        if status not in NOT_BROKEN
    }


def _spread(values: np.ndarray) -> dict[str, float]:
    values = values[np.isfinite(values)]
    if not values.size:
        return {}
    return {"mean": float(values.mean()), "smallest": float(values.min()), "largest": float(values.max())}
