"""What the figures of the study are drawn from, and the marks that they share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.study.answers import Answer, Line
from benchmarks.study.rows import Rows
from cooperative.reporting import panels

BLUE, RED, GREEN, PINK = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
YELLOW, GREY = "#E69F00", "#5A5A5A"
MODES = {"deep": (BLUE, "o"), "progressive": (RED, "s"), "compound": (PINK, "D"), "shallow": (GREEN, "^")}
"""Colour and marker of each mode; the colours of the report (Okabe and Ito), which all kinds of vision tell apart."""
INSIDE, FAINT = 8.5, 9.0
"""Sizes of letters (pt) in legends, and of notes beside the axes."""


@dataclass(frozen=True)
class Study:
    """What is drawn.

    Attributes:
        rows: of all runs.
        lines: of the table.
    """

    rows: Rows
    lines: Sequence[Line]

    def line(self, key: str) -> Line:
        """The row with this name, or the first whose words begin so."""
        named = (line for line in self.lines if line.name == key)
        return next(named, None) or next(line for line in self.lines if line.what.startswith(key))

    def answer(self, key: str) -> Answer:
        """The answer in that row. ValueError where it has none."""
        answer = self.line(key).answer
        if isinstance(answer, str):
            raise ValueError(f"{key}: not run yet: {answer}")
        return answer


def sheet(rows: int, columns: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """Panels of `size` [inch] each, with some air between them and around."""
    figure, axes = panels(rows, columns, size=size)
    figure.set_layout_engine("constrained", w_pad=0.1, h_pad=0.06)
    return figure, axes


def upright(ax: Axes, at: float, answer: Answer, **style: Any) -> None:
    """A value over `at`, with its interval."""
    ax.plot((at, at), answer.interval, "-", color=style["color"], lw=1.4)
    ax.plot(at, answer.value, ls="none", **style)


def with_limits(answer: Answer, digits: int = 2) -> str:
    """A value with its interval in words."""
    return f"{answer.value:.{digits}f} ({answer.interval[0]:.{digits}f} to {answer.interval[1]:.{digits}f})"
