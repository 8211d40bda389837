"""Figures of the slides: shares of the modes (Fig. 20), distributions of consequences (Fig. 19, Tables 4 and 5)."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.study.answers import Answer
from benchmarks.study.cases import LENGTHS, SWEEP, sweep_case
from benchmarks.study.figures._study import BLUE, GREY, INSIDE, MODES, RED, Study, sheet, upright
from benchmarks.study.modes import BEST_FITS, TO_FIT, rough_shares, weighted_slides
from cooperative.estimate import Fit, fit_distributions

LABELS = {"area": "influence area [m$^2$]", "volume": "sliding volume [m$^3$]", "runout": "run-out [m]"}


def modes(study: Study) -> Figure:
    """Shares of the modes against each correlation length, and beside them those of refined slides and the printed."""
    figure, axes = sheet(1, 3, (3.2, 3.9))
    for ax, axis in zip(axes, ("lx", "ly"), strict=False):
        counts = [_rough(ax, at, study, [sweep_case(axis, length)]) for at, length in enumerate(LENGTHS)]
        ticks = [f"{length:g} m\nn = {count}" for length, count in zip(LENGTHS, counts, strict=True)]
        ax.set_xticks(range(len(ticks)), ticks, fontsize=INSIDE)
        ax.set_xlabel(f"correlation length $l_{axis[1]}$, the other 60 m")
        ax.set_title("rough grid, calibrated", loc="left", fontsize=10)
    _beside(axes[2], study)
    for ax in axes:
        ax.set(ylim=(-0.02, 1.02), xlim=(-0.5, len(ax.get_xticks()) - 0.5))
        ax.grid(axis="y", color="0.9", lw=0.6)
    axes[0].set_ylabel("share of the failures [-]")
    marks = [axes[0].plot([], [], marker, color=color, label=mode)[0] for mode, (color, marker) in MODES.items()]
    figure.legend(handles=marks, loc="outside upper center", ncols=4, frameon=False)
    return figure


def _rough(ax: Axes, at: float, study: Study, cases: Collection[str]) -> int:
    """Shares on the calibrated rough grid over `at`; the number of slides."""
    for mode in MODES:
        _share(ax, at, mode, rough_shares(study.rows, cases, (mode,)))
    return sum(run.case in cases and run.grid == "rough" and o.mode is not None for run, o in study.rows.items())


def _share(ax: Axes, at: float, mode: str, answer: Answer) -> None:
    color, marker = MODES[mode]
    upright(ax, at + 0.16 * (list(MODES).index(mode) - 1.5), answer, color=color, marker=marker, ms=5)


def _beside(ax: Axes, study: Study) -> None:
    pooled = _rough(ax, 0, study, SWEEP)
    for number, (mode, (color, marker)) in enumerate(MODES.items()):
        line = study.line(f"share_{mode}")
        _share(ax, 1, mode, study.answer(f"share_{mode}"))
        assert line.printed is not None
        ax.plot(2 + 0.16 * (number - 1.5), line.printed, marker, color=color, mfc="white", mew=1.6, ms=6)
    names = (
        f"rough grid\nall lengths\nn = {pooled}",
        f"refined grid\n60 m\nn = {len(weighted_slides(study.rows).ended)}",
        "printed\nall lengths\n ",
    )
    ax.set_xticks(range(3), names, fontsize=INSIDE)
    ax.set_title("beside them", loc="left", fontsize=10)


def fits(study: Study) -> Figure:
    """Distributions fitted to the consequences of each mode of enough refined slides, the printed family among them."""
    slides = weighted_slides(study.rows)
    fitted = [mode for mode in MODES if slides.of_mode(mode).sum() >= TO_FIT]
    figure, axes = sheet(len(fitted), len(LABELS), (3.15, 3.7))
    for mode, row in zip(fitted, np.array(axes).reshape(len(fitted), -1), strict=True):
        of_mode = [slide for slide in slides.ended if slide.mode == mode]
        for ax, (measure, label) in zip(row, LABELS.items(), strict=True):
            values = np.array([getattr(slide, measure) for slide in of_mode], float)
            _distributions(ax, values, slides.weight[slides.of_mode(mode)], BEST_FITS[mode][measure])
            ax.set(xlabel=label, ylim=(-0.02, 1.02))
        row[0].set_ylabel(f"share of {mode} slides below [-]")
        row[0].set_title(f"{len(of_mode)} {mode} slides, refined grid", loc="left", fontsize=10)
    return figure


def _distributions(ax: Axes, values: np.ndarray, weight: np.ndarray, printed: str) -> None:
    """Weighted values as a staircase; the printed family and the best one over it, the others faint."""
    order = np.argsort(values, kind="stable")
    share = np.concatenate([[0.0], np.cumsum(weight[order]) / weight.sum()])
    ax.step(np.concatenate([values[order][:1], values[order]]), share, where="post", color="black", lw=1.4)
    reach = np.ptp(values)
    at = np.linspace(max(values.min() - 0.2 * reach, 0.0), values.max() + 0.2 * reach, 200)
    done = fit_distributions(values, weight)
    for fit in done.fits:
        color, style, width = GREY, "-", 0.5
        if fit.name == printed:
            color, style, width = RED, "--", 2.2
        elif fit.name == done.best_aic:
            color, style, width = BLUE, "-", 2.0
        ax.plot(at, fit.frozen.cdf(at), style, color=color, lw=width, label=_words(fit, done.fits[0], printed))
    ax.legend(
        frameon=False, fontsize=INSIDE, title="AIC above the best", title_fontsize=INSIDE, loc="upper center",
        bbox_to_anchor=(0.45, -0.18), ncols=2, columnspacing=0.8, handlelength=1.4, alignment="left",
    )  # fmt: skip


def _words(fit: Fit, best: Fit, printed: str) -> str:
    words = f"{fit.name} {fit.aic - best.aic:.1f}"
    return f"{words} (printed)" if fit.name == printed else words
