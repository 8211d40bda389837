"""A scene before it runs: ground, layers, water, walls, elements at risk, random fields and strength against depth.

One field is drawn on each grid. In 3D a map and a section, and a page whose ground the reader turns.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import Normalize, to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from cooperative.folder import models_of
from cooperative.reporting import _interactive as interactive
from cooperative.reporting import _page as page
from cooperative.reporting import _plots as plots
from cooperative.reporting import _profiles as profiles
from cooperative.reporting._bodies import skin
from cooperative.reporting._soundings import conditioned, measured_of
from cooperative.runs import GridModel, coefficients_of, ground_of, soil_of
from cooperative.scene import Campaign, check_cells
from cooperative.store import write_aside
from jaxmpm import Ground, Raster
from jaxmpm.ground import floor
from jaxmpm.laws import WaterSurface, WaterTable
from jaxmpm.support.text import literal

if TYPE_CHECKING:
    from plotly.graph_objects import Mesh3d, Scatter3d

LAYERS = colormaps["Set2"]
WATER, ROCK = "#1f77b4", "#969696"

Values = dict[str, Mapping[str, np.ndarray]]
"""By grid and parameter of the soil, of the particles (N,), nan for rock."""

EXPOSED = "#D55E00"
TRACK = "#CC0066"


def draw(campaign: Campaign, *paths: Path, sample: int | None = None) -> None:
    """Draw a scene into each of these files: a PNG, PDF or SVG, or in 3D an HTML page that turns.

    Where no soil is random, its strength is drawn in place of a field.

    Args:
        campaign: to be drawn.
        paths: of the files.
        sample: number of the sample whose field is drawn, None for the first.

    Raises:
        ValueError: the scene has not so many samples, or nothing in it is random; its ground, soil and grids do not fit
            together; a name has no picture's ending, or a page is asked for of a section.
    """
    check_cells(campaign)
    campaign.check_sample(sample)
    if unknown := [
        path for path in paths if path.suffix[1:] not in ("html", *Figure().canvas.get_supported_filetypes())
    ]:
        raise ValueError(f"{unknown[0]} is no name of a picture: give a PNG, PDF or SVG, such as {unknown[0]}.png")
    turns = [path for path in paths if path.suffix == ".html"]
    if turns and campaign.dimension < 3:
        raise ValueError(f"{turns[0]}: a section has nothing to turn, give a PNG, PDF or SVG")
    if turns and not interactive.installed():
        raise ValueError(f"{turns[0]}: a page that turns needs plotly, which is not installed: pip install plotly")
    models = models_of(campaign)
    coefficients = coefficients_of(campaign, models["rough"].soil)
    values: Values = {grid: soil_of(model, coefficients[sample or 0]).values for grid, model in models.items()}
    if not values["refined"]:
        raise ValueError("nothing in the soil is random, nor does its law declare a strength: there is nothing to draw")
    for path in turns:
        write_aside(path, solid(models, values).encode())
    if len(turns) < len(paths):
        figure = ground(models, values, coefficients)
        plots.lay_out(figure)
        for path in paths:
            if path not in turns:
                plots.save(figure, path)


def solid(models: dict[str, GridModel], values: Values) -> str:
    """A page that turns: the ground by its layers, and one field on every grid, the first."""
    campaign = models["refined"].campaign
    name = _first(campaign, values)
    scale = plots.quantity(name)
    field = {grid: by_name[name] / scale.size for grid, by_name in values.items()}
    low, high = plots.ends(field.values())
    bodies = {"layers": _layered(models["refined"])}
    for grid, model in models.items():
        body = skin(np.asarray(model.scene.particles.position, float), 2 * model.half_size)
        seen = field[grid][body.of]
        rock = np.isnan(seen)
        soil = interactive.mesh(
            body.corners, body.faces[~rock], of_faces=seen[~rock], cmin=low, cmax=high, colorscale="Cividis",
            colorbar={"title": {"text": scale.unit}},
        )  # fmt: skip
        bodies[f"{scale.word}, {grid} grid"] = [soil, interactive.mesh(body.corners, body.faces[rock], color=ROCK)]
    figure = interactive.chosen(bodies, list(_outlines(models["refined"])))
    shown = "one sample's random field" if campaign.random else "the soil's strength"
    text = f"Ground by its layers, and {shown} on both grids. Drag it to turn it."
    parts = [page.heading(campaign.name, 1), interactive.html(figure, "ground"), page.paragraph(text)]
    return page.document(campaign.name, [*parts, interactive.script()])


def _first(campaign: Campaign, values: Values) -> str:
    """The parameter that is drawn: the first that is random, or else the first of strength."""
    return next(iter(campaign.random or values["refined"]))


def _layered(model: GridModel) -> list[Mesh3d]:
    """The ground by its layers, and the water above it."""
    body = skin(np.asarray(model.scene.particles.position, float), 2 * model.half_size)
    number = np.zeros(len(body.of), int) if model.layer is None else model.layer[body.of]
    parts = [
        interactive.mesh(
            body.corners, body.faces[number == k], color=to_hex(LAYERS(k % LAYERS.N)), name=name, showlegend=True
        )
        for k, name in enumerate(_names(model.campaign))
    ]
    pool = _pool(model).reshape(-1, 3)
    if len(pool):
        squares = np.arange(len(pool)).reshape(-1, 4)
        parts.append(interactive.mesh(pool, squares, color=WATER, opacity=0.4, name="water", showlegend=True))
    return parts


def _pool(model: GridModel) -> np.ndarray:
    """Squares (n, 4, 3) m of the water table, where it stands above the ground."""
    shape = model.campaign.site.shape
    low, extent, cell = shape.corner[:2], shape.extent[:2], model.scene.grid.cell
    edges = [start + np.linspace(0, size, round(size / cell) + 1) for start, size in zip(low, extent, strict=True)]
    x, y = np.meshgrid(*edges, indexing="ij")
    table = _water(model, x, y)
    if table is None:
        return np.empty((0, 4, 3))
    corners = np.stack([x, y, table], axis=-1)
    squares = np.stack([corners[:-1, :-1], corners[1:, :-1], corners[1:, 1:], corners[:-1, 1:]], axis=2)
    middle = squares.mean(axis=2)
    return squares[middle[..., 2] > shape.heights(middle[..., 0], middle[..., 1])]


def _outlines(model: GridModel) -> Iterator[Scatter3d]:
    """The base, the walls and the elements at risk, these on the surface of the ground."""
    campaign = model.campaign
    shape = campaign.site.shape
    low, high = np.array(shape.corner), np.array(shape.corner) + shape.extent
    (x0, y0, z0), (x1, y1, z1) = low, high
    ring = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]
    # Lines on the surface lie above the boxes of its particles.
    above = 2 * model.half_size[-1]
    x, y = _around(np.array(ring[:4]), model.scene.grid.cell / 2).T
    yield interactive.line(np.column_stack([x, y, floor(shape, x, y)]), _contact(shape))
    for (axis, side), hold in _holds(model).items():
        at = (low if side == "low" else high)[axis]
        ends = [point for point in ring[:4] if point[axis] == at]
        frame = np.array([(*ends[0], z0), (*ends[0], z1), (*ends[1], z1), (*ends[1], z0)])
        yield interactive.line(frame, f"{hold} wall, {'xy'[axis]} = {at:g} m", dashed=hold == "roller")
    if (table := _water(model, x, y)) is not None:
        yield interactive.line(np.column_stack([x, y, table]), "water table", WATER)
    if campaign.site.track is not None:
        points = _between(np.array(campaign.site.track.points), model.scene.grid.cell / 2)
        yield interactive.line(
            np.column_stack([points, shape.heights(*points.T) + above]), "run-out line", TRACK, dashed=True
        )
    for element in campaign.elements_at_risk:
        corners = _around(np.array(element.corners), model.scene.grid.cell / 2)
        yield interactive.line(np.column_stack([corners, shape.heights(*corners.T) + above]), element.name, EXPOSED)


def _around(corners: np.ndarray, step: float) -> np.ndarray:
    """Points (m, 2) along the sides of a polygon, back to its start; a point is left."""
    return corners if len(corners) == 1 else _between(np.concatenate([corners, corners[:1]]), step)


def _between(line: np.ndarray, step: float) -> np.ndarray:
    """Points (m, 2) along a line, at most `step` (m) apart."""
    return np.concatenate(
        [np.linspace(a, b, max(int(np.ceil(np.linalg.norm(b - a) / step)), 1) + 1) for a, b in pairwise(line)]
    )


def _names(campaign: Campaign) -> list[str]:
    """Of the layers."""
    return [layer.name + (" (rock)" if layer.rock else "") for layer in campaign.site.layers] or ["soil"]


def _holds(model: GridModel) -> dict[tuple[int, str], str]:
    """What each upright wall holds, by axis and side."""
    upright = len(model.half_size) - 1
    return {(wall.axis, wall.side): wall.hold for wall in model.scene.boundary.walls if wall.axis < upright}


def _water(model: GridModel, x: np.ndarray, y: np.ndarray) -> np.ndarray | None:
    """Height of the water table (m) at points (m), in a section whatever y; None where there is none."""
    table = model.scene.loads.water
    if isinstance(table, WaterTable):
        return np.interp(x, np.asarray(table.x), np.asarray(table.z))
    if not isinstance(table, WaterSurface):
        return None
    west, south = np.asarray(table.corner, float).tolist()
    raster = Raster(np.asarray(table.heights, float), (west, south), float(table.step))
    return raster.at(*(np.clip(at, *ends) for at, ends in zip((x, y), raster.ends, strict=True)))


def ground(models: dict[str, GridModel], values: Values, coefficients: np.ndarray) -> Figure:
    """Ground with its layers above the first field on every grid, and strength against depth beside them.

    In 3D the section in the middle, below a map that shows where it lies. Of a field that is conditioned, the values
    measured, and mean and deviation over samples by their coefficients (samples, modes).
    """
    stored, fine = ground_of(models), models["refined"]
    planes = {grid: plots.plane_at(grid_stored, stored.middle) for grid, grid_stored in stored.grids.items()}
    sections = {grid: plots.section_of(grid_stored, planes[grid]) for grid, grid_stored in stored.grids.items()}
    mapped = fine.campaign.dimension == 3
    name = _first(fine.campaign, values)
    scale, measured = plots.quantity(name), measured_of(fine.campaign, name)
    rows = 1 + len(models) + mapped
    shown_profiles = profiles.profiles(fine, planes["refined"])
    count = rows + 2 * (measured is not None)
    figure, axes, beside = plots.section_panels_beside(sections["refined"][0], count, len(shown_profiles[0].mean))
    profiles.draw_profiles(beside, shown_profiles)
    if mapped:
        _map(figure, axes[0], fine, stored.middle)
    _layers(axes[int(mapped)], fine, planes["refined"], sections["refined"], stored.middle)
    for profile in shown_profiles:
        axes[int(mapped)].vlines(
            profile.x,
            profile.elevation - profile.depth.max(),
            profile.elevation,
            color=profiles.COLOURS[profile.station],
            lw=2,
        )
    if measured is not None:
        axes[0].plot(*measured[:, :2].T, ".", color="k", ms=2, label="measured")
        shown = np.flatnonzero(planes["refined"])
        moments = [field / scale.size for field in conditioned(fine, name, coefficients, shown)]
        _moments(figure, axes[rows:], sections["refined"], moments, scale, None if mapped else measured)
    shown_values = {grid: fields[name][planes[grid]] / scale.size for grid, fields in values.items()}
    norm, of = Normalize(*plots.ends(shown_values.values())), ", one sample" if fine.campaign.random else ""
    uniform = norm.vmin == norm.vmax
    of += f", {scale.word} {norm.vmin:.4g} {scale.unit}" if uniform else ""
    panels = list(axes[1 + mapped : rows])
    for ax, (grid, (position, half)) in zip(panels, sections.items(), strict=True):
        boxes = plots.draw_particles(ax, position, half, shown_values[grid], "cividis", norm)
        ax.set_title(f"{grid} grid, {models[grid].scene.particles.mass.size:,} particles{of}", loc="left")
    if not uniform:
        figure.colorbar(boxes, ax=panels, label=scale.label)
    return figure


def _moments(
    figure: Figure, axes: Sequence[Axes], section: plots.Section, moments: Sequence[np.ndarray],
    scale: plots.ParameterLabel, measured: np.ndarray | None,
) -> None:  # fmt: skip
    """Mean and deviation (N,) of a conditioned field in a section, with the values measured (n, 3) in their colours."""
    position, half = section
    for ax, values, word in zip(axes, moments, ("mean", "standard deviation"), strict=True):
        finite = [values[np.isfinite(values)]]
        if word == "mean" and measured is not None:
            finite.append(measured[:, -1] / scale.size)
        norm = Normalize(min(part.min() for part in finite), max(part.max() for part in finite))
        boxes = plots.draw_particles(ax, position, half, values, "cividis", norm)
        if measured is not None:
            x, z, value = measured.T
            inner = norm(value / scale.size) if word == "mean" else np.zeros(value.size)
            ax.scatter(x, z, 8, colormaps["cividis"](inner), edgecolors="w", linewidths=0.3)
        ax.set_title(f"{word} over samples", loc="left")
        figure.colorbar(boxes, ax=ax, label=f"[{scale.unit}]")


def _layers(ax: Axes, model: GridModel, plane: np.ndarray, section: plots.Section, middle: float) -> None:
    """Particles by their layer, the water, the walls and the base."""
    campaign, (position, half) = model.campaign, section
    number = np.zeros(position.shape[1]) if model.layer is None else model.layer[plane].astype(float)
    norm = Normalize(-0.5, LAYERS.N - 0.5)
    plots.draw_particles(ax, position, half, number % LAYERS.N, "Set2", norm)
    handles: list[Artist] = [
        Patch(color=LAYERS(k % LAYERS.N), label=literal(name)) for k, name in enumerate(_names(campaign))
    ]
    corner, extent = campaign.site.shape.corner, campaign.site.shape.extent
    ends = corner[0], corner[0] + extent[0]
    x = np.linspace(*ends, 200)
    table = _water(model, x, np.full(x.size, middle))
    if table is not None:
        handles += ax.plot(x, table, color=WATER, lw=1.5, label="water")
    hold = [_holds(model).get((0, side), "no") for side in ("low", "high")]
    for end, kind in zip(ends, hold, strict=True):
        ax.axvline(end, color="k", lw=1.5, ls="--" if kind == "roller" else "-")
    ax.plot(x, floor(campaign.site.shape, *(x, np.full(x.size, middle))[: campaign.dimension - 1]), color="k", lw=2)
    if campaign.dimension == 2:
        shape = campaign.site.shape
        for element in campaign.elements_at_risk:
            x = np.linspace(min(element.corners)[0], max(element.corners)[0], 100)
            ax.plot(x, shape.heights(x), color=EXPOSED, lw=4, marker="v", markevery=[50])
            _name(ax, element.name, (x[50], shape.heights(x)[50]))
    walls = ", ".join(f"{kind} wall at x = {end:g} m" for end, kind in zip(ends, hold, strict=True))
    ax.set_title(f"{walls}, {_contact(campaign.site.shape)}", loc="left")
    ax.legend(handles=handles, loc="upper left", bbox_to_anchor=(1, 1), fontsize="small", frameon=False)


def _contact(shape: Ground) -> str:
    """What rigid ground there is under a shape, in words."""
    slides, rock = (getattr(shape, part, None) is not None for part in ("interface", "bedrock"))
    return ("soil slides on the " if slides else "fixed ") + ("bedrock" if rock else "base")


def _name(ax: Axes, name: str, at: tuple[float, float]) -> None:
    """Write the name of an element at risk above it."""
    text = ax.annotate(name, at, color=EXPOSED, fontsize="small", xytext=(0, 8), textcoords="offset points")
    text.set_parse_math(False)


def _map(figure: Figure, ax: Axes, model: GridModel, middle: float) -> None:
    """Heights of the ground from above with the elements at risk, and where the section lies."""
    shape = model.campaign.site.shape
    (x0, y0), (length, width) = shape.corner[:2], shape.extent[:2]
    x, y = (start + np.linspace(0, size, 200) for start, size in ((x0, length), (y0, width)))
    at = np.meshgrid(x, y, indexing="ij")
    heights = shape.heights(*at)
    shown = ax.pcolormesh(x, y, heights.T, cmap="summer", rasterized=True)
    ax.axhline(middle, color="k", lw=1, ls="--")
    for element in model.campaign.elements_at_risk:
        corners = np.array([*element.corners, element.corners[0]])
        ax.plot(*corners.T, color=EXPOSED, lw=2, marker="o" if len(element.corners) == 1 else "")
        _name(ax, element.name, tuple(corners[0]))
    if model.campaign.site.track is not None:
        ax.plot(*np.array(model.campaign.site.track.points).T, color=TRACK, lw=1.5, ls=":", label="run-out line")
        ax.legend(loc="upper left", fontsize="small", framealpha=0.8)
    ax.set(aspect="equal", anchor="W", xlabel="x [m]", ylabel="y [m]")
    ax.set_title("height of the ground, and the section below", loc="left")
    # Below it the sections begin at the left, too.
    figure.colorbar(shown, ax=ax, label="z [m]", panchor=False)
