"""Pictures of a slope: its random fields, its slide at several times, from the side and from above.

Arrays go in and a matplotlib Figure comes out; none keeps any state. Units stand on every axis; the colour maps are
perceptually even for all kinds of colour vision (viridis, cividis). Figures of numbers are in `_charts`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from cooperative.reporting._charts import panels
from cooperative.runs import StoredGrid
from jaxmpm.support import files

Section = tuple[np.ndarray, np.ndarray]
"""Positions (2, N) as x and z (m), and half the particle spacing (2,) m."""


NEAR = 1.5
"""Radius, in spacings, of the largest circle without a particle that is drawn as soil."""

TORN = 2.0
"""Distance, in spacings, by which neighbours move apart before soil is drawn as torn."""


@dataclass(frozen=True)
class ParameterLabel:
    """How a parameter of soil is drawn.

    Args:
        word: its name in plain words.
        symbol: in the mathematics of matplotlib.
        unit: of its scale.
        size: of that unit, in SI units or degrees.
    """

    word: str
    symbol: str
    unit: str
    size: float = 1.0

    @property
    def label(self) -> str:
        """Label of its scale."""
        return f"{self.word} {self.symbol} [{self.unit}]"


QUANTITIES = {
    "strength": ParameterLabel("undrained strength", "$S_u$", "kPa", 1e3),
    "strength_ratio": ParameterLabel("undrained strength over effective vertical stress", r"$S_u/\sigma'_v$", "-"),
    "cohesion": ParameterLabel("cohesion", "$c$", "kPa", 1e3),
    "friction": ParameterLabel("friction angle", r"$\varphi$", "degrees"),
    "interface_friction": ParameterLabel("friction angle of the interface", r"$\varphi_i$", "degrees"),
    "interface_cohesion": ParameterLabel("cohesion of the interface", "$c_i$", "kPa", 1e3),
    "dilation": ParameterLabel("dilation angle", r"$\psi$", "degrees"),
    "b_value": ParameterLabel("B-value", r"$B$", "-"),
    "young": ParameterLabel("Young's modulus", "$E$", "MPa", 1e6),
    "poisson": ParameterLabel("Poisson's ratio", r"$\nu$", "-"),
    "unit_weight": ParameterLabel("unit weight", r"$\gamma$", "kN/m3", 1e3),
    "softening_modulus": ParameterLabel("softening modulus", "$H$", "kPa", 1e3),
    "residual_cohesion": ParameterLabel("residual cohesion", "$c_r$", "kPa", 1e3),
    "residual_friction": ParameterLabel("residual friction angle", r"$\varphi_r$", "degrees"),
    "residual_ratio": ParameterLabel("residual over peak strength", "$r$", "-"),
    "strain_95": ParameterLabel("plastic strain of 95 % of the loss", r"$\gamma_{95}$", "-"),
    "softening_strain": ParameterLabel("plastic strain of the loss", r"$\gamma_r$", "-"),
    "rate_coefficient": ParameterLabel("rise of strength per tenfold rate", r"$\mu$", "-"),
    "loss_time": ParameterLabel("time over which strength is lost", "$t_r$", "s"),
    "viscosity": ParameterLabel("plastic viscosity", r"$\eta$", "Pa s"),
    "compression": ParameterLabel("slope of the virgin line", r"$\lambda^*$", "-"),
    "critical_state": ParameterLabel("critical state ratio", "$M$", "-"),
    "ocr": ParameterLabel("overconsolidation ratio", "OCR", "-"),
    "active_strength": ParameterLabel("active undrained strength", "$S_u^A$", "kPa", 1e3),
    "simple_strength": ParameterLabel("undrained strength in simple shear", "$S_u^{DSS}$", "kPa", 1e3),
    "passive_strength": ParameterLabel("passive undrained strength", "$S_u^P$", "kPa", 1e3),
    "failure_strain": ParameterLabel("plastic strain at failure", r"$\gamma_f$", "-"),
    "static_friction": ParameterLabel("static friction angle", r"$\varphi_s$", "degrees"),
    "dynamic_friction": ParameterLabel("dynamic friction angle", r"$\varphi_2$", "degrees"),
    "grain_size": ParameterLabel("grain size", "$d$", "mm", 1e-3),
}


def quantity(name: str) -> ParameterLabel:
    """How a parameter is drawn; one that a law of the user's own has, by its name and in its own unit.

    Args:
        name: of the parameter.

    Returns:
        Its word, symbol and unit.
    """
    return QUANTITIES.get(name, ParameterLabel(name.replace("_", " "), "", "in its own unit"))


def parameter_fields(name: str, sections: Mapping[str, Section], fields: Mapping[str, np.ndarray]) -> Figure:
    """One random field on every grid, one panel each, on one colour scale.

    Args:
        name: of the soil's parameter.
        sections: by grid name.
        fields: grid name -> its values (N,), in SI units or degrees, of the same particles; nan is rock.
    """
    scale = quantity(name)
    shown = {grid: values / scale.size for grid, values in fields.items()}
    norm = Normalize(*ends(shown.values()))
    figure, axes = section_panels(next(iter(sections.values()))[0], len(sections))
    for ax, (grid, (position, half)) in zip(axes, sections.items(), strict=True):
        boxes = draw_particles(ax, position, half, shown[grid], "cividis", norm)
        ax.set_title(f"{grid} grid, {position.shape[1]:,} particles", loc="left")
    figure.colorbar(boxes, ax=axes, label=scale.label)
    return figure


def before_and_after(
    position: np.ndarray, displacement: np.ndarray, plastic_strain: np.ndarray, half_size: np.ndarray
) -> Figure:
    """Section before and after, coloured by the plastic strain at the end.

    Args:
        position: (2, N) m, rows x and z.
        displacement: (d, N) m, also across the section in 3D.
        plastic_strain: (N,).
        half_size: (2,) m.
    """
    figure, axes = section_panels(position, 2)
    norm = Normalize(0.0, max(float(np.quantile(plastic_strain, 0.99)), 1e-3))
    magnitude = float(np.linalg.norm(displacement, axis=0).max())
    for ax, step, title in (
        (axes[0], np.zeros_like(position), "before, in the colours of the end"),
        (axes[1], displacement[[0, -1]], f"after, largest displacement {magnitude:.3g} m"),
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
        displacement: (T, d, N) m at the T times (s), across the section too; colour shows how far a particle has moved.
        times: of the displacements (s).
    """
    position, half = section
    magnitude = np.linalg.norm(displacement, axis=1)
    figure, axes = section_panels(position, len(times) + 1)
    scale = quantity(name)
    shown = field / scale.size
    boxes = draw_particles(axes[0], position, half, shown, "cividis", Normalize(*ends([shown])))
    axes[0].set_title(f"{'strength' if name == 'strength' else scale.word} before", loc="left")
    figure.colorbar(boxes, ax=axes[0], label=f"{scale.symbol} [{scale.unit}]", aspect=8)
    norm = Normalize(0.0, max(float(magnitude.max()), 1e-6))
    for ax, time, step, far in zip(axes[1:], times, displacement, magnitude, strict=True):
        boxes = draw_particles(ax, position, half, far, "viridis", norm, displacement=step[[0, -1]])
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
    magnitude = np.linalg.norm(displacement, axis=1)
    norm = Normalize(0.0, max(float(magnitude.max()), 1e-6))
    length, width = np.ptp(position[0]), np.ptp(position[1])
    figure, axes = panels(1, len(times), size=(11.0 / len(times), 11.0 / len(times) * width / length + 1.0))
    for ax, time, step, far in zip(axes, times, displacement, magnitude, strict=True):
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
        path: of the file, with the suffix of PNG, PDF or SVG.
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


def section_panels(position: np.ndarray, rows: int) -> tuple[Figure, list[Axes]]:
    """Panels as high as a section drawn in true scale asks for."""
    length, height = np.ptp(position, axis=1)
    return panels(rows, size=(8.0, 6.8 * height / length + 0.8))


BESIDE = 3.2
"""Width (inch) of panels beside a section."""


def section_panels_beside(position: np.ndarray, rows: int, beside: int) -> tuple[Figure, list[Axes], list[Axes]]:
    """Panels of a section, and others one above the other to their right.

    Args:
        position: of the section (2, N) m.
        rows: panels of the section.
        beside: panels to their right, 0 for none.
    """
    if beside == 0:
        return *section_panels(position, rows), []
    length, height = np.ptp(position, axis=1)
    figure = Figure(figsize=(8.0 + BESIDE, rows * (6.8 * height / length + 0.8)), layout="constrained")
    both = figure.add_gridspec(1, 2, width_ratios=(8.0, BESIDE))
    # The layout keeps panels of one grid apart, and knows nothing of those of another.
    grids = both[0].subgridspec(rows, 1), both[1].subgridspec(beside, 1)
    columns = [[figure.add_subplot(grid[row, 0]) for row in range(grid.nrows)] for grid in grids]
    for ax in (*columns[0], *columns[1]):
        ax.spines[["top", "right"]].set_visible(False)
    return figure, columns[0], columns[1]


def ends(fields: Iterable[np.ndarray]) -> tuple[float, float]:
    """Smallest and largest value of any field."""
    values = np.concatenate([np.ravel(field) for field in fields])
    return float(np.nanmin(values)), float(np.nanmax(values))


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
    corners, shown = displaced_boxes(position, step, half), values
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


def displaced_boxes(position: np.ndarray, displacement: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Corners (N, 4, 2) of the boxes of particles that moved from a lattice.

    A corner goes with the mean displacement of the particles that met there, so that soil which stretches has no cracks
    in it; particles that have moved apart by more than `TORN` of their spacings do not hold each other's corners.

    Args:
        position: (2, N) m.
        displacement: (2, N) m.
        half: half the spacing (2,) m.
    """
    index = np.rint((position - position.min(axis=1, keepdims=True)) / (2 * half[:, None])).astype(int) + 1
    number = np.full(index.max(axis=1) + 2, -1)
    number[tuple(index)] = np.arange(position.shape[1])
    # Where several stand in one cell there is no lattice by which neighbours are known.
    lattice = bool((number[tuple(index)] == np.arange(position.shape[1])).all())
    corners = []
    for side in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
        total, count = displacement.astype(float), np.ones(position.shape[1])
        for step in ((side[0], 0), (0, side[1]), side) if lattice else ():
            other = number[tuple(index + np.array(step)[:, None])]
            apart = displacement[:, other] - displacement
            meets = (other >= 0) & (np.linalg.norm(apart, axis=0) < TORN * 2 * half.max())
            total, count = total + np.where(meets, displacement[:, other], 0.0), count + meets
        corners.append((position + np.array(side)[:, None] * half[:, None] + total / count).T)
    return np.stack(corners, axis=1)


def soil_between(position: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Triangles of neighbouring particles with soil between them.

    Those of the Delaunay triangulation whose circumcircle has a radius of at most `NEAR` spacings (the alpha shape of
    Edelsbrunner, Kirkpatrick and Seidel 1983, doi:10.1109/TIT.1983.1056714).

    Args:
        position: (2, N) m, where the particles are.
        half: half the spacing (2,) m.

    Returns:
        Triangles (m, 3); none where the particles lie on a line.
    """
    from scipy.spatial import Delaunay, QhullError  # loads what only soil that has slid needs

    try:
        triangles = Delaunay(position.T).simplices
    except QhullError:
        return np.zeros((0, 3), int)
    corners = position.T[triangles]
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    twice = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    # Radius: the product of the sides by four times the area.
    return triangles[sides.prod(axis=1) <= 2 * twice * NEAR * 2 * half.max()]


def _share_limits(axes: Sequence[Axes]) -> None:
    """Show the same piece of ground in every panel."""
    for limits, give in (("get_xlim", "set_xlim"), ("get_ylim", "set_ylim")):
        ends = np.array([getattr(ax, limits)() for ax in axes])
        for ax in axes:
            getattr(ax, give)(float(ends[:, 0].min()), float(ends[:, 1].max()))


def plane_at(grid: StoredGrid, centre: float) -> np.ndarray:
    """Particles (N,) of the section at y = centre (m): all of them in 2D."""
    if len(grid.position) == 2:
        return np.ones(grid.position.shape[1], bool)
    nearest = grid.position[1, np.argmin(np.abs(grid.position[1] - centre))]
    return np.abs(grid.position[1] - nearest) < grid.half_size[1]


def section_of(grid: StoredGrid, plane: np.ndarray) -> Section:
    """Positions (2, n) of a section's particles and half their spacing (2,) m."""
    return np.asarray(grid.position, float)[[0, -1]][:, plane], grid.half_size[[0, -1]]
