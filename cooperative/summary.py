"""A campaign in numbers, from its rows alone: probability, modes, consequences, how well the grids agree."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from dataclasses import asdict
from typing import Any

import numpy as np

from cooperative import effects
from cooperative.effects import MEASURES
from cooperative.estimate import (
    Estimate,
    Phases,
    Slides,
    after_more_runs,
    correlation,
    fit_distributions,
    severity_ranking,
    shares,
)
from cooperative.measure import EDGE, SEVERITY
from cooperative.runs import phases_of
from cooperative.scene import Campaign
from cooperative.store import Rows, Store
from foundation import files

NOT_BROKEN = ("FINISHED", "SETTLED", "DECIDED")
CHECKSUM = "checksum"
"""Key of a summary that tells whether it is whole, and of which rows."""
CONTENT = 5
"""Of what a summary says, counted up when it says more: one of an earlier version is made anew."""
MORE = 50
"""What so many more refined runs would buy is told, or fewer where no more are left."""


def summarise(campaign: Campaign, rough: Rows, refined: Rows) -> dict[str, Any]:
    """The campaign in numbers, ready for JSON. Means, shares and fits weigh every refined run by what it stands for;
    where only some failures slid on to their end, these stand for all (see `slide_weights`).

    What there is too little of is None or says so: modes of rows that have none (written before modes were kept), fits
    of fewer than two failures, a correlation without spread.
    """
    found = _summary(campaign, rough, refined)
    return {**found, CHECKSUM: _checksum(campaign, rough, refined, found)}


def stored(campaign: Campaign, store: Store, rough: Rows, refined: Rows) -> dict[str, Any]:
    """The summary in `summary.json`, where it is whole and of just these rows; else made anew from the rows."""
    try:
        kept = json.loads(files.read_plain(store.folder / "summary.json"))
        seal = kept.pop(CHECKSUM)
        if seal == _checksum(campaign, rough, refined, kept):
            return {**kept, CHECKSUM: seal}
    except (OSError, ValueError, TypeError, AttributeError, KeyError, RecursionError):
        pass
    return summarise(campaign, rough, refined)


def _checksum(campaign: Campaign, rough: Rows, refined: Rows, found: dict[str, Any]) -> str:
    """SHA-256 of a summary and of all that it was made from."""
    said = (
        str(CONTENT),
        campaign.text,
        repr(campaign.estimator),
        repr(campaign.raised),
        repr(campaign.measured),
        json.dumps(found, sort_keys=True),
    )
    digest = hashlib.sha256("\0".join(said).encode())
    for rows in (rough, refined):
        for name, values in sorted(rows.columns.items()):
            digest.update(f"{name} {values.dtype} {values.size}".encode() + np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def _summary(campaign: Campaign, rough: Rows, refined: Rows) -> dict[str, Any]:
    phases = phases_of(campaign, rough, refined)
    found, slides = phases.estimate, slides_of(campaign, phases, refined)
    weight, failed = slides.weight, slides.slid
    limit, cut = campaign.run.failure_displacement, effects.cut_off(campaign, refined, slides)
    calibration, limit_load = campaign.measured.calibration, campaign.measured.limit_load
    return {
        "name": campaign.name,
        "probability_of_failure": found.probability,
        "interval": list(found.interval),
        "level": found.level,
        "estimator": found.method,
        "coefficient_of_variation": _finite(found.cov),
        "unseen": found.unseen,
        "sampling_interval": found.sampling_interval and list(found.sampling_interval),
        "finished": phases.why_finished,
        "after_more_runs": _after_more_runs(campaign, phases),
        "other_estimates": {
            e.method: {"probability": e.probability, "interval": list(e.interval)} for e in phases.beside
        },
        "convergence": _convergence(phases.path),
        "samples": len(rough.numbers),
        "failures_rough": int(np.sum(rough.columns["displacement"] > limit)),
        "refined_runs": len(refined.numbers),
        "failures_refined": int(slides.failed.sum()),
        "slides": int(failed.sum()),
        "slides_drawn": slides.planned,
        "calibration": calibration and {**asdict(calibration), "factor": calibration.factor},
        "limit_load": limit_load and asdict(limit_load),
        "grids": _grids(campaign, phases, rough, refined),
        "modes": _modes(found, refined, failed, weight),
        "status": {"rough": _counts(rough), "refined": _counts(refined)},
        "broke_off": {grid: _broken(rows) for grid, rows in (("rough", rough), ("refined", refined))},
        "cut_off": cut,
        "consequences_of_failures": effects.means(campaign, found, refined, slides),
        "exceedance": effects.exceedances(found, refined, slides),
        "risk": effects.risk(campaign, found, refined, slides),
        "fits": _fits(refined, failed, weight),
        "severity": _severity(refined, failed, weight),
        "seconds": {
            grid: float(np.sum(rows.columns["seconds"])) for grid, rows in (("rough", rough), ("refined", refined))
        },
        "refined_runs_allowed": campaign.raised and asdict(campaign.raised),
        "notes": [
            *_limit_load(campaign),
            *found.notes,
            *_walls(rough, refined),
            *_raised(campaign),
            *slides.notes,
            *effects.cut_off_notes(campaign, cut),
            *_still_moving(campaign, phases, refined),
        ],
    }


def slides_of(campaign: Campaign, phases: Phases, refined: Rows) -> Slides:
    """Which refined failures slid on to their end, and what each run stands for then."""
    return Slides.of(phases, refined.numbers, refined.ended, campaign.plan.slides, campaign.plan.seed)


def _after_more_runs(campaign: Campaign, phases: Phases) -> dict[str, Any]:
    """What further refined runs would buy: so many as the budget and the samples leave, and all samples. Coefficients
    of variation are None where the runs do not tell, or the estimator takes no more."""
    found, population = phases.estimate, phases.population
    if population is None:
        return {"runs": 0, "coefficient_of_variation": None, "samples_left": None, "all_samples": None}
    # A sample at which a chain of subset simulation stood still has several places.
    left = np.setdiff1d(population.numbers, list(phases.answers)).size
    budget = campaign.estimator.budget(population.size)
    # Once the budget is spent the folder may allow more.
    allowed = left if budget is None or phases.why_finished else max(budget - len(phases.answers), 0)
    runs = min(MORE, left, allowed)

    def after(more: int) -> float | None:
        if left and not found.audit_variance:
            return None
        return _finite(after_more_runs(found, more if more < left else population.size, samples=population.size))

    then, at_last = after(runs), after(left)
    return {"runs": runs, "coefficient_of_variation": then, "samples_left": left, "all_samples": at_last}


def _still_moving(campaign: Campaign, phases: Phases, refined: Rows) -> list[str]:
    """That runs stood at t_end and had not settled: their class is that of this time."""
    if campaign.run.settle is None:
        return []
    stands = np.array([phases.answers[number] is False for number in refined.numbers], bool)
    moving = stands & (refined.columns["status"] == "FINISHED")
    if not moving.any():
        return []
    return [
        f"{moving.sum()} of {stands.sum()} refined runs that stand had not settled at t_end = {campaign.run.t_end:g} "
        f"s, having moved {refined.columns['displacement'][moving].max():.2g} m at most: they may fail later"
    ]


def _limit_load(campaign: Campaign) -> list[str]:
    found = campaign.measured.limit_load
    if found is None:
        return []
    return [
        f"failure counts from {found.displacement:g} m of {campaign.least_volume or 'any soil'}, where the slope of "
        f"median soil passes its limit load, a factor of safety of {found.factor:.3f}"
    ]


def _convergence(way: list[Estimate]) -> dict[str, list[float]]:
    """The estimate against the refined runs spent."""
    return {
        "refined_runs": [estimate.refined_runs for estimate in way],
        "probability": [estimate.probability for estimate in way],
        "low": [estimate.interval[0] for estimate in way],
        "high": [estimate.interval[1] for estimate in way],
    }


def _grids(campaign: Campaign, phases: Phases, rough: Rows, refined: Rows) -> dict[str, Any] | None:
    """How well the rough grid tells the refined one, over all runs that have a class on both, by their weights in the
    audit: whether a failure slid on to its end does not matter for its class."""
    weights, classes = phases.weights, {n: phases.answer(*result) for n, result in rough.results.items()}
    # A rough sample may lack while its damaged file waits to be redone.
    both = [number for number in refined.numbers if weights[number] > 0 and classes.get(number) is not None]
    if not both:
        return None
    found = correlation(
        _as_far_as_known(rough, both),
        _as_far_as_known(refined, both),
        np.array([weights[number] for number in both]),
        failure_displacement=campaign.run.failure_displacement,
    )
    return None if found is None else {name: _plain(value) for name, value in asdict(found).items()}


def _as_far_as_known(rows: Rows, numbers: list[int]) -> np.ndarray:
    """Largest displacement of these samples (n,) m. Runs that ended once they had failed, or broke off, would have
    moved farther, so nothing tells which of those beyond the least of them moved farthest: they are all alike."""
    at = np.isin(rows.numbers, numbers)
    moved, cut = rows.columns["displacement"][at], (~rows.ended | rows.columns["broke_off"].astype(bool))[at]
    return np.minimum(moved, moved[cut].min(initial=np.inf))


def _modes(found: Estimate, refined: Rows, failed: np.ndarray, weight: np.ndarray) -> dict[str, Any] | None:
    """Count, ratio among the failures and probability of each mode."""
    if "mode" not in refined.columns:
        return None
    told = failed & (refined.columns["mode"] != "") & (weight > 0)
    if not told.any():
        return {}
    parts = shares(refined.columns["mode"][told], weight[told], SEVERITY, level=found.level)
    return {
        mode: {
            "count": part.count,
            "ratio": part.share,
            "interval": list(part.interval),
            "probability": found.probability * part.share,
        }
        for mode, part in parts.items()
    }


def _groups(refined: Rows, failed: np.ndarray, weight: np.ndarray) -> dict[str, np.ndarray]:
    """Failed runs of each mode that occurs, (runs,) bool each."""
    told = failed & (weight > 0) & ~refined.columns.get("broke_off", np.zeros(failed.size)).astype(bool)
    modes = refined.columns.get("mode", np.full(failed.size, ""))
    return {"all": told} | {mode: told & (modes == mode) for mode in SEVERITY if (told & (modes == mode)).any()}


def _fits(refined: Rows, failed: np.ndarray, weight: np.ndarray) -> dict[str, dict[str, Any]]:
    """Fitted distributions of each consequence, of all failures and of each mode, best by AIC first."""
    found: dict[str, dict[str, Any]] = {}
    for group, mine in _groups(refined, failed, weight).items():
        fits = {name: fit_distributions(refined.columns[name][mine], weight[mine]) for name in MEASURES if mine.any()}
        found[group] = {name: _plain(asdict(fit)) for name, fit in fits.items()}
    return found


def _severity(refined: Rows, failed: np.ndarray, weight: np.ndarray) -> dict[str, list[dict[str, Any]]]:
    """Modes by the median of each consequence, most severe first."""
    groups = {mode: mine for mode, mine in _groups(refined, failed, weight).items() if mode != "all"}
    if not groups:
        return {}
    return {
        name: [
            _plain(asdict(place))
            for place in severity_ranking(
                {mode: refined.columns[name][mine] for mode, mine in groups.items()},
                weights={mode: weight[mine] for mode, mine in groups.items()},
            )
        ]
        for name in MEASURES
    }


def _walls(rough: Rows, refined: Rows) -> list[str]:
    """Which walls slides have reached, on the refined grid or, where nothing slid on it, the rough one."""
    for grid, rows in (("refined", refined), ("rough", rough)):
        reached = [place for walls in rows.columns.get("walls", ()) for place in str(walls).split("; ") if place]
        if reached:
            return [
                f"the slide reached {place if place == EDGE else f'the wall at {place}'}, which held it, in {count} "
                f"{grid} run{'s' if count > 1 else ''}: "
                f"{'draw it farther out' if place == EDGE else 'lengthen the ground'} there"
                for place, count in sorted(Counter(reached).items())
            ]
    return []


def _raised(campaign: Campaign) -> list[str]:
    if campaign.raised is None:
        return []
    allowed = campaign.raised
    return [f"the folder allows {allowed.refined_runs} refined runs, the scene {allowed.scene}"]


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


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _plain(value: Any) -> Any:
    """Ready for JSON, which has no infinity and no nan: None stands for them."""
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return _finite(value) if isinstance(value, float) else value
