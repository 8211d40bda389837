"""One typical slide of each mode, drawn: in 3D at several times, through its deepest section, and its strength there.

`python -m benchmarks.study --draw` runs these slides once more, since the rows of the study hold no fields. As Figs. 11
to 18 of Jiang et al. (2024), Computers and Geotechnics 172, 106413.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Polygon
from matplotlib.patheffects import withStroke
from scipy.ndimage import median_filter

from benchmarks.study.study_runs import prepared
from benchmarks.study.study_table import Rows, Run
from cooperative.reporting import draw_particles, save
from jaxmpm import solve

SLID = 1.0
"""Soil that has moved farther (m) has slid: the publication's failure displacement."""
VIEW = np.radians((35.0, 30.0))
"""From where the ground is seen: turned about the vertical from the side of low y, and above the horizon."""
COLOURS = colormaps["viridis"].with_extremes(bad="0.6")
"""Of displacements. Soil that has not slid is grey, as `draw_particles` has it."""


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
    scene, state = replace(model, strength_factor=1 / run.reduction).of_sample(coefficients[run.sample])
    campaign = model.campaign
    times = tuple(dict.fromkeys(min(time, campaign.run.t_end) for time in times))
    done = solve(scene, state, t_end=campaign.run.t_end, snapshots=times, settle=campaign.run.settle).raise_if_failed()
    return Slide(
        np.asarray(model.scene.particles.position),
        model.half_size,
        np.asarray(scene.material.strength),
        times,
        np.stack([np.asarray(state.displacement) for state in done.snapshots]),
        campaign.grids[run.grid].cell,
    )


def surface(position: np.ndarray, values: np.ndarray, cell: float) -> tuple[np.ndarray, ...]:
    """Top of the soil over the columns of a lattice: their middles x (nx,) and y (ny,), then, (nx, ny) each, the height
    of the highest particle and its value; 0 and nan where no soil is. position: (3, N) m. values: (N,). cell: of the
    lattice (m)."""
    low = np.floor(position[:2].min(axis=1) / cell)
    column = np.floor(position[:2] / cell - low[:, None]).astype(int)
    shape = tuple(column.max(axis=1) + 1)
    height, value = np.zeros(shape), np.full(shape, np.nan)
    upwards = np.argsort(position[2], kind="stable")
    height[tuple(column[:, upwards])] = position[2, upwards]
    value[tuple(column[:, upwards])] = values[upwards]
    x, y = ((low[a] + np.arange(shape[a]) + 0.5) * cell for a in range(2))
    return x, y, height, value


def places(slide: Slide) -> np.ndarray:
    """Place (3, N) of each particle on the lattice that it began on."""
    low = slide.position.min(axis=1, keepdims=True)
    return np.rint((slide.position - low) / (2 * slide.half_size[:, None])).astype(int)


def deepest_section(slide: Slide) -> np.ndarray:
    """Particles (n,) of the layer along x that holds the lowest soil that slid; of those that hold soil as low, of the
    one where most slid."""
    slid = np.linalg.norm(slide.displacement[-1], axis=0) > SLID
    _, layer, height = places(slide)
    if not slid.any():
        return np.flatnonzero(layer == 0)
    low = slid & (height == height[slid].min())
    most = np.bincount(layer[slid]) * (np.bincount(layer[low], minlength=layer[slid].max() + 1) > 0)
    return np.flatnonzero(layer == np.argmax(most))


def seen(x: Any, y: Any, z: Any) -> np.ndarray:
    """Points (..., 2) of a parallel view from downhill and above (m). x, y, z: (...) m."""
    (turn, rise), (x, y, z) = VIEW, np.broadcast_arrays(x, y, z)
    away = y * np.cos(turn) - x * np.sin(turn)
    return np.stack([x * np.cos(turn) + y * np.sin(turn), away * np.sin(rise) + z * np.cos(rise)], axis=-1)


def tiles(slide: Slide, step: np.ndarray, norm: Normalize) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Top of the ground after a displacement (3, N) m: x (nx + 1,) and y (ny + 1,) of the corners of its tiles, their
    heights (nx + 1, ny + 1), and the colours (nx, ny, 3), lit from uphill."""
    x, y, height, moved = surface(slide.position + step, np.linalg.norm(step, axis=0), slide.cell)
    # A grain in the air makes no spike.
    height, moved = (median_filter(of, 3, mode="nearest") for of in (height + slide.half_size[2], moved))
    around = np.pad(height, 1, mode="edge")
    z = (around[1:, 1:] + around[:-1, 1:] + around[1:, :-1] + around[:-1, :-1]) / 4
    x, y = (np.append(at - slide.cell / 2, at[-1] + slide.cell / 2) for at in (x, y))
    along, across = (np.gradient(height, slide.cell, axis=axis) for axis in range(2))
    light = 0.5 + 0.5 * ((0.6 * along - 0.4 * across + 1) / np.sqrt(along**2 + across**2 + 1)).clip(0)
    colours = COLOURS(norm(np.ma.masked_invalid(beyond(moved))))[..., :3] * light[..., None]
    return x, y, z, colours.clip(0, 1)


def beyond(moved: np.ndarray) -> np.ndarray:
    """Displacements (m), nan where soil has not slid."""
    return np.where(moved > SLID, moved, np.nan)


def block(ax: Axes, slide: Slide, step: np.ndarray, norm: Normalize, cut: float) -> None:
    """The ground as a block, a line on it where the section lies. step: displacement (3, N) m. cut: y of the section
    (m)."""
    x, y, z, colours = tiles(slide, step, norm)
    nodes = seen(x[:, None], y, z)
    corners = np.stack([nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:]], axis=2)
    # The farthest first: what stands before it is drawn over it.
    faces, fill = (np.swapaxes(of[:, ::-1], 0, 1) for of in (corners, colours))
    fill = fill.reshape(-1, 3)
    ax.add_collection(PolyCollection(list(faces.reshape(-1, 4, 2)), fc=fill, ec=fill, lw=0.4, antialiased=False))
    for at_x, at_y, top, side in ((x, y[:1], nodes[:, 0], "right"), (x[-1:], y, nodes[-1], "left")):
        foot = seen(at_x[[0, -1]], at_y[[0, -1]], 0.0)
        ax.add_patch(Polygon([*top, *foot[::-1]], fc="white", ec="0.2", lw=0.8))
        length = max(np.ptp(at_x), np.ptp(at_y))
        ax.annotate(f"{length:.0f} m", foot.mean(axis=0), (0, -4), textcoords="offset points", ha=side, va="top")
    ax.plot(*nodes[:, np.abs(y - cut).argmin()].T, color="black", lw=1, ls="--")
    ax.set_aspect("equal")
    ax.set_axis_off()


def outline(ax: Axes, position: np.ndarray, half: np.ndarray) -> None:
    """A line along the top of a section before. position: (2, n) m. half: half the spacing (2,) m."""
    x, column = np.unique(position[0], return_inverse=True)
    top = np.full(x.shape, -np.inf)
    np.maximum.at(top, column, position[1])
    ax.plot(x, top + half[1], color="black", lw=1)


def slid_part(ax: Axes, slide: Slide, cut: np.ndarray) -> None:
    """A line on a section before around what slides in the end. cut: particles (n,) of the section."""
    at, (i, _, k) = slide.position[::2, cut], places(slide)[:, cut]
    slid = np.zeros((i.max() + 3, k.max() + 3))
    slid[i + 1, k + 1] = np.linalg.norm(slide.displacement[-1][:, cut], axis=0) > SLID
    (low_x, low_z), (wide, high) = at.min(axis=1), 2 * slide.half_size[::2]
    x, z = (low_x + wide * (np.arange(slid.shape[0]) - 1), low_z + high * (np.arange(slid.shape[1]) - 1))
    if slid.any():
        line = ax.contour(x, z, slid.T, [0.5], colors="black", linewidths=1.5)
        line.set(path_effects=[withStroke(linewidth=3.5, foreground="white")])


def drawing(slide: Slide, title: str) -> Figure:
    """A slide in 3D at each time, its deepest section then, and the strength there before."""
    cut = deepest_section(slide)
    level = float(slide.position[1, cut].mean())
    far = np.linalg.norm(slide.displacement[-1], axis=0)
    norm = Normalize(0.0, max(float(np.quantile(far, 0.999)), 2 * SLID))
    count = len(slide.times)
    rows = -(-count // 2)
    heights = (2.55 * rows, 1.4 * (count + 1) + 0.6)
    figure = Figure(figsize=(9.0, 0.3 + sum(heights)), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=heights).flat
    for view in above.subplots(rows, 2, squeeze=False).flat[count:]:
        view.remove()
    for view, time, step in zip(above.axes, slide.times, slide.displacement, strict=True):
        block(view, slide, step, norm, level)
        view.set_title(f"t = {time:g} s", loc="left", y=0.8)
    sections(below, slide, cut, norm)
    below.supxlabel(
        f"True scale. Sections at y = {level:.0f} m, dashed in the views. Grey: moved less than {SLID:g} m.\n"
        f"Line along the top: ground before. Line in the strength: what moves farther than {SLID:g} m in the end.",
        fontsize="medium",
    )
    return figure


def sections(figure: SubFigure, slide: Slide, cut: np.ndarray, norm: Normalize) -> None:
    """A section at each time, and the strength there before. cut: its particles (n,). norm: of displacements (m)."""
    at, half = slide.position[::2, cut], slide.half_size[::2]
    *sides, below = figure.subplots(len(slide.times) + 1, 1, sharex=True, sharey=True)
    for side, time, step in zip(sides, slide.times, slide.displacement[:, :, cut], strict=True):
        far = beyond(np.linalg.norm(step, axis=0))
        boxes = draw_particles(side, at, half, far, "viridis", norm, displacement=step[::2])
        outline(side, at, half)
        side.set_title(f"t = {time:g} s ", loc="right", y=0.72)
    strength = slide.strength[cut] / 1e3
    soil = draw_particles(below, at, half, strength, "cividis", Normalize(strength.min(), strength.max()))
    slid_part(below, slide, cut)
    below.set_title("strength before ", loc="right", y=0.72)
    below.set_ylim(0.0, 1.1 * (at[1].max() + half[1]))
    for ax in (*sides, below):
        ax.label_outer()
    figure.colorbar(boxes, ax=sides, label="displacement [m]", aspect=40, extend="max")
    figure.colorbar(soil, ax=below, label="$S_u$ [kPa]", aspect=9)


@dataclass(frozen=True)
class Drawn:
    """The pictures of typical slides that were drawn, and of those that broke off what is to be said of each."""

    files: tuple[Path, ...]
    broke_off: tuple[str, ...]


def titled(mode: str, run: Run) -> str:
    """What the picture of a typical slide is of."""
    return f"Typical {mode} slide: sample {run.sample} of {run.case!r}, {run.grid} grid"


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
            files.append(save(drawing(slide, titled(mode, run)), folder / f"published_slide_{mode}.png", dpi=100))
    return Drawn(tuple(files), tuple(broke_off))
