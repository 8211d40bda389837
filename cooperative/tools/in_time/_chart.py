"""The probability of failure on a chart: of storms by intensity and duration, of drawdowns by rate.

All loads have the same samples. In each load a sample is asked at the time at which its factor of safety by slices is
lowest, and its loads stand in the order of these factors. A sample that fails under one load fails under all those
under which its factor is lower, so that bisection finds the first one in a few runs, however many loads there are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cooperative.estimate import Estimate, fails_under, falling_chain, on_chart
from cooperative.names import GRIDS
from cooperative.scene import Campaign, Drawdown, Rain
from cooperative.tools.in_time._answer import (
    StateRunner,
    WaterState,
    audited_samples,
    first_failures,
    first_lines,
    noted,
    running,
    screened,
)
from cooperative.tools.seepage import MM_PER_HOUR, in_hours

CHANCES = (0.1, 0.5, 0.9)
"""Probabilities of failure whose lines a chart has."""
FALLS = (0.2, 0.4, 0.6, 0.8, 1.0)
"""Shares of its fall at which a drawdown is asked: slopes are often weakest before the pool is gone."""
M_PER_DAY = 86400.0
CHART = "chart"
"""Folder of the answers of a chart."""


@dataclass(frozen=True)
class Load:
    """Rain of one intensity and duration, or a drawdown at one rate.

    Args:
        rate: of the rain, or of the fall of the level (m/s).
        duration: of it (s).
        campaign: with this load alone.
    """

    rate: float
    duration: float
    campaign: Campaign

    @property
    def words(self) -> str:
        """What it is, for a terminal."""
        if self.campaign.drawdown is not None:
            return f"{M_PER_DAY * self.rate:.3g} m/day"
        return f"{MM_PER_HOUR * self.rate:.3g} mm/h for {in_hours(self.duration)}"

    def states(self, number: int) -> list[WaterState]:
        """In which samples are asked under it, one for each of its times.

        Args:
            number: of the load in its chart.
        """
        table = self.campaign.seepage
        assert table is not None
        return [WaterState(f"{in_hours(time)} of {self.words}", self.campaign, time, number) for time in table.times]


@dataclass(frozen=True)
class Line:
    """Where the probability of failure has one value.

    Args:
        chance: that value.
        duration: of the rain (s), None for drawdowns.
        rate: of the rain or the fall (m/s), nan where the chart does not have the value.
        low: rate at which the upper end of the intervals has that value, nan where all are above it.
        high: rate at which their lower end has it, nan where none is.
    """

    chance: float
    duration: float | None
    rate: float
    low: float
    high: float


@dataclass(frozen=True)
class Chart:
    """The probability of failure under loads.

    Args:
        campaign: of the scene.
        rates: of rain, or of a falling level (I,) m/s.
        durations: of rain (J,) s, None for drawdowns, each of which lasts until its level has fallen.
        estimates: of each rate and duration, rows of rates; of drawdowns with one column.
        rough: whether each sample fails (n, I, J) on the rough grid, nan where a run broke off.
        refined: the same (I, J) of the samples that ran on the refined grid.
        factors: lowest factors of safety of each sample (n, I, J) by slices.
        runs: on each grid.
    """

    campaign: Campaign
    rates: tuple[float, ...]
    durations: tuple[float, ...] | None
    estimates: tuple[tuple[Estimate, ...], ...]
    rough: np.ndarray
    refined: dict[int, np.ndarray]
    factors: np.ndarray
    runs: dict[str, int]

    @property
    def probability(self) -> np.ndarray:
        """Of failure (I, J)."""
        return np.array([[estimate.probability for estimate in row] for row in self.estimates])

    @property
    def interval(self) -> np.ndarray:
        """Ends of the interval of each (2, I, J)."""
        return np.moveaxis(np.array([[estimate.interval for estimate in row] for row in self.estimates]), -1, 0)

    def lines(self, chances: Sequence[float] = CHANCES) -> list[Line]:
        """Rates at which the probability of failure has values, for each duration.

        Between two rates it is linear in the logarithm of the rate.

        Args:
            chances: the values.
        """
        low, high = self.interval
        return [
            Line(
                chance, None if self.durations is None else self.durations[column],
                *(rate_at(chance, self.rates, chances[:, column]) for chances in (self.probability, high, low)),
            )
            for chance in chances
            for column in range(len(self.estimates[0]))
        ]  # fmt: skip


def rate_at(chance: float, rates: Sequence[float] | np.ndarray, rising: Sequence[float] | np.ndarray) -> float:
    """The rate at which a probability that rises with it reaches a value, linear in the logarithm of the rate.

    Args:
        chance: the value.
        rates: that rise (I,).
        rising: the probability at each (I,).

    Returns:
        The rate, nan where the probability is above the value at all rates, or below it.

    Example:
        >>> from cooperative.tools.in_time import rate_at
        >>> round(rate_at(0.5, [1.0, 4.0], [0.2, 0.8]), 6)
        2.0
    """
    first = int(np.searchsorted(rising, chance))
    if first == len(rising) or (first == 0 and rising[0] > chance):
        return float("nan")
    if first == 0:
        return float(rates[0])
    share = (chance - rising[first - 1]) / (rising[first] - rising[first - 1])
    return float(rates[first - 1] * (rates[first] / rates[first - 1]) ** share)


def loads_of(campaign: Campaign) -> list[list[Load]]:
    """Loads of the chart of a campaign, rows of rates.

    Args:
        campaign: with a chart in its table of rain or drawdown.

    Raises:
        ValueError: it has none.
    """
    table = campaign.seepage
    if isinstance(table, Rain) and table.chart is not None:
        after = table.chart.after
        return [[_storm(campaign, table, rate, duration, after) for duration in table.chart.durations]
                for rate in table.chart.rates]  # fmt: skip
    if isinstance(table, Drawdown) and table.chart is not None:
        return [[_drawdown(campaign, table, rate)] for rate in table.chart.rates]
    raise ValueError(
        'the scene has no chart: add [rain.chart] with rates = ["5 mm/h", "10 mm/h"] and durations = ["6 h", "24 h"], '
        'or [drawdown.chart] with rates = ["0.1 m/day", "1 m/day"]'
    )


def _storm(campaign: Campaign, rain: Rain, rate: float, duration: float, after: Sequence[float]) -> Load:
    times = (duration, *(duration + delay for delay in after))
    alone = replace(rain, rate=((0.0, rate), (duration, 0.0)), times=times, at=None, chart=None)
    return Load(rate, duration, replace(campaign, rain=alone))


def _drawdown(campaign: Campaign, drawdown: Drawdown, rate: float) -> Load:
    assert drawdown.level is not None
    first, last = drawdown.level[0][1], min(level for _, level in drawdown.level)
    duration = (first - last) / rate
    times = tuple(share * duration for share in FALLS)
    alone = replace(drawdown, level=((0.0, first), (duration, last)), times=times, at=None, chart=None)
    return Load(rate, duration, replace(campaign, drawdown=alone))


def probability_chart(
    campaign: Campaign,
    folder: Path,
    *,
    refined_runs: int | None = None,
    workers: int = 1,
    progress: Callable[[str], None] = lambda line: None,
) -> Chart:
    """The probability of failure against the intensity and the duration of rain, or against the rate of a drawdown.

    What has run is kept in the folder `chart` of the folder, and the same call goes on from there.

    Args:
        campaign: with `[rain.chart]` or `[drawdown.chart]`, on a section.
        folder: to keep answers in.
        refined_runs: samples on the refined grid; None for a fifth of them, at least 20; 0 for none.
        workers: processes that run samples.
        progress: called with a line after each round.

    Returns:
        An estimate with its interval for each load.

    Raises:
        ValueError: no chart, nothing random, no factor of safety by slices, or a folder of another scene.
    """
    audited = audited_samples(campaign, refined_runs)
    states = states_on_chart(loads_of(campaign))
    with running(campaign, states, folder / CHART, audited, workers, chart=True) as runner:
        return answered_chart(runner, progress)


def states_on_chart(rows: Sequence[Sequence[Load]]) -> list[WaterState]:
    """States of the ground under the loads of a chart, those of one load beside each other, as many of each."""
    loads = [load for row in rows for load in row]
    return [state for number, load in enumerate(loads) for state in load.states(number)]


def answered_chart(runner: StateRunner, progress: Callable[[str], None]) -> Chart:
    """The probability under each load, from what is kept and what runs."""
    campaign, rows = runner.campaign, loads_of(runner.campaign)
    shape = len(rows), len(rows[0])
    factors = screened(runner, progress)
    if not np.isfinite(factors).all():
        raise ValueError(
            "a chart orders its loads by factors of safety by slices, which not all of its samples have: give a "
            "section with cohesion and friction, or ask for each load by --probability"
        )
    worst, least, chains = chains_on_chart(factors, shape[0] * shape[1])
    rough, refined = first_failures(runner, factors, chains, progress)

    def under(first: int, number: int) -> np.ndarray:
        return fails_under(first, chains[number], worst[number]).reshape(shape)

    fails = np.array([under(first, number) for number, first in enumerate(rough)])
    fine = {number: under(first, number) for number, first in refined.items()}
    least = least.reshape(-1, *shape)
    estimates = list(noted(on_chart(fails, fine or None, least), rough, refined))
    return Chart(
        campaign, tuple(row[0].rate for row in rows),
        tuple(load.duration for load in rows[0]) if campaign.drawdown is None else None,
        tuple(tuple(estimates[at * shape[1] : (at + 1) * shape[1]]) for at in range(shape[0])),
        fails, fine, least, {grid: runner.kept.count(grid) for grid in GRIDS},
    )  # fmt: skip


def chains_on_chart(factors: np.ndarray, loads: int) -> tuple[np.ndarray, np.ndarray, list[list[int]]]:
    """The states in which samples are asked under the loads of a chart.

    Args:
        factors: of safety of each sample in each state (n, states).
        loads: their number.

    Returns:
        Number of the state with the lowest factor under each load (n, loads), these factors, and the former of each
        sample from the safest on.
    """
    of_load = factors.reshape(len(factors), loads, -1)
    worst = of_load.argmin(axis=2) + of_load.shape[2] * np.arange(loads)
    least = of_load.min(axis=2)
    return (
        worst,
        least,
        [loads_of[falling_chain(factor)].tolist() for loads_of, factor in zip(worst, least, strict=True)],
    )


def chart_lines(result: Chart) -> Iterator[str]:
    """The chart in words, for a terminal.

    Args:
        result: of `probability_chart`.
    """
    yield from first_lines(result.campaign.name, len(result.rough), len(result.refined), result.runs)
    if result.durations is None:
        yield "  fall          P_f    (95 %)"
        for rate, (estimate,) in zip(result.rates, result.estimates, strict=True):
            low, high = estimate.interval
            yield f"  {M_PER_DAY * rate:6.3g} m/day  {estimate.probability:6.3f}  ({low:.3f} to {high:.3f})"
    else:
        yield "  P_f of rain for " + "".join(f"{in_hours(duration):>9}" for duration in result.durations)
        for rate, row in zip(result.rates, result.estimates, strict=True):
            yield f"  {MM_PER_HOUR * rate:8.3g} mm/h  " + "".join(f"{estimate.probability:9.3f}" for estimate in row)
    for line in result.lines():
        if np.isfinite(line.rate):
            where = "" if line.duration is None else f" in {in_hours(line.duration)}"
            unit, scale = ("m/day", M_PER_DAY) if line.duration is None else ("mm/h", MM_PER_HOUR)
            ends = (f"{scale * end:.3g}" if np.isfinite(end) else "-" for end in (line.low, line.high))
            yield f"    {line.chance:.0%} at {scale * line.rate:.3g} {unit} ({' to '.join(ends)}){where}"
    yield from (
        f"    {note}"
        for note in dict.fromkeys(note for row in result.estimates for estimate in row for note in estimate.notes)
    )
