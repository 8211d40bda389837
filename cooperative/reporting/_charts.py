"""Figures of a campaign's numbers. Each takes arrays or parts of its summary and gives a matplotlib Figure.

Units stand on every axis. The colours are those of Okabe and Ito (2008), distinct for all kinds of colour vision; what
colour shows, shape or position shows too. Pictures of the slope itself are in `_plots`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cooperative.estimate import Exceedance, Fits, Severity
from cooperative.hazard import ARRIVAL, REACHED, THICKNESS, HazardMaps
from cooperative.summary import Convergence, ModeShare

ROUGH, REFINED, FAILED, GREY = "#0072B2", "#D55E00", "#CC79A7", "#5A5A5A"
SERIES = (ROUGH, REFINED, FAILED, "#009E73", "#56B4E9", GREY)
MODE_COLOURS = {"progressive": "#D55E00", "compound": "#CC79A7", "deep": "#0072B2", "shallow": "#009E73"}
STYLES = ("-", "--", "-.", ":")

Curve = tuple[np.ndarray, ...]
"""Where it is taken (n,), and its values there with their limits (n,) each."""


def panels(rows: int, columns: int = 1, *, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """A figure with panels, without state beyond itself.

    Args:
        rows: of panels.
        columns: of panels.
        size: of a panel (inch).
    """
    figure = Figure(figsize=(size[0] * columns, size[1] * rows), layout="constrained")
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    for ax in axes:
        ax.spines[["top", "right"]].set_visible(False)
    return figure, axes


def tiled(count: int, columns: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """A figure with panels in rows.

    Args:
        count: of panels.
        columns: panels beside each other, at most.
        size: of a panel (inch).
    """
    columns = min(count, columns)
    figure, axes = panels(-(-count // columns), columns, size=size)
    for ax in axes[count:]:
        ax.set_axis_off()
    return figure, axes[:count]


def ranked_displacements(rows: Mapping[str, np.ndarray], *, failure_displacement: float = 1.0) -> Figure:
    """Largest displacement of every sample, by rank on the rough grid, with its refined result.

    Args:
        rows: "rough" and "refined" displacement (N,) m, nan where a sample has no result on that grid.
        failure_displacement: drawn as a line (m).
    """
    figure, (ax,) = panels(1, size=(7.0, 4.2))
    rough, refined = (np.asarray(rows[name], dtype=float) for name in ("rough", "refined"))
    rank, lost = ranks(rough), ~np.isfinite(rough)
    ax.plot(rank, rough, ".", color=ROUGH, ms=7, label=f"rough grid ({(~lost).sum()} samples)")
    if count := np.isfinite(refined).sum():
        ax.plot(rank, refined, "^", color=REFINED, ms=5, mfc="none", label=f"refined grid ({count} samples)")
    if lost.any():
        top = np.full(lost.sum(), np.nanmax(rough))
        ax.plot(rank[lost], top, "x", color=GREY, label=f"rough run broke off ({lost.sum()})")
    ax.axhline(failure_displacement, color=GREY, lw=1, ls=":")
    below = failure_displacement > max(np.nanmax(rough, initial=0.0), np.nanmax(refined, initial=0.0))
    ax.annotate(
        f"failure from {failure_displacement:g} m",
        (rank.max(), failure_displacement),
        ha="right",
        va="top" if below else "bottom",
        color=GREY,
        fontsize=9,
    )
    ax.set(yscale="log", xlabel="rank on the rough grid [-]", ylabel="largest displacement $R_d$ [m]")
    ax.legend()
    return figure


def ranks(rough: np.ndarray) -> np.ndarray:
    """Rank (N,) of each sample by its displacement on the rough grid, the farthest first; without one before all."""
    order = np.argsort(-np.where(np.isfinite(rough), rough, np.inf), kind="stable")
    return np.argsort(order) + 1


def exceedance(curves: Mapping[str, Exceedance], labels: Mapping[str, str], *, level: float) -> Figure:
    """Exceedance curves with their pointwise intervals, one panel each.

    Args:
        curves: by consequence, as in the summary.
        labels: name -> axis label with its unit.
        level: of the intervals.
    """
    figure, axes = tiled(len(curves), 3, (3.7, 3.1))
    for ax, (name, curve) in zip(axes, curves.items(), strict=True):
        _exceeded(ax, curve, ROUGH, level)
        ax.set(xlabel=labels[name], ylabel="probability of more [-]")
        ax.set_xlim(0, curve.thresholds[-1] or 1.0)
    axes[0].legend()
    return figure


def losses(curve: Exceedance, *, level: float) -> Figure:
    """Loss exceedance (F-N) curve: probability of losing more, with its interval."""
    figure, (ax,) = panels(1, size=(6.0, 3.6))
    _exceeded(ax, curve, REFINED, level)
    ax.set(xlabel="loss [currency of the scene]", ylabel="probability of losing more [-]")
    ax.legend()
    return figure


def stairs_of(curve: Exceedance) -> Curve:
    """Thresholds of a curve, and the probabilities that they are exceeded."""
    return tuple(map(np.array, (curve.thresholds, curve.probability, curve.low, curve.high)))


def _exceeded(ax: Axes, curve: Exceedance, colour: str, level: float) -> None:
    _banded(ax, stairs_of(curve), colour=colour, name=f"with {level:.0%} interval", steps=True)
    ax.set_ylim(bottom=0)


def profile(maps: HazardMaps, *, toe: float | None) -> Figure:
    """Hazard along a section: probabilities, expected thickness and arrival against x.

    What is reached, the thickness and the arrival have their intervals.

    Args:
        maps: of a section.
        toe: x of the toe (m), drawn as a line where there is one.
    """
    figure, axes = panels(3, size=(8.0, 2.6))
    for ax, (label, curves) in zip(axes, along(maps).items(), strict=True):
        for number, (name, curve) in enumerate(curves.items()):
            colour, style = SERIES[number % 6], STYLES[number % 4] + ("" if number < 4 else "o")
            if number == 0:
                _banded(ax, curve, colour=colour, name=name, style=style, steps=True)
            else:
                ax.step(*curve[:2], style, where="post", color=colour, lw=1.8, ms=2.5, label=name)
        ax.set(xlabel="x [m]", ylabel=label, xlim=(curve[0][0], curve[0][-1]))
        ax.set_ylim(bottom=0)
        if toe is not None:
            ax.axvline(toe, color=GREY, lw=1, ls=":")
        ax.legend(fontsize=8)
    if toe is not None:
        axes[0].annotate(" toe", (toe, axes[0].get_ylim()[1]), va="top", color=GREY, fontsize=9)
    return figure


def along(maps: HazardMaps) -> dict[str, dict[str, Curve]]:
    """Hazard along a section: by the label of a panel, its curves by name."""

    def at(name: str) -> Curve:
        chances = maps.maps[name]
        value, low, high = (np.append(values, values[-1:]) for values in (chances.value, chances.low, chances.high))
        return maps.edges[0], value, low, high

    return {
        "probability [-]": {name: at(name) for name, unit in maps.units.items() if unit == "-"},
        "thickness [m]": {"expected thickness of the deposit": at(THICKNESS)},
        "arrival [s]": {"mean arrival of the slides that come": at(ARRIVAL)},
    }


def _banded(
    ax: Axes, curve: Curve, *, colour: str, name: str, style: str = "-", marker: str = "", steps: bool = False
) -> None:
    """A curve in the band of its interval, whose ends are thin lines, to be seen in black and white too."""
    at, value, low, high = curve
    drawstyle = "steps-post" if steps else "default"
    ax.fill_between(at, low, high, step="post" if steps else None, color=colour, alpha=0.2, lw=0)
    ax.plot(at, value, style, color=colour, lw=2, marker=marker, ms=4, drawstyle=drawstyle, label=name)
    for limit in (low, high):
        ax.plot(at, limit, "-", color=colour, lw=0.6, drawstyle=drawstyle)


def plan_maps(maps: HazardMaps, *, toe: float | None) -> Figure:
    """Hazard in plan, one panel for each map, with the limits of its interval beside it for the first.

    Args:
        maps: in plan.
        toe: x of the toe (m), drawn as a line where there is one.
    """
    shown = list(mapped(maps))
    x, y = maps.edges
    figure, axes = tiled(len(shown), 2, (5.4, 5.4 * np.ptp(y) / np.ptp(x) + 0.9))
    for ax, (title, unit, values, top) in zip(axes, shown, strict=True):
        mesh = ax.pcolormesh(x, y, values.T, cmap="cividis", vmin=0.0, vmax=top, rasterized=True)
        if toe is not None:
            ax.axvline(toe, color="white", lw=1.2, ls="--")
        ax.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
        ax.set_title(title, loc="left", fontsize=9)
        figure.colorbar(mesh, ax=ax, label=f"[{unit}]", shrink=0.8)
    return figure


def mapped(maps: HazardMaps) -> Iterable[tuple[str, str, np.ndarray, float]]:
    """Title, unit, values (nx, ny) and end of the scale of each map in plan.

    The limits of what is reached follow it and share its scale.
    """
    for name, chances in maps.maps.items():
        reached, unit = name == REACHED, maps.units[name]
        top = float(np.nanmax(chances.high if reached else chances.value, initial=0.0)) or 1.0
        yield name, unit, chances.value, top
        if reached:
            yield f"{name}, lower limit", unit, chances.low, top
            yield f"{name}, upper limit", unit, chances.high, top


def convergence(path: Convergence, method: str, *, level: float) -> Figure:
    """Probability of failure against refined runs, with its interval.

    Args:
        path: estimates as refined runs came in.
        method: name of the estimator.
        level: of the interval.
    """
    figure, (ax,) = panels(1, size=(7.0, 4.2))
    values = tuple(map(np.array, (path.refined_runs, path.probability, path.low, path.high)))
    _banded(ax, values, colour=ROUGH, name=f"{method}, {level:.0%} interval", marker="o")
    ax.set(xlabel="refined runs [-]", ylabel="probability of failure $P_f$ [-]")
    ax.set_ylim(bottom=0)
    ax.legend()
    return figure


def grids(rough: np.ndarray, refined: np.ndarray, *, failure_displacement: float, title: str = "") -> Figure:
    """Refined against rough displacement of the samples that ran on both: how well the rough grid predicts.

    Args:
        rough: (n,) m.
        refined: (n,) m.
        failure_displacement: m.
        title: what is known of it, in words.
    """
    figure, (ax,) = panels(1, size=(5.2, 4.6))
    fails = refined > failure_displacement
    for group, marker, colour, name in (
        (fails, "^", REFINED, "fails on the refined grid"),
        (~fails, "o", ROUGH, "stands on the refined grid"),
    ):
        ax.plot(rough[group], refined[group], marker, color=colour, mfc="none", ms=5, label=f"{name} ({group.sum()})")
    ends = np.array([min(rough.min(), refined.min()), max(rough.max(), refined.max())])
    ax.plot(ends, ends, "-", color=GREY, lw=0.8, label="both alike")
    ax.axhline(failure_displacement, color=GREY, lw=1, ls=":")
    ax.axvline(failure_displacement, color=GREY, lw=1, ls=":")
    ax.set(xscale="log", yscale="log", xlabel="$R_d$ on the rough grid [m]", ylabel="$R_d$ on the refined grid [m]")
    ax.set_title(title, loc="left", fontsize=9)
    ax.legend(fontsize=8)
    return figure


def mode_shares(modes: Mapping[str, ModeShare]) -> Figure:
    """Share of each failure mode among the failures, with its interval."""
    figure, (ax,) = panels(1, size=(6.0, 3.2))
    for at, (name, share) in enumerate(modes.items()):
        ax.plot([at, at], share.interval, "-_", color="black", lw=1.2, ms=12)
        ax.plot([at], [share.ratio], "o", color=MODE_COLOURS[name], ms=9)
    ax.set_xticks(range(len(modes)), [f"{name}\n{share.count}" for name, share in modes.items()])
    ax.set(ylabel="share of the failures [-]", xlabel="failure mode, runs [-]", ylim=(0, 1.02))
    ax.set_xlim(-0.6, len(modes) - 0.4)
    return figure


def fitted(
    samples: Mapping[str, np.ndarray],
    weights: np.ndarray,
    fits: Mapping[str, Fits],
    labels: Mapping[str, str],
    *,
    most: int = 3,
) -> Figure:
    """Cumulative distribution of each consequence with the best fits, one panel each.

    Args:
        samples: name -> values (n,) of the failures.
        weights: what each stands for (n,).
        fits: of each name.
        labels: name -> axis label with its unit.
        most: fits drawn in each panel.
    """
    figure, axes = tiled(len(samples), 3, (3.5, 2.9))
    for ax, (name, values) in zip(axes, samples.items(), strict=True):
        ax.ecdf(values, weights, color="black", lw=1.4, label="runs")
        reach = np.ptp(values)
        curve = np.linspace(values.min() - 0.15 * reach, values.max() + 0.15 * reach, 200)
        styles = zip((REFINED, "#009E73", "#56B4E9"), STYLES, strict=False)
        for fit, (colour, style) in zip(fits[name].fits[:most], styles, strict=False):
            ax.plot(curve, fit.frozen.cdf(curve), style, color=colour, lw=1.6, label=f"{fit.name}, AIC {fit.aic:.1f}")
        ax.set(xlabel=labels[name], ylabel="cumulative share [-]", ylim=(-0.02, 1.02))
        ax.legend(fontsize=7)
    return figure


def severity(severities: Mapping[str, Sequence[Severity]], labels: Mapping[str, str]) -> Figure:
    """Median of each consequence by failure mode, most severe on top, with its bootstrap interval.

    Args:
        severities: consequence -> modes by rank, as in the summary.
        labels: name -> axis label with its unit.
    """
    # The summary ranks areas too, which a section has none of.
    severities = {name: ranked for name, ranked in severities.items() if name in labels}
    figure, axes = tiled(len(severities), 2, (5.2, 2.4))
    for ax, (name, ranked) in zip(axes, severities.items(), strict=True):
        for height, mode in enumerate(reversed(ranked)):
            colour = MODE_COLOURS[mode.group]
            ax.plot([mode.middle], [height], "o", color=colour, ms=7)
            if mode.interval is not None:
                ax.plot(mode.interval, [height, height], "-|", color=colour, lw=2.5, ms=9)
        ax.set_yticks(range(len(ranked)), [f"{mode.group} ({mode.count})" for mode in reversed(ranked)])
        ax.set(xlabel=labels[name], ylabel="failure mode (runs) [-]", ylim=(-0.6, len(ranked) - 0.4))
        ax.set_xmargin(0.08)
    return figure
