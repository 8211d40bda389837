"""Pressure and saturation at times, the factor of safety against time, and their numbers."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.animation import FuncAnimation
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure

from cooperative.one_run import MILLISECONDS, save_animation
from cooperative.reporting import panels, save
from cooperative.scene import Campaign
from cooperative.store import write_aside
from cooperative.tools.seepage._answer import Moment, Wetted, clock, in_hours
from jaxmpm.ground import WATER_WEIGHT
from jaxmpm.support.text import literal

MOST_ROWS = 12
"""Times that a picture shows; of more, some evenly spread."""
MM_PER_HOUR = 3.6e6


def write_wetted(result: Wetted, folder: Path) -> list[Path]:
    """Write pictures and numbers: `seepage.png`, `factor.png` where there are factors, `seepage.csv` and `heads.csv`.

    Args:
        result: of `wetted`.
        folder: to write to.

    Returns:
        Paths of the files.

    Raises:
        OSError: the disk refuses.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / "seepage.png"]
    save(_pressures(result), paths[0])
    if any(moment.factor is not None for moment in result.moments):
        paths.append(folder / "factor.png")
        save(_factors(result), paths[-1])
    texts = {"seepage.csv": _rows(result), "heads.csv": _heads(result), "seepage.json": _json(result)}
    return [*paths, *write_texts(folder, texts)]


def write_texts(folder: Path, texts: Mapping[str, str]) -> list[Path]:
    """Write texts, each whole or not at all.

    Args:
        folder: to write to.
        texts: by name of the file.

    Returns:
        Paths of the files.
    """
    for name, text in texts.items():
        write_aside(folder / name, text.encode())
    return [folder / name for name in texts]


def _middle(result: Wetted, values: np.ndarray) -> np.ndarray:
    """Values in the section, of a solid in its middle."""
    return values[:, values.shape[1] // 2] if values.ndim == 3 else values


def _across(result: Wetted) -> float:
    """Where along y that section is in a solid (m)."""
    cells = result.cells
    return float(cells.corner[1] + (cells.shape[1] // 2 + 0.5) * cells.spacing[1])


def _pressures(result: Wetted) -> Figure:
    """Pressure and, where it is known, saturation at the times."""
    count = len(result.moments)
    shown = [result.moments[k] for k in np.unique(np.linspace(0, count - 1, min(count, MOST_ROWS)).astype(int))]
    figure, rows, norm = _rows_of_panels(result, len(shown))
    for axes, moment in zip(rows, shown, strict=True):
        for ax, mesh in zip(axes, _draw(axes, result, moment, norm), strict=True):
            figure.colorbar(mesh, ax=ax)
    _finish(figure, result, rows)
    return figure


def write_animation(result: Wetted, path: Path) -> Path:
    """Write pressure and saturation at the times as an animation.

    Args:
        result: of `wetted`, at times that are evenly spread.
        path: MP4 or GIF, as of `cooperative.one_run.animation_path`.

    Returns:
        The path.

    Raises:
        OSError: the disk refuses, or ffmpeg does.
    """
    figure, [axes], norm = _rows_of_panels(result, 1)
    for ax, mesh in zip(axes, _draw(axes, result, result.moments[0], norm), strict=True):
        figure.colorbar(mesh, ax=ax)
    _finish(figure, result, [axes])

    def draw(moment: Moment) -> list[QuadMesh]:
        meshes = _draw(axes, result, moment, norm)
        _name_x([axes], result)
        return meshes

    return save_animation(FuncAnimation(figure, draw, frames=result.moments, interval=MILLISECONDS), path)


def _rows_of_panels(result: Wetted, rows: int) -> tuple[Figure, list[list[Axes]], TwoSlopeNorm]:
    """A figure with a row of panels for each time, and the colours of pressure, which all times share."""
    cells, columns = result.cells, 1 + any(np.isfinite(moment.saturation).any() for moment in result.moments)
    length, height = cells.shape[0] * cells.spacing[0], cells.shape[-1] * cells.spacing[-1]
    figure, axes = panels(rows, columns, size=(5.6, max(1.3, 5.6 * height / length + 0.7)))
    pressures = [_pressure(result, moment) for moment in result.moments]
    low, high = min(map(np.nanmin, pressures)), max(map(np.nanmax, pressures))
    norm = TwoSlopeNorm(0.0, min(float(low), -1e-3), max(float(high), 1e-3))
    return figure, [axes[row * columns : (row + 1) * columns] for row in range(rows)], norm


def _pressure(result: Wetted, moment: Moment) -> np.ndarray:
    """Of the section (kPa)."""
    return WATER_WEIGHT / 1e3 * _middle(result, moment.head)


def _draw(axes: Sequence[Axes], result: Wetted, moment: Moment, norm: TwoSlopeNorm) -> list[QuadMesh]:
    """Pressure at a time, and saturation where there is a second panel, in place of what the panels show."""
    for ax in axes:
        ax.clear()
    pressure = _pressure(result, moment)
    meshes = [_field(axes[0], result, pressure, cmap="RdBu", norm=norm)]
    _outline(axes[0], result, moment, pressure)
    axes[0].set_title(f"{in_hours(moment.time)}: pore pressure [kPa]", loc="left")
    for ax in axes[1:]:
        meshes.append(_field(ax, result, _middle(result, moment.saturation), cmap="Blues", vmin=0.0, vmax=1.0))
        factor = "" if moment.factor is None else f", factor of safety {moment.factor:.3f}"
        ax.set_title(f"effective saturation{factor}", loc="left")
    return meshes


def _finish(figure: Figure, result: Wetted, rows: Sequence[Sequence[Axes]]) -> None:
    """Name the lines and the axis."""
    _name_x(rows, result)
    lines = dict(zip(*reversed(rows[0][0].get_legend_handles_labels()), strict=True))
    figure.legend(lines.values(), lines.keys(), loc="outside upper center", ncols=len(lines), frameon=False)


def _name_x(rows: Sequence[Sequence[Axes]], result: Wetted) -> None:
    where = f", at y = {_across(result):g} m" if len(result.cells.shape) == 3 else ""
    for ax in rows[-1]:
        ax.set_xlabel(f"x [m]{where}")


def _field(ax: Axes, result: Wetted, values: np.ndarray, **style: Any) -> QuadMesh:
    cells = result.cells
    edges = [cells.corner[k] + cells.spacing[k] * np.arange(cells.shape[k] + 1) for k in (0, len(cells.shape) - 1)]
    ax.set(aspect="equal", ylabel="z [m]")
    return ax.pcolormesh(*edges, values.T, **style)


def _outline(ax: Axes, result: Wetted, moment: Moment, pressure: np.ndarray) -> None:
    """The ground, the line of no pressure, the pool and the slip surface, in their section."""
    cells, shape = result.cells, result.campaign.site.shape
    along = np.linspace(cells.corner[0], cells.corner[0] + cells.shape[0] * cells.spacing[0], 401)
    across = [np.full(401, _across(result))] * (len(cells.shape) == 3)
    ax.plot(along, shape.heights(along, *across), color="0.4", lw=0.8, label="ground")
    x, z = (cells.corner[k] + cells.spacing[k] * (np.arange(cells.shape[k]) + 0.5) for k in (0, len(cells.shape) - 1))
    if np.nanmin(pressure) < 0 < np.nanmax(pressure):
        ax.contour(x, z, pressure.T, levels=[0.0], colors="k", linewidths=1.0)
    ax.plot([], [], color="k", lw=1.0, label="no pore pressure")
    if moment.level is not None:
        ax.axhline(moment.level, color="#1f77b4", lw=1.0, ls="--", label="level of the pool")
    if moment.safety is not None and moment.safety.equilibrium is not None:
        ax.plot(*moment.safety.equilibrium.slip.points.T, color="#D55E00", lw=1.2, label="slip of the least factor")


def _factors(result: Wetted) -> Figure:
    """Factor of safety against time, above the rain or the level."""
    figure, axes = panels(2, 1, size=(7.0, 2.8))
    answered = [moment for moment in result.moments if moment.factor is not None]
    unit, _ = clock(result.moments[-1].time)
    times, factors = zip(*((moment.time / unit, moment.factor) for moment in answered), strict=True)
    axes[0].plot(times, factors, "o-", color="#D55E00", clip_on=False)
    axes[0].axhline(1.0, color="0.5", lw=0.8, ls=":")
    axes[0].set(ylabel="factor of safety by slices")
    axes[0].set_title(literal(result.campaign.name), loc="left")
    draw_load(axes, result.campaign)
    return figure


def draw_load(axes: Sequence[Axes], campaign: Campaign) -> None:
    """Draw the rain or the level of a campaign below what is drawn against time.

    Args:
        axes: two, one below the other.
        campaign: with water that moves.
    """
    table = campaign.seepage
    assert table is not None
    end = table.times[-1]
    unit, name = clock(end)
    if table.rate is not None:
        times, rates = np.array([*table.rate, (max(end, table.rate[-1][0]), table.rate[-1][1])]).T
        axes[1].step(times / unit, rates * MM_PER_HOUR, where="post", color="#0072B2")
        axes[1].set(ylabel="rain [mm/h]", ylim=(min(0.0, 1.1 * rates.min() * MM_PER_HOUR), None))
    elif table.level is not None:
        times = np.linspace(0, end, 200)
        axes[1].plot(times / unit, np.interp(times, *np.array(table.level).T), color="#0072B2")
        axes[1].set(ylabel="level [m]")
    axes[1].set(xlabel=f"time [{name}]")
    for ax in axes:
        ax.set(xlim=(0, end / unit))


def csv_text(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table as the text of a CSV.

    Args:
        head: names of its columns.
        rows: their values.
    """
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([head, *rows])
    return text.getvalue()


def _rows(result: Wetted) -> str:
    rows: list[list[object]] = [
        [
            moment.time, moment.rate * MM_PER_HOUR, "" if moment.level is None else moment.level, moment.wet,
            "" if moment.factor is None else round(moment.factor, 5),
        ]
        for moment in result.moments
    ]  # fmt: skip
    return csv_text(["t [s]", "rain [mm/h]", "level [m]", "saturated share", "factor of safety"], rows)


def _heads(result: Wetted) -> str:
    """Total heads at the centres of the cells, as `[rain] pressure` reads them."""
    cells = result.cells
    position = cells.centres().reshape(len(cells.shape), -1)[:, cells.soil.ravel()]
    axes = ["x [m]", "z [m]"] if len(position) == 2 else ["x [m]", "y [m]", "z [m]"]
    rows: list[list[object]] = [
        [*(round(float(coordinate), 4) for coordinate in at), moment.time, round(float(head + at[-1]), 5)]
        for moment in result.moments
        for at, head in zip(position.T, moment.head[cells.soil], strict=True)
    ]
    return csv_text([*axes, "t [s]", "total head [m]"], rows)


def _json(result: Wetted) -> str:
    flow = result.campaign.flow
    content = {
        "name": result.campaign.name,
        "water_balance": getattr(flow, "balance", None),
        "rained": getattr(flow, "rained", None),
        "soaked_in": getattr(flow, "entered", None),
        "moments": [
            {
                "time": moment.time,
                "rate": moment.rate,
                "level": moment.level,
                "saturated": moment.wet,
                "factor": moment.factor,
            }
            for moment in result.moments
        ],
    }
    return json.dumps(content, indent=1) + "\n"
