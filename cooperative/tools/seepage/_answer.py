"""The flow of a scene at its times, and the factor of safety by slices at each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cooperative.scene import Campaign, rested
from cooperative.tools.safety import Safety, factor_of_safety, of_own_flow
from jaxmpm import seepage
from jaxmpm.seepage import Cells
from jaxmpm.support.text import printable

HOUR, DAY = 3600.0, 86400.0
DAYS = 3 * DAY
"""Time (s) from which on it is given in days."""
ROUNDING = 1e-3
"""Share of the rain that is none."""


@dataclass(frozen=True)
class Moment:
    """The ground at one time.

    Args:
        time: s.
        head: pressure heads (m) at the centres of the cells, of their shape, nan without soil.
        saturation: effective one there, nan where no retention is known.
        wet: share of the ground that is saturated.
        level: of the pool on the ground (m), None without.
        rate: of the rain (m/s), 0 without.
        safety: by slices, None where it was not asked for.
    """

    time: float
    head: np.ndarray
    saturation: np.ndarray
    wet: float
    level: float | None
    rate: float
    safety: Safety | None

    @property
    def factor(self) -> float | None:
        """Of safety by slices, None where there is none."""
        return None if self.safety is None or self.safety.equilibrium is None else self.safety.equilibrium.slip.factor


@dataclass(frozen=True)
class Wetted:
    """A scene's ground at its times.

    Args:
        campaign: of the scene.
        cells: at whose centres it is known.
        moments: by time.
    """

    campaign: Campaign
    cells: Cells
    moments: tuple[Moment, ...]


def wetted(
    campaign: Campaign,
    *,
    factors: bool = True,
    sample: int | None = None,
    times: Sequence[float] | None = None,
    announce: Callable[[Moment], None] | None = None,
) -> Wetted:
    """The ground of a campaign at the times of its rain or drawdown.

    Args:
        campaign: the campaign.
        factors: whether the factor of safety is worked out at each, which takes seconds.
        sample: whose soil it is, None for median soil.
        times: other ones than those of its table (s), none after the last of these.
        announce: called with each moment.

    Returns:
        Heads, saturation and factors.

    Raises:
        ValueError: no water moves in the scene, or its flow will not do.
    """
    table = campaign.seepage
    if table is None:
        raise ValueError(
            'no water moves in the scene: add [rain] with times, rate = "14 mm/h" and soil, or [drawdown] with level'
        )
    campaign = of_own_flow(campaign, sample)
    shape = campaign.site.shape
    spacing = table.cell or (*(campaign.refined.cell,) * (campaign.dimension - 1), campaign.refined.cell / 2)
    flow = campaign.flow
    cells = getattr(flow, "cells", None) or seepage.cells_under(shape, spacing)
    position = cells.centres().reshape(campaign.dimension, -1)
    layer = campaign.site.layer_of(position, campaign.grids["refined"])
    number = np.zeros(position.shape[1], int) if layer is None else layer
    moments = []
    for time in table.times if times is None else times:
        resting = rested(campaign, time)
        pressure = resting.site.pressure
        assert pressure is not None
        head = np.asarray(pressure.heads.at(position), float)
        retention = pressure.retention(number)
        full = np.full(head.shape, np.nan) if retention is None else np.asarray(retention.saturation(head), float)
        soil = cells.soil.ravel()
        wet = float(np.mean(head[soil] >= 0))
        head, full = (np.where(soil, values, np.nan).reshape(cells.shape) for values in (head, full))
        safety = _factor(resting, sample) if factors else None
        moments.append(Moment(time, head, full, wet, pressure.level, _rate(table.rate, time), safety))
        if announce is not None:
            announce(moments[-1])
    return Wetted(campaign, cells, tuple(moments))


def _factor(campaign: Campaign, sample: int | None) -> Safety | None:
    try:
        return factor_of_safety(campaign, sample=sample, solver=False)
    except ValueError as error:
        return Safety("", (), "", notes=(str(error),))


def _rate(rate: tuple[tuple[float, float], ...] | None, time: float) -> float:
    """Rain (m/s) that falls from a time on."""
    if rate is None:
        return 0.0
    times, values = np.array(rate).T
    at = int(np.searchsorted(times, time, side="right")) - 1
    return float(values[at]) if at >= 0 else 0.0


def in_hours(time: float) -> str:
    """A time (s) in words."""
    return f"{time / DAY:g} d" if time >= DAYS else f"{time / HOUR:g} h"


def clock(end: float) -> tuple[float, str]:
    """The unit of an axis of time up to an end (s): its length (s) and its name."""
    return (DAY, "d") if end >= DAYS else (HOUR, "h")


def lines(result: Wetted) -> Iterator[str]:
    """What the flow is, and the factor of safety against time, for a terminal.

    Args:
        result: of `wetted`.
    """
    campaign = result.campaign
    flow: Any = campaign.flow
    yield printable(campaign.name)
    unit = "m3" if campaign.dimension == 3 else "m2"
    if hasattr(flow, "steps"):
        yield (
            f"  flow      {int(result.cells.soil.sum())} cells, {flow.steps} steps; the water balance closes to "
            f"{flow.balance:.1g} of what has moved"
        )
        if flow.rained:
            runoff = "the rest ran off" if flow.rained - flow.entered > ROUNDING * flow.rained else "none ran off"
            yield f"  rain      {flow.rained:.3g} {unit} fell, {flow.entered:.3g} {unit} soaked in, {runoff}"
    else:
        yield f"  pressure  of another program, at {len(flow.times)} times"
    for moment in result.moments:
        factor = "   -  " if moment.factor is None else f"{moment.factor:6.3f}"
        pool = "" if moment.level is None else f", pool at {moment.level:.3g} m"
        yield f"  {in_hours(moment.time):>8}  factor of safety {factor}  {moment.wet:4.0%} saturated{pool}"
    notes = dict.fromkeys(
        note for moment in result.moments if moment.safety is not None for note in moment.safety.notes
    )
    yield from (f"    {note}" for note in notes)
    answered = [moment for moment in result.moments if moment.factor is not None]
    if answered:
        least = min(answered, key=lambda moment: moment.factor or 0.0)
        yield f"  least     {least.factor:.3f} at {in_hours(least.time)}, by limit equilibrium"
