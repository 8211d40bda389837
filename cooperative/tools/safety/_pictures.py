"""The critical slip surface drawn beside the slope that the solver has failing, and its numbers as JSON."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import matplotlib
import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.patches import Polygon

from cooperative.reporting import draw_particles, panels, save
from cooperative.scene import Campaign
from cooperative.store import write_aside
from cooperative.tools.safety._factor import Safety
from cooperative.tools.safety._slices import zones
from jaxmpm.support.text import literal

LAYERS = matplotlib.colormaps["Pastel2"]
WATER, CIRCLE, SURFACE = "#1f77b4", "#0072B2", "#D55E00"


def write_safety(result: Safety, campaign: Campaign, folder: Path) -> list[Path]:
    """Write `fos.png` and `fos.json`.

    Args:
        result: of `factor_of_safety`.
        campaign: whose it is.
        folder: to write to.

    Returns:
        Paths of the files.

    Raises:
        OSError: the disk refuses.
    """
    folder.mkdir(parents=True, exist_ok=True)
    picture, numbers = folder / "fos.png", folder / "fos.json"
    draw_safety(result, campaign, picture)
    write_aside(numbers, (json.dumps(_content(result, campaign), indent=1) + "\n").encode())
    return [picture, numbers]


def _content(result: Safety, campaign: Campaign) -> dict[str, object]:
    """What `fos.json` holds."""
    content: dict[str, object] = {
        "name": campaign.name, "soil": result.soil, "loads": list(result.loads),
        "limit_equilibrium": None, "solver": None, "difference": result.difference,
        "reasons": list(result.reasons), "notes": list(result.notes),
    }  # fmt: skip
    if result.equilibrium is not None:
        slip, circle = result.equilibrium.slip, result.equilibrium.circle
        content["limit_equilibrium"] = {
            "factor": slip.factor, "method": slip.method, "surface": slip.points.tolist(),
            "thickness": slip.thickness, "area": slip.area,
            "circle_factor": None if circle is None else circle.factor,
            "circle_method": None if circle is None else circle.method,
            "circle": None if circle is None or circle.circle is None else vars(circle.circle),
            "surfaces": result.equilibrium.surfaces, "seconds": round(result.seconds, 2),
        }  # fmt: skip
    if result.solver is not None:
        content["solver"] = asdict(result.solver) | {"grid": result.grid}
    return content


def draw_safety(result: Safety, campaign: Campaign, path: Path) -> None:
    """Draw the critical slip surface in its layers, above the slope just beyond the solver's limit load.

    Args:
        result: of `factor_of_safety`.
        campaign: whose it is.
        path: of a PNG, PDF or SVG.

    Raises:
        OSError: the disk refuses.
    """
    there = [result.equilibrium is not None, result.failing is not None]
    length, height = campaign.site.shape.extent[0], campaign.site.shape.extent[-1]
    figure, axes = panels(max(sum(there), 1), 1, size=(9.0, 0.85 * 9.0 * height / length + 1.6))
    figure.set_layout_engine("compressed")  # of panels in true scale, whose titles the other one may cut off
    title = ", ".join([result.soil, *result.loads])
    shown = iter(axes)
    if result.equilibrium is not None:
        _surfaces(next(shown), result, campaign, title)
    if result.failing is not None:
        _failing(next(shown), result)
    save(figure, path)


def _surfaces(ax: Axes, result: Safety, campaign: Campaign, title: str) -> None:
    """Layers, water and slip surfaces."""
    assert result.equilibrium is not None
    assert result.shape is not None
    names = [literal(layer.name) + (" (rock)" if layer.rock else "") for layer in campaign.site.layers] or ["soil"]
    for number, zone in zones(result.shape, result.layers):
        corners = np.asarray(shapely.get_exterior_ring(zone).coords)
        ax.add_patch(Polygon(corners, fc=LAYERS(number % LAYERS.N), ec="0.5", lw=0.6, label=names[number]))
        names[number] = "_"
    if result.water is not None:
        ax.plot(*result.water.T, color=WATER, lw=1.2, label="water table")
    slip, circle = result.equilibrium.slip, result.equilibrium.circle
    if circle is not None:
        ax.plot(*circle.points.T, color=CIRCLE, lw=1.6, ls="--" if slip is not circle else "-",
                label=f"critical circle, {circle.factor:.3f}")  # fmt: skip
    if slip is not circle:
        ax.plot(*slip.points.T, color=SURFACE, lw=2, label=f"critical surface, {slip.factor:.3f}")
    ax.autoscale_view()
    ax.set(aspect="equal", xlabel="x [m]", ylabel="z [m]")
    ax.set_title(f"limit equilibrium {slip.factor:.3f}, {title}", loc="left")
    ax.legend(loc="best", fontsize="small", framealpha=0.7)


def _failing(ax: Axes, result: Safety) -> None:
    """Displacement of the slope just beyond its limit load, in 3D in the middle."""
    assert result.failing is not None
    assert result.solver is not None
    scene, state = result.failing
    position = np.asarray(scene.particles.position, float)
    displacement = np.asarray(state.displacement, float)
    if len(position) == 3:
        middle = np.abs(position[1] - (position[1].max() + position[1].min()) / 2)
        plane = middle <= middle.min() + 1e-6
        position, displacement = position[:, plane], displacement[:, plane]
    size = np.linalg.norm(displacement, axis=0)
    section, half = (
        position[[0, -1]],
        np.array([np.diff(np.unique(coordinate.round(6))).min() / 2 for coordinate in position[[0, -1]]]),
    )
    norm = Normalize(0.0, max(float(np.quantile(size, 0.995)), 1e-6))
    boxes = draw_particles(ax, section, half, size, "viridis", norm, displacement=displacement[[0, -1]])
    ax.set_title(f"solver {result.solver.kink:.3f}, {result.grid}, just beyond the limit load", loc="left")
    assert ax.figure is not None
    ax.figure.colorbar(boxes, ax=ax, label="displacement [m]", extend="max", location="bottom", shrink=0.5)
