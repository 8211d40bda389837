"""A typical slide of each failure mode: in 3D at several times, its deepest section then, and the strength there.

The rows of the study hold no fields, so `python -m benchmarks.study --draw` runs these slides once more. As Figs. 11 to
18 of Jiang et al. (2024), Computers and Geotechnics 172, 106413.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Normalize
from matplotlib.figure import Figure, SubFigure
from scipy.ndimage import median_filter

from benchmarks.study.cases import CASES, FAILS_ABOVE, MORE_AIR, campaign_of
from benchmarks.study.rows import Rows, Run
from cooperative import build, coefficients_of, random_soil
from cooperative.measure import SEVERITY
from cooperative.reporting import draw_particles, save
from jaxmpm import solve

COLOURS = colormaps["viridis"].with_extremes(bad="0.6")
"""Of displacements, as `draw_particles` has them: soil that has not slid is grey."""


@dataclass(frozen=True)
class Slide:
    """A slide to draw.

    Attributes:
        position: of the particles at the start (3, N) m.
        half_size: half the particle spacing (3,) m.
        strength: undrained, at the start (N,) Pa.
        times: T moments, ascending (s).
        displacement: at each of them (T, 3, N) m.
        cell: of the grid (m).
    """

    position: np.ndarray
    half_size: np.ndarray
    strength: np.ndarray
    times: tuple[float, ...]
    displacement: np.ndarray
    cell: float


def typical(rows: Rows) -> dict[str, Run]:
    """By mode, the refined slide of the headline campaign with a volume nearest to the median of its mode.

    Slides that left their grid count as they ended on the higher one.
    """
    volumes: dict[str, dict[Run, float]] = {}
    for run, outcome in rows.items():
        of_campaign = run.case in ("published", MORE_AIR) and run.grid == "refined"
        if of_campaign and outcome.mode and outcome.volume is not None:
            volumes.setdefault(outcome.mode, {})[run] = outcome.volume
    chosen = {}
    for mode, volume in sorted(volumes.items()):
        median = float(np.median(list(volume.values())))
        chosen[mode] = min(volume, key=lambda run: (abs(volume[run] - median), run.sample))
    return chosen


def run_again(run: Run, times: tuple[float, ...] = (2.0, 4.0, 8.0, 20.0)) -> Slide:
    """Run a slide of the study once more.

    Args:
        run: the slide.
        times: when its states are taken (s).

    Raises:
        FloatingPointError: the run breaks off.
    """
    campaign = campaign_of(**CASES[run.case])
    soil = random_soil(campaign)
    model, coefficients = build(campaign, run.grid, soil), coefficients_of(campaign, soil)[run.sample]
    times = tuple(dict.fromkeys(min(time, campaign.run.t_end) for time in times))
    result = solve(
        *model.of_sample(coefficients), t_end=campaign.run.t_end, snapshots=times, rules=campaign.run.rules()
    ).raise_if_failed()
    return Slide(
        np.asarray(model.scene.particles.position),
        model.half_size,
        np.asarray(model.strength(coefficients)),
        times,
        np.stack([np.asarray(state.displacement) for state in result.snapshots]),
        campaign.grids[run.grid].cell,
    )


def surface(position: np.ndarray, values: np.ndarray, cell: float) -> tuple[np.ndarray, ...]:
    """Top of the soil over the columns of a lattice.

    Args:
        position: of the particles (3, N) m.
        values: at the particles (N,).
        cell: of the lattice (m).

    Returns:
        Middles of the columns x (nx,) and y (ny,); then, (nx, ny) each, the height (m) of the highest particle and its
        value, 0 and nan where no soil is.
    """
    low = np.floor(position[:2].min(axis=1) / cell)
    column = np.floor(position[:2] / cell - low[:, None]).astype(int)
    shape = tuple(column.max(axis=1) + 1)
    height, value = np.zeros(shape), np.full(shape, np.nan)
    upwards = np.argsort(position[2], kind="stable")
    height[tuple(column[:, upwards])] = position[2, upwards]
    value[tuple(column[:, upwards])] = values[upwards]
    x, y = ((low[a] + np.arange(shape[a]) + 0.5) * cell for a in range(2))
    return x, y, height, value


def deepest_section(slide: Slide) -> np.ndarray:
    """Particles (n,) of the layer along x that has the lowest soil that slid; of several such layers, of the one where
    most soil slid."""
    slid = slid_part(slide.displacement[-1]) > 0
    low = slide.position.min(axis=1, keepdims=True)
    _, layer, height = np.rint((slide.position - low) / (2 * slide.half_size[:, None])).astype(int)
    if not slid.any():
        return np.flatnonzero(layer == 0)
    lowest = slid & (height == height[slid].min())
    most = np.bincount(layer[slid]) * (np.bincount(layer[lowest], minlength=layer[slid].max() + 1) > 0)
    return np.flatnonzero(layer == np.argmax(most))


def slid_part(displacement: np.ndarray) -> np.ndarray:
    """Length (N,) m of displacements (3, N) m, nan where soil has not slid."""
    far = np.linalg.norm(displacement, axis=0)
    return np.where(far > FAILS_ABOVE, far, np.nan)


def view(ax: Any, slide: Slide, step: np.ndarray, norm: Normalize, cut: float) -> None:
    """Draw the ground as a block, with a line where the section is.

    Args:
        ax: axes in 3D.
        slide: its ground.
        step: displacement (3, N) m.
        norm: of displacements (m).
        cut: y of the section (m).
    """
    x, y, height, far = surface(slide.position + step, slid_part(step), slide.cell)
    # A grain in the air makes no spike.
    height, far = (median_filter(image, 3, mode="nearest") for image in (height + slide.half_size[2], far))
    ax.plot(x, np.full(x.shape, cut), height[:, np.abs(y - cut).argmin()], color="black", lw=1, ls="--", zorder=2)
    # The sides of the block are a rim of the surface that goes down to the base.
    at_x, at_y = np.meshgrid(np.pad(x, 1, mode="edge"), np.pad(y, 1, mode="edge"), indexing="ij")
    colours = np.pad(COLOURS(norm(np.ma.masked_invalid(far))), ((1, 1), (1, 1), (0, 0)), constant_values=1.0)
    ax.plot_surface(at_x, at_y, np.pad(height, 1), facecolors=colours, rstride=1, cstride=1, lw=0, antialiased=False)
    ax.set_box_aspect([np.ptp(x), np.ptp(y), height.max()], zoom=1.25)
    ax.set_axis_off()


def drawing(slide: Slide, title: str) -> Figure:
    """A slide in 3D at each time, its deepest section then, and the strength there at the start."""
    cut = deepest_section(slide)
    level = float(slide.position[1, cut].mean())
    farthest = float(np.quantile(np.linalg.norm(slide.displacement[-1], axis=0), 0.999))
    norm = Normalize(0.0, max(farthest, 2 * FAILS_ABOVE))
    rows = -(-len(slide.times) // 2)
    heights = (2.55 * rows, 1.4 * (len(slide.times) + 1) + 0.6)
    figure = Figure(figsize=(9.0, 0.3 + sum(heights)), layout="constrained")
    figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=heights).flat
    for number, (time, step) in enumerate(zip(slide.times, slide.displacement, strict=True), start=1):
        ax = above.add_subplot(rows, 2, number, projection="3d", azim=-55, computed_zorder=False)
        view(ax, slide, step, norm, level)
        ax.set_title(f"t = {time:g} s", loc="left", y=0.8)
    sections(below, slide, cut, norm)
    below.supxlabel(
        f"True scale. Sections at y = {level:.0f} m, dashed in the views. Grey: displacement up to {FAILS_ABOVE:g} m.\n"
        f"Line along the top: ground at the start. Line in the strength: displacement of {FAILS_ABOVE:g} m at the end.",
        fontsize="medium",
    )
    return figure


def sections(figure: SubFigure, slide: Slide, cut: np.ndarray, norm: Normalize) -> None:
    """Draw a section at each time, and the strength there at the start.

    Args:
        figure: to draw in.
        slide: whose sections.
        cut: particles of the section (n,).
        norm: of displacements (m).
    """
    at, half = slide.position[::2, cut], slide.half_size[::2]
    x, column = np.unique(at[0], return_inverse=True)
    top = np.zeros(x.shape)
    np.maximum.at(top, column, at[1] + half[1])
    *axes, below = figure.subplots(len(slide.times) + 1, 1, squeeze=False, sharex=True, sharey=True).flat
    for ax, time, step in zip(axes, slide.times, slide.displacement[:, :, cut], strict=True):
        boxes = draw_particles(ax, at, half, slid_part(step), "viridis", norm, displacement=step[::2])
        ax.plot(x, top, color="black", lw=1)
        ax.set_title(f"t = {time:g} s ", loc="right", y=0.72)
    strength = slide.strength[cut] / 1e3
    soil = draw_particles(below, at, half, strength, "cividis", Normalize(strength.min(), strength.max()))
    far = np.linalg.norm(slide.displacement[-1][:, cut], axis=0)
    if far.max() > FAILS_ABOVE:
        below.tricontour(at[0], at[1], far, levels=[FAILS_ABOVE], colors="white", linewidths=2)
    below.set_title("strength before ", loc="right", y=0.72)
    below.set_ylim(0.0, 1.1 * top.max())
    for ax in (*axes, below):
        ax.label_outer()
    figure.colorbar(boxes, ax=axes, label="displacement [m]", aspect=40, extend="max")
    figure.colorbar(soil, ax=below, label="$S_u$ [kPa]", aspect=9)


def draw(rows: Rows, folder: Path, modes: Collection[str] = SEVERITY) -> tuple[list[Path], list[str]]:
    """Run and draw a typical slide of each mode that has one.

    Args:
        rows: of the study.
        folder: of the pictures.
        modes: to draw.

    Returns:
        The pictures, and a message for each slide that broke off, whose picture stays as it was.
    """
    pictures, broke_off = [], []
    for mode, run in typical(rows).items():
        if mode not in modes:
            continue
        try:
            slide = run_again(run)
        except FloatingPointError as error:
            broke_off.append(f"{mode}: sample {run.sample} of {run.case!r} broke off and is not drawn: {error}")
        else:
            figure = drawing(slide, f"Typical {mode} slide: sample {run.sample} of {run.case!r}, {run.grid} grid")
            pictures.append(save(figure, folder / f"published_slide_{mode}.png", dpi=100))
    return pictures, broke_off
