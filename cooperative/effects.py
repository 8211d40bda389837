"""What the slides of a campaign do, in numbers: means, probabilities of more, exposed places and losses.

A slide that ended before it came to rest would have gone on, so all of this is at least what is given.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cooperative.estimate import Curve, Estimate, Slides, chance_of, exceedance, mean_interval, mean_of
from cooperative.measure import SEVERITY, Place
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
class Spread:
    """A consequence over the slides. mean: weighted. interval: its confidence limits, None for too few slides.
    smallest, largest: of all slides. at_least: whether the slides would have gone on."""

    mean: float
    interval: tuple[float, float] | None
    smallest: float
    largest: float
    at_least: bool


@dataclass(frozen=True)
class Exceedance:
    """Probability that a sample fails and goes beyond each of `thresholds` (k,), with its confidence limits."""

    thresholds: tuple[float, ...]
    probability: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]

    @classmethod
    def of(cls, curve: Curve) -> Exceedance:
        """An exceedance curve without its counts of slides."""
        arrays = curve.thresholds, curve.chance.value, curve.chance.low, curve.chance.high
        return cls(*(tuple(array.tolist()) for array in arrays))


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


def cut_off(campaign: Campaign, refined: Rows, slides: Slides) -> CutOff:
    """How many of the slides that count had not come to rest at their end, at `t_end` (s) or because they broke off."""
    mine = slides.slid & (slides.weight > 0)
    status = refined.columns["status"][mine]
    broke_off = refined.columns.get("broke_off", np.zeros(mine.size))[mine].astype(bool)
    return CutOff(
        of=int(mine.sum()),
        at_t_end=int(np.sum((status == "FINISHED") & ~broke_off)),
        broke_off=int(broke_off.sum()),
        t_end=campaign.run.last("refined"),
    )


def cut_off_notes(campaign: Campaign, cut: CutOff) -> list[str]:
    """That slides ended before they came to rest, in words."""
    notes = []
    if cut.at_t_end:
        how = "had not come to rest" if campaign.run.settle else "were not looked at for rest (settle = false)"
        notes.append(
            f"{cut.at_t_end} of {cut.of} slides {how} when they ended at {cut.t_end:g} s: all that slides do "
            "is at least what is given. A later [run] slides_t_end lets slides run on"
        )
    if cut.broke_off:
        notes.append(
            f"{cut.broke_off} of {cut.of} slides broke off: their displacement is at least what is given, and "
            "they have no part in the other consequences"
        )
    return notes


def means(campaign: Campaign, estimate: Estimate, refined: Rows, slides: Slides) -> dict[str, Spread | None]:
    """Weighted mean of each consequence with its interval, smallest and largest; None where no slide has it, and
    nothing without a slide."""
    if not slides.slid.any():
        return {}
    cut = cut_off(campaign, refined, slides)
    # No soil lies deeper than the ground.
    most = {"depth": campaign.site.shape.extent[-1]}
    return {
        name: _spread(
            measure(refined, name)[slides.slid],
            slides.weight[slides.slid],
            estimate.level,
            at_least=bool(cut.at_t_end or (cut.broke_off and name == "displacement")),
            most=most.get(name, np.inf),
        )
        for name in MEASURES
    }


def exceedances(estimate: Estimate, refined: Rows, slides: Slides) -> dict[str, Exceedance]:
    """Probability that a sample fails and goes beyond each threshold, failures that stay below included; nothing where
    no slide has consequences."""
    curves = {}
    for name in CURVES:
        values = measure(refined, name)
        mine = slides.slid & (slides.weight > 0) & np.isfinite(values)
        if mine.any():
            curves[name] = Exceedance.of(exceedance(estimate, slides.weight[mine], values[mine]))
    return curves


def risk(campaign: Campaign, estimate: Estimate, refined: Rows, slides: Slides) -> Risk | None:
    """What comes over the elements at risk, and what is lost there; None where there are none. Of an element nothing is
    known while no run counts, or runs failed and none of them has slid to its end."""
    if campaign.hazard is None or not campaign.hazard.places:
        return None
    # A slide that broke off has no columns.
    mine = slides.slid & (slides.weight > 0) & np.isfinite(measure(refined, "area_columns"))
    if not mine.any() and (slides.failed.any() or not slides.weight.any()):
        return Risk(dict.fromkeys(place.name for place in campaign.hazard.places), None)
    weight, elements = slides.weight[mine], {}
    at_least = bool(cut_off(campaign, refined, slides).at_t_end)
    lost, bound = np.zeros(weight.size), 0.0
    for place in campaign.hazard.places:
        came = {what: measure(refined, f"{what}_at_{place.key}")[mine] for what in ("thickness", "speed", "arrival")}
        reached = np.isfinite(came["arrival"])
        chance = chance_of(estimate, weight, reached[:, None])
        # Nothing that comes after the end of the runs is seen.
        limits = {"arrival": campaign.run.last("refined")}
        spreads = {
            what: _spread(
                values[reached], weight[reached], estimate.level, at_least=at_least, most=limits.get(what, np.inf)
            )
            for what, values in came.items()
        }
        loss = None
        if place.vulnerability is not None and place.value is not None:
            each = np.where(reached, place.value * place.vulnerability.share(came[place.vulnerability.of]), 0.0)
            most = _most_lost(place) * float(chance.high[0])
            loss = ElementLoss(place.value, *_expected(estimate, weight, each, most), at_least)
            lost, bound = lost + each, bound + most
        low, high = float(chance.low[0]), float(chance.high[0])
        elements[place.name] = Element(Reached(float(chance.value[0]), (low, high), at_least), **spreads, loss=loss)
    if all(element.loss is None for element in elements.values()):
        return Risk(elements, None)
    exceeded, modes, samples = _of_loss(estimate, refined, mine, weight, lost)
    return Risk(elements, Loss(*_expected(estimate, weight, lost, bound), at_least, exceeded, modes, samples))


def measure(rows: Rows, name: str) -> np.ndarray:
    """A consequence of each run (runs,), nan where it has none: those that broke off have not."""
    return rows.columns.get(name, np.full(len(rows.numbers), np.nan))


def _of_loss(
    estimate: Estimate, refined: Rows, mine: np.ndarray, weight: np.ndarray, lost: np.ndarray
) -> tuple[Exceedance, dict[str, float], tuple[SampleLoss, ...]]:
    """Probability of losing more at all elements together, and which modes and samples make the loss. mine: slides that
    count (runs,) bool. weight, lost: of each of them (n,)."""
    modes = refined.columns.get("mode", np.full(mine.size, ""))[mine]
    whole, number = float(weight @ lost), refined.columns["sample"][mine]
    most = [at for at in np.argsort(-weight * lost, kind="stable")[:MOST_LOSS] if lost[at] > 0]
    return (
        Exceedance.of(exceedance(estimate, weight, lost, np.unique(np.concatenate([[0.0], lost])))),
        {mode: float((weight * lost)[modes == mode].sum() / whole) for mode in SEVERITY if mode in modes and whole},
        tuple(SampleLoss(int(number[at]), float(lost[at]), float(weight[at] * lost[at] / whole)) for at in most),
    )


def _most_lost(place: Place) -> float:
    """What is lost at most where a slide comes; shares of the value do not fall."""
    assert place.value is not None
    assert place.vulnerability is not None
    return place.value * place.vulnerability.lost[-1]


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
