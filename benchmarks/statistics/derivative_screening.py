"""Do gradients of the rough run predict the refined outcome better than its displacement? On the 400 real pairs.

Each sample's rough run is differentiated by its coefficients. Two features come of it: the length of the gradient of
log displacement, and the first-order distance to failure, (log 1 m - log displacement) over that length. A logistic
model of refined failure with and without them is judged by cross-validation: its logarithmic loss, and the audit it
needs, the square of the mean of sqrt(p (1 - p)), to which the number of refined runs for a given accuracy is
proportional. The price is what a gradient costs beside the run itself.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import minimize
from scipy.special import expit
from scipy.stats import norm, rankdata

from benchmarks.measure import Report, scene_campaign
from benchmarks.statistics.section_pairs import SAMPLES, read
from cooperative import runs
from jaxmpm import replay, with_soil
from jaxmpm.run import objectives

SECONDS = 2.0
FOLDS = 20
RIDGE = 0.05


def gradients(count: int) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Log displacement after `SECONDS` (count,), length of its gradient by the coefficients, seconds of both and of the
    run alone, per sample."""
    campaign = scene_campaign("paper_section")
    campaign = replace(campaign, plan=replace(campaign.plan, samples=SAMPLES))
    soil = runs.random_soil(campaign)
    model = runs.build(campaign, "rough", soil)
    steps = round(SECONDS / float(model.scene.numerics.time_step))

    def response(coefficients: jax.Array) -> jax.Array:
        scene, state = with_soil(model.scene, model.state, **model.varied(coefficients))
        final, _ = replay(scene, state, steps)
        return objectives.log_displacement(final, 1e-4)

    both, alone = jax.jit(jax.value_and_grad(response)), jax.jit(response)
    table = jnp.asarray(runs.coefficients_of(campaign, soil)[:count])
    jax.block_until_ready((both(table[0]), alone(table[0])))
    start = time.perf_counter()
    result = [both(xi) for xi in table]
    values = np.array([float(value) for value, _ in result]) + np.log(1e-4)
    lengths = np.array([float(jnp.linalg.norm(gradient)) for _, gradient in result])
    middle = time.perf_counter()
    jax.block_until_ready([alone(xi) for xi in table])
    return values, lengths, (middle - start) / count, (time.perf_counter() - middle) / count


def scored(values: np.ndarray) -> np.ndarray:
    """Normal scores of the ranks."""
    return norm.ppf((rankdata(values) - 0.5) / values.size)


def predicted(features: np.ndarray, failed: np.ndarray) -> np.ndarray:
    """Probability of failure (N,) of each sample by a ridge-penalised logistic model fitted without its fold."""
    design = np.column_stack([np.ones(failed.size), features])
    fold, p = np.arange(failed.size) % FOLDS, np.empty(failed.size)
    for left_out in range(FOLDS):
        rows = fold != left_out

        def loss(beta: np.ndarray, rows: np.ndarray = rows) -> float:
            score = design[rows] @ beta
            return float(np.sum(np.logaddexp(0, score) - failed[rows] * score) + RIDGE * beta[1:] @ beta[1:])

        beta = minimize(loss, np.zeros(design.shape[1])).x
        p[~rows] = expit(design[~rows] @ beta)
    return np.clip(p, 1e-6, 1 - 1e-6)


def run(quick: bool) -> Report:
    """Models with and without gradients."""
    count = 60 if quick else SAMPLES
    pairs = read()
    failed = (pairs.displacement["refined"][:count] > 1.0).astype(float)
    rough = scored(pairs.displacement["rough"][:count])
    values, lengths, with_gradient, alone = gradients(count)
    distance = -values / np.maximum(lengths, 1e-12)
    features = {
        "rough displacement": [rough],
        "rough displacement at 2 s": [scored(values)],
        "and length of the gradient": [rough, scored(lengths)],
        "and first-order distance to failure": [rough, scored(distance)],
        "first-order distance alone": [scored(distance)],
    }
    rows: list[dict[str, Any]] = []
    for name, columns in features.items():
        p = predicted(np.column_stack(columns), failed)
        rows.append(
            {
                "model": name,
                "log_loss": float(-np.mean(failed * np.log(p) + (1 - failed) * np.log(1 - p))),
                "audit_needed": float(np.mean(np.sqrt(p * (1 - p))) ** 2),
                "misclassified": int(np.sum((p > 0.5) != (failed > 0.5))),
            }
        )
    base = rows[0]["audit_needed"]
    best = min(rows[2:], key=lambda r: r["log_loss"])
    values_: dict[str, Any] = {
        "samples": count,
        "failed_refined": int(failed.sum()),
        "best_model_with_gradients": best["model"],
        "audit_saved_by_gradients": 1 - best["audit_needed"] / base,
        "log_loss_without": rows[0]["log_loss"],
        "log_loss_with": best["log_loss"],
        "gradient_seconds": with_gradient,
        "run_seconds": alone,
    }
    return Report(values_, rows)
