"""One typical slide of each mode, drawn: in 3D at several times, through its deepest section, and its strength there.

`python -m benchmarks.study --draw` runs these slides once more, since the rows of the study hold no fields. As Figs. 11
to 18 of Jiang et al. (2024), Computers and Geotechnics 172, 106413.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from benchmarks.study_runs import prepared
from benchmarks.study_table import Rows, Run
from cooperative.reporting import save
from jaxmpm import solve, with_strength


@dataclass(frozen=True)
class Slide:
    """A slide as it is drawn. position, half_size: before (3, N), (3,) m. strength: (N,) Pa. times: (T,) s.
    displacement: (T, 3, N) m. cell: of its grid (m)."""

    position: np.ndarray
    half_size: np.ndarray
    strength: np.ndarray
    times: tuple[float, ...]
    displacement: np.ndarray
    cell: float


def typical(rows: Rows) -> dict[str, Run]:
    """Of each mode the slide whose volume is nearest the median of its mode, on the refined grid at lx = ly = 60 m."""
    slides = {
        run: outcome
        for run, outcome in rows.items()
        if run.case == "published" and run.grid == "refined" and outcome.mode and outcome.volume is not None
    }
    chosen = {}
    for mode in sorted({str(outcome.mode) for outcome in slides.values()}):
        volume = {run: float(o.volume or 0.0) for run, o in slides.items() if o.mode == mode}
        middle = float(np.median(list(volume.values())))
        chosen[mode] = min(volume, key=lambda run: (abs(volume[run] - middle), run.sample))
    return chosen


def run_again(run: Run, times: tuple[float, ...] = (2.0, 4.0, 8.0, 20.0)) -> Slide:
    """The slide of a run in 3D, with its states at `times` (s). FloatingPointError where the run breaks off."""
    model, coefficients = prepared(run.case, run.grid)
    strength = model.strength(coefficients[run.sample]) / run.reduction
    campaign = model.campaign
    times = tuple(dict.fromkeys(min(time, campaign.run.t_end) for time in times))
    done = solve(
        with_strength(model.scene, strength), model.state, t_end=campaign.run.t_end, snapshots=times,
        settle=campaign.run.settle,
    ).raise_if_failed()  # fmt: skip
    return Slide(
        np.asarray(model.scene.particles.position),
        model.half_size,
        np.asarray(strength),
        times,
        np.stack([np.asarray(state.displacement) for state in done.snapshots]),
        campaign.grids[run.grid].cell,
    )


def surface(position: np.ndarray, values: np.ndarray, cell: float) -> tuple[np.ndarray, ...]:
    """Top of the soil over the columns of a lattice: x, y, its height and the value of the particle that lies there,
    (nx, ny) each, nan where no soil is. position: (3, N) m. values: (N,). cell: of the lattice (m)."""
    low = np.floor(position[:2].min(axis=1) / cell)
    column = np.floor(position[:2] / cell - low[:, None]).astype(int)
    shape = tuple(column.max(axis=1) + 1)
    height, value = np.full(shape, np.nan), np.full(shape, np.nan)
    upwards = np.argsort(position[2], kind="stable")
    height[tuple(column[:, upwards])] = position[2, upwards]
    value[tuple(column[:, upwards])] = values[upwards]
    x, y = np.meshgrid(*((low[a] + np.arange(shape[a]) + 0.5) * cell for a in range(2)), indexing="ij")
    return x, y, height, value


def deepest_section(slide: Slide, limit: float = 1.0) -> np.ndarray:
    """Particles (n,) of the slice, a cell wide, through the lowest soil that has moved farther than `limit` (m)."""
    moved = np.linalg.norm(slide.displacement[-1], axis=0) > limit
    lowest = np.argmin(np.where(moved, slide.position[2], np.inf)) if moved.any() else 0
    slice_of = np.floor(slide.position[1] / slide.cell)
    return np.flatnonzero(slice_of == slice_of[lowest])


def drawing(slide: Slide) -> Figure:
    """Ground at each time in 3D, the section through the deepest soil that slid then, and the strength there before."""
    count = len(slide.times)
    figure = Figure(figsize=(3.4 * count, 6.6), layout="constrained")
    FigureCanvasAgg(figure)
    moved = np.linalg.norm(slide.displacement, axis=1)
    norm = Normalize(0.0, max(float(np.quantile(moved[-1], 0.999)), 1e-6))
    cut = deepest_section(slide)
    for n, (time, step, far) in enumerate(zip(slide.times, slide.displacement, moved, strict=True)):
        top: Any = figure.add_subplot(3, count, n + 1, projection="3d")
        x, y, height, value = surface(slide.position + step, far, slide.cell)
        colours = colormaps["viridis"](norm(np.nan_to_num(value)))
        top.plot_surface(x, y, height, facecolors=colours, rstride=1, cstride=1, shade=False, linewidth=0)
        top.set_box_aspect((np.ptp(x), np.ptp(y), 2 * max(np.nanmax(height), 1.0)))
        top.set_title(f"t = {time:g} s", loc="left")
        top.set_axis_off()
        side = figure.add_subplot(3, count, count + n + 1)
        now = (slide.position + step)[:, cut]
        side.scatter(now[0], now[2], c=far[cut], norm=norm, cmap="viridis", s=1, rasterized=True)
        side.set(aspect="equal", xlabel="x [m]", ylabel="z [m]")
    below = figure.add_subplot(3, 1, 3)
    at = slide.position[:, cut]
    dots = below.scatter(at[0], at[2], c=slide.strength[cut] / 1e3, cmap="cividis", s=3, rasterized=True)
    below.set(aspect="equal", xlabel="x [m]", ylabel="z [m]", title=f"strength before, at y = {at[1].mean():.0f} m")
    figure.colorbar(dots, ax=below, label="$S_u$ [kPa]")
    return figure


@dataclass(frozen=True)
class Drawn:
    """The pictures of typical slides that were drawn, and of those that broke off what is to be said of each."""

    files: tuple[Path, ...]
    broke_off: tuple[str, ...]


def draw(rows: Rows, folder: Path) -> Drawn:
    """Run and draw the typical slides of all modes that have one. One that breaks off leaves the others, and the
    picture of its mode as it was."""
    files, broke_off = [], []
    for mode, run in typical(rows).items():
        try:
            slide = run_again(run)
        except FloatingPointError as error:
            broke_off.append(f"{mode}: sample {run.sample} of {run.case!r} broke off, nothing is drawn of it: {error}")
        else:
            files.append(save(drawing(slide), folder / f"published_slide_{mode}.png", dpi=80))
    return Drawn(tuple(files), tuple(broke_off))
