"""Figures of the probability of failure: the ranks behind it, correlation lengths, readings of what is left open."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.study import study_pieces, study_runs
from benchmarks.study.published_probability import drawn
from benchmarks.study.study_figures._study import (
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
from benchmarks.study.study_pieces import LIMIT, population, score
from benchmarks.study.study_runs import LENGTHS
from benchmarks.study.study_table import Run

CHANGE = "P_f of the section, change by: "
SAID = {
    "one strength per cell": "one strength per cell, not per particle",
    "equivalent plastic strain": "equivalent, not engineering plastic strain",
    "published time step": "time step as published (CFL 0.11, 0.22)",
    "CFL 0.9": "time step longer (CFL 0.9)",
    "one particle a cell": "one particle per cell, not four",
    "F-bar": "F-bar, which cures locking",
    "default": "default settings: F-bar, and\nbands as thick on every grid",
}
"""Readings that need more words than their names."""


def readings(study: Study) -> Figure | None:
    """What each reading is worth in P_f of the section."""
    known = [(line.what.removeprefix(CHANGE), line.found) for line in study.lines if line.what.startswith(CHANGE)]
    if all(isinstance(found, str) for _, found in known):
        return None
    figure, (ax,) = sheet(1, 1, (7.6, 1.4 + 0.32 * len(known)))
    for at, (_, found) in enumerate(known):
        if isinstance(found, str):
            ax.text(0, at, "  not run yet", va="center", color=GREY, fontsize=FAINT)
        else:
            ax.plot(found.interval, (at, at), color=BLUE, lw=1.8)
            ax.plot(found.value, at, "o", color=BLUE)
    ax.axvline(0, color=GREY, linewidth=0.8)
    ax.set_yticks(range(len(known)), [SAID.get(name, name) for name, _ in known])
    ax.set_ylim(len(known) - 0.5, -0.5)
    ax.grid(axis="x", color="0.9", lw=0.6)
    base = study.answer("P_f of the section")
    told = "" if base is None else f": {with_limits(base, 3)}, {base.rests_on}"
    ax.set_title(f"$P_f$ of the section{told};\nwhat one change at a time makes of it", loc="left", fontsize=10)
    ax.set_xlabel("change of $P_f$ on the same samples [-], 95 % interval")
    return figure


def lengths(study: Study) -> Figure | None:
    """P_f against the correlation length along each axis (Fig. 10), and the one printed value where it is printed."""
    named = (("P_f in 3D, {} = {:g} m, the other 60 m", "o", BLUE, "{} at each length", -1.0),
             ("rough grid alone: P_f at {} = {:g} m", "s", GREY, "rough grid alone, calibrated: {}", 1.0))  # fmt: skip
    keys = [name.format(axis, length) for name, *_ in named for axis in ("lx", "ly") for length in LENGTHS]
    if not any(study.answer(key) for key in keys):
        return None
    figure, axes = sheet(1, 2, (4.4, 3.9))
    for ax, axis in zip(axes, ("lx", "ly"), strict=True):
        for name, marker, color, words, aside in named:
            known = {length: study.answer(name.format(axis, length)) for length in LENGTHS}
            there = {length + aside: found for length, found in known.items() if found is not None}
            for at, found in there.items():
                upright(ax, at, found, color=color, marker=marker, ms=5)
            values = [np.nan if found is None else found.value for found in known.values()]
            # What the answers rest on, less their notes.
            rests_on = " or ".join(dict.fromkeys(found.rests_on.split(";")[0] for found in there.values()))
            places = [length + aside for length in known]
            ax.plot(places, values, f"{marker}-", color=color, ms=5, lw=1.2, label=words.format(rests_on))
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
    if line is None or line.printed is None:
        return
    if line.counted is not None:
        ax.plot((63.5, 63.5), line.counted, "-", color=RED, lw=1.4)
    ax.plot(63.5, line.printed, "D-", color=RED, ms=6, label=f"printed: {line.printed:g} at $l_x = l_y$ = 60 m")


def ranks(study: Study) -> Figure | None:
    """Each sample by its rank on the rough grid, and how the two grids agree on those that the audit drew."""
    rows, samples = study.rows, study_runs.SAMPLES
    screened = population(rows, "published", samples)
    if screened is None:
        return None
    rough = screened.rough_displacement
    refined = {n: score(rows[run]) for n in range(samples) if (run := Run("published", "refined", n)) in rows}
    weight = drawn(rows, "published", samples, study_pieces.AUDIT)
    figure, (left, right) = sheet(1, 2, (4.6, 4.0))
    order = np.argsort(-rough, kind="stable")
    place = np.empty(samples, int)
    place[order] = np.arange(1, samples + 1)
    left.plot(np.arange(1, samples + 1), rough[order], color="black", lw=1.4, label=f"rough grid, {samples} samples")
    rest, chance = [n for n in refined if n not in weight], list(weight)
    for mine, marker, color, words in (
        (rest, "x", YELLOW, "refined, in rank order"),
        (chance, "o", BLUE, "refined, drawn by chance"),
    ):
        left.plot(place[mine], [refined[n] for n in mine], marker, color=color, ms=4, label=f"{words}: {len(mine)}")
    left.axhline(LIMIT, color=GREY, lw=0.8, ls="--")
    left.text(samples, LIMIT * 1.1, f"fails above {LIMIT:g} m", ha="right", va="bottom", color=GREY, fontsize=FAINT)
    left.set(yscale="log", xlabel="rank on the rough grid [-]")
    left.set_ylabel(f"displacement [m]; of a failure, what\n20 s give at its speed up to {LIMIT:g} m")
    left.set_title("every sample by its rank", loc="left", fontsize=10)
    left.legend(frameon=False, fontsize=INSIDE)
    _agreement(right, rough[chance], np.array([refined[n] for n in chance]), np.array(list(weight.values())))
    known = (("rank correlation", study.answer("spearman_3d")), ("classed alike", study.answer("same_class_3d")))
    told = [f"{words} {with_limits(found)}" for words, found in known if found is not None]
    right.set_title("\n".join(told or ["both grids"]), loc="left", fontsize=10)
    return figure


def _agreement(ax: Axes, rough: np.ndarray, refined: np.ndarray, weight: np.ndarray) -> None:
    """Displacements (n,) of the samples drawn by chance on both grids, and how many have which classes."""
    ax.scatter(rough, refined, 1500 * weight / weight.sum(), color=BLUE, alpha=0.6, lw=0)
    for line in (ax.axvline, ax.axhline):
        line(LIMIT, color=GREY, lw=0.8, ls="--")
    for words, on_rough, on_refined in (
        ("both fail", True, True),
        ("only rough fails", True, False),
        ("only refined fails", False, True),
        ("both stand", False, False),
    ):
        count = ((rough > LIMIT) == on_rough) & ((refined > LIMIT) == on_refined)
        ax.text(
            LIMIT * (1.15 if on_rough else 0.87), LIMIT * (1.15 if on_refined else 0.87), f"{words}: {count.sum()}",
            ha="left" if on_rough else "right", va="bottom" if on_refined else "top", fontsize=FAINT,
        )  # fmt: skip
    ax.set(xscale="log", yscale="log")
    ax.set_xlabel("displacement on the rough grid [m]; area:\nhow many samples one stands for")
    ax.set_ylabel("displacement on the refined grid [m]")
