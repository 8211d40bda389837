"""Screening of the published slope: samples per hour, where the time goes, and what ending lanes early changes.

The rough grid of paper.toml in 3D, random fields as in the campaign, at CFL 0.5.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import spearmanr

from benchmarks.measure import Report, scene_campaign
from cooperative import runs
from cooperative.store import open_store, write_sample
from jaxmpm import Result
from jaxmpm.run import Chunk
from jaxmpm.transfer import g2p, p2g


def screened(campaign: Any, count: int) -> dict[str, Any]:
    """Screen `count` samples as a campaign does, stored and all; seconds by what they went to."""
    soil = runs.random_soil(campaign)
    model = runs.build(campaign, "rough", soil)
    coefficients = runs.coefficients_of(campaign, soil)
    chunks: list[Chunk] = []
    # Compile outside the clock: it is paid once a campaign, not once a sample.
    next(iter(runs.run_samples(model, coefficients, [0], width=1, rules=campaign.rules(1e-9))))
    seconds = {"storing": 0.0}
    rows = []
    with tempfile.TemporaryDirectory() as folder, open_store(f"{folder}/screening", campaign.source) as store:
        start = time.perf_counter()
        for sample in runs.run_samples(
            model,
            coefficients,
            range(count),
            rules=campaign.rules(campaign.plan.screening_stop),
            on_chunk=chunks.append,
        ):
            clock = time.perf_counter()
            write_sample(store, "rough", sample)
            seconds["storing"] += time.perf_counter() - clock
            rows.append({"sample": sample.number, "status": sample.status, "steps": sample.steps, **sample.row})
        total = time.perf_counter() - start
    lane_steps = sum(chunk.lanes * chunk.steps for chunk in chunks)
    busy = sum(chunk.busy * chunk.steps for chunk in chunks)
    seconds["transfers"] = seconds_of_transfers(model) * busy
    seconds["lane handling"] = seconds_of_handling(model, coefficients) * count
    seconds["rest of the step"] = total - sum(seconds.values())
    return {
        "total": total,
        "seconds": seconds,
        "waiting_share": 1 - busy / lane_steps,
        "steps": busy,
        "rows": sorted(rows, key=lambda row: row["sample"]),
    }


def seconds_of_handling(model: runs.GridModel, coefficients: np.ndarray) -> float:
    """Seconds that a sample takes beside its steps: its field, and its consequences (median of some)."""
    still = Result(jax.device_get(model.state), model.scene.numerics.time_step)
    spent = []
    for number in range(6):
        clock = time.perf_counter()
        jax.block_until_ready(model.strength(jnp.asarray(coefficients[number % len(coefficients)])))
        runs.finished_run(model, number, coefficients[0], still, 0.0)
        spent.append(time.perf_counter() - clock)
    return float(np.median(spent[1:]))


def seconds_of_transfers(model: runs.GridModel) -> float:
    """Seconds per step of the transfers of MUSL alone, compiled as one loop (median of some repeats)."""
    scene, particles = model.scene, model.scene.particles
    steps = 40
    d = scene.grid.dimension
    mass, vectors = particles.mass[None], jnp.zeros_like(particles.position)

    @jax.jit
    def transfers(position: Any, stress: Any, count: Any) -> Any:
        def body(_: Any, carry: Any) -> Any:
            start, nodal_sum = carry
            # A dependence on the turn before, or the compiler would do the work once only.
            position = start + 1e-30 * nodal_sum
            nodal = p2g(scene.grid, scene.numerics.kernel, position, jnp.concatenate([mass, vectors]), stress)
            fields = jnp.concatenate([nodal[:, 1:], nodal[:, 1:]], axis=1)[:, : 2 * d]
            values, _ = g2p(scene.grid, scene.numerics.kernel, position, fields, values=2 * d, gradients=0)
            again = p2g(scene.grid, scene.numerics.kernel, position, values[:d], None)
            _, gradient = g2p(scene.grid, scene.numerics.kernel, position, again, values=0, gradients=d)
            return start, gradient[0, 0, 0]

        return jax.lax.fori_loop(0, count, body, (position, jnp.zeros((), position.dtype)))

    alone = []
    for _ in range(6):
        clock = time.perf_counter()
        jax.block_until_ready(transfers(particles.position, model.state.stress, jnp.asarray(steps)))
        alone.append((time.perf_counter() - clock) / steps)
    return float(np.median(alone[1:]))


def early_stop_effect(campaign: Any, count: int) -> list[dict[str, Any]]:
    """The same samples run to the end, until settled, and until settled or decided: ranks, classes, steps."""
    limit = campaign.run.failure_displacement
    plan = replace(campaign.plan, screening_stop=None)
    to_the_end = replace(campaign, run=replace(campaign.run, settle=False), plan=plan)
    variants = {
        "run to t_end": to_the_end,
        "settled lanes end": replace(campaign, plan=replace(campaign.plan, screening_stop=None)),
        "settled lanes end, others at 3 m": replace(campaign, plan=replace(campaign.plan, screening_stop=3.0)),
    }
    done = {name: screened(variant, count) for name, variant in variants.items()}
    full = np.array([row["displacement"] for row in done["run to t_end"]["rows"]])
    table = []
    for name, run in done.items():
        displacement = np.array([row["displacement"] for row in run["rows"]])
        table.append(
            {
                "variant": name,
                "samples": count,
                "steps_share": round(run["steps"] / done["run to t_end"]["steps"], 3),
                "seconds": round(run["total"], 1),
                "classes_changed": int(np.sum((displacement > limit) != (full > limit))),
                "rank_correlation": round(float(spearmanr(displacement, full).statistic), 5),
                "largest_rank_change_among_standing": rank_change(displacement, full, full <= limit),
            }
        )
    return table


def rank_change(displacement: np.ndarray, full: np.ndarray, among: np.ndarray) -> int:
    """Largest change of a rank among some samples."""
    if not among.any():
        return 0
    ranks = [np.argsort(np.argsort(-values[among], kind="stable"), kind="stable") for values in (displacement, full)]
    return int(np.max(np.abs(ranks[0] - ranks[1])))


def run(quick: bool) -> Report:
    """40 samples in 3D for the rate, 50 of the section with and without early stop."""
    campaign = scene_campaign("paper")
    count = 4 if quick else 40
    done = screened(campaign, count)
    shares = {name: round(value / done["total"], 4) for name, value in done["seconds"].items()}
    rows: list[dict[str, Any]] = [
        {
            "scene": campaign.name,
            "samples": count,
            "seconds": round(done["total"], 1),
            "samples_per_hour": round(count / done["total"] * 3600, 1),
            "beyond_failure_displacement": int(sum(row["displacement"] > 1 for row in done["rows"])),
            "steps_per_sample": round(done["steps"] / count),
            "share_of_time": shares,
        }
    ]
    rows += early_stop_effect(scene_campaign("paper_section"), 6 if quick else 50)
    return Report(
        {
            "hours_per_1000_samples": round(done["total"] / count * 1000 / 3600, 3),
            "waiting_share": round(done["waiting_share"], 4),
        },
        rows,
    )
