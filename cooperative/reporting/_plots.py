"""Pictures of a slope: its random fields, its slide at several times, from the side and from above.

Arrays go in and a matplotlib Figure comes out; none keeps any state. Units stand on every axis; the colour maps are
perceptually even for all kinds of colour vision (viridis, cividis). Figures of numbers are in `_charts`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from cooperative.reporting._bodies import moved_boxes, soil_between
from cooperative.reporting._charts import panels
from cooperative.reporting._quantities import quantity
from cooperative.runs import Frames, SampleSoil, StoredGrid, StoredGround
from cooperative.store import Sample
from foundation import files

if TYPE_CHECKING:
    import plotly.graph_objects as plotly

Section = tuple[np.ndarray, np.ndarray]
"""Positions (2, N) as x and z (m), and half the particle spacing (2,) m."""


@dataclass(frozen=True)
class Drawn:
    """A figure of a report.

    Args:
        name: of its file.
        caption: what it shows, in sentences.
        figure: as matplotlib draws it.
        interactive: makes the same figure in Plotly, None where there is none.
    """

    name: str
    caption: str
    figure: Figure
    interactive: Callable[[], plotly.Figure] | None = None


def parameter_fields(name: str, sections: Mapping[str, Section], fields: Mapping[str, np.ndarray]) -> Figure:
    """One random field on every grid, one panel each, on one colour scale.

    Args:
        name: of the soil's parameter.
        sections: by grid name.
        fields: grid name -> its values (N,), in SI units or degrees, of the same particles; nan is rock.
    """
    drawn = quantity(name)
    low = min(float(np.nanmin(values)) for values in fields.values()) / drawn.size
    high = max(float(np.nanmax(values)) for values in fields.values()) / drawn.size
    figure, axes = section_panels(next(iter(sections.values()))[0], len(sections))
    norm = Normalize(low, high)
    for ax, (grid, (position, half)) in zip(axes, sections.items(), strict=True):
        boxes = draw_particles(ax, position, half, fields[grid] / drawn.size, "cividis", norm)
        ax.set_title(f"{grid} grid, {position.shape[1]:,} particles", loc="left")
    figure.colorbar(boxes, ax=axes, label=drawn.label)
    return figure


def before_and_after(
    position: np.ndarray, displacement: np.ndarray, plastic_strain: np.ndarray, half_size: np.ndarray
) -> Figure:
    """Section before and after, coloured by the plastic strain at the end.

    Args:
        position: (2, N) m, rows x and z.
        displacement: (2, N) m, rows x and z.
        plastic_strain: (N,).
        half_size: (2,) m.
    """
    figure, axes = section_panels(position, 2)
    norm = Normalize(0.0, max(float(np.quantile(plastic_strain, 0.99)), 1e-3))
    moved = float(np.linalg.norm(displacement, axis=0).max())
    for ax, step, title in (
        (axes[0], np.zeros_like(position), "before, in the colours of the end"),
        (axes[1], displacement, f"after, largest displacement {moved:.3g} m"),
    ):
        boxes = draw_particles(ax, position, half_size, plastic_strain, "viridis", norm, displacement=step)
        ax.set_title(title, loc="left")
    _share_limits(axes)
    figure.colorbar(boxes, ax=axes, label="accumulated plastic shear strain [-]", extend="max")
    return figure


def slide(section: Section, name: str, field: np.ndarray, displacement: np.ndarray, times: Sequence[float]) -> Figure:
    """A random field above the slide that it led to, at several times.

    Args:
        section: before.
        name: of the soil's parameter, and its values (N,), SI units or degrees.
        field: of the soil's parameter, and its values (N,), SI units or degrees.
        displacement: (T, 2, N) m at the T times (s); colour tells how far a particle has moved by then.
        times: of the displacements (s).
    """
    position, half = section
    moved = np.linalg.norm(displacement, axis=1)
    figure, axes = section_panels(position, len(times) + 1)
    drawn = quantity(name)
    norm = Normalize(float(np.nanmin(field)) / drawn.size, float(np.nanmax(field)) / drawn.size)
    boxes = draw_particles(axes[0], position, half, field / drawn.size, "cividis", norm)
    axes[0].set_title(f"{'strength' if name == 'strength' else drawn.word} before", loc="left")
    figure.colorbar(boxes, ax=axes[0], label=f"{drawn.symbol} [{drawn.unit}]", aspect=8)
    norm = Normalize(0.0, max(float(moved.max()), 1e-6))
    for ax, time, step, far in zip(axes[1:], times, displacement, moved, strict=True):
        boxes = draw_particles(ax, position, half, far, "viridis", norm, displacement=step)
        ax.set_title(f"t = {time:.3g} s, moved up to {far.max():.3g} m", loc="left")
    figure.colorbar(boxes, ax=axes[1:], label="displacement [m]", aspect=8 * len(times))
    _share_limits(axes)
    return figure


def plan(
    position: np.ndarray, displacement: np.ndarray, times: Sequence[float], half_size: np.ndarray, *, toe: float | None
) -> Figure:
    """A slide from above at several times: how far the soil on top has moved.

    Args:
        position: initial (3, N) m.
        displacement: (T, 3, N) m at the T times (s).
        times: of the displacements (s).
        half_size: half the particle spacing (3,) m.
        toe: x of the toe (m), drawn as a line where there is one.
    """
    moved = np.linalg.norm(displacement, axis=1)
    norm = Normalize(0.0, max(float(moved.max()), 1e-6))
    length, width = np.ptp(position[0]), np.ptp(position[1])
    figure, axes = panels(1, len(times), size=(11.0 / len(times), 11.0 / len(times) * width / length + 1.0))
    for ax, time, step, far in zip(axes, times, displacement, moved, strict=True):
        now = position + step
        # Drawn from below upwards, so that the topmost soil is seen.
        upwards = np.argsort(now[2], kind="stable")
        boxes = draw_particles(ax, now[:2, upwards], half_size[:2], far[upwards], "viridis", norm, vertical="y [m]")
        if toe is not None:
            ax.axvline(toe, color="white", lw=1.2, ls="--")
        ax.set_title(f"t = {time:.3g} s", loc="left")
    if toe is not None:
        axes[0].text(toe, position[1].max(), " toe", va="top", color="white")
    _share_limits(axes)
    figure.colorbar(boxes, ax=axes, label="displacement [m]", shrink=0.7)
    return figure


def lay_out(figure: Figure) -> None:
    """Place the axes of a figure once, since each file that it is written to would do so again."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine(None)


def save(figure: Figure, path: str | Path, *, dpi: int = 150) -> Path:
    """Write a figure, whole or not at all.

    Args:
        figure: to write.
        path: of the file; its suffix says PNG, PDF or SVG.
        dpi: resolution of pixels.

    Returns:
        The path.

    Raises:
        OSError: the disk refuses; the message has the file's name.
    """
    path = Path(path)
    with files.aside(path) as part:
        figure.savefig(part, dpi=dpi, format=path.suffix[1:])
    return path


def section_panels(position: np.ndarray, rows: int, columns: int = 1) -> tuple[Figure, list[Axes]]:
    """Panels as high as a section drawn in true scale asks for."""
    width = 8.0 if columns == 1 else 4.8
    length, height = np.ptp(position, axis=1)
    return panels(rows, columns, size=(width, 0.85 * width * height / length + 0.8))


def draw_particles(
    ax: Axes,
    position: np.ndarray,
    half: np.ndarray,
    values: np.ndarray,
    colours: str,
    norm: Normalize,
    *,
    displacement: np.ndarray | None = None,
    vertical: str = "z [m]",
) -> PolyCollection:
    """Particles as boxes in true size, so that both grids fill the same area.

    With a displacement, they are moved and stretched, over the soil between them.

    Args:
        ax: axes to draw on.
        position: before (2, N) m.
        half: half the particle spacing (2,) m.
        values: that colours show (N,).
        colours: name of a colour map.
        norm: ends of its scale.
        displacement: from a lattice (2, N) m, None for none.
        vertical: label of the vertical axis.
    """
    step = np.zeros_like(position) if displacement is None else displacement
    corners, shown = moved_boxes(position, step, half), values
    if step.any():
        between = soil_between(position + step, half)
        # Triangles with their last corner twice, so that one array holds them and the boxes.
        corners = np.concatenate([(position + step).T[between[:, [0, 1, 2, 2]]], corners])
        shown = np.concatenate([values[between].mean(axis=1), values])
    boxes = PolyCollection(
        list(corners),
        array=np.ma.masked_invalid(shown),
        cmap=colormaps[colours].with_extremes(bad="0.6"),
        norm=norm,
        lw=0,
        antialiased=False,
        rasterized=True,
    )
    ax.add_collection(boxes)
    ax.autoscale_view()
    ax.set(aspect="equal", xlabel="x [m]", ylabel=vertical)
    return boxes


def _share_limits(axes: Sequence[Axes]) -> None:
    """Show the same piece of ground in every panel."""
    for limits, give in (("get_xlim", "set_xlim"), ("get_ylim", "set_ylim")):
        ends = np.array([getattr(ax, limits)() for ax in axes])
        for ax in axes:
            getattr(ax, give)(float(ends[:, 0].min()), float(ends[:, 1].max()))


def drawn_fields(ground: StoredGround, sample: Sample, soils: Mapping[str, SampleSoil]) -> Iterator[Drawn]:
    """The random fields of one sample on both grids, a picture for each parameter.

    Args:
        ground: of the campaign.
        sample: whose fields are drawn.
        soils: of the sample, by grid.
    """
    planes = {grid: _plane(ground, grid, sample) for grid in soils}
    sections = {grid: section_of(ground.grids[grid], plane) for grid, plane in planes.items()}
    for number, name in enumerate(ground.random):
        seen = {grid: soil.values[name][planes[grid]] for grid, soil in soils.items()}
        caption = f"Sample {sample.number}: the same random field of {_word(name)} on both grids."
        if ground.bottoms is not None and len(ground.bottoms):
            caption += " Lines: lower boundaries of the layers."
        figure = parameter_fields(name, sections, seen)
        for ax, (grid, plane) in zip(figure.axes, planes.items(), strict=False):
            _draw_outline(ax, ground, float(ground.grids[grid].position[1, plane].mean()))
        yield Drawn(f"field-{name}" if number else "field", caption, figure)


def _draw_outline(ax: Axes, ground: StoredGround, y: float) -> None:
    """Lower boundaries of layers, and walls along x, in a section at y (m)."""
    for x, z in ground.boundaries(y):
        ax.plot(x, z, color="k", lw=0.8)
    for axis, position, hold in ground.walls:
        if axis == 0:
            ax.axvline(position, color="k", lw=1.5, ls="--" if hold == "roller" else "-")


def drawn_change(ground: StoredGround, grid: str, sample: Sample) -> Drawn:
    """One sample's section before and after, by the stored plastic strain."""
    plane = _plane(ground, grid, sample)
    section, half = section_of(ground.grids[grid], plane)
    moved, strain = sample.fields["displacement"][[0, -1]][:, plane], sample.fields["plastic_strain"][plane]
    caption = f"Sample {sample.number} before and after its slide, by plastic strain."
    return Drawn("slope", caption, before_and_after(section, moved, strain, half))


def drawn_slide(ground: StoredGround, grid: str, sample: Sample, soil: SampleSoil, shown: Frames) -> Iterator[Drawn]:
    """A sample's strength and slide at several times, in 3D from above too; nothing where no moment is known."""
    if not shown.times:
        return
    displacement, plane = np.stack(shown.displacement), _plane(ground, grid, sample)
    name, of = ground.random[0], ground.grids[grid]
    seen = displacement[:, [0, -1]][:, :, plane]
    where = " Section where it moved farthest." if ground.dimension == 3 else ""
    yield Drawn(
        f"slide-{sample.number:06d}",
        f"{title(sample)}: {_word(name)} and slide.{where}",
        slide(section_of(of, plane), name, soil.values[name][plane], seen, shown.times),
    )
    if ground.dimension == 3:
        toe = None if ground.face is None else ground.face.toe_x
        yield Drawn(
            f"plan-{sample.number:06d}",
            f"{title(sample)}, by how far the soil on top has moved, from above.",
            plan(np.asarray(of.position, float), displacement, shown.times, of.half_size, toe=toe),
        )


def title(sample: Sample) -> str:
    """Number and failure mode of a sample."""
    mode = sample.row.get("mode")
    return f"Sample {sample.number}" + ("" if mode in (None, "none") else f", {mode}")


def _word(name: str) -> str:
    return "strength" if name == "strength" else quantity(name).word


def _plane(ground: StoredGround, grid: str, sample: Sample) -> np.ndarray:
    """Particles (N,) of the section to draw: all of them in 2D, in 3D the slice that moved farthest."""
    of, moved = ground.grids[grid], sample.fields.get("displacement")
    if ground.dimension == 3 and moved is not None and moved.shape == of.position.shape:
        return plane_at(of, float(of.position[1, np.argmax(np.linalg.norm(moved, axis=0))]))
    return plane_at(of, ground.middle)


def plane_at(grid: StoredGrid, centre: float) -> np.ndarray:
    """Particles (N,) of the section at y = centre (m): all of them in 2D."""
    if len(grid.position) == 2:
        return np.ones(grid.position.shape[1], bool)
    nearest = grid.position[1, np.argmin(np.abs(grid.position[1] - centre))]
    return np.abs(grid.position[1] - nearest) < grid.half_size[1]


def section_of(grid: StoredGrid, plane: np.ndarray) -> Section:
    """Positions (2, n) of a section's particles and half their spacing (2,) m."""
    return np.asarray(grid.position, float)[[0, -1]][:, plane], grid.half_size[[0, -1]]
