"""What the slides of a campaign do, in numbers: means, probabilities of more, exposed places and losses.

A slide that ended before it came to rest would have gone on, so all of this is at least what is given.
"""

from __future__ import annotations

from typing import Any

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


def cut_off(campaign: Campaign, refined: Rows, slides: Slides) -> dict[str, Any]:
    """How many of the slides that count had not come to rest at their end, at `t_end` (s) or because they broke off."""
    mine = slides.slid & (slides.weight > 0)
    status = refined.columns["status"][mine]
    broke_off = refined.columns.get("broke_off", np.zeros(mine.size))[mine].astype(bool)
    return {
        "of": int(mine.sum()),
        "at_t_end": int(np.sum((status == "FINISHED") & ~broke_off)),
        "broke_off": int(broke_off.sum()),
        "t_end": campaign.run.last("refined"),
    }


def cut_off_notes(campaign: Campaign, cut: dict[str, Any]) -> list[str]:
    """That slides ended before they came to rest, in words."""
    found = []
    if cut["at_t_end"]:
        how = "had not come to rest" if campaign.run.settle else "were not looked at for rest (settle = false)"
        found.append(
            f"{cut['at_t_end']} of {cut['of']} slides {how} when they ended at {cut['t_end']:g} s: all that slides do "
            "is at least what is given. A later [run] slides_t_end lets slides run on"
        )
    if cut["broke_off"]:
        found.append(
            f"{cut['broke_off']} of {cut['of']} slides broke off: their displacement is at least what is given, and "
            "they have no part in the other consequences"
        )
    return found


def means(campaign: Campaign, found: Estimate, refined: Rows, slides: Slides) -> dict[str, Any]:
    """Weighted mean of each consequence with its interval, smallest and largest; nothing without a slide."""
    if not slides.slid.any():
        return {}
    cut = cut_off(campaign, refined, slides)
    # No soil lies deeper than the ground.
    most = {"depth": campaign.site.shape.extent[-1]}
    return {
        name: _spread(
            measure(refined, name)[slides.slid],
            slides.weight[slides.slid],
            found.level,
            at_least=bool(cut["at_t_end"] or (cut["broke_off"] and name == "displacement")),
            most=most.get(name, np.inf),
        )
        for name in MEASURES
    }


def exceedances(found: Estimate, refined: Rows, slides: Slides) -> dict[str, Any]:
    """Probability that a sample fails and goes beyond each threshold, failures that stay below included; nothing where
    no slide has consequences."""
    curves = {}
    for name in CURVES:
        values = measure(refined, name)
        mine = slides.slid & (slides.weight > 0) & np.isfinite(values)
        if mine.any():
            curves[name] = _curve(exceedance(found, slides.weight[mine], values[mine]))
    return curves


def risk(campaign: Campaign, found: Estimate, refined: Rows, slides: Slides) -> dict[str, Any] | None:
    """What comes over the exposed places, and what is lost there; None where there are none. Of a place nothing is
    known, None, while no run counts, or runs failed and none of them has slid to its end."""
    if campaign.hazard is None or not campaign.hazard.places:
        return None
    # A slide that broke off has no columns.
    mine = slides.slid & (slides.weight > 0) & np.isfinite(measure(refined, "area_columns"))
    if not mine.any() and (slides.failed.any() or not slides.weight.any()):
        return {"places": dict.fromkeys(place.name for place in campaign.hazard.places), "loss": None}
    weight, places = slides.weight[mine], {}
    at_least = bool(cut_off(campaign, refined, slides)["at_t_end"])
    lost, bound = np.zeros(weight.size), 0.0
    for place in campaign.hazard.places:
        came = {what: measure(refined, f"{what}_at_{place.key}")[mine] for what in ("thickness", "speed", "arrival")}
        reached = np.isfinite(came["arrival"])
        chance = chance_of(found, weight, reached[:, None])
        told: dict[str, Any] = {
            "reached": {
                "probability": float(chance.value[0]),
                "interval": [float(chance.low[0]), float(chance.high[0])],
                "at_least": at_least,
            }
        }
        for what, values in came.items():
            # Nothing that comes after the end of the runs is seen.
            most = campaign.run.last("refined") if what == "arrival" else np.inf
            told[what] = _spread(values[reached], weight[reached], found.level, at_least=at_least, most=most)
        if place.vulnerability is not None and place.value is not None:
            each = np.where(reached, place.value * place.vulnerability.share(came[place.vulnerability.of]), 0.0)
            most = _most_lost(place) * float(chance.high[0])
            told["loss"] = {"value": place.value, **_expected(found, weight, each, most, at_least=at_least)}
            lost, bound = lost + each, bound + most
        places[place.name] = told
    if not any("loss" in told for told in places.values()):
        return {"places": places, "loss": None}
    loss = _expected(found, weight, lost, bound, at_least=at_least) | _loss(found, refined, mine, weight, lost)
    return {"places": places, "loss": loss}


def measure(rows: Rows, name: str) -> np.ndarray:
    """A consequence of each run (runs,), nan where it has none: those that broke off have not."""
    return rows.columns.get(name, np.full(len(rows.numbers), np.nan))


def _loss(found: Estimate, refined: Rows, mine: np.ndarray, weight: np.ndarray, lost: np.ndarray) -> dict[str, Any]:
    """Probability of losing more at all places together, and which modes and samples make the loss. mine: slides that
    count (runs,) bool. weight, lost: of each of them (n,)."""
    modes = refined.columns.get("mode", np.full(mine.size, ""))[mine]
    whole, number = float(weight @ lost), refined.columns["sample"][mine]
    most = np.argsort(-weight * lost, kind="stable")[:MOST_LOSS]
    return {
        "exceedance": _curve(exceedance(found, weight, lost, np.unique(np.concatenate([[0.0], lost])))),
        "modes": {
            mode: float((weight * lost)[modes == mode].sum() / whole) for mode in SEVERITY if mode in modes and whole
        },
        "samples": [
            {"sample": int(number[at]), "loss": float(lost[at]), "share": float(weight[at] * lost[at] / whole)}
            for at in most
            if lost[at] > 0
        ],
    }


def _most_lost(place: Place) -> float:
    """What is lost at most where a slide comes; shares of the value do not fall."""
    assert place.value is not None
    assert place.vulnerability is not None
    return place.value * place.vulnerability.lost[-1]


def _expected(
    found: Estimate, weight: np.ndarray, amount: np.ndarray, bound: float, *, at_least: bool
) -> dict[str, Any]:
    """Expected value over all samples, with its interval. bound: what it is at most, the upper limit of the probability
    that anything is lost times all that may be lost."""
    mean = mean_of(found, weight, amount)
    low, high = float(mean.low), float(mean.high)
    high = min(high, bound) if np.isfinite(high) else bound
    return {"expected": float(mean.value), "interval": [low, high], "at_least": at_least}


def _curve(curve: Curve) -> dict[str, list[float]]:
    chance = curve.chance
    return {
        "thresholds": curve.thresholds.tolist(),
        "probability": chance.value.tolist(),
        "low": chance.low.tolist(),
        "high": chance.high.tolist(),
    }


def _spread(values: np.ndarray, weight: np.ndarray, level: float, *, at_least: bool, most: float) -> dict[str, Any]:
    """Weighted mean with its interval, smallest and largest; of runs that stand for nothing only the last two. No
    interval, None, for too few runs (see `mean_interval`). at_least: whether the runs would have gone on. most: no mean
    is larger."""
    known = np.isfinite(values)
    values, weight = values[known], weight[known]
    if not values.size:
        return {}
    mean = float(weight @ values / weight.sum()) if weight.any() else float(values.mean())
    stands = weight > 0
    interval = mean_interval(values[stands], weight[stands], level=level) if stands.any() else None
    return {
        "mean": mean,
        "interval": interval and [interval[0], max(min(interval[1], most), mean)],
        "smallest": float(values.min()),
        "largest": float(values.max()),
        "at_least": at_least and bool(values.min() < most * (1 - 1e-3)),
    }
