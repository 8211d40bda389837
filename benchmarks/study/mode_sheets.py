"""Sheets from which a reader names the mode of a slide: what it did, under a number that names neither sample nor rule.

A sheet has maps and sections of the displacement at several times, the ground at the end, when the soil of each section
let go, how much of the volume lets go in a second, and the depth of each slice across the slope.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import LightSource, Normalize
from matplotlib.figure import Figure, SubFigure
from scipy.ndimage import median_filter

from benchmarks.study.cases import FAILS_ABOVE
from benchmarks.study.draw import COLOURS, deepest_section, slid_part, surface
from benchmarks.study.mode_pasts import EVERY, Past, Watched, slides, watch
from cooperative.reporting import draw_particles, save

SHEETS = 20
"""Slides that readers see: those of the lowest samples."""
ORDER = 32
"""Seed of the order of the sheets."""

RELEASES = colormaps["plasma"].with_extremes(bad="0.6")
SECTIONS = 6
"""Evenly across the slope."""


def numbered(samples: Sequence[int]) -> dict[int, int]:
    """Sample of each sheet, by its number from 1 on, in an order that depends on nothing else.

    Args:
        samples: of the slides, of which the lowest SHEETS have a sheet.
    """
    order = np.random.default_rng(ORDER).permutation(sorted(samples)[:SHEETS])
    return {number: int(sample) for number, sample in enumerate(order, start=1)}


def draw(folder: Path) -> Iterator[Path]:
    """Run each slide whose sheet the folder lacks, and draw its sheet.

    Args:
        folder: of the sheets, `slide_01.png` and so on.

    Yields:
        Each new sheet.
    """
    folder.mkdir(parents=True, exist_ok=True)
    runs = {run.sample: run for run in slides()}
    for number, sample in numbered(list(runs)).items():
        path = folder / f"slide_{number:02d}.png"
        if not path.exists():
            yield save(drawing(watch(runs[sample]), f"Slide {number}"), path, dpi=100)


def drawing(watched: Watched, title: str) -> Figure:
    """A sheet."""
    slide = watched.slide
    farthest = float(np.quantile(np.linalg.norm(slide.displacement[-1], axis=0), 0.999))
    far = Normalize(0.0, max(farthest, 2 * FAILS_ABOVE))
    when = np.where(np.isfinite(watched.onset), watched.onset, np.nan)
    let_go = Normalize(*np.nanquantile(when, (0.0, 1.0))) if np.isfinite(when).any() else Normalize()
    figure = Figure(figsize=(15.0, 16.5), layout="constrained")
    figure.suptitle(title, x=0.01, ha="left", fontweight="bold", fontsize="x-large")
    parts = figure.subfigures(4, 1, squeeze=False, height_ratios=(3.3, 4.3, 4.3, 3.9))
    above, beside, across, below = parts.flat
    maps(above, watched, far)
    cut = deepest_section(slide)
    level = float(slide.position[1, cut].mean())
    beside.suptitle(f"Displacement in the section at y = {level:.0f} m (dashed line of the maps)", fontweight="bold")
    for ax, time, step in zip(grid(beside, len(slide.times)), slide.times, slide.displacement, strict=True):
        shown = section(ax, watched, cut, slid_part(step), step, "viridis", far)
        ax.set_title(f"t = {time:g} s ", loc="right", y=0.72)
    beside.colorbar(shown, ax=beside.axes, label="displacement [m]", aspect=40)
    across.suptitle("When soil let go, in sections across the slope, drawn at the end", fontweight="bold")
    layer_of = np.rint(slide.position[1] / slide.half_size[1])
    layers = np.unique(layer_of)
    for ax, part in zip(grid(across, SECTIONS), (np.arange(SECTIONS) + 0.5) / SECTIONS, strict=True):
        cut = np.flatnonzero(layer_of == layers[int(part * layers.size)])
        shown = section(ax, watched, cut, when, slide.displacement[-1], "plasma", let_go)
        ax.set_title(f"y = {slide.position[1, cut].mean():.0f} m ", loc="right", y=0.72)
    across.colorbar(shown, ax=across.axes, label="let go at [s]", aspect=40)
    left, middle, right, last = below.subplots(1, 4, width_ratios=(1.0, 1.0, 1.35, 1.35))
    relief(left, watched)
    shown = from_above(middle, watched, when, np.zeros_like(slide.displacement[-1]), RELEASES, let_go)
    middle.set_title("surface before: when it let go")
    below.colorbar(shown, ax=middle, label="[s]", location="bottom", aspect=30)
    rate(right, watched.past)
    depths(last, watched)
    return figure


def grid(figure: SubFigure, count: int) -> list[Axes]:
    """Axes of so many sections in two columns, down the left one first."""
    axes = list(figure.subplots(-(-count // 2), 2, sharex=True, sharey=True, squeeze=False).T.flat)
    for ax in axes[count:]:
        ax.remove()
    return axes[:count]


def maps(figure: SubFigure, watched: Watched, norm: Normalize) -> None:
    """Draw the displacement from above at each time."""
    slide = watched.slide
    level = float(slide.position[1, deepest_section(slide)].mean())
    figure.suptitle(
        f"Displacement from above (crest on the left; dotted: toe before the slide; grey: up to {FAILS_ABOVE:g} m)",
        fontweight="bold",
    )
    axes = figure.subplots(1, len(slide.times), sharex=True, sharey=True, squeeze=False).flat
    for ax, time, step in zip(axes, slide.times, slide.displacement, strict=True):
        shown = from_above(ax, watched, slid_part(step), step, COLOURS, norm)
        ax.axhline(level, color="black", lw=1, ls="--")
        ax.set_title(f"t = {time:g} s")
        ax.label_outer()
    figure.colorbar(shown, ax=figure.axes, label="[m]", aspect=20)


def from_above(ax: Axes, watched: Watched, values: np.ndarray, step: np.ndarray, colours: Any, norm: Normalize) -> Any:
    """Draw values (N,) of the highest soil of each column.

    Args:
        ax: to draw on.
        watched: whose ground.
        values: nan where grey.
        step: displacement of the soil (3, N) m.
        colours: colour map.
        norm: of the values.
    """
    slide = watched.slide
    x, y, _, top = surface(slide.position + step, values, slide.cell)
    shown = ax.pcolormesh(x, y, np.ma.masked_invalid(median_filter(top, 3, mode="nearest")).T, cmap=colours, norm=norm)
    ax.axvline(watched.face.toe_x, color="white", lw=1.5, ls=":")
    ax.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    return shown


def relief(ax: Axes, watched: Watched) -> None:
    """Draw the ground at the end, lit from behind the crest."""
    slide = watched.slide
    position = slide.position + slide.displacement[-1]
    x, y, height, _ = surface(position, position[2], slide.cell)
    height = median_filter(height, 3, mode="nearest")
    shade = LightSource(azdeg=0, altdeg=35).hillshade(height.T, vert_exag=2.0, dx=slide.cell, dy=slide.cell)
    ax.imshow(shade, cmap="gray", origin="lower", extent=(x[0], x[-1], y[0], y[-1]), interpolation="bilinear")
    ax.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title="ground at the end, shaded")


def section(
    ax: Axes, watched: Watched, cut: np.ndarray, values: np.ndarray, step: np.ndarray, colours: str, norm: Normalize
) -> Any:
    """Draw a section.

    Args:
        ax: to draw on.
        watched: whose ground.
        cut: particles of the section (n,).
        values: of all particles (N,), nan where grey.
        step: displacement of the soil (3, N) m.
        colours: name of a colour map.
        norm: of the values.
    """
    slide = watched.slide
    at, half = slide.position[::2, cut], slide.half_size[::2]
    x, column = np.unique(at[0], return_inverse=True)
    top = np.zeros(x.shape)
    np.maximum.at(top, column, at[1] + half[1])
    shown = draw_particles(ax, at, half, values[cut], colours, norm, displacement=step[::2, cut])
    ax.plot(x, top, color="black", lw=1)
    ax.axhline(watched.face.toe_z, color="crimson", lw=1, ls=":")
    ax.set_ylim(0.0, 1.15 * top.max())
    ax.label_outer()
    return shown


def rate(ax: Axes, past: Past) -> None:
    """Draw the share of the sliding volume that lets go per second against time."""
    time = EVERY * np.arange(past.released.size)
    ax.bar(time, past.released / EVERY, EVERY, align="edge", color="0.35")
    ax.set(xlabel="t [s]", ylabel="share of the volume per second", xlim=(0.0, time[-1] + EVERY))
    ax.set_title("soil that lets go")


def depths(ax: Axes, watched: Watched) -> None:
    """Draw the depth of the slip below the crest in each slice across the slope, and its share of the volume."""
    past = watched.past
    y = watched.slide.position[1]
    width = (y.max() - y.min() + 2 * watched.slide.half_size[1]) / past.depth.size
    middle = y.min() - watched.slide.half_size[1] + width * (np.arange(past.depth.size) + 0.5)
    ax.bar(middle, past.depth, width, color="0.55")
    ax.axhline(past.height, color="crimson", lw=1.5, ls=":")
    ax.set(xlabel="y [m]", ylabel="depth below the crest [m]", ylim=(1.05 * max(past.depth.max(), past.height), 0.0))
    ax.set_title("depth of slices (dotted: slope height)")
