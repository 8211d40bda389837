"""The refined runs that a folder allows beyond its scene: for a target that moves, or rough runs that broke off."""

from __future__ import annotations

import json
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

from cooperative.estimate import Sampling
from cooperative.scene._campaign import Budget, Campaign
from cooperative.store import MOST_TEXT, write_aside
from foundation import files
from foundation.text import shown

KEPT = "budget.json"
MOST_RUNS = 2**31 - 1
"""Refined runs at most that a folder may allow."""


def allowing(campaign: Campaign, folder: Path, refined_runs: int | None) -> Campaign:
    """The scene with the refined runs that its folder allows, or is to allow from now on.

    Raises ValueError for no more than is allowed already, or an estimator without such a setting.
    """
    kept = kept_budget(folder)
    if refined_runs is None:
        return campaign if kept is None else raised(campaign, kept)
    first = Sampling(campaign.plan.samples, campaign.run.failure_displacement, campaign.plan.screening_stop)
    scene = campaign.estimator.budget(campaign.estimator.rough_runs(first))
    if scene is None:
        raise ValueError(
            f"refined_runs = {refined_runs}: estimator {campaign.estimator.name!r} has no number of runs to raise, its "
            "rule alone tells when to stop"
        )
    if refined_runs <= scene or (kept is not None and refined_runs < kept.refined_runs):
        allowed = scene if kept is None else kept.refined_runs
        raise ValueError(f"refined_runs = {refined_runs}: the campaign allows {allowed} already, give more")
    return raised(campaign, Budget(refined_runs, scene))


def raised(campaign: Campaign, budget: Budget) -> Campaign:
    """The scene with so many refined runs allowed.

    Raises ValueError for fewer than the scene allows, or an estimator that has no such setting.
    """
    if not budget.refined_runs > budget.scene >= 1:
        raise ValueError(f"refined_runs = {budget.refined_runs}: the scene allows {budget.scene} already, give more")
    if budget.refined_runs > MOST_RUNS:
        raise ValueError(f"refined_runs = {shown(budget.refined_runs)}: give at most {MOST_RUNS:,}")
    chosen: Any = campaign.estimator
    if "refined_runs" not in {setting.name for setting in fields(chosen)}:
        raise ValueError(f"refined_runs = {budget.refined_runs}: estimator {chosen.name!r} has no such setting")
    return replace(campaign, estimator=replace(chosen, refined_runs=budget.refined_runs), raised=budget)


def write_budget(folder: Path, budget: Budget) -> None:
    """Keep the refined runs allowed in a campaign's folder. OSError where the disk refuses."""
    if kept_budget(folder) != budget:
        write_aside(folder / KEPT, json.dumps(asdict(budget)).encode())


def kept_budget(folder: Path) -> Budget | None:
    """The refined runs that a campaign's folder allows beyond its scene, None where it does not.

    Raises ValueError for a file that holds something else.
    """
    path = folder / KEPT
    if not path.exists():
        return None
    try:
        found = json.loads(files.read_plain(path, MOST_TEXT))
        values = found["refined_runs"], found["scene"]
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"{path} holds no number of refined runs: {REMEDY}") from error
    if not all(type(value) is int and 0 < value <= MOST_RUNS for value in values):
        raise ValueError(f"{path} holds {shown(values)} in place of numbers of refined runs: {REMEDY}")
    return Budget(*values)


REMEDY = "delete it, and say --refined-runs again"
