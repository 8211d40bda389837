"""Risk of the elements that a campaign's slides may reach, and what the slides are that count for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cooperative.estimate import Estimate, Exceedance, chance_of, exceedance, mean_interval, mean_of
from cooperative.measure import SEVERITY
from cooperative.scene import Campaign

MOST_LOSS = 5
"""Samples named that make most of the expected loss."""


@dataclass(frozen=True)
class CutOff:
    """Slides that ended before they came to rest.

    Args:
        of: slides that count.
        at_t_end: those that moved still when they ended.
        broke_off: those that ended for numerical reasons.
        t_end: up to when slides may go on (s).
    """

    of: int
    at_t_end: int
    broke_off: int
    t_end: float


@dataclass(frozen=True)
class Spread:
    """A consequence over the slides.

    Args:
        mean: weighted.
        interval: its confidence limits, None for too few slides.
        smallest: of all slides.
        largest: of all slides.
        at_least: whether the slides would have gone on.
    """

    mean: float
    interval: tuple[float, float] | None
    smallest: float
    largest: float
    at_least: bool


@dataclass(frozen=True)
class Reached:
    """Probability that a slide reaches an element at risk.

    Args:
        probability: over all samples.
        interval: its confidence limits.
        at_least: as in `Spread`.
    """

    probability: float
    interval: tuple[float, float]
    at_least: bool


@dataclass(frozen=True)
class ElementLoss:
    """Expected loss at one element at risk.

    Args:
        value: what it is worth.
        expected: over all samples.
        interval: its confidence limits.
        at_least: as in `Spread`.
    """

    value: float
    expected: float
    interval: tuple[float, float]
    at_least: bool


@dataclass(frozen=True)
class SampleLoss:
    """A sample that is part of the loss.

    Args:
        sample: its number.
        loss: if it fails.
        share: of the expected loss.
    """

    sample: int
    loss: float
    share: float


@dataclass(frozen=True)
class Loss:
    """Expected loss at all elements at risk together.

    Args:
        expected: over all samples.
        interval: its confidence limits.
        at_least: as in `Spread`.
        exceedance: probability of losing more.
        modes: share of the loss by failure mode.
        samples: those with the largest shares.
    """

    expected: float
    interval: tuple[float, float]
    at_least: bool
    exceedance: Exceedance
    modes: Mapping[str, float]
    samples: tuple[SampleLoss, ...]


@dataclass(frozen=True)
class Element:
    """Effects on one element at risk.

    Args:
        reached: probability that a slide arrives.
        thickness: largest of the slides that arrive (m), None where none does.
        speed: largest of the slides that arrive (m/s), None where none does.
        arrival: of the slides that arrive (s), None where none does.
        loss: None where the scene gives no value.
    """

    reached: Reached
    thickness: Spread | None
    speed: Spread | None
    arrival: Spread | None
    loss: ElementLoss | None


@dataclass(frozen=True)
class Risk:
    """Risk of the elements at risk.

    Args:
        places: effects by name of the element, None each while nothing is known of them.
        loss: of all together, None where no element has a value.
    """

    places: Mapping[str, Element | None]
    loss: Loss | None


@dataclass(frozen=True)
class Slid:
    """Slides, a part of the table of refined runs.

    Args:
        columns: by name (n,).
        weight: what each stands for (n,).
    """

    columns: Mapping[str, np.ndarray]
    weight: np.ndarray

    def __getitem__(self, name: str) -> np.ndarray:
        """A column (n,); where the rows, of an earlier version, lack it, nan, no mode and nothing that broke off."""
        absent = {"mode": "", "broke_off": 0.0}.get(name, np.nan)
        return self.columns.get(name, np.full(self.weight.size, absent))

    def where(self, mine: np.ndarray) -> Slid:
        """Some of the slides.

        Args:
            mine: which (n,) bool.
        """
        return Slid({name: each[mine] for name, each in self.columns.items()}, self.weight[mine])


def risk_of(campaign: Campaign, estimate: Estimate, counting: Slid, cut: CutOff, *, unknown: bool) -> Risk | None:
    """What comes over the elements at risk, and what is lost there; None where there are none.

    Nothing is known of an element where no slide has columns.

    Args:
        campaign: whose elements these are.
        estimate: of the probability of failure.
        counting: slides that count.
        cut: slides that had not come to rest.
        unknown: whether no run counts, or some failed and may slide yet.
    """
    if campaign.hazard is None or not campaign.hazard.places:
        return None
    # A slide that broke off has no columns.
    slid = counting.where(np.isfinite(counting["area_columns"]))
    if not slid.weight.size and unknown:
        return Risk(dict.fromkeys(place.name for place in campaign.hazard.places), None)
    weight, elements, at_least = slid.weight, {}, bool(cut.at_t_end)
    lost, bound = np.zeros(weight.size), 0.0
    for exposed in campaign.hazard.places:
        came = {what: slid[f"{what}_at_{exposed.key}"] for what in ("thickness", "speed", "arrival")}
        reached = np.isfinite(came["arrival"])
        chance = chance_of(estimate, weight, reached[:, None])
        low, high = float(chance.low[0]), float(chance.high[0])
        # Nothing that comes after the end of the runs is seen.
        limits = {"arrival": cut.t_end}
        spreads = {
            what: spread_of(
                values[reached], weight[reached], estimate.level, at_least=at_least, most=limits.get(what, np.inf)
            )
            for what, values in came.items()
        }
        loss = None
        if exposed.vulnerability is not None and exposed.value is not None:
            each = np.where(reached, exposed.value * exposed.vulnerability.share(came[exposed.vulnerability.of]), 0.0)
            # Shares of the value do not fall.
            most = exposed.value * exposed.vulnerability.lost[-1] * high
            loss = ElementLoss(exposed.value, *expected_of(estimate, weight, each, most), at_least)
            lost, bound = lost + each, bound + most
        elements[exposed.name] = Element(Reached(float(chance.value[0]), (low, high), at_least), **spreads, loss=loss)
    if all(element.loss is None for element in elements.values()):
        return Risk(elements, None)
    part, whole, modes = weight * lost, float(weight @ lost), slid["mode"]
    loss_of_all = Loss(
        *expected_of(estimate, weight, lost, bound),
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


def expected_of(
    estimate: Estimate, weight: np.ndarray, amount: np.ndarray, bound: float
) -> tuple[float, tuple[float, float]]:
    """Expected value over all samples, and its interval.

    Args:
        estimate: of the probability of failure.
        weight: what each slide stands for (n,).
        amount: that each slide brings (n,).
        bound: limit of the expected value: the upper limit of the probability that anything is lost times all that may
            be lost.
    """
    mean = mean_of(estimate, weight, amount)
    low, high = float(mean.low), float(mean.high)
    return float(mean.value), (low, min(high, bound) if np.isfinite(high) else bound)


def spread_of(values: np.ndarray, weight: np.ndarray, level: float, *, at_least: bool, most: float) -> Spread | None:
    """Mean of a consequence over slides, with its interval; None where no value is known.

    Of runs that stand for nothing the mean is the plain one. Too few runs have no interval, see `mean_interval`.

    Args:
        values: (n,), nan where unknown.
        weight: what each stands for (n,).
        level: confidence level of the interval.
        at_least: whether the runs would have gone on.
        most: limit of the mean.
    """
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
