"""Figures of the slides: shares of the modes (Fig. 20), distributions of consequences (Fig. 19, Tables 4 and 5)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.study.published_answers import Found
from benchmarks.study.published_modes import BEST_FITS, TO_FIT, rough_shares, weighted_slides
from benchmarks.study.study_figures._study import BLUE, GREY, INSIDE, MODES, RED, Study, sheet, upright
from benchmarks.study.study_pieces import sweep_cases
from benchmarks.study.study_runs import LENGTHS, sweep_case
from cooperative.estimate import Fit, fit_distributions

LABELS = {"area": "influence area [m$^2$]", "volume": "sliding volume [m$^3$]", "runout": "run-out [m]"}


def modes(study: Study) -> Figure | None:
    """Shares of the modes against each correlation length, and beside them those of refined slides and the printed."""
    by_length = [[(f"{length:g} m", [sweep_case(axis, length)]) for length in LENGTHS] for axis in ("lx", "ly")]
    found = {mode: study.answer(f"share_{mode}") for mode in MODES}
    known = [rough_shares(study.rows, cases, (mode,)) for groups in by_length for _, cases in groups for mode in MODES]
    if all(isinstance(answer, str) for answer in known) and not any(found.values()):
        return None
    figure, axes = sheet(1, 3, (3.2, 3.9))
    for ax, axis, groups in zip(axes, ("l_x", "l_y"), by_length, strict=False):
        ticks = [f"{name}\nn = {_rough(ax, at, study, cases)}" for at, (name, cases) in enumerate(groups)]
        ax.set_xticks(range(len(ticks)), ticks, fontsize=INSIDE)
        ax.set_xlabel(f"correlation length ${axis}$, the other 60 m")
        ax.set_title("rough grid, calibrated", loc="left", fontsize=10)
    _beside(axes[2], study, found)
    for ax in axes:
        ax.set(ylim=(-0.02, 1.02), xlim=(-0.5, len(ax.get_xticks()) - 0.5))
        ax.grid(axis="y", color="0.9", lw=0.6)
    axes[0].set_ylabel("share of the failures [-]")
    marks = [axes[0].plot([], [], marker, color=color, label=mode)[0] for mode, (color, marker) in MODES.items()]
    figure.legend(handles=marks, loc="outside upper center", ncols=4, frameon=False)
    return figure


def _rough(ax: Axes, at: float, study: Study, cases: list[str]) -> int:
    """Shares on the calibrated rough grid over `at`; the number of slides."""
    for mode in MODES:
        answer = rough_shares(study.rows, cases, (mode,))
        if not isinstance(answer, str):
            _share(ax, at, mode, answer)
    return sum(run.case in cases and run.grid == "rough" and o.mode is not None for run, o in study.rows.items())


def _share(ax: Axes, at: float, mode: str, answer: Found) -> None:
    color, marker = MODES[mode]
    upright(ax, at + 0.16 * (list(MODES).index(mode) - 1.5), answer, color=color, marker=marker, ms=5)


def _beside(ax: Axes, study: Study, refined: dict[str, Found | None]) -> None:
    pooled = _rough(ax, 0, study, sweep_cases())
    for mode, answer in refined.items():
        if answer is not None:
            _share(ax, 1, mode, answer)
        line = study.line(f"share_{mode}")
        if line is not None and line.printed is not None:
            at, (color, marker) = 2 + 0.16 * (list(MODES).index(mode) - 1.5), MODES[mode]
            if line.counted is not None:
                ax.plot((at, at), line.counted, "-", color=color, lw=1.4)
            ax.plot(at, line.printed, marker, color=color, mfc="white", mew=1.6, ms=6)
    names = (
        f"rough grid\nall lengths\nn = {pooled}",
        f"refined grid\n60 m\nn = {len(weighted_slides(study.rows).ended)}",
        "printed\nall lengths\n ",
    )
    ax.set_xticks(range(3), names, fontsize=INSIDE)
    ax.set_title("beside them", loc="left", fontsize=10)


def fits(study: Study) -> Figure | None:
    """Distributions fitted to the consequences of each mode of enough refined slides, the printed family among them."""
    slides = weighted_slides(study.rows)
    names = np.array([slide.mode for slide in slides.ended])
    told = [mode for mode in MODES if (names == mode).sum() >= TO_FIT]
    if not told:
        return None
    figure, axes = sheet(len(told), len(LABELS), (3.15, 3.7))
    for mode, row in zip(told, np.array(axes).reshape(len(told), -1), strict=True):
        mine = [slide for slide in slides.ended if slide.mode == mode]
        for ax, (measure, label) in zip(row, LABELS.items(), strict=True):
            values = np.array([getattr(slide, measure) for slide in mine], float)
            _distributions(ax, values, slides.weight[names == mode], BEST_FITS[mode][measure])
            ax.set(xlabel=label, ylim=(-0.02, 1.02))
        row[0].set_ylabel(f"share of {mode} slides below [-]")
        row[0].set_title(f"{len(mine)} {mode} slides, refined grid", loc="left", fontsize=10)
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
    said = f"{fit.name} {fit.aic - best.aic:.1f}"
    return f"{said} (printed)" if fit.name == printed else said
