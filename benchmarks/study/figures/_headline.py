"""The headline numbers of the study over the printed ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from benchmarks.study.answers import Answer, Line
from benchmarks.study.figures._study import BLUE, GREY, RED, Study, sheet


class Kind(NamedTuple):
    """A kind of verdict: how it begins, and how it is drawn."""

    begins: tuple[str, ...]
    color: str
    marker: str


VERDICTS = {
    "agrees": Kind(("agrees", "rises, as published"), BLUE, "o"),
    "differs": Kind(("differs", "falls"), RED, "s"),
    "not resolved": Kind(("",), GREY, "^"),
}
"""The first that fits; what neither agrees nor differs is not resolved."""


@dataclass(frozen=True)
class Panel:
    """Rows on one axis. rows: of the table, and their labels. digits: of the numbers. ends: of the axis, None where
    the data set it. rises: what is printed is that the value is above 0."""

    title: str
    rows: dict[str, str]
    digits: int = 2
    ends: tuple[float, float] | None = None
    rises: bool = False


PANELS = (
    Panel(
        "Probability of failure",
        {
            "pf_3d": "published settings",
            "P_f in 3D by the published rule": "the same, by the published rule",
            "pf_3d_rollers": "y ends on rollers instead of fixed",
            "pf_3d_default": "default settings, which cure locking",
        },
        digits=3,
        ends=(0.0, 0.75),
    ),
    Panel(
        "Factor of safety (interval: one step of its search)",
        {
            "fos_rough_3d": "cells of 2 m",
            "fos_refined_3d": "cells of 1 m",
            "Table 3 with cells of 0.75 m, 3D: factor": "cells of 0.75 m",
        },
    ),
    Panel(
        "Run-out at that factor in metres (interval: half a cell)",
        {"runout_refined_3d_m": "cells of 1 m", "Table 3 with cells of 0.75 m, 3D: run-out": "cells of 0.75 m"},
        digits=1,
    ),
    Panel(
        "Share of the failures (correlation lengths here 60 m, printed all)",
        {
            "share_deep": "deep",
            "share_progressive": "progressive",
            "share_compound": "compound",
            "share_progressive_or_compound": "progressive or compound",
            "share_shallow": "shallow",
        },
        ends=(-0.02, 1.0),
    ),
    Panel(
        "Rise of the probability of failure, correlation length 10 to 120 m",
        {
            "rise of P_f from lx": "along the run-out (x)",
            "rough grid alone: rise of P_f from lx": "the same, rough grid alone",
            "rise of P_f from ly": "across the slope (y)",
            "rough grid alone: rise of P_f from ly": "the same, rough grid alone",
        },
        rises=True,
    ),
)
COLUMNS = (24, 74, 136)
"""Where ours, the printed value and the verdict stand in words, right of the axes (pt)."""


def against(study: Study) -> Figure:
    """Each headline number with its interval over the printed one, marked by its verdict."""
    heights = [len(panel.rows) + 1.6 for panel in PANELS]
    figure, axes = sheet(len(PANELS), 1, (9.0, 0.275 * sum(heights) / len(PANELS)))
    grid = axes[0].get_gridspec()
    if grid is not None:
        grid.set_height_ratios(heights)
    for ax, panel in zip(axes, PANELS, strict=True):
        _panel(ax, study, panel)
    for at, word in zip(COLUMNS, ("here", "printed"), strict=False):
        _beside(axes[0], -1.15, at, word, weight="bold")
    marks = [
        Line2D([], [], color=kind.color, marker=kind.marker, label=f"here: {word}") for word, kind in VERDICTS.items()
    ]
    marks.append(
        Line2D([], [], color="black", marker="|", ms=13, mew=2, ls="none", label="printed (grey: its own interval)")
    )
    figure.suptitle(
        "The published slope in 3D: what came out here, with its interval, and what is printed", fontsize=11
    )
    figure.legend(handles=marks, loc="outside lower center", ncols=4, frameon=False)
    return figure


def _panel(ax: Axes, study: Study, panel: Panel) -> None:
    for at, key in enumerate(panel.rows):
        _row(ax, at, study.line(key), study.answer(key), panel)
    ax.set_yticks(range(len(panel.rows)), list(panel.rows.values()))
    ax.set_ylim(len(panel.rows) - 0.4, -0.6)
    ax.tick_params(axis="y", length=0)
    ax.grid(axis="x", color="0.9", lw=0.6)
    ax.set_axisbelow(True)
    ax.set_title(panel.title, loc="left", fontsize=10, weight="bold")
    if panel.ends is not None:
        ax.set_xlim(panel.ends)
    else:
        ax.margins(x=0.12)
    ax.locator_params(axis="x", nbins=8, steps=(1, 2, 5, 10))
    if panel.rises:
        ax.axvline(0, color="black", lw=0.8)


def _row(ax: Axes, at: int, line: Line, answer: Answer, panel: Panel) -> None:
    """Mark and words of one row."""
    printed = "rises" if panel.rises else "" if line.printed is None else f"{line.printed:.{panel.digits}f}"
    if line.printed is not None:
        if line.counted is not None:
            ax.plot(line.counted, (at, at), "-", color="black", lw=4, alpha=0.25, solid_capstyle="butt")
        ax.plot(line.printed, at, "|", color="black", ms=13, mew=2, zorder=4)
    word, kind = judged(line)
    low, high = np.clip(answer.interval, *(panel.ends or (-np.inf, np.inf)))
    ax.plot((low, high), (at, at), "-", color=kind.color, lw=1.8, zorder=3)
    ax.plot(answer.value, at, kind.marker, color=kind.color, ms=7, zorder=3, clip_on=False)
    shown = f"{answer.value:{'+' if panel.rises else ''}.{panel.digits}f}"
    for points, words, color in zip(COLUMNS, (shown, printed, word), ("black", "black", kind.color), strict=True):
        _beside(ax, at, points, words, color=color)


def _beside(ax: Axes, at: float, points: float, words: str, **style: Any) -> None:
    """Words right of the axes, in the row at `at`."""
    ax.annotate(
        words, (1, at), (points, 0), ax.get_yaxis_transform(), "offset points", ha="center", va="center",
        annotation_clip=False, **style,
    )  # fmt: skip


def judged(line: Line) -> tuple[str, Kind]:
    """A verdict in a word, and how that is drawn."""
    verdict = line.verdict()
    return next((word, kind) for word, kind in VERDICTS.items() if verdict.startswith(kind.begins))
