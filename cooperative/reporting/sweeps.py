"""Figures and table of a sweep: P_f, differences, fragility curves, displacement and modes, against what is varied."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TypedDict

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cooperative.measure import SEVERITY
from cooperative.reporting._charts import tiled
from foundation.text import csv_text

LABELS = {
    "lx": "correlation length $l_x$ [m]",
    "ly": "correlation length $l_y$ [m]",
    "lz": "correlation length $l_z$ [m]",
    "cov": "coefficient of variation of $S_u$ [-]",
    "k_t": "standing samples in a row $k_t$ [-]",
}
PATHS = {
    "motion.scale": "scale of the record [-]",
    "run.k_h": "horizontal seismic coefficient $k_h$ [-]",
    "run.k_v": "vertical seismic coefficient $k_v$ [-]",
    "run.strength_factor": "factor on the strength [-]",
    "water.depth": "depth of the water table [m]",
    "water.level": "water level [m]",
}
"""Labels of paths that are often swept."""
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
STYLES = dict(zip(SEVERITY, (("#D55E00", "o"), ("#CC79A7", "s"), ("#0072B2", "^"), ("#009E73", "v")), strict=True))
PEAK = "peak acceleration [g]"
RECORDS = "records"
"""Name of the curve of all records together."""


class ModePart(TypedDict):
    """A failure mode of a point."""

    count: int
    ratio: float
    interval: list[float]
    probability: float


class Change(TypedDict):
    """Difference of P_f to that of the base, of the same samples, as `cooperative.estimate.Difference`."""

    difference: float
    interval: list[float]
    unpaired: float


class Displaced(TypedDict):
    """Largest displacement of the samples (m) on the rough grid: median and 90 % quantile."""

    median: float
    ninety: float


class Point(TypedDict):
    """A value of a parameter in `sweep.json`: its campaign, and fields of the summary.

    `peak` is the largest horizontal acceleration of a record (g), None without one.
    """

    value: float | str
    campaign: str
    probability: float
    interval: list[float]
    level: float
    estimator: str
    refined_runs: int
    samples: int
    failures_refined: int
    modes: dict[str, ModePart] | None
    finished: str | None
    difference: Change | None
    displacement: Displaced | None
    peak: float | None


class Fitted(TypedDict):
    """A fragility curve, as `cooperative.estimate.Curve`."""

    form: str
    median: float
    median_interval: list[float]
    deviation: float
    deviation_interval: list[float]
    rises: bool
    log_likelihood: float
    level: list[float]
    probability: list[float]
    low: list[float]
    high: list[float]


Parameters = Mapping[str, list[Point]]
Fragility = Mapping[str, list[Fitted]]


def label_of(parameter: str) -> str:
    """Label of a parameter's axis.

    Args:
        parameter: its key, or its path in the scene.
    """
    path, _, record = parameter.partition(" of ")
    return LABELS.get(parameter, PATHS.get(path, path) + (f", {record}" if record else ""))


COLUMNS = (
    "parameter",
    "value",
    "peak_g",
    "probability",
    "low",
    "high",
    "difference",
    "difference_low",
    "difference_high",
    "displacement_median_m",
    "displacement_90_m",
    "samples",
    "refined_runs",
    "campaign",
)
"""Of `sweep.csv`, a row for each value of each parameter; what a value does not have is empty."""


def table(parameters: Parameters) -> str:
    """The points of a sweep as CSV.

    Args:
        parameters: points of `sweep.json` by parameter.
    """
    rows: list[Sequence[object]] = [COLUMNS]
    for name, points in parameters.items():
        for point in points:
            change, displaced = point["difference"], point["displacement"]
            compared = ["", "", ""] if change is None else [change["difference"], *change["interval"]]
            displacement = ["", ""] if displaced is None else [displaced["median"], displaced["ninety"]]
            answer = [point["peak"], point["probability"], *point["interval"]]
            counts = [point["samples"], point["refined_runs"], point["campaign"]]
            rows.append([name, point["value"], *answer, *compared, *displacement, *counts])
    return csv_text(rows)


def in_words(parameters: Parameters, fragility: Fragility) -> str:
    """A sweep for a terminal: P_f and its difference to the base at each value, and the fitted curves.

    Args:
        parameters: points of `sweep.json` by parameter.
        fragility: its curves by parameter, the likelier first.
    """
    lines = []
    for name, points in parameters.items():
        lines.append(name)
        for point in points:
            value = point["value"] if isinstance(point["value"], str) else f"{point['value']:g}"
            line = f"  {value:<12} P_f {point['probability']:.3g} {_limits(point['interval'])}"
            if (change := point["difference"]) is not None:
                line += f", {change['difference']:+.3g} {_limits(change['interval'])} to the base"
            lines.append(line)
        lines += [f"  curve        {line}" for line in _curves(fragility.get(name, []))]
    if RECORDS in fragility:
        lines += [f"all records, {PEAK}", *(f"  curve        {line}" for line in _curves(fragility[RECORDS]))]
    return "\n".join(lines)


def _curves(curves: Sequence[Fitted]) -> Iterator[str]:
    for curve in curves[:1]:
        kind = _kind(curve)
        yield (
            f"{curve['form']}, median {curve['median']:.3g} {_limits(curve['median_interval'])}, {kind} "
            f"{curve['deviation']:.2g} {_limits(curve['deviation_interval'])}"
        )


def _limits(interval: Sequence[float]) -> str:
    return f"({interval[0]:.3g} to {interval[1]:.3g})"


def probabilities(parameters: Parameters) -> Figure:
    """P_f with its interval against each parameter, one panel each.

    Args:
        parameters: points of `sweep.json` by parameter.
    """
    figure, axes = _panels(len(parameters))
    for ax, (name, rows) in zip(axes, parameters.items(), strict=True):
        shares, limits = [row["probability"] for row in rows], [row["interval"] for row in rows]
        _errorbar(ax, rows, shares, limits, COLOURS[0], "o", "")
        ax.set(xlabel=label_of(name), ylabel="probability of failure $P_f$ [-]")
        ax.set_ylim(bottom=0)
    return figure


def differences(parameters: Parameters) -> Figure:
    """Difference of P_f to the base, of the same samples, with its interval against each parameter.

    Args:
        parameters: points of `sweep.json` by parameter, with differences.
    """
    figure, axes = _panels(len(parameters))
    for ax, (name, rows) in zip(axes, parameters.items(), strict=True):
        known = [(row, change) for row in rows if (change := row["difference"])]
        of = [change["difference"] for _, change in known]
        limits = [change["interval"] for _, change in known]
        ax.axhline(0.0, color="0.6", lw=0.8)
        _errorbar(ax, [row for row, _ in known], of, limits, COLOURS[0], "o", "")
        ax.set(xlabel=label_of(name), ylabel="difference of $P_f$ to the base [-]")
    return figure


def fragility_curves(parameters: Parameters, fragility: Fragility) -> Figure:
    """Fragility curves with the points that they are fitted to; of records all in one panel.

    Args:
        parameters: points of `sweep.json` by parameter.
        fragility: its curves by parameter, the likelier first.
    """
    of_records = [name for name in parameters if parameters[name][0]["peak"] is not None]
    alone = [name for name in fragility if name in parameters and name not in of_records]
    figure, axes = _panels(len(alone) + bool(of_records))
    for ax, name in zip(axes, alone, strict=False):
        curve = fragility[name][0]
        _band(ax, curve, COLOURS[0])
        ax.set_title(f"{curve['form']}: {_in_words(curve)}", fontsize=8)
        rows = parameters[name]
        _errorbar(ax, rows, [r["probability"] for r in rows], [r["interval"] for r in rows], "0.15", "o", "", line="")
        ax.set(xlabel=label_of(name), ylabel="probability of failure $P_f$ [-]", ylim=(-0.02, 1.02))
    if of_records:
        _records(axes[-1] if len(axes) == len(alone) + 1 else axes[len(alone)], parameters, fragility, of_records)
    return figure


def displacements(parameters: Parameters) -> Figure:
    """Displacement of the samples on the rough grid against each parameter: median and 90 % quantile.

    Args:
        parameters: points of `sweep.json` by parameter.
    """
    figure, axes = _panels(len(parameters))
    for ax, (name, rows) in zip(axes, parameters.items(), strict=True):
        displaced = [(row["value"], each) for row in rows if (each := row["displacement"])]
        at = [value for value, _ in displaced]
        ax.plot(at, [max(each["ninety"], 1e-4) for _, each in displaced], "^-", color=COLOURS[1], label="90 % quantile")
        ax.plot(at, [max(each["median"], 1e-4) for _, each in displaced], "o-", color=COLOURS[0], label="median")
        ax.set(xlabel=label_of(name), ylabel="largest displacement, rough grid [m]", yscale="log")
        ax.legend(frameon=False, fontsize=7)
    return figure


def mode_ratios(parameters: Parameters) -> Figure:
    """Share of each mode among the failures, with its interval, against each parameter, one panel each.

    Args:
        parameters: points of `sweep.json` by parameter.
    """
    figure, axes = _panels(len(parameters))
    handles: dict[str, Artist] = {}
    for ax, (name, rows) in zip(axes, parameters.items(), strict=True):
        with_failures = [(row, modes) for row in rows if (modes := row["modes"])]
        for number, (mode, (colour, marker)) in enumerate(STYLES.items()):
            parts = [modes[mode] for _, modes in with_failures]
            if any(part["count"] for part in parts):
                ratio, limits = [part["ratio"] for part in parts], [part["interval"] for part in parts]
                drawn = [row for row, _ in with_failures]
                _errorbar(ax, drawn, ratio, limits, colour, marker, mode, shift=number - 1.5)
        ax.set(xlabel=label_of(name), ylabel="share of the failures [-]", ylim=(-0.02, 1.02))
        handles |= {label: handle for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    if handles:
        shown = [mode for mode in STYLES if mode in handles]
        figure.legend([handles[mode] for mode in shown], shown, loc="outside upper center", ncols=4, frameon=False)
    return figure


def _records(ax: Axes, parameters: Parameters, fragility: Fragility, names: Sequence[str]) -> None:
    """Curves of records against their peak acceleration, and that of all together."""
    for number, name in enumerate(names):
        colour, rows = COLOURS[(number + 1) % len(COLOURS)], parameters[name]
        at = [{**row, "value": row["peak"] or 0.0} for row in rows]
        label = name.partition(" of ")[2]
        _errorbar(ax, at, [r["probability"] for r in rows], [r["interval"] for r in rows], colour, "o", label, line="-")  # type: ignore[arg-type]
    if RECORDS in fragility:
        curve = fragility[RECORDS][0]
        _band(ax, curve, "0.3", "all records")
        ax.set_title(f"{curve['form']}: {_in_words(curve)}", fontsize=8)
    ax.set(xlabel=PEAK, ylabel="probability of failure $P_f$ [-]", ylim=(-0.02, 1.02))
    ax.legend(frameon=False, fontsize=7, loc="best")


def _band(ax: Axes, curve: Fitted, colour: str, label: str = "") -> None:
    at = curve["level"]
    ax.fill_between(at, curve["low"], curve["high"], color=colour, alpha=0.2, lw=0)
    ax.plot(at, curve["probability"], color=colour, lw=1.4, label=label)


def _in_words(curve: Fitted) -> str:
    """Median and deviation of a curve."""
    return f"median {curve['median']:.3g}, {_kind(curve)} {curve['deviation']:.2g}"


def _kind(curve: Fitted) -> str:
    """What a curve's deviation is called."""
    return "dispersion" if curve["form"] == "lognormal" else "deviation"


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    """So many panels, at most three beside each other, so that a page's width leaves them legible."""
    rows = -(-count // 3)
    columns = -(-count // rows)
    return tiled(count, columns, (3.4 if columns == 1 else 3.0, 3.2))


def _errorbar(
    ax: Axes, rows: Sequence[Point], middle: list[float], limits: list[list[float]], colour: str, marker: str,
    label: str, *, shift: float = 0.0, line: str = "-",
) -> None:  # fmt: skip
    """A line with intervals, displaced a little sideways so that intervals do not lie on each other."""
    values = [row["value"] for row in rows]
    named = any(isinstance(value, str) for value in values)
    at = np.arange(len(values), dtype=float) if named else np.array(values, float)
    if named:
        ax.set_xticks(at, [str(value) for value in values], rotation=20, ha="right")
        line = ""
    at = at + shift * 0.008 * (np.ptp(at) if at.size > 1 else 1.0)
    off = [[m - low for m, (low, _) in zip(middle, limits, strict=True)],
           [high - m for m, (_, high) in zip(middle, limits, strict=True)]]  # fmt: skip
    ax.margins(x=0.08)
    ax.errorbar(
        at, middle, np.maximum(off, 0.0), color=colour, marker=marker, ms=5, lw=1.4, ls=line or "none", capsize=2,
        elinewidth=1.4, label=label,
    )  # fmt: skip
