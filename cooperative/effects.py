"""What the slides of a campaign do, in numbers: modes, means, probabilities of more, exposed places, losses, fits.

A slide that ended before it came to rest would have gone on, so all of this is at least what is given.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cooperative.estimate import (
    Estimate,
    Exceedance,
    Fits,
    Severity,
    Slides,
    chance_of,
    exceedance,
    fit_distributions,
    mean_interval,
    mean_of,
    severity_ranking,
    shares,
)
from cooperative.measure import SEVERITY
from cooperative.scene import Campaign
from cooperative.store import Rows

MEASURES = ("displacement", "depth", "runout", "volume", "area")
CURVES = ("runout", "volume", "depth")
"""Consequences whose probability of being exceeded is told."""
MOST_LOSS = 5
"""Samples named that make most of the expected loss."""


@dataclass(frozen=True)
class CutOff:
    """Slides that ended before they came to rest. of: slides that count. at_t_end: those that moved still when they
    ended. broke_off: those that ended for numerical reasons. t_end: up to when slides may go on (s)."""

    of: int
    at_t_end: int
    broke_off: int
    t_end: float


@dataclass(frozen=True)
class ModeShare:
    """A failure mode. count: refined runs that failed so. ratio: weighted share of the failures, with its confidence
    limits. probability: that a sample fails so."""

    count: int
    ratio: float
    interval: tuple[float, float]
    probability: float


@dataclass(frozen=True)
class Spread:
    """A consequence over the slides. mean: weighted. interval: its confidence limits, None for too few slides.
    smallest, largest: of all slides. at_least: whether the slides would have gone on."""

    mean: float
    interval: tuple[float, float] | None
    smallest: float
    largest: float
    at_least: bool


@dataclass(frozen=True)
class Reached:
    """Probability that a slide reaches an element at risk, with its confidence limits. at_least: as in `Spread`."""

    probability: float
    interval: tuple[float, float]
    at_least: bool


@dataclass(frozen=True)
class ElementLoss:
    """Expected loss at one element at risk, with its confidence limits. value: what it is worth. at_least: as in
    `Spread`."""

    value: float
    expected: float
    interval: tuple[float, float]
    at_least: bool


@dataclass(frozen=True)
class SampleLoss:
    """A sample that is part of the loss. loss: if it fails. share: of the expected loss."""

    sample: int
    loss: float
    share: float


@dataclass(frozen=True)
class Loss:
    """Expected loss at all elements at risk together, with its confidence limits. at_least: as in `Spread`. exceedance:
    probability of losing more. modes: share of the loss by failure mode. samples: those with the largest shares."""

    expected: float
    interval: tuple[float, float]
    at_least: bool
    exceedance: Exceedance
    modes: Mapping[str, float]
    samples: tuple[SampleLoss, ...]


@dataclass(frozen=True)
class Element:
    """What comes over one element at risk. thickness (m), speed (m/s), arrival (s): of the slides that come, None where
    none does. loss: None where the scene gives no value."""

    reached: Reached
    thickness: Spread | None
    speed: Spread | None
    arrival: Spread | None
    loss: ElementLoss | None


@dataclass(frozen=True)
class Risk:
    """places: the elements at risk by name; None each while nothing is known of them. loss: of all together, None
    where no element has a value."""

    places: Mapping[str, Element | None]
    loss: Loss | None


@dataclass(frozen=True)
class Effects:
    """What the slides do; each field as in `cooperative.Summary`."""

    cut_off: CutOff
    modes: Mapping[str, ModeShare] | None
    consequences_of_failures: Mapping[str, Spread | None]
    exceedance: Mapping[str, Exceedance]
    risk: Risk | None
    fits: Mapping[str, Mapping[str, Fits]]
    severity: Mapping[str, tuple[Severity, ...]]


@dataclass(frozen=True)
class _Slid:
    """Slides (n,), a part of the table of refined runs. columns: by name. weight: what each stands for."""

    columns: Mapping[str, np.ndarray]
    weight: np.ndarray

    def __getitem__(self, name: str) -> np.ndarray:
        """A column (n,); where the rows, of an earlier version, lack it, nan, no mode and nothing that broke off."""
        absent = {"mode": "", "broke_off": 0.0}.get(name, np.nan)
        return self.columns.get(name, np.full(self.weight.size, absent))

    def where(self, mine: np.ndarray) -> _Slid:
        """Some of them. mine: (n,) bool."""
        return _Slid({name: each[mine] for name, each in self.columns.items()}, self.weight[mine])


def effects_of(campaign: Campaign, estimate: Estimate, refined: Rows, slides: Slides) -> Effects:
    """What the refined runs that slid on to their end do, each weighed by what it stands for."""
    slid = _Slid(refined.columns, slides.weight).where(slides.slid)
    counting = slid.where(slid.weight > 0)
    broke_off = counting["broke_off"].astype(bool)
    cut = CutOff(
        of=broke_off.size,
        at_t_end=int(np.sum((counting["status"] == "FINISHED") & ~broke_off)),
        broke_off=int(broke_off.sum()),
        t_end=campaign.run.last("refined"),
    )
    whole = counting.where(~broke_off)
    by_mode = {mode: whole.where(whole["mode"] == mode) for mode in SEVERITY if mode in whole["mode"]}
    unknown = slides.failed.any() or not slides.weight.any()
    return Effects(
        cut_off=cut,
        modes=_modes(estimate, counting),
        consequences_of_failures=_means(campaign, estimate.level, slid, cut),
        exceedance={
            name: exceedance(estimate, known.weight, known[name])
            for name in CURVES
            if (known := counting.where(np.isfinite(counting[name]))).weight.size
        },
        risk=_risk(campaign, estimate, counting, cut, unknown=bool(unknown)),
        fits={
            group: {name: fit_distributions(mine[name], mine.weight) for name in MEASURES if mine.weight.size}
            for group, mine in ({"all": whole} | by_mode).items()
        },
        severity={
            name: tuple(
                severity_ranking(
                    {mode: mine[name] for mode, mine in by_mode.items()},
                    weights={mode: mine.weight for mode, mine in by_mode.items()},
                )
            )
            for name in MEASURES
            if by_mode
        },
    )


def _modes(estimate: Estimate, counting: _Slid) -> dict[str, ModeShare] | None:
    """Count, ratio among the failures and probability of each mode; None where the rows have none."""
    if "mode" not in counting.columns:
        return None
    known = counting.where(counting["mode"] != "")
    parts = shares(known["mode"], known.weight, SEVERITY, level=estimate.level) if known.weight.size else {}
    return {
        mode: ModeShare(part.count, part.share, part.interval, estimate.probability * part.share)
        for mode, part in parts.items()
    }


def _means(campaign: Campaign, level: float, slid: _Slid, cut: CutOff) -> dict[str, Spread | None]:
    """Weighted mean of each consequence with its interval, smallest and largest; None where no slide has it, and
    nothing without a slide."""
    # No soil lies deeper than the ground.
    most = {"depth": campaign.site.shape.extent[-1]}
    return {
        name: _spread(
            slid[name], slid.weight, level,
            at_least=bool(cut.at_t_end or (cut.broke_off and name == "displacement")), most=most.get(name, np.inf),
        )
        for name in MEASURES
        if slid.weight.size
    }  # fmt: skip


def _risk(campaign: Campaign, estimate: Estimate, counting: _Slid, cut: CutOff, *, unknown: bool) -> Risk | None:
    """What comes over the elements at risk, and what is lost there; None where there are none. Of an element nothing is
    known where no slide has columns. unknown: no run counts, or some failed and may slide yet."""
    if campaign.hazard is None or not campaign.hazard.places:
        return None
    # A slide that broke off has no columns.
    slid = counting.where(np.isfinite(counting["area_columns"]))
    if not slid.weight.size and unknown:
        return Risk(dict.fromkeys(place.name for place in campaign.hazard.places), None)
    weight, elements, at_least = slid.weight, {}, bool(cut.at_t_end)
    lost, bound = np.zeros(weight.size), 0.0
    for place in campaign.hazard.places:
        came = {what: slid[f"{what}_at_{place.key}"] for what in ("thickness", "speed", "arrival")}
        reached = np.isfinite(came["arrival"])
        chance = chance_of(estimate, weight, reached[:, None])
        low, high = float(chance.low[0]), float(chance.high[0])
        # Nothing that comes after the end of the runs is seen.
        limits = {"arrival": cut.t_end}
        spreads = {
            what: _spread(
                values[reached], weight[reached], estimate.level, at_least=at_least, most=limits.get(what, np.inf)
            )
            for what, values in came.items()
        }
        loss = None
        if place.vulnerability is not None and place.value is not None:
            each = np.where(reached, place.value * place.vulnerability.share(came[place.vulnerability.of]), 0.0)
            # Shares of the value do not fall.
            most = place.value * place.vulnerability.lost[-1] * high
            loss = ElementLoss(place.value, *_expected(estimate, weight, each, most), at_least)
            lost, bound = lost + each, bound + most
        elements[place.name] = Element(Reached(float(chance.value[0]), (low, high), at_least), **spreads, loss=loss)
    if all(element.loss is None for element in elements.values()):
        return Risk(elements, None)
    part, whole, modes = weight * lost, float(weight @ lost), slid["mode"]
    loss_of_all = Loss(
        *_expected(estimate, weight, lost, bound),
        at_least,
        exceedance=exceedance(estimate, weight, lost, np.unique(np.concatenate([[0.0], lost]))),
        modes={mode: float(part[modes == mode].sum() / whole) for mode in SEVERITY if mode in modes and whole},
        samples=tuple(
            SampleLoss(int(slid["sample"][at]), float(lost[at]), float(part[at] / whole))
            for at in np.argsort(-part, kind="stable")[:MOST_LOSS]
            if lost[at] > 0
        ),
    )
    return Risk(elements, loss_of_all)


def _expected(
    estimate: Estimate, weight: np.ndarray, amount: np.ndarray, bound: float
) -> tuple[float, tuple[float, float]]:
    """Expected value over all samples, and its interval. bound: what it is at most, the upper limit of the probability
    that anything is lost times all that may be lost."""
    mean = mean_of(estimate, weight, amount)
    low, high = float(mean.low), float(mean.high)
    return float(mean.value), (low, min(high, bound) if np.isfinite(high) else bound)


def _spread(values: np.ndarray, weight: np.ndarray, level: float, *, at_least: bool, most: float) -> Spread | None:
    """Spread of `values` (n,), None where none is known; of runs that stand for nothing the plain mean. No
    interval for too few runs (see `mean_interval`). at_least: whether the runs would have gone on. most: no mean is
    larger."""
    known = np.isfinite(values)
    values, weight = values[known], weight[known]
    if not values.size:
        return None
    mean = float(weight @ values / weight.sum()) if weight.any() else float(values.mean())
    stands = weight > 0
    interval = mean_interval(values[stands], weight[stands], level=level) if stands.any() else None
    return Spread(
        mean,
        interval and (interval[0], max(min(interval[1], most), mean)),
        float(values.min()),
        float(values.max()),
        at_least and bool(values.min() < most * (1 - 1e-3)),
    )
