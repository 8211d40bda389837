"""Hazard maps: do their intervals hold the truth, do they add up, and what do they cost?

Campaigns are drawn with replacement from two fully refined populations (`benchmarks.hazard_populations`): 600 samples,
an audit of 60 refined runs by the two-phase estimator, all failures sliding or 20 of them. Maps of five events
(reached, covered at the end, deposit thicker than 0.5 and 1 m, faster than 1 m/s) are held against the population's
own. Coverage counts the cells whose true probability times the refined slides is at least 5; in rarer cells the
intervals may only hold more. A Monte Carlo campaign of 300 refined runs beside each says how often both maps agree.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.hazard_populations import LIMIT, SOLID, Population, population
from benchmarks.leave_out import microseconds, unchanged, with_looks
from benchmarks.measure import Report, scene_campaign
from cooperative import Estimate, MonteCarlo, Phases, TwoPhase, report
from cooperative import run as run_campaign
from cooperative.estimate import Estimator, Slides, chance_of, exceedance, mean_of
from cooperative.estimate import Population as Screening
from cooperative.measure import Vulnerability
from cooperative.scene import built

SAMPLES, REFINED, OFTEN = 600, 60, 5.0
HOUSE = Vulnerability("thickness", (0.0, 0.5, 2.0), (0.0, 0.4, 1.0))


def events(of: Population) -> np.ndarray:
    """What each sample does in each column (N, events, columns) bool, without the columns where nothing ever comes."""
    deposit, thickness, speed, _ = (values.reshape(of.rough.size, -1) for values in of.columns.values())
    found = np.stack(
        [thickness >= of.least, deposit >= of.least, deposit > 0.5, deposit > 1.0, speed > 1.0], axis=1
    )  # fmt: skip
    return found[:, :, (thickness > 0).any(axis=0)]


@dataclass(frozen=True)
class Drawn:
    """A campaign that has run. found: its P_f. weight: what each slide stands for (n,). at: which sample of the
    population each is (n,)."""

    found: Estimate
    weight: np.ndarray
    at: np.ndarray


def campaign(of: Population, estimator: Estimator, samples: int, slides: int | None, seed: int) -> Drawn:
    """One campaign whose samples are drawn from a population with replacement."""
    at = np.random.default_rng([seed, samples]).integers(of.rough.size, size=samples)
    phases = Phases(estimator, LIMIT, population=Screening(of.rough[at]))
    while wanted := phases.next_runs(64, ()):
        phases = phases.refined({n: (of.refined[at[n]], False) for n in {*phases.answers, *wanted}})
    numbers = sorted(phases.answers)
    drawn = Slides.of(phases, numbers, np.ones(len(numbers), bool), slides, seed)
    mine = drawn.slid & (drawn.weight > 0)
    return Drawn(phases.estimate, drawn.weight[mine], at[np.array(numbers)[mine]])


def coverage(name: str, slides: int | None, repeats: int) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    """How often intervals hold the truth, a row of the table; coverage of each cell that is reached often, and of each
    that is not."""
    of = population(name)
    happens = events(of)
    truth = happens.mean(axis=0)
    held, agree, bias, count = (np.zeros(truth.shape) for _ in range(4))
    area, loss = 0.0, 0.0
    for seed in range(repeats):
        drawn = campaign(of, TwoPhase(refined_runs=REFINED, seed=seed), SAMPLES, slides, seed)
        maps = chance_of(drawn.found, drawn.weight, happens[drawn.at])
        other = campaign(of, MonteCarlo(), SAMPLES // 2, None, seed + 10**6)
        plain = chance_of(other.found, other.weight, happens[other.at])
        held += (maps.low <= truth) & (truth <= maps.high)
        agree += (maps.low <= plain.high) & (plain.low <= maps.high)
        bias += maps.value - truth
        count += truth * drawn.at.size
        area, loss = max(area, area_error(of, drawn)), max(loss, loss_error(of, drawn))
    often = count / repeats >= OFTEN
    held, agree, bias = held / repeats, agree / repeats, bias / repeats
    edges = of.numbers["area"][of.fails].mean() / of.numbers["area_columns"][of.fails].mean() - 1
    row = {
        "population": name,
        "slides": "all" if slides is None else slides,
        "campaigns": repeats,
        "cells": int(often.sum()),
        "coverage_mean": float(held[often].mean()),
        "coverage_min": float(held[often].min()),
        "rarer_cells": int((~often & (truth > 0)).sum()),
        "rarer_coverage_min": float(held[~often & (truth > 0)].min()),
        "agrees_with_monte_carlo": float(agree[often].mean()),
        "bias_over_truth": float(np.abs(bias[often] / truth[often]).max()),
        "covered_area_error": area,
        "loss_identity_error": loss,
        "edge_based_area_over_columns": float(edges),
    }
    return row, held[often], held[~often & (truth > 0)]


def area_error(of: Population, drawn: Drawn) -> float:
    """How far the map of what is covered at the end, summed beyond the toe, lies from the expected covered area."""
    covered = of.columns["column_deposit"][drawn.at][:, of.beyond :] >= of.least
    mapped = float(chance_of(drawn.found, drawn.weight, covered).value.sum()) * of.cell_area
    counted = float(mean_of(drawn.found, drawn.weight, of.numbers["area_columns"][drawn.at]).value)
    return abs(mapped / counted - 1)


def loss_error(of: Population, drawn: Drawn) -> float:
    """How far the area under the loss exceedance curve lies from the expected loss, of a house at the foot."""
    thickest = of.columns["column_thickness"][drawn.at][:, of.beyond + 1].reshape(drawn.at.size, -1).max(axis=1)
    lost = 1e5 * HOUSE.share(thickest)
    curve = exceedance(drawn.found, drawn.weight, lost, np.unique(np.concatenate([[0.0], lost])))
    under = float(curve.chance.value[:-1] @ np.diff(curve.thresholds))
    expected = float(mean_of(drawn.found, drawn.weight, lost).value)
    return abs(under / expected - 1) if expected else abs(under)


def overhead(repeats: int) -> float:
    """Share of a step that looking at the columns takes, on the published section's rough grid and on a small solid."""
    shares = []
    for name in ("paper_section", "paper"):
        scene, state = built(scene_campaign(name), "rough")
        plain, looked = microseconds([unchanged(scene, state), with_looks(scene, state)], repeats)
        shares.append(1 - plain / looked)
    return max(shares)


def report_size() -> float:
    """Megabytes of the report of a campaign in 3D, with maps."""
    with tempfile.TemporaryDirectory() as folder:
        text = SOLID.replace("samples = 300", "samples = 20\nrefined_runs = 12")
        run_campaign(text, Path(folder) / "solid")
        report(Path(folder) / "solid")
        return (Path(folder) / "solid" / "report.html").stat().st_size / 1e6


def run(quick: bool) -> Report:
    """Both populations, with all failures sliding and with a part of them."""
    repeats = 20 if quick else 300
    told = [coverage(name, slides, repeats) for name in ("section", "solid") for slides in (None, 20)]
    rows = [row for row, _, _ in told]
    often = np.concatenate([held for _, held, _ in told])
    values = {
        "map_coverage_mean": float(often.mean()),
        "map_coverage_min": float(often.min()),
        "rarer_coverage_min": min(row["rarer_coverage_min"] for row in rows),
        "agrees_with_monte_carlo": min(row["agrees_with_monte_carlo"] for row in rows),
        "covered_area_error": max(row["covered_area_error"] for row in rows),
        "loss_identity_error": max(row["loss_identity_error"] for row in rows),
        "overhead_share": overhead(3 if quick else 15),
        "report_mb": report_size(),
    }
    return Report(values, rows)
