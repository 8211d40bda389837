"""Hazard maps: do their intervals hold the truth, do they add up, and what do they cost?

Campaigns are drawn with replacement from two fully refined populations (`benchmarks.statistics.hazard_populations`):
600 samples, an audit of 60 refined runs by the two-phase estimator, all failures sliding or 20 of them. Maps of five
events (reached, covered at the end, deposit thicker than 0.5 and 1 m, faster than 1 m/s) are held against the
population's own. Coverage counts the cells whose true probability times the refined slides is at least 5; in rarer
cells the intervals may only hold more. The least of many cells is biased low by noise: `standard_error` is that of one
cell's coverage, from as many campaigns. A Monte Carlo campaign of 300 refined runs beside each shows how often the
difference of both maps is within its own 95 % interval.

`overhead_share` is what looking at the columns takes of a step on one core, turn by turn against the same step without,
the median; columns are looked at every `looked_at_every_steps`.
"""

from __future__ import annotations

import json
import statistics
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measure import Report, on_cores, scene_campaign
from benchmarks.speed.leave_out import turns, unchanged, with_looks
from benchmarks.statistics import estimators_means as means
from benchmarks.statistics.hazard_populations import LIMIT, SOLID, Population, population
from cooperative import MonteCarlo, TwoPhase, report
from cooperative import run as run_campaign
from cooperative.estimate import Chances, Estimate, Estimator, chance_of, exceedance, mean_of
from cooperative.measure import Vulnerability
from cooperative.scene import built

SAMPLES, REFINED, OFTEN = 600, 60, 5.0
HOUSE = Vulnerability("thickness", (0.0, 0.5, 2.0), (0.0, 0.4, 1.0))


def events(of: Population) -> np.ndarray:
    """What each sample does in each column (N, events, columns) bool, without the columns where nothing ever comes."""
    deposit, thickness, speed, _ = (values.reshape(of.rough.size, -1) for values in of.columns.values())
    result = np.stack(
        [thickness >= of.least, deposit >= of.least, deposit > 0.5, deposit > 1.0, speed > 1.0], axis=1
    )  # fmt: skip
    return result[:, :, (thickness > 0).any(axis=0)]


@dataclass(frozen=True)
class SampledCampaign:
    """A campaign that has run. result: its P_f. weight: what each slide stands for (n,). at: which sample of the
    population each is (n,)."""

    result: Estimate
    weight: np.ndarray
    at: np.ndarray


def campaigns(
    of: Population, estimator: Estimator, samples: int, slides: tuple[int | None, ...], seed: int
) -> list[SampledCampaign]:
    """One campaign whose samples are drawn from a population with replacement, with as many of its failures sliding as
    each of `slides` describes."""
    at = np.random.default_rng([seed, samples]).integers(of.rough.size, size=samples)
    failed, result = of.refined[at] > LIMIT, []
    audit = means.audited(estimator, of.rough[at], failed)
    for count in slides:
        phases, numbers, slides_of = means.slid(audit, failed, count, seed)
        sliding = slides_of.slid & (slides_of.weight > 0)
        result.append(SampledCampaign(phases.estimate, slides_of.weight[sliding], at[np.array(numbers)[sliding]]))
    return result


class Tally:
    """How often the maps of campaigns held the truth (k,) of so many cells, and agreed with those of Monte Carlo."""

    def __init__(self, truth: np.ndarray) -> None:
        self.truth, self.campaigns, self.slides, self.area, self.loss = truth, 0, 0, 0.0, 0.0
        self.covered, self.agree, self.bias = (np.zeros(truth.size) for _ in range(3))

    def add(self, of: Population, happens: np.ndarray, campaign: SampledCampaign, plain: SampledCampaign) -> None:
        """Count one campaign, and one by Monte Carlo beside it. happens: (N, k)."""
        maps, other = (
            chance_of(campaign_or_plain.result, campaign_or_plain.weight, happens[campaign_or_plain.at])
            for campaign_or_plain in (campaign, plain)
        )
        self.covered += (maps.low <= self.truth) & (self.truth <= maps.high)
        self.agree += agreeing(maps, other)
        self.bias += maps.value - self.truth
        self.campaigns, self.slides = self.campaigns + 1, self.slides + campaign.at.size
        self.area, self.loss = max(self.area, area_error(of, campaign)), max(self.loss, loss_error(of, campaign))

    @property
    def often(self) -> np.ndarray:
        """Cells (k,) that are reached often enough."""
        return self.truth * self.slides / self.campaigns >= OFTEN


def coverage(name: str, repeats: int) -> tuple[list[dict[str, Any]], list[np.ndarray]]:
    """How often intervals hold the truth: a row of the table with all failures sliding and one with 20 of them, and for
    each the coverage of every cell that is reached often."""
    of = population(name)
    # Many columns are reached by the same samples, event by event: each such group is counted once, times its size.
    happens, cells = np.unique(events(of).reshape(of.rough.size, -1), axis=1, return_counts=True)
    some = happens.any(axis=0)
    happens, cells = happens[:, some], cells[some]
    counts = (None, 20)
    tallies = {count: Tally(happens.mean(axis=0)) for count in counts}
    for seed in range(repeats):
        (plain,) = campaigns(of, MonteCarlo(), SAMPLES // 2, (None,), seed + 10**6)
        audited = campaigns(of, TwoPhase(refined_runs=REFINED, seed=seed), SAMPLES, counts, seed)
        for count, campaign in zip(counts, audited, strict=True):
            tallies[count].add(of, happens, campaign, plain)
    rows = [_row(name, of, count, tally, cells) for count, tally in tallies.items()]
    return rows, [np.repeat(tally.covered[tally.often] / repeats, cells[tally.often]) for tally in tallies.values()]


def _row(name: str, of: Population, slides: int | None, tally: Tally, cells: np.ndarray) -> dict[str, Any]:
    often, repeats = tally.often, tally.campaigns
    covered, weight = tally.covered / repeats, cells[often]
    return {
        "population": name,
        "slides": "all" if slides is None else slides,
        "campaigns": repeats,
        "standard_error": float(np.sqrt(0.05 * 0.95 / repeats)),
        "cells": int(weight.sum()),
        "coverage_mean": float(np.average(covered[often], weights=weight)),
        "coverage_min": float(covered[often].min()),
        "rarer_cells": int(cells[~often].sum()),
        "rarer_coverage_mean": float(np.average(covered[~often], weights=cells[~often])),
        "rarer_coverage_min": float(covered[~often].min()),
        "agrees_with_monte_carlo": float(np.average(tally.agree[often] / repeats, weights=weight)),
        "bias_over_truth": float(np.abs(tally.bias[often] / repeats / tally.truth[often]).max()),
        "covered_area_error": tally.area,
        "loss_identity_error": tally.loss,
        "edge_based_area_over_columns": float(
            of.numbers["area"][of.fails].mean() / of.numbers["area_columns"][of.fails].mean() - 1
        ),
    }


def agreeing(one: Chances, other: Chances) -> np.ndarray:
    """Where two independent maps differ by no more than both their intervals allow together, by squares."""
    lower, upper = (np.where(one.value < other.value, a, b) for a, b in ((one.high, one.low), (other.low, other.high)))
    return np.abs(one.value - other.value) <= np.hypot(lower - one.value, upper - other.value)


def area_error(of: Population, campaign: SampledCampaign) -> float:
    """How far the map of what is covered at the end, summed beyond the toe, lies from the expected covered area."""
    covered = of.columns["column_deposit"][campaign.at][:, of.beyond :] >= of.least
    mapped = float(chance_of(campaign.result, campaign.weight, covered).value.sum()) * of.cell_area
    counted = float(mean_of(campaign.result, campaign.weight, of.numbers["area_columns"][campaign.at]).value)
    return abs(mapped / counted - 1)


def loss_error(of: Population, campaign: SampledCampaign) -> float:
    """How far the area under the loss exceedance curve lies from the expected loss, of a house at the foot."""
    thickest = of.columns["column_thickness"][campaign.at][:, of.beyond + 1].reshape(campaign.at.size, -1).max(axis=1)
    lost = 1e5 * HOUSE.share(thickest)
    curve = exceedance(campaign.result, campaign.weight, lost, np.unique(np.concatenate([[0.0], lost])))
    under = float(np.array(curve.probability[:-1]) @ np.diff(curve.thresholds))
    expected = float(mean_of(campaign.result, campaign.weight, lost).value)
    return abs(under / expected - 1) if expected else abs(under)


def overhead(repeats: int) -> dict[str, Any]:
    """Share of a step that looking at the columns takes, on the published rough section and slope, on one core."""
    result = [on_cores(1, "benchmarks.statistics.hazard", name, str(repeats)) for name in ("paper_section", "paper")]
    return max(result, key=lambda row: row["overhead_share"])


def report_size() -> float:
    """Megabytes of the report of a campaign in 3D, with maps."""
    with tempfile.TemporaryDirectory() as folder:
        text = SOLID.replace("samples = 300", "samples = 20\nrefined_runs = 12")
        run_campaign(text, Path(folder) / "solid")
        report(Path(folder) / "solid")
        return (Path(folder) / "solid" / "report.html").stat().st_size / 1e6


def overhead_of(name: str, repeats: int) -> dict[str, Any]:
    """Share of a step on the rough grid of a scene of benchmarks/scenes, the median over turns in which the step with
    looks and the one without follow each other, and how often the columns are looked at."""
    scene, state = built(scene_campaign(name), "rough")
    looked = with_looks(scene, state)
    columns = looked[1].columns
    assert columns is not None
    shares = [1 - plain / looking for plain, looking in turns([unchanged(scene, state), looked], repeats)]
    return {"overhead_share": statistics.median(shares), "looked_at_every_steps": columns.every}


def run(quick: bool) -> Report:
    """Both populations, with all failures sliding and with a part of them."""
    repeats = 30 if quick else 1000
    tallies = [coverage(name, repeats) for name in ("section", "solid")]
    rows = [row for both, _ in tallies for row in both]
    often = np.concatenate([covered for _, both in tallies for covered in both])
    values = {
        "map_coverage_mean": float(often.mean()),
        "map_coverage_min": float(often.min()),
        "rarer_coverage_mean": min(row["rarer_coverage_mean"] for row in rows),
        "rarer_coverage_min": min(row["rarer_coverage_min"] for row in rows),
        "standard_error": rows[0]["standard_error"],
        "agrees_with_monte_carlo": min(row["agrees_with_monte_carlo"] for row in rows),
        "covered_area_error": max(row["covered_area_error"] for row in rows),
        "loss_identity_error": max(row["loss_identity_error"] for row in rows),
        **overhead(5 if quick else 41),
        "report_mb": report_size(),
    }
    return Report(values, rows)


if __name__ == "__main__":
    print(json.dumps(overhead_of(sys.argv[1], int(sys.argv[2]))))
