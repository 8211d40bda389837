"""What the slides of a campaign do, in numbers: modes, means, probabilities of more, elements at risk, losses, fits.

A slide that ended before it came to rest would have gone on, so all of this is at least what is given.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cooperative.estimate import (
    Estimate,
    Slides,
    chance_of,
    exceedance,
    fit_distributions,
    mean_interval,
    mean_of,
    severity_ranking,
    shares,
)
from cooperative.measure import MEASURES, SEVERITY, ElementAtRisk
from cooperative.scene import Campaign
from cooperative.store import Rows
from cooperative.summary._values import (
    CutOff,
    Element,
    ElementLoss,
    FailureConsequences,
    FailureModes,
    Loss,
    ModeShare,
    Reached,
    Risk,
    SampleLoss,
    Spread,
)

CURVES = ("runout", "volume", "depth")
"""Consequences with a curve of their probability of being exceeded."""
AT_REST = ("SETTLED", "DECIDED")
"""How runs end that would have gone no further, or of which no more was asked."""
MOST_LOSS = 5
"""Samples named that make most of the expected loss."""


@dataclass(frozen=True)
class SlideRows:
    """Slides, a part of the table of refined runs.

    Args:
        columns: by name (n,).
        weight: what each stands for (n,).
    """

    columns: Mapping[str, np.ndarray]
    weight: np.ndarray

    def __getitem__(self, name: str) -> np.ndarray:
        """A column (n,), numbers out of range nan; where the rows lack it, nan, no mode and nothing that broke off."""
        absent = {"mode": "", "broke_off": 0.0}.get(name, np.nan)
        return in_range(self.columns.get(name, np.full(self.weight.size, absent)))

    def measured(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """The values (k,) of a measure as far as slides have it, and what each stands for.

        Args:
            name: of its column.
        """
        values = self[name]
        there = np.isfinite(values)
        return values[there], self.weight[there]

    def where(self, chosen: np.ndarray) -> SlideRows:
        """Some of the slides.

        Args:
            chosen: which (n,) bool.
        """
        return SlideRows({name: column[chosen] for name, column in self.columns.items()}, self.weight[chosen])


def in_range(values: np.ndarray) -> np.ndarray:
    """Measures of slides, nan where one is unknown: not finite, or below 0, which no measure is.

    Args:
        values: of the slides (n,); texts and counts stay as they are.
    """
    return np.where(np.isfinite(values) & (values >= 0), values, np.nan) if values.dtype.kind == "f" else values


def out_of_range(refined: Rows, slid: np.ndarray) -> str:
    """Name the measures of slides that are no measures, and so count as unknown; empty where there are none.

    Args:
        refined: rows of the refined grid.
        slid: which of them slid to their end (n,) bool.
    """
    bad = [
        f"{name} = {values[at]:.3g} of sample {refined.numbers[at]}"
        for name, values in refined.columns.items()
        if name in MEASURES or "_at_" in name or name == "area_columns"
        for at in np.flatnonzero(slid & ~np.isnan(values) & np.isnan(in_range(values)))
    ]
    if not bad:
        return ""
    several = f", and {len(bad) - 1} more" if len(bad) > 1 else ""
    return f"{bad[0]}{several}: no measure is below 0 or without end, so that it counts as unknown"


def counting(refined: Rows, slides: Slides) -> SlideRows:
    """The slides that stand for failures.

    Args:
        refined: rows of the refined grid.
        slides: which failures slid, and what each stands for.
    """
    rows = SlideRows(refined.columns, slides.weight)
    return rows.where(slides.slid & (slides.weight > 0))


def by_mode(rows: SlideRows) -> dict[str, SlideRows]:
    """The slides of each mode that occurs, without those that broke off.

    Args:
        rows: of the slides.
    """
    whole = rows.where(~rows["broke_off"].astype(bool))
    return {mode: whole.where(whole["mode"] == mode) for mode in SEVERITY if mode in whole["mode"]}


def modes_of(estimate: Estimate, refined: Rows, slides: Slides) -> FailureModes:
    """Count, ratio among the failures and probability of each mode, and which are severe.

    Args:
        estimate: of the probability of failure.
        refined: rows of the refined grid.
        slides: which failures slid, and what each stands for.
    """
    rows, shares_of_modes = counting(refined, slides), None
    if "mode" in rows.columns:
        named = rows.where(rows["mode"] != "")
        parts = shares(named["mode"], named.weight, SEVERITY, level=estimate.level) if named.weight.size else {}
        shares_of_modes = {
            mode: ModeShare(part.count, part.share, part.interval, estimate.probability * part.share)
            for mode, part in parts.items()
        }
    groups, severity = by_mode(rows), {}
    for name in MEASURES:
        measured = {mode: group.measured(name) for mode, group in groups.items()}
        measured = {mode: pair for mode, pair in measured.items() if pair[0].size}
        if measured:
            values, weights = ({mode: pair[at] for mode, pair in measured.items()} for at in (0, 1))
            severity[name] = tuple(severity_ranking(values, weights=weights))
    return FailureModes(shares_of_modes, severity)


def consequences_of(campaign: Campaign, estimate: Estimate, refined: Rows, slides: Slides) -> FailureConsequences:
    """What the refined runs that slid on to their end do, each weighed by what it stands for.

    Args:
        campaign: whose runs these are.
        estimate: of the probability of failure.
        refined: rows of the refined grid.
        slides: which failures slid, and what each stands for.
    """
    rows, run = counting(refined, slides), campaign.run
    broke_off = rows["broke_off"].astype(bool)
    cut = CutOff(
        of=broke_off.size,
        at_t_end=int(np.sum(~np.isin(rows["status"], AT_REST) & ~broke_off)),
        broke_off=int(broke_off.sum()),
        t_end=run.last("refined"),
    )
    groups = {"all": rows.where(~broke_off)} | by_mode(rows)
    of_all = SlideRows(refined.columns, slides.weight).where(slides.slid)
    unknown = bool(slides.failed.any() or not slides.weight.any())
    return FailureConsequences(
        slides=int(slides.slid.sum()),
        planned=slides.planned,
        weights={refined.numbers[at]: float(slides.weight[at]) for at in np.flatnonzero(slides.slid)},
        cut_off=cut,
        means=_means(campaign.site.shape.extent[-1], estimate.level, of_all, cut),
        exceedance={
            name: exceedance(estimate, weight, values)
            for name in CURVES
            for values, weight in [rows.measured(name)]
            if values.size
        },
        fits={
            name: {measure: fit_distributions(*group.measured(measure)) for measure in MEASURES if group.weight.size}
            for name, group in groups.items()
        },
        risk=risk_of(campaign.elements_at_risk, estimate, rows, cut, run.failure_displacement, unknown=unknown),
    )


def _means(deepest: float, level: float, rows: SlideRows, cut: CutOff) -> dict[str, Spread | None]:
    """Weighted mean of each consequence with its interval, smallest and largest.

    None where no slide has the consequence, and nothing without a slide.
    """
    most = {"depth": deepest}
    return {
        name: spread_of(
            rows[name], rows.weight, level,
            at_least=bool(cut.at_t_end or (cut.broke_off and name == "displacement")), most=most.get(name, np.inf),
        )
        for name in MEASURES
        if rows.weight.size
    }  # fmt: skip


def risk_of(
    elements_at_risk: Sequence[ElementAtRisk],
    estimate: Estimate,
    rows: SlideRows,
    cut: CutOff,
    failure_displacement: float,
    *,
    unknown: bool,
) -> Risk | None:
    """What comes over the elements at risk and carries them away, and what is lost there; None where there are none.

    Nothing is known of an element where no slide has columns.

    Args:
        elements_at_risk: those of the campaign.
        estimate: of the probability of failure.
        rows: slides that count.
        cut: slides that had not come to rest.
        failure_displacement: from which the ground of an element carries it away (m).
        unknown: whether no run counts, or some failed and may slide yet.
    """
    if not elements_at_risk:
        return None
    # A slide that broke off has no columns, and one that arrives with a number out of range no known loss.
    usable = np.isfinite(rows["area_columns"])
    for exposed in elements_at_risk:
        arrival, *measured = (rows[f"{what}_at_{exposed.key}"] for what in ("arrival", "thickness", "speed"))
        usable &= ~np.isfinite(arrival) | np.isfinite(measured).all(axis=0)
    slid = rows.where(usable)
    if not slid.weight.size and unknown:
        return Risk(dict.fromkeys(element.name for element in elements_at_risk), None)
    weight, elements, at_least = slid.weight, {}, bool(cut.at_t_end)
    lost, bound = np.zeros(weight.size), 0.0
    for exposed in elements_at_risk:
        came = {what: slid[f"{what}_at_{exposed.key}"] for what in ("thickness", "speed", "arrival")}
        reached = np.isfinite(came["arrival"])
        chance = chance_of(estimate, weight, reached[:, None])
        # A slide that had not come to rest may reach it yet, unless all have.
        open_ = at_least and not reached.all()
        low, high = float(chance.low[0]), estimate.interval[1] if open_ else float(chance.high[0])
        # Nothing that comes after the end of the runs is seen.
        limits = {"arrival": cut.t_end}
        spreads = {
            what: spread_of(
                values[reached], weight[reached], estimate.level, at_least=at_least, most=limits.get(what, np.inf)
            )
            for what, values in came.items()
        }
        ground, loss = slid[f"ground_at_{exposed.key}"], None
        moves = ground >= failure_displacement
        carried = chance_of(estimate, weight, moves[:, None])
        most_likely = estimate.interval[1] if at_least else float(carried.high[0])
        if exposed.vulnerability is not None and exposed.value is not None:
            losses = np.where(reached, exposed.value * exposed.vulnerability.share(came[exposed.vulnerability.of]), 0.0)
            # Shares of the value do not fall.
            all_of_it = exposed.value * exposed.vulnerability.lost[-1]
            more = at_least and bool((losses < all_of_it * (1 - 1e-3)).any())
            loss = ElementLoss(exposed.value, *expected_of(estimate, weight, losses, all_of_it * high, more), more)
            lost, bound = lost + losses, bound + all_of_it * high
        elements[exposed.name] = Element(
            Reached(float(chance.value[0]), (low, high), open_),
            **spreads,
            loss=loss,
            carried=Reached(float(carried.value[0]), (float(carried.low[0]), most_likely), at_least),
            ground=spread_of(ground[moves], weight[moves], estimate.level, at_least=at_least, most=np.inf),
        )
    if all(element.loss is None for element in elements.values()):
        return Risk(elements, None)
    part, whole, modes = weight * lost, float(weight @ lost), slid["mode"]
    more = any(element.loss is not None and element.loss.at_least for element in elements.values())
    loss_of_all = Loss(
        *expected_of(estimate, weight, lost, bound, more),
        more,
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
    estimate: Estimate, weight: np.ndarray, amount: np.ndarray, bound: float, at_least: bool
) -> tuple[float, tuple[float, float]]:
    """Expected value over all samples, and its interval.

    Args:
        estimate: of the probability of failure.
        weight: what each slide stands for (n,).
        amount: that each slide brings (n,).
        bound: limit of the expected value: the upper limit of the probability that anything is lost times all that may
            be lost.
        at_least: whether slides had not come to rest, so that more may be lost, up to the bound.
    """
    mean = mean_of(estimate, weight, amount)
    low, high = float(mean.low), float(mean.high)
    return float(mean.value), (low, bound if at_least or not np.isfinite(high) else min(high, bound))


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
    finite = np.isfinite(values)
    values, weight = values[finite], weight[finite]
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
