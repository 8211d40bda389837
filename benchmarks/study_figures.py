"""Figures of the published study beside ours, of as much as there is."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
from matplotlib.axes import Axes

from benchmarks.study_pieces import LIMIT, failed, score
from benchmarks.study_runs import LENGTHS, SAMPLES
from benchmarks.study_table import Rows, Run
from cooperative.reporting import panels, save

BLUE, RED, GREY = "#0072B2", "#D55E00", "#777777"
CHANGE = "P_f of the section, change by: "


class Answer(Protocol):
    """An answer with its interval."""

    @property
    def value(self) -> float: ...

    @property
    def interval(self) -> tuple[float, float]: ...


Lines = list[tuple[str, "Answer | str"]]


def draw(rows: Rows, lines: Lines, folder: Path) -> list[Path]:
    """Draw what there is; returns the files. A figure without any of its data is not drawn."""
    known = [(what, found) for what, found in lines if not isinstance(found, str)]
    drawn = (_readings(known, folder), _lengths(known, folder), _ranks(rows, folder))
    return [path for path in drawn if path is not None]


def _readings(known: list[tuple[str, Answer]], folder: Path) -> Path | None:
    mine = [(what.removeprefix(CHANGE), found) for what, found in known if what.startswith(CHANGE)]
    if not mine:
        return None
    figure, (ax,) = panels(1, size=(6.0, 0.8 + 0.32 * len(mine)))
    for at, (_, found) in enumerate(mine):
        _interval(ax, found, at)
    ax.axvline(0, color=GREY, linewidth=0.8)
    ax.set_yticks(range(len(mine)), [name for name, _ in mine])
    ax.invert_yaxis()
    ax.set_xlabel("change of $P_f$ of the section [-], same samples, 95 % interval")
    return save(figure, folder / "published_readings.png", dpi=110)


def _interval(ax: Axes, found: Answer, at: float) -> None:
    ax.plot(found.interval, (at, at), color=BLUE)
    ax.plot(found.value, at, "o", color=BLUE)


def _lengths(known: list[tuple[str, Answer]], folder: Path) -> Path | None:
    by_name = dict(known)
    named = (("P_f in 3D, {} = {:g} m, the other 60 m", "o", BLUE, "audited"),
             ("rough grid alone: P_f at {} = {:g} m", "s", GREY, "rough grid, calibrated"))  # fmt: skip
    if not any(
        name.format(axis, length) in by_name for name, *_ in named for axis in ("lx", "ly") for length in LENGTHS
    ):
        return None
    figure, axes = panels(1, 2, size=(3.6, 3.2))
    for ax, axis in zip(axes, ("lx", "ly"), strict=True):
        for (name, marker, color, label), aside in zip(named, (-1.0, 1.0), strict=True):
            mine = [(length, by_name[each]) for length in LENGTHS if (each := name.format(axis, length)) in by_name]
            for length, found in mine:
                ax.plot((length + aside,) * 2, found.interval, color=color)
            places = [length + aside for length, _ in mine]
            ax.plot(places, [found.value for _, found in mine], f"{marker}-", color=color, markersize=4, label=label)
        ax.axhline(0.244, color=RED, linestyle="--", linewidth=0.8, label="published at 60 m")
        ax.set(xlabel=f"correlation length ${axis[0]}_{axis[1]}$ [m]", ylabel="probability of failure $P_f$ [-]")
        ax.set_ylim(bottom=0)
    axes[0].legend(frameon=False)
    return save(figure, folder / "published_lengths.png", dpi=110)


def _ranks(rows: Rows, folder: Path) -> Path | None:
    rough = {n: rows[run] for n in range(SAMPLES) if (run := Run("published", "rough", n)) in rows}
    if len(rough) < SAMPLES:
        return None
    order = sorted(rough, key=lambda n: -score(rough[n]))
    place = {sample: rank for rank, sample in enumerate(order, start=1)}
    figure, (ax,) = panels(1, size=(6.0, 3.2))
    ax.plot(np.arange(1, SAMPLES + 1), [score(rough[n]) for n in order], color=GREY, label="rough")
    for fails, color, word in ((True, RED, "refined, failed"), (False, BLUE, "refined, stood")):
        mine = [(n, rows[run]) for n in order if (run := Run("published", "refined", n)) in rows]
        mine = [(n, outcome) for n, outcome in mine if failed(outcome) is fails]
        ax.plot([place[n] for n, _ in mine], [score(o) for _, o in mine], "o", color=color, markersize=3, label=word)
    ax.axhline(LIMIT, color=GREY, linewidth=0.6, linestyle="--")
    ax.set(
        yscale="log", xlabel="rank on the rough grid", ylabel="displacement, of failures at 20 s\nat their speed [m]"
    )
    ax.legend(frameon=False)
    return save(figure, folder / "published_ranks.png", dpi=110)
