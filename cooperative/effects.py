"""What the slides of a campaign do, in numbers: modes, means, probabilities of more, elements at risk, losses, fits.

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
    exceedance,
    fit_distributions,
    severity_ranking,
    shares,
)
from cooperative.measure import SEVERITY
from cooperative.risk import CutOff, Risk, Slid, Spread, risk_of, spread_of
from cooperative.scene import Campaign
from cooperative.store import Rows

MEASURES = ("displacement", "depth", "runout", "volume", "area")
CURVES = ("runout", "volume", "depth")
"""Consequences with a curve of their probability of being exceeded."""


@dataclass(frozen=True)
class ModeShare:
    """A failure mode.

    Args:
        count: refined runs that failed so.
        ratio: weighted share of the failures.
        interval: confidence limits of the share.
        probability: that a sample fails so.
    """

    count: int
    ratio: float
    interval: tuple[float, float]
    probability: float


@dataclass(frozen=True)
class Effects:
    """What the slides do; each field as in `cooperative.Summary`.

    Args:
        cut_off: slides that had not come to rest.
        modes: by name, None where the rows have none.
        consequences_of_failures: by name, None where no slide has it.
        exceedance: curves by consequence.
        risk: of the elements at risk, None without any.
        fits: by group and consequence.
        severity: modes by the median of each consequence.
    """

    cut_off: CutOff
    modes: Mapping[str, ModeShare] | None
    consequences_of_failures: Mapping[str, Spread | None]
    exceedance: Mapping[str, Exceedance]
    risk: Risk | None
    fits: Mapping[str, Mapping[str, Fits]]
    severity: Mapping[str, tuple[Severity, ...]]


def effects_of(campaign: Campaign, estimate: Estimate, refined: Rows, slides: Slides) -> Effects:
    """What the refined runs that slid on to their end do, each weighed by what it stands for.

    Args:
        campaign: whose runs these are.
        estimate: of the probability of failure.
        refined: rows of the refined grid.
        slides: which failures slid, and what each stands for.
    """
    slid = Slid(refined.columns, slides.weight).where(slides.slid)
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
        risk=risk_of(campaign, estimate, counting, cut, unknown=bool(unknown)),
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


def _modes(estimate: Estimate, counting: Slid) -> dict[str, ModeShare] | None:
    """Count, ratio among the failures and probability of each mode; None where the rows have none."""
    if "mode" not in counting.columns:
        return None
    known = counting.where(counting["mode"] != "")
    parts = shares(known["mode"], known.weight, SEVERITY, level=estimate.level) if known.weight.size else {}
    return {
        mode: ModeShare(part.count, part.share, part.interval, estimate.probability * part.share)
        for mode, part in parts.items()
    }


def _means(campaign: Campaign, level: float, slid: Slid, cut: CutOff) -> dict[str, Spread | None]:
    """Weighted mean of each consequence with its interval, smallest and largest.

    None where no slide has the consequence, and nothing without a slide.
    """
    # No soil lies deeper than the ground.
    most = {"depth": campaign.site.shape.extent[-1]}
    return {
        name: spread_of(
            slid[name], slid.weight, level,
            at_least=bool(cut.at_t_end or (cut.broke_off and name == "displacement")), most=most.get(name, np.inf),
        )
        for name in MEASURES
        if slid.weight.size
    }  # fmt: skip
