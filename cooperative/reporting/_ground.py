"""A scene before it runs: its ground with layers, water and walls, and one random field on both grids."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from cooperative.reporting import _pictures as pictures
from cooperative.reporting import _plots as plots
from cooperative.runs import GridModel, coefficients_of
from cooperative.scene import Campaign
from jaxmpm import Section

LAYERS = matplotlib.colormaps["Set2"]
WATER = "#1f77b4"


def draw(campaign: Campaign, path: Path, *, sample: int = 0) -> Path:
    """Draw a scene into a PNG, PDF or SVG, and give the path back.

    sample: number of the sample whose field is drawn. Raises ValueError where the scene has not so many samples, or its
    ground, soil and grids do not fit together.
    """
    if not 0 <= sample < campaign.plan.samples:
        raise ValueError(f"sample = {sample}: the scene has samples 0 to {campaign.plan.samples - 1}")
    models = pictures.models_of(campaign)
    coefficients = coefficients_of(campaign, models["rough"].soil)[sample]
    figure = ground(models, {grid: pictures.values_of(model, coefficients) for grid, model in models.items()})
    plots.lay_out(figure)
    return plots.save(figure, path)


def ground(models: dict[str, GridModel], values: dict[str, dict[str, np.ndarray]]) -> Figure:
    """Ground above one random field on every grid, the first; in 3D the section in the middle, and its place on a map.

    values: by grid and parameter of the soil, of the particles (N,), nan for rock.
    """
    planes = {grid: pictures.plane_at(model, pictures.middle(model)) for grid, model in models.items()}
    sections = {grid: pictures.section_of(model, planes[grid]) for grid, model in models.items()}
    fine = models["refined"]
    solid = fine.campaign.dimension == 3
    figure, axes = plots.section_panels(sections["refined"][0], 1 + len(models) + solid)
    if solid:
        _map(figure, axes[0], fine)
    _layers(axes[int(solid)], fine, planes["refined"], sections["refined"])
    name = next(iter(fine.campaign.random))
    drawn = plots.QUANTITIES[name]
    kept = {grid: found[name][planes[grid]] / drawn.unit for grid, found in values.items()}
    norm = Normalize(min(map(np.nanmin, kept.values())), max(map(np.nanmax, kept.values())))
    shown = list(axes[1 + solid :])
    for ax, (grid, (position, half)) in zip(shown, sections.items(), strict=True):
        boxes = plots.draw_particles(ax, position, half, kept[grid], "cividis", norm)
        ax.set_title(f"{grid} grid, {models[grid].scene.particles.mass.size:,} particles, one sample", loc="left")
    figure.colorbar(boxes, ax=shown, label=drawn.label)
    return figure


def _layers(ax: Axes, model: GridModel, plane: np.ndarray, section: plots.Section) -> None:
    """Particles by their layer, the water, the walls and the base."""
    campaign, (position, half) = model.campaign, section
    layers = campaign.site.layers
    number = np.zeros(position.shape[1]) if model.layer is None else model.layer[plane].astype(float)
    norm = Normalize(-0.5, LAYERS.N - 0.5)
    plots.draw_particles(ax, position, half, number % LAYERS.N, "Set2", norm)
    names = [each.name + (" (rock)" if each.rock else "") for each in layers] or ["soil"]
    handles: list[Any] = [Patch(color=LAYERS(k % LAYERS.N), label=name) for k, name in enumerate(names)]
    corner, extent = campaign.site.shape.corner, campaign.site.shape.extent
    ends = corner[0], corner[0] + extent[0]
    table = model.scene.water
    if table is not None:
        handles += ax.plot(np.asarray(table.x), np.asarray(table.z), color=WATER, lw=1.5, label="water")
    hold = {wall.axis: wall.hold for wall in model.scene.walls}
    for end in ends:
        ax.axvline(end, color="k", lw=1.5, ls="--" if hold[0] == "roller" else "-")
    ax.axhline(corner[-1], color="k", lw=2)
    ax.set_title(f"ground between {hold[0]} walls at x = {ends[0]:g} and {ends[1]:g} m, on a fixed base", loc="left")
    ax.legend(handles=handles, loc="upper right", fontsize="small", framealpha=0.8)


def _map(figure: Figure, ax: Axes, model: GridModel) -> None:
    """Heights of the ground from above, and where the section lies."""
    shape = model.campaign.site.shape
    (x0, y0), (length, width) = shape.corner[:2], shape.extent[:2]
    if isinstance(shape, Section):
        return
    x, y = (start + np.linspace(0, size, 200) for start, size in ((x0, length), (y0, width)))
    at = np.meshgrid(x, y, indexing="ij")
    heights = shape.heights(*at)
    lines = ax.contourf(x, y, heights.T, 20, cmap="terrain")
    ax.axhline(pictures.middle(model), color="k", lw=1, ls="--")
    ax.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    ax.set_title("height of the ground, and the section below", loc="left")
    figure.colorbar(lines, ax=ax, label="z [m]")
