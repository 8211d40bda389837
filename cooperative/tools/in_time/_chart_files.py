"""A chart of the probability of failure as a figure and as tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cooperative.reporting import panels, save
from cooperative.tools.in_time._chart import CHANCES, M_PER_DAY, Chart
from cooperative.tools.seepage import HOUR, MM_PER_HOUR, csv_text, write_texts
from jaxmpm.support.text import literal

COLOURS = ("#009E73", "#E69F00", "#D55E00")
"""Of the lines of CHANCES, of the palette of Okabe and Ito (2008)."""


def write_chart(result: Chart, folder: Path) -> list[Path]:
    """Write `chart.png`, `chart.csv` and `chart_lines.csv`.

    Args:
        result: of `probability_chart`.
        folder: to write to.

    Returns:
        Paths of the files.

    Raises:
        OSError: the disk refuses.
    """
    folder.mkdir(parents=True, exist_ok=True)
    picture = folder / "chart.png"
    save(_of_drawdowns(result) if result.durations is None else _of_storms(result), picture)
    return [picture, *write_texts(folder, {"chart.csv": _table(result), "chart_lines.csv": _lines(result)})]


def _edges(values: np.ndarray) -> np.ndarray:
    """Edges of boxes about values on a logarithmic axis."""
    at = np.log(values)
    half = np.diff(at) / 2 if at.size > 1 else np.array([0.3])
    return np.exp(np.concatenate([[at[0] - half[0]], at[:-1] + half[: at.size - 1], [at[-1] + half[-1]]]))


def _of_storms(result: Chart) -> Figure:
    """P_f in a box for each storm, with the lines of CHANCES and their intervals."""
    figure, (ax,) = panels(1, size=(7.0, 4.6))
    hours, rates = np.array(result.durations) / HOUR, np.array(result.rates) * MM_PER_HOUR
    edges = _edges(hours), _edges(rates)
    mesh = ax.pcolormesh(*edges, result.probability, cmap="Greys", vmin=0, vmax=1.8)
    for row, top in zip(result.estimates, edges[1][1:], strict=True):
        for estimate, left in zip(row, edges[0], strict=False):
            low, high = estimate.interval
            words = f" {estimate.probability:.2f}\n {low:.2f} to {high:.2f}"
            ax.text(left, 0.97 * top, words, va="top", fontsize=7)
    # Bars of one duration stand beside each other; where an end lies beyond the chart, a bar goes on to its edge.
    for number, (chance, colour) in enumerate(zip(CHANCES, COLOURS, strict=True)):
        line, low, high = (MM_PER_HOUR * rates_of for rates_of in _line(result, chance))
        ends = np.nan_to_num(low, nan=edges[1][0]), np.nan_to_num(high, nan=edges[1][-1])
        there, at = np.isfinite(line), hours * 1.04 ** (number - 1)
        ax.vlines(at[there], ends[0][there], ends[1][there], color=colour, lw=1.2)
        label = f"$P_f$ = {chance:.0%}, 95 % interval" if there.any() else None
        ax.plot(at, line, "o-", ms=4, color=colour, label=label)
    ax.set(xlabel="duration of the rain [h]", ylabel="intensity [mm/h]")
    _logarithmic(ax, x=hours, y=rates)
    ax.set_title(literal(result.campaign.name), loc="left")
    label = "$P_f$; in each box with its 95 % interval"
    figure.colorbar(mesh, ax=ax, label=label, boundaries=np.linspace(0, 1, 101), ticks=[0, 0.25, 0.5, 0.75, 1])
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=3, frameon=False, fontsize="small")
    return figure


def _logarithmic(ax: Axes, **ticks: np.ndarray) -> None:
    """Have axes logarithmic with ticks at these values."""
    for name, values in ticks.items():
        ax.set(**{f"{name}scale": "log"})
        axis = getattr(ax, f"{name}axis")
        axis.set_ticks(values, [f"{value:.3g}" for value in values])
        axis.set_ticks([], minor=True)


def _of_drawdowns(result: Chart) -> Figure:
    """P_f with its interval against the rate of the fall."""
    figure, (ax,) = panels(1, size=(7.0, 3.4))
    rates = M_PER_DAY * np.array(result.rates)
    low, high = result.interval[..., 0]
    ax.fill_between(rates, low, high, color="#0072B2", alpha=0.25, lw=0, label="95 % interval at each rate")
    ax.plot(rates, result.probability[:, 0], "o-", color="#0072B2", label="$P_f$", clip_on=False)
    for chance, colour in zip(CHANCES, COLOURS, strict=True):
        rate = M_PER_DAY * float(_line(result, chance)[0][0])
        if np.isfinite(rate):
            ax.plot([rate, rate], [0, chance], ":", color=colour, label=f"{chance:.0%} at {rate:.3g} m/day")
    ax.set(xlabel="fall of the level [m/day]", ylabel="probability of failure $P_f$", ylim=(0, None))
    _logarithmic(ax, x=rates)
    ax.set_title(literal(result.campaign.name), loc="left")
    ax.legend(frameon=False, fontsize="small")
    return figure


def _line(result: Chart, chance: float) -> np.ndarray:
    """Rates (m/s) of a line and of both ends of its interval (3, J)."""
    return np.array([(line.rate, line.low, line.high) for line in result.lines([chance])]).T


def _table(result: Chart) -> str:
    durations = (None,) if result.durations is None else result.durations
    rows: list[list[object]] = [
        [
            rate * (M_PER_DAY if duration is None else MM_PER_HOUR), *(() if duration is None else (duration / HOUR,)),
            estimate.probability, *estimate.interval, estimate.cov, estimate.refined_runs,
        ]
        for rate, row in zip(result.rates, result.estimates, strict=True)
        for duration, estimate in zip(durations, row, strict=True)
    ]  # fmt: skip
    return csv_text([*_head(result), "P_f", "low", "high", "cov", "runs"], rows)


def _head(result: Chart) -> list[str]:
    return ["fall [m/day]"] if result.durations is None else ["intensity [mm/h]", "duration [h]"]


def _lines(result: Chart) -> str:
    """Rates at which P_f has the values of CHANCES; empty beyond the chart."""
    scale = M_PER_DAY if result.durations is None else MM_PER_HOUR
    rows: list[list[object]] = [
        [
            line.chance, *(() if line.duration is None else (line.duration / HOUR,)),
            *(scale * rate if np.isfinite(rate) else "" for rate in (line.rate, line.low, line.high)),
        ]
        for line in result.lines()
    ]  # fmt: skip
    rate, *duration = _head(result)
    return csv_text(["P_f", *duration, rate, "low", "high"], rows)
