"""A campaign in numbers, from its rows alone: probability, modes, consequences, how well the grids agree."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from cooperative import effects
from cooperative.effects import MEASURES, CutOff, Exceedance, Risk, Spread
from cooperative.estimate import (
    Correlation,
    Estimate,
    Fits,
    Phases,
    Severity,
    Slides,
    after_more_runs,
    correlation,
    fit_distributions,
    severity_ranking,
    shares,
)
from cooperative.measure import EDGE, SEVERITY
from cooperative.runs import phases_of, sampling_of
from cooperative.scene import Budget, Calibration, Campaign, LimitLoad
from cooperative.store import Rows, Store
from foundation import files

NOT_BROKEN = ("FINISHED", "SETTLED", "DECIDED")
CHECKSUM = "checksum"
"""Key of a summary that tells whether it is whole, and of which rows."""
CONTENT = 7
"""Of what a summary says, counted up when it says more: one of an earlier version is made anew."""
MADE_FROM = ("measured.json", "budget.json")
"""Files of a campaign's folder that say what its scene and rows do not."""
MORE = 50
"""What so many more refined runs would buy is told, or fewer where no more are left."""


@dataclass(frozen=True)
class OtherEstimate:
    """Probability of failure by another estimator from the same runs, with its confidence limits."""

    probability: float
    interval: tuple[float, float]


@dataclass(frozen=True)
class MoreRuns:
    """What further refined runs would buy. runs: so many as the budget and the samples leave, at most `MORE`.
    coefficient_of_variation, all_samples: after these runs, and after all samples; None where the runs do not tell, or
    the estimator takes no more. samples_left: not run refined yet, None while the first phase is not complete."""

    runs: int
    coefficient_of_variation: float | None
    samples_left: int | None
    all_samples: float | None


@dataclass(frozen=True)
class Convergence:
    """The estimate and its confidence limits after so many refined runs (k,) each."""

    refined_runs: tuple[int, ...]
    probability: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]


@dataclass(frozen=True)
class ModeShare:
    """A failure mode. count: refined runs that failed so. ratio: weighted share of the failures, with its confidence
    limits. probability: that a sample fails so."""

    count: int
    ratio: float
    interval: tuple[float, float]
    probability: float


@dataclass(frozen=True)
class Summary:
    """A campaign in numbers.

    name: of the campaign. probability_of_failure: by the `estimator`, with its confidence limits, the interval, at
    `level` and its coefficient_of_variation, None at 0. unseen, sampling_interval: as in `Estimate`. finished: why no
    further run is asked for, None where some are. after_more_runs: what these would buy. other_estimates: by estimator.
    convergence: the estimate as refined runs came in. samples, failures_rough: on the rough grid. refined_runs,
    failures_refined: on the refined grid. slides: failures that slid on to their end; slides_drawn: that there are in
    the end, as far as is known. calibration, limit_load: as measured before the first run, None where not asked for.
    grids: how well the rough grid tells the refined one, None without any spread. modes: by name, None where the rows
    have none. status: count of runs by how they ended, of each grid. broke_off: by grid and sample, why and at which
    step. cut_off: slides that had not come to rest. consequences_of_failures: by name, None where no slide has it.
    exceedance: by consequence. risk: of the elements at risk, None without any. fits: by group ("all" or a mode) and
    consequence. severity: modes by the median of each consequence, most severe first. seconds: of all runs of each grid
    (s). refined_runs_allowed: where the folder allows more than the scene. notes: what a reader must know, in words.
    estimate_runs, audit_variance, freedom: as in `Estimate`, whose refined_runs are the first, None for no limit.
    planned_samples: on the rough grid in the end.
    failure_displacement (m), least_volume (m3, in a section m2; None for any particle): from which on a slope fails.
    settle: whether a run ends once it has settled. slide_weights: by sample, what each slide stands for.
    """

    name: str
    probability_of_failure: float
    interval: tuple[float, float]
    level: float
    estimator: str
    coefficient_of_variation: float | None
    unseen: float
    sampling_interval: tuple[float, float] | None
    finished: str | None
    after_more_runs: MoreRuns
    other_estimates: Mapping[str, OtherEstimate]
    convergence: Convergence
    samples: int
    failures_rough: int
    refined_runs: int
    failures_refined: int
    slides: int
    slides_drawn: int
    calibration: Calibration | None
    limit_load: LimitLoad | None
    grids: Correlation | None
    modes: Mapping[str, ModeShare] | None
    status: Mapping[str, Mapping[str, int]]
    broke_off: Mapping[str, Mapping[int, str]]
    cut_off: CutOff
    consequences_of_failures: Mapping[str, Spread | None]
    exceedance: Mapping[str, Exceedance]
    risk: Risk | None
    fits: Mapping[str, Mapping[str, Fits]]
    severity: Mapping[str, tuple[Severity, ...]]
    seconds: Mapping[str, float]
    refined_runs_allowed: Budget | None
    notes: tuple[str, ...]
    estimate_runs: int
    audit_variance: float
    freedom: float | None
    planned_samples: int
    failure_displacement: float
    least_volume: float | None
    settle: bool
    slide_weights: Mapping[int, float]

    @property
    def estimate(self) -> Estimate:
        """The probability of failure as the estimator gave it, without its notes."""
        return Estimate(
            self.probability_of_failure,
            self.interval,
            np.inf if self.coefficient_of_variation is None else self.coefficient_of_variation,
            self.estimate_runs,
            self.estimator,
            self.level,
            audit_variance=self.audit_variance,
            unseen=self.unseen,
            sampling_interval=self.sampling_interval,
            freedom=np.inf if self.freedom is None else self.freedom,
        )

    def as_json(self) -> dict[str, Any]:
        """Its fields as JSON has them, which `from_json` reads: a number that is not finite is null."""
        fields: dict[str, Any] = _plain(asdict(self))
        if self.calibration is not None:
            fields["calibration"]["factor"] = self.calibration.factor
        return fields

    @classmethod
    def from_json(cls, text: str | bytes) -> Summary:
        """A summary from the JSON of `as_json`, without keys that are no field. Raises ValueError for anything else."""
        return _SUMMARY.validate_json(text, strict=True)


_SUMMARY = TypeAdapter(Summary)


def summarise(campaign: Campaign, rough: Rows, refined: Rows) -> Summary:
    """The campaign in numbers. Means, shares and fits weigh every refined run by what it stands for; where only some
    failures slid on to their end, these stand for all (see `slide_weights`).

    What there is too little of is None or says so: modes of rows that have none (written before modes were kept), fits
    of fewer than two failures, a correlation without spread.
    """
    phases = phases_of(campaign, rough, refined)
    estimate, slides = phases.estimate, slides_of(campaign, phases, refined)
    weight, slid = slides.weight, slides.slid
    limit, cut = campaign.run.failure_displacement, effects.cut_off(campaign, refined, slides)
    return Summary(
        name=campaign.name,
        probability_of_failure=estimate.probability,
        interval=estimate.interval,
        level=estimate.level,
        estimator=estimate.method,
        coefficient_of_variation=_finite(estimate.cov),
        unseen=estimate.unseen,
        sampling_interval=estimate.sampling_interval,
        finished=phases.why_finished,
        after_more_runs=_after_more_runs(campaign, phases),
        other_estimates={each.method: OtherEstimate(each.probability, each.interval) for each in phases.beside},
        convergence=_convergence(phases.path),
        samples=len(rough.numbers),
        failures_rough=int(np.sum(rough.columns["displacement"] > limit)),
        refined_runs=len(refined.numbers),
        failures_refined=int(slides.failed.sum()),
        slides=int(slid.sum()),
        slides_drawn=slides.planned,
        calibration=campaign.measured.calibration,
        limit_load=campaign.measured.limit_load,
        grids=_grids(campaign, phases, rough, refined),
        modes=_modes(estimate, refined, slid, weight),
        status={"rough": _counts(rough), "refined": _counts(refined)},
        broke_off={"rough": _broken(rough), "refined": _broken(refined)},
        cut_off=cut,
        consequences_of_failures=effects.means(campaign, estimate, refined, slides),
        exceedance=effects.exceedances(estimate, refined, slides),
        risk=effects.risk(campaign, estimate, refined, slides),
        fits=_fits(refined, slid, weight),
        severity=_severity(refined, slid, weight),
        seconds={
            grid: float(np.sum(rows.columns["seconds"])) for grid, rows in (("rough", rough), ("refined", refined))
        },
        refined_runs_allowed=campaign.raised,
        notes=(
            *_limit_load(campaign),
            *estimate.notes,
            *_walls(rough, refined),
            *_raised(campaign),
            *slides.notes,
            *effects.cut_off_notes(campaign, cut),
            *_still_moving(campaign, phases, refined),
        ),
        estimate_runs=estimate.refined_runs,
        audit_variance=estimate.audit_variance,
        freedom=_finite(estimate.freedom),
        planned_samples=campaign.estimator.rough_runs(sampling_of(campaign)),
        failure_displacement=limit,
        least_volume=campaign.run.least_volume,
        settle=campaign.run.settle is not None,
        slide_weights={refined.numbers[at]: float(weight[at]) for at in np.flatnonzero(slid)},
    )


def write(campaign: Campaign, store: Store, rough: Rows, refined: Rows) -> Summary:
    """The summary of these rows, written to `summary.json` too. OSError where the disk refuses."""
    made = summarise(campaign, rough, refined)
    fields = made.as_json()
    fields[CHECKSUM] = _checksum(store, rough, refined, fields)
    files.write_aside(store.folder / "summary.json", json.dumps(fields, indent=1).encode())
    return made


def stored(store: Store, rough: Rows, refined: Rows) -> Summary | None:
    """The summary in `summary.json`, None where it is not whole, or not of just these rows and this version."""
    try:
        text = files.read_plain(store.folder / "summary.json")
        fields = json.loads(text)
        if fields.pop(CHECKSUM) == _checksum(store, rough, refined, fields):
            return Summary.from_json(text)
    except (OSError, ValueError, TypeError, AttributeError, KeyError, RecursionError):
        pass
    return None


def _checksum(store: Store, rough: Rows, refined: Rows, fields: dict[str, Any]) -> str:
    """SHA-256 of the fields of a summary and of all that it was made from."""
    digest = hashlib.sha256("\0".join((str(CONTENT), store.digest, json.dumps(fields, sort_keys=True))).encode())
    for name in MADE_FROM:
        path = store.folder / name
        digest.update(files.read_plain(path) if path.exists() else b"")
    for rows in (rough, refined):
        for name, values in sorted(rows.columns.items()):
            digest.update(f"{name} {values.dtype} {values.size}".encode() + np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def slides_of(campaign: Campaign, phases: Phases, refined: Rows) -> Slides:
    """Which refined failures slid on to their end, and what each run stands for then."""
    return Slides.of(phases, refined.numbers, refined.ended, campaign.plan.slides, campaign.plan.seed)


def _after_more_runs(campaign: Campaign, phases: Phases) -> MoreRuns:
    found, population = phases.estimate, phases.population
    if population is None:
        return MoreRuns(0, None, None, None)
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

    return MoreRuns(runs, after(runs), left, after(left))


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


def _convergence(path: Sequence[Estimate]) -> Convergence:
    """The estimate against the refined runs spent."""
    return Convergence(
        refined_runs=tuple(estimate.refined_runs for estimate in path),
        probability=tuple(estimate.probability for estimate in path),
        low=tuple(estimate.interval[0] for estimate in path),
        high=tuple(estimate.interval[1] for estimate in path),
    )


def _grids(campaign: Campaign, phases: Phases, rough: Rows, refined: Rows) -> Correlation | None:
    """How well the rough grid tells the refined one, over all runs that have a class on both, by their weights in the
    audit: whether a failure slid on to its end does not matter for its class."""
    weights, classes = phases.weights, {n: phases.answer(*result) for n, result in rough.results.items()}
    # A rough sample may lack while its damaged file waits to be redone.
    both = [number for number in refined.numbers if weights[number] > 0 and classes.get(number) is not None]
    if not both:
        return None
    return correlation(
        _as_far_as_known(rough, both),
        _as_far_as_known(refined, both),
        np.array([weights[number] for number in both]),
        failure_displacement=campaign.run.failure_displacement,
    )


def _as_far_as_known(rows: Rows, numbers: list[int]) -> np.ndarray:
    """Largest displacement of these samples (n,) m. Runs that ended once they had failed, or broke off, would have
    moved farther, so nothing tells which of those beyond the least of them moved farthest: they are all alike."""
    at = np.isin(rows.numbers, numbers)
    moved, cut = rows.columns["displacement"][at], (~rows.ended | rows.columns["broke_off"].astype(bool))[at]
    return np.minimum(moved, moved[cut].min(initial=np.inf))


def _modes(estimate: Estimate, refined: Rows, failed: np.ndarray, weight: np.ndarray) -> dict[str, ModeShare] | None:
    """Count, ratio among the failures and probability of each mode."""
    if "mode" not in refined.columns:
        return None
    known = failed & (refined.columns["mode"] != "") & (weight > 0)
    if not known.any():
        return {}
    parts = shares(refined.columns["mode"][known], weight[known], SEVERITY, level=estimate.level)
    return {
        mode: ModeShare(part.count, part.share, part.interval, estimate.probability * part.share)
        for mode, part in parts.items()
    }


def _groups(refined: Rows, failed: np.ndarray, weight: np.ndarray) -> dict[str, np.ndarray]:
    """Failed runs of each mode that occurs, (runs,) bool each."""
    told = failed & (weight > 0) & ~refined.columns.get("broke_off", np.zeros(failed.size)).astype(bool)
    modes = refined.columns.get("mode", np.full(failed.size, ""))
    return {"all": told} | {mode: told & (modes == mode) for mode in SEVERITY if (told & (modes == mode)).any()}


def _fits(refined: Rows, failed: np.ndarray, weight: np.ndarray) -> dict[str, dict[str, Fits]]:
    """Fitted distributions of each consequence, of all failures and of each mode, best by AIC first."""
    return {
        group: {name: fit_distributions(refined.columns[name][mine], weight[mine]) for name in MEASURES if mine.any()}
        for group, mine in _groups(refined, failed, weight).items()
    }


def _severity(refined: Rows, failed: np.ndarray, weight: np.ndarray) -> dict[str, tuple[Severity, ...]]:
    """Modes by the median of each consequence, most severe first."""
    groups = {mode: mine for mode, mine in _groups(refined, failed, weight).items() if mode != "all"}
    if not groups:
        return {}
    return {
        name: tuple(
            severity_ranking(
                {mode: refined.columns[name][mine] for mode, mine in groups.items()},
                weights={mode: weight[mine] for mode, mine in groups.items()},
            )
        )
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


def _broken(rows: Rows) -> dict[int, str]:
    """Samples whose run broke off: why, and at which step."""
    columns = rows.columns
    return {
        number: f"{status} at step {steps}"
        for number, status, steps in zip(rows.numbers, columns["status"], columns["steps"], strict=True)
        if status not in NOT_BROKEN
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _plain(value: Any) -> Any:
    """Ready for JSON, which has no infinity and no nan: None stands for them. Its keys are texts."""
    if isinstance(value, dict):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return _finite(value) if isinstance(value, float) else value
