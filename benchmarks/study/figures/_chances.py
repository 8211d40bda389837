"""Figures of the probability of failure: the ranks behind it, correlation lengths, readings of what is left open."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.study.cases import AUDIT, FAILS_ABOVE, LENGTHS, SAMPLES
from benchmarks.study.figures._study import (
    BLUE,
    FAINT,
    GREY,
    INSIDE,
    RED,
    YELLOW,
    Study,
    sheet,
    upright,
    with_limits,
)
from benchmarks.study.probability import CHANGE, audit_weights, audited_length, rough_length
from benchmarks.study.rows import Run, population

READINGS = {
    "one strength per cell": "one strength per cell, not per particle",
    "equivalent plastic strain": "equivalent, not engineering plastic strain",
    "published time step": "time step as published (CFL 0.11, 0.22)",
    "CFL 0.9": "time step longer (CFL 0.9)",
    "one particle a cell": "one particle per cell, not four",
    "F-bar": "F-bar, which cures locking",
    "default": "default settings: strain averaged over\ncells, bands as thick on every grid",
}
"""Readings that need more words than their names."""


def readings(study: Study) -> Figure:
    """Change of P_f of the section by each reading."""
    changes = {
        line.what.removeprefix(CHANGE): study.answer(line.what) for line in study.lines if line.what.startswith(CHANGE)
    }
    figure, (ax,) = sheet(1, 1, (7.6, 1.4 + 0.32 * len(changes)))
    for at, answer in enumerate(changes.values()):
        ax.plot(answer.interval, (at, at), color=BLUE, lw=1.8)
        ax.plot(answer.value, at, "o", color=BLUE)
    ax.axvline(0, color=GREY, linewidth=0.8)
    ax.set_yticks(range(len(changes)), [READINGS.get(name, name) for name in changes])
    ax.set_ylim(len(changes) - 0.5, -0.5)
    ax.grid(axis="x", color="0.9", lw=0.6)
    base = study.answer("P_f of the section")
    title = f"$P_f$ of the section: {with_limits(base, 3)}, {base.rests_on};\nwhat one change at a time makes of it"
    ax.set_title(title, loc="left", fontsize=10)
    ax.set_xlabel("change of $P_f$ on the same samples [-], 95 % interval")
    return figure


def lengths(study: Study) -> Figure:
    """P_f against the correlation length along each axis (Fig. 10), and the one printed value where it is printed."""
    kinds = (
        (audited_length, "o", BLUE, "{} at each length", -1.0),
        (rough_length, "s", GREY, "rough grid alone, calibrated: {}", 1.0),
    )
    figure, axes = sheet(1, 2, (4.4, 3.9))
    for ax, axis in zip(axes, ("lx", "ly"), strict=True):
        for name, marker, color, words, aside in kinds:
            answers = {length + aside: study.answer(name(axis, length)) for length in LENGTHS}
            for at, answer in answers.items():
                upright(ax, at, answer, color=color, marker=marker, ms=5)
            # The runs behind the answers, less the notes.
            rests_on = " or ".join(dict.fromkeys(answer.rests_on.split(";")[0] for answer in answers.values()))
            values = [answer.value for answer in answers.values()]
            ax.plot([*answers], values, f"{marker}-", color=color, ms=5, lw=1.2, label=words.format(rests_on))
        _printed(ax, study)
        ax.set_xticks(LENGTHS)
        ax.set(xlabel=f"correlation length ${axis[0]}_{axis[1]}$ [m], the other 60 m", ylim=(0, None))
    top = max(ax.get_ylim()[1] for ax in axes)
    for ax in axes:
        ax.set_ylim(0, top)
    axes[0].set_ylabel("probability of failure $P_f$ [-]")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", frameon=False, fontsize=FAINT)
    return figure


def _printed(ax: Axes, study: Study) -> None:
    line = study.line("pf_3d")
    assert line.counted is not None
    assert line.printed is not None
    ax.plot((63.5, 63.5), line.counted, "-", color=RED, lw=1.4)
    ax.plot(63.5, line.printed, "D-", color=RED, ms=6, label=f"printed: {line.printed:g} at $l_x = l_y$ = 60 m")


def ranks(study: Study) -> Figure:
    """Each sample by its rank on the rough grid, and how the two grids agree on those that the audit drew."""
    samples = SAMPLES
    rough = population(study.rows, "published", samples).rough_displacement
    runs = {n: Run("published", "refined", n) for n in range(samples)}
    refined = {n: study.rows[run].score for n, run in runs.items() if run in study.rows}
    weight = audit_weights(study.rows, "published", samples, AUDIT)
    figure, (left, right) = sheet(1, 2, (4.6, 4.0))
    order = np.argsort(-rough, kind="stable")
    rank = np.empty(samples, int)
    rank[order] = np.arange(1, samples + 1)
    left.plot(np.arange(1, samples + 1), rough[order], color="black", lw=1.4, label=f"rough grid, {samples} samples")
    rest, chance = [n for n in refined if n not in weight], list(weight)
    for numbers, marker, color, words in (
        (rest, "x", YELLOW, "refined, in rank order"),
        (chance, "o", BLUE, "refined, drawn by chance"),
    ):
        left.plot(
            rank[numbers], [refined[n] for n in numbers], marker, color=color, ms=4, label=f"{words}: {len(numbers)}"
        )
    left.axhline(FAILS_ABOVE, color=GREY, lw=0.8, ls="--")
    words = f"fails above {FAILS_ABOVE:g} m"
    left.text(samples, FAILS_ABOVE * 1.1, words, ha="right", va="bottom", color=GREY, fontsize=FAINT)
    left.set(yscale="log", xlabel="rank on the rough grid [-]")
    left.set_ylabel(f"displacement [m]; of a failure, what\n20 s give at its speed up to {FAILS_ABOVE:g} m")
    left.set_title("every sample by its rank", loc="left", fontsize=10)
    left.legend(frameon=False, fontsize=INSIDE)
    _agreement(right, rough[chance], np.array([refined[n] for n in chance]), np.array(list(weight.values())))
    in_title = {"rank correlation": study.answer("spearman_3d"), "classed alike": study.answer("same_class_3d")}
    title = "\n".join(f"{words} {with_limits(answer)}" for words, answer in in_title.items())
    right.set_title(title, loc="left", fontsize=10)
    return figure


def _agreement(ax: Axes, rough: np.ndarray, refined: np.ndarray, weight: np.ndarray) -> None:
    """Displacements (n,) of the samples drawn by chance on both grids, and how many have which classes."""
    ax.scatter(rough, refined, 1500 * weight / weight.sum(), color=BLUE, alpha=0.6, lw=0)
    for line in (ax.axvline, ax.axhline):
        line(FAILS_ABOVE, color=GREY, lw=0.8, ls="--")
    for words, on_rough, on_refined in (
        ("both fail", True, True),
        ("only rough fails", True, False),
        ("only refined fails", False, True),
        ("both stand", False, False),
    ):
        count = ((rough > FAILS_ABOVE) == on_rough) & ((refined > FAILS_ABOVE) == on_refined)
        x, y = (FAILS_ABOVE * (1.15 if fails else 0.87) for fails in (on_rough, on_refined))
        sides: dict[str, Any] = {"ha": "left" if on_rough else "right", "va": "bottom" if on_refined else "top"}
        ax.text(x, y, f"{words}: {count.sum()}", fontsize=FAINT, **sides)
    ax.set(xscale="log", yscale="log")
    ax.set_xlabel("displacement on the rough grid [m]; area:\nhow many samples one stands for")
    ax.set_ylabel("displacement on the refined grid [m]")
