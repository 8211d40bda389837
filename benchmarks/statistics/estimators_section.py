"""Estimators on real populations: the 400 pairs of `benchmarks.statistics.section_pairs`, campaigns resampled from
them.

One population has the published settings, the other those that a scene has by default. A campaign draws its samples
from the 400 with replacement, so that the share of them that fails on the refined grid is the truth, and spends the
seconds that those runs took. Every method at several budgets gives error against run time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.statistics.section_pairs import Pairs, read
from cooperative.estimate import (
    AuditPlan,
    Estimate,
    Population,
    control_variate,
    correlation,
    monte_carlo,
    published,
    rank_samples,
    sample_weights,
    stopping_rank,
    two_phase,
    wilson_interval,
)
from cooperative.reporting import save

LIMIT = 1.0
BUDGETS = (20, 40, 80, 160)
Spent = tuple[Estimate, float]


@lru_cache
def population(study: str) -> Pairs:
    """The data file of a study, read once per process."""
    return read(study)


@dataclass(frozen=True)
class SampledCampaign:
    """Samples of one campaign: their numbers in the population (N,), which grid screens them, refined runs allowed."""

    of: Pairs
    at: np.ndarray
    grid: str
    runs: int
    seed: int

    @property
    def rough(self) -> np.ndarray:
        """Displacements of the screening (N,) m."""
        return self.of.displacement[self.grid][self.at]

    @property
    def failed(self) -> np.ndarray:
        """Whether each sample fails on the refined grid (N,)."""
        return self.of.displacement["refined"][self.at] > LIMIT

    def seconds(self, refined: np.ndarray) -> float:
        """What the screening took, the factors of safety where it is calibrated, and the runs `refined` (numbers)."""
        spent = self.of.seconds
        fixed = self.of.calibration_seconds if self.grid == "calibrated" else 0.0
        return float(spent[self.grid][self.at].sum() + spent["refined"][self.at[refined]].sum()) + fixed


def _audited(campaign: SampledCampaign) -> Spent:
    refined, plan = dict(enumerate(campaign.failed.tolist())), AuditPlan(runs=campaign.runs, seed=campaign.seed)
    screened = Population(campaign.rough)
    return two_phase(screened, refined, plan), campaign.seconds(np.array(list(sample_weights(screened, refined, plan))))


def _published(campaign: SampledCampaign) -> Spent:
    refined, k_t = dict(enumerate(campaign.failed.tolist())), max(campaign.at.size // 50, 3)
    order = rank_samples(campaign.rough).order
    return published(campaign.rough, refined, k_t), campaign.seconds(order[: stopping_rank(order, refined, k_t)])


def _control_variate(campaign: SampledCampaign) -> Spent:
    first = np.arange(campaign.runs)
    return control_variate(campaign.rough, dict(enumerate(campaign.failed[first].tolist()))), campaign.seconds(first)


def _screening_alone(campaign: SampledCampaign) -> Spent:
    fails, count = int(np.sum(campaign.rough > LIMIT)), campaign.at.size
    result = Estimate(fails / count, wilson_interval(fails, count), np.nan, 0, "screening alone")
    return result, campaign.seconds(np.zeros(0, int))


def _monte_carlo(campaign: SampledCampaign) -> Spent:
    spent = campaign.of.seconds["refined"][campaign.at]
    return monte_carlo(campaign.failed), float(spent.sum())


@dataclass(frozen=True)
class Method:
    """What a campaign does, the grid that screens, samples per refined run of the budget, and the population."""

    act: Callable[[SampledCampaign], Spent]
    grid: str = "rough"
    per_run: int = 10
    study: str = "published"


METHODS = {
    "two-phase": Method(_audited),
    "two-phase, calibrated": Method(_audited, "calibrated"),
    "control variate": Method(_control_variate),
    "control variate, calibrated": Method(_control_variate, "calibrated"),
    "published n/N": Method(_published, per_run=5),
    "published n/N, calibrated": Method(_published, "calibrated", per_run=5),
    "screening alone": Method(_screening_alone),
    "screening alone, calibrated": Method(_screening_alone, "calibrated"),
    "Monte Carlo": Method(_monte_carlo, "refined", per_run=1),
    "two-phase, default settings": Method(_audited, study="default"),
    "screening alone, default settings": Method(_screening_alone, study="default"),
    "Monte Carlo, default settings": Method(_monte_carlo, "refined", per_run=1, study="default"),
}


def repeat(case: tuple[str, int], first: int, count: int) -> np.ndarray:
    """Campaigns number `first` to `first + count` of a method with so many runs: rows of P_f, limits, refined runs,
    seconds."""
    method, runs = case
    how = METHODS[method]
    pairs = population(how.study)
    size = pairs.displacement[how.grid].size
    rows = []
    for number in range(first, first + count):
        generator = np.random.default_rng([number, runs, list(METHODS).index(method)])
        campaign = SampledCampaign(pairs, generator.integers(size, size=how.per_run * runs), how.grid, runs, number)
        result, seconds = how.act(campaign)
        refined = runs if how.grid == "refined" else result.refined_runs
        rows.append((result.probability, *result.interval, refined, seconds))
    return np.array(rows)


def summarise(method: str, runs: int, rows: np.ndarray) -> dict[str, Any]:
    """Bias, error, coverage and run time of one method at one budget, relative to the population's P_f."""
    truth = float(np.mean(population(METHODS[method].study).displacement["refined"] > LIMIT))
    probability, low, high, refined, seconds = rows.T
    off = probability / truth - 1
    return {
        "population": "section",
        "method": method,
        "samples": METHODS[method].per_run * runs,
        "refined_runs": float(refined.mean()),
        "seconds": float(seconds.mean()),
        "bias": float(off.mean()),
        "bias_error": float(off.std() / np.sqrt(len(rows))),
        "rmse": float(np.sqrt(np.mean(off**2))),
        "coverage": float(np.mean((low <= truth) & (truth <= high))),
    }


def values(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Named figures: the populations, what calibration does to them, and seconds for an error of 10 %."""
    named = _agreement(population("published"), "section") | _agreement(population("default"), "section_default")
    for method, name in (
        ("Monte Carlo", "monte_carlo"),
        ("control variate", "control_variate"),
        ("two-phase", "two_phase"),
        ("two-phase, calibrated", "two_phase_calibrated"),
        ("Monte Carlo, default settings", "default_monte_carlo"),
        ("two-phase, default settings", "default_two_phase"),
    ):
        method_rows = [row for row in rows if row["method"] == method]
        named[f"section_{name}_seconds_for_10_percent"] = seconds_for(method_rows, 0.1)
    return named


def _agreement(pairs: Pairs, name: str) -> dict[str, float]:
    """Shares that fail, and how far the rough grid, plain and calibrated, agrees with the refined one."""
    refined, even = pairs.displacement["refined"], np.ones(pairs.displacement["refined"].size)
    named = {f"{name}_pf": float(np.mean(refined > LIMIT))}
    for grid in ("rough", "calibrated"):
        result = correlation(pairs.displacement[grid], refined, even, failure_displacement=LIMIT)
        if result is None:
            raise ValueError(
                f"the {grid} displacements of {len(refined)} pairs do not differ: make the data file again"
            )
        named[f"{name}_{grid}_pf"] = float(np.mean(pairs.displacement[grid] > LIMIT))
        named[f"{name}_{grid}_spearman"] = result.spearman
        named[f"{name}_{grid}_pearson_log"] = result.pearson_log
        named[f"{name}_{grid}_same_class"] = result.same_class
    return named


def seconds_for(rows: list[dict[str, Any]], error: float) -> float:
    """Run time at which the error meets `error`, from a fit of rmse^2 = c / (seconds - fixed cost)."""
    seconds, square = (np.array([row[name] for row in rows]) for name in ("seconds", "rmse"))
    slope, fixed = np.polyfit(1 / square**2, seconds, 1)
    return float(fixed + slope / error**2)


def draw(rows: list[dict[str, Any]], folder: Path) -> None:
    """Error and bias against run time, one line per method."""
    colours = {"two-phase": "#0072B2", "control variate": "#009E73", "published n/N": "#D55E00"}
    colours |= {"screening alone": "#CC79A7", "Monte Carlo": "#5A5A5A"}
    markers = dict(zip(colours, "os^vD", strict=True))
    figure = Figure(figsize=(10.5, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    error, bias = figure.subplots(1, 2)
    for method in (name for name, how in METHODS.items() if how.study == "published"):
        method_rows = sorted((row for row in rows if row["method"] == method), key=lambda row: row["seconds"])
        kind, calibrated = method.removesuffix(", calibrated"), method.endswith("calibrated")
        style = {
            "color": colours[kind], "marker": markers[kind], "ls": "--" if calibrated else "-", "ms": 6,
            "mfc": "none" if calibrated else colours[kind],
        }  # fmt: skip
        seconds = [row["seconds"] for row in method_rows]
        error.plot(seconds, [100 * row["rmse"] for row in method_rows], label=method, **style)
        bias.errorbar(
            seconds,
            [100 * row["bias"] for row in method_rows],
            [200 * row["bias_error"] for row in method_rows],
            capsize=2,
            **style,
        )
    error.set(xscale="log", yscale="log", ylabel="root mean square error of $P_f$ [%]")
    bias.set(xscale="log", ylim=(-9, 9), ylabel="bias of $P_f$ [%], bars of 2 standard errors")
    bias.axhline(0, color="#5A5A5A", lw=0.8)
    alone = next(row for row in rows if row["method"] == "screening alone")["bias"]
    bias.annotate(f"screening alone: {100 * alone:.0f} %", (0.03, 0.03), xycoords="axes fraction", color="#CC79A7")
    for ax in (error, bias):
        ax.set_xlabel("run time of a campaign, one process [s]")
        ax.spines[["top", "right"]].set_visible(False)
        ax.set_xticks([10, 30, 100, 300, 1000], ["10", "30", "100", "300", "1000"])
        ax.minorticks_off()
    error.set_yticks([2, 5, 10, 20, 50], ["2", "5", "10", "20", "50"])
    figure.legend(*error.get_legend_handles_labels(), loc="outside right upper", frameon=False)
    save(figure, folder / "estimators_error_time.png", dpi=110)
