"""Figures of a campaign. Each takes arrays or rows and gives a matplotlib Figure; none keeps any state.

Rows are dicts of equally long numpy arrays. Units stand on every axis. The colours are those of Okabe and Ito
(2008), distinct for all kinds of colour vision, and perceptually even maps (viridis, cividis); what colour tells,
shape or position tells too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

ROUGH, REFINED, FAILED, GREY = "#0072B2", "#D55E00", "#CC79A7", "#5A5A5A"
FIT_STYLES = (("#009E73", "-"), ("#E69F00", "--"), ("#56B4E9", "-."))

Section = tuple[np.ndarray, np.ndarray]


def strength_fields(sections: Mapping[str, Section], strength: Mapping[str, np.ndarray]) -> Figure:
    """One strength field on every grid, one panel each, on one colour scale.

    sections: grid name -> (positions (2, N) as x and z [m], half particle spacing (2,) [m]).
    strength: grid name -> undrained strength (N,) [Pa], of the same particles.
    """
    low = min(float(np.min(values)) for values in strength.values()) / 1e3
    high = max(float(np.max(values)) for values in strength.values()) / 1e3
    figure, axes = _section_panels(next(iter(sections.values()))[0], len(sections))
    norm = Normalize(low, high)
    for ax, (grid, (position, half)) in zip(axes, sections.items(), strict=True):
        boxes = _draw_particles(ax, position, half, strength[grid] / 1e3, "cividis", norm)
        ax.set_title(f"{grid} grid, {position.shape[1]:,} particles", loc="left")
    figure.colorbar(boxes, ax=axes, label="undrained strength $S_u$ [kPa]")
    return figure


def before_and_after(
    position: np.ndarray, displacement: np.ndarray, plastic_strain: np.ndarray, half_size: np.ndarray
) -> Figure:
    """Section before and after, coloured by the plastic strain at the end.

    position, displacement: (2, N) [m], rows x and z. plastic_strain: (N,). half_size: (2,) [m].
    """
    figure, axes = _section_panels(position, 2)
    norm = Normalize(0.0, max(float(np.quantile(plastic_strain, 0.99)), 1e-3))
    moved = float(np.linalg.norm(displacement, axis=0).max())
    for ax, where, title in (
        (axes[0], position, "before"),
        (axes[1], position + displacement, f"after, largest displacement {moved:.3g} m"),
    ):
        boxes = _draw_particles(ax, where, half_size, plastic_strain, "viridis", norm)
        ax.set_title(title, loc="left")
    axes[0].set_xlim(axes[1].get_xlim())
    figure.colorbar(boxes, ax=axes, label="accumulated plastic shear strain [-]", extend="max")
    return figure


def frames(
    times: Sequence[float],
    position: np.ndarray,
    displacement: np.ndarray,
    half_size: np.ndarray,
    *,
    columns: int = 2,
) -> Figure:
    """One slide at several times, coloured by how far it has moved.

    times: T moments [s]. position: (2, N) [m]. displacement: (T, 2, N) [m]. half_size: (2,) [m].
    """
    figure, axes = _section_panels(position, -(-len(times) // columns), columns)
    moved = np.linalg.norm(displacement, axis=1)
    norm = Normalize(0.0, max(float(moved.max()), 1e-6))
    for ax, time, step, far in zip(axes, times, displacement, moved, strict=False):
        boxes = _draw_particles(ax, position + step, half_size, far, "viridis", norm)
        ax.set_title(f"t = {time:.3g} s", loc="left")
    for ax in axes[len(times) :]:
        ax.set_axis_off()
    figure.colorbar(boxes, ax=axes, label="displacement [m]")
    return figure


def ranked_displacements(rows: Mapping[str, np.ndarray], *, threshold: float = 1.0) -> Figure:
    """Largest displacement of every sample, by rank on the rough grid, with its refined result.

    rows: rough (N,) [m] and refined (N,) [m], nan where a sample has no result on that grid; optionally
    audited (N,) bool, samples drawn by the audit. threshold: displacement that counts as failure [m].
    """
    figure, (ax,) = _panels(1, size=(7.0, 4.2))
    rough, refined = (np.asarray(rows[name], dtype=float) for name in ("rough", "refined"))
    order = np.argsort(-np.where(np.isfinite(rough), rough, np.inf), kind="stable")
    rank = np.arange(1, rough.size + 1)
    rough, refined = rough[order], refined[order]
    audited = np.asarray(rows.get("audited", np.zeros(rough.size, dtype=bool)))[order]
    ax.plot(rank, rough, ".", color=ROUGH, ms=4, label=f"rough grid ({np.isfinite(rough).sum()} samples)")
    for chosen, marker, name in ((~audited, "^", "refined grid"), (audited, "s", "refined grid, audit")):
        if np.isfinite(refined[chosen]).any():
            count = np.isfinite(refined[chosen]).sum()
            ax.plot(
                rank[chosen],
                refined[chosen],
                marker,
                color=REFINED if marker == "^" else FAILED,
                ms=5,
                mfc="none",
                label=f"{name} ({count} samples)",
            )
    lost = ~np.isfinite(rough)
    if lost.any():
        ax.plot(
            rank[lost],
            np.full(lost.sum(), np.nanmax(rough)),
            "x",
            color=GREY,
            label=f"rough lane failed ({lost.sum()})",
        )
    ax.axhline(threshold, color=GREY, lw=1, ls=":")
    ax.annotate(f"failure from {threshold:g} m", (rank[-1], threshold), ha="right", va="bottom", color=GREY, fontsize=9)
    ax.set(yscale="log", xlabel="rank on the rough grid [-]", ylabel="largest displacement $R_d$ [m]")
    ax.legend()
    return figure


def histograms(
    samples: Mapping[str, np.ndarray],
    labels: Mapping[str, str],
    densities: Mapping[str, Mapping[str, tuple[np.ndarray, np.ndarray]]] | None = None,
) -> Figure:
    """Histograms of consequences, one panel each, with the densities of fitted distributions.

    samples: name -> values (n,). labels: name -> axis label with its unit.
    densities: name -> fit name -> (values, density) of a curve to draw over the histogram.
    """
    columns = min(len(samples), 3)
    figure, axes = _panels(-(-len(samples) // columns), columns, size=(3.2, 2.7))
    for ax, (name, values) in zip(axes, samples.items(), strict=False):
        values = np.asarray(values, dtype=float)
        values = values[np.isfinite(values)]
        if values.size:
            ax.hist(values, bins="sqrt", density=True, color="#BBD5E8", edgecolor=ROUGH, lw=0.6)
        else:
            ax.annotate("no samples", (0.5, 0.5), xycoords="axes fraction", ha="center", color=GREY)
        for (fit, (at, density)), (colour, style) in zip(
            (densities or {}).get(name, {}).items(), FIT_STYLES, strict=False
        ):
            ax.plot(at, density, style, color=colour, lw=1.8, label=fit)
        if (densities or {}).get(name):
            ax.legend(fontsize=8)
        ax.set(xlabel=labels[name], ylabel="probability density")
        ax.set_title(f"{values.size} samples", loc="left", fontsize=9)
    for ax in axes[len(samples) :]:
        ax.set_axis_off()
    return figure


def convergence(
    spent: Mapping[str, np.ndarray],
    probability: Mapping[str, np.ndarray],
    interval: Mapping[str, np.ndarray],
    *,
    truth: float | None = None,
) -> Figure:
    """Probability of failure against refined runs spent, one band per estimator.

    spent: method -> refined runs (m,). probability: method -> P_f (m,). interval: method -> limits (2, m).
    truth: a known answer, drawn as a line.
    """
    figure, (ax,) = _panels(1, size=(7.0, 4.2))
    for (method, runs), (colour, style) in zip(
        spent.items(), ((ROUGH, "-"), (REFINED, "--"), ("#009E73", "-."), (FAILED, ":")), strict=False
    ):
        ax.fill_between(runs, *interval[method], color=colour, alpha=0.15, lw=0)
        ax.plot(runs, probability[method], style, color=colour, lw=2, label=f"{method}, 95 % interval")
    if truth is not None:
        ax.axhline(truth, color=GREY, lw=1, label=f"all samples refined: {truth:.3g}")
    ax.set(xlabel="refined runs spent [-]", ylabel="probability of failure $P_f$ [-]")
    ax.set_ylim(bottom=0)
    ax.legend()
    return figure


def save(figure: Figure, path: str | Path, *, dpi: int = 150) -> Path:
    """Write the figure (PNG, PDF or SVG by its suffix) and give the path back."""
    figure.savefig(path, dpi=dpi)
    return Path(path)


def _panels(rows: int, columns: int = 1, *, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """A figure of rows x columns panels of `size` [inch] each."""
    figure = Figure(figsize=(size[0] * columns, size[1] * rows), layout="constrained")
    FigureCanvasAgg(figure)
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    for ax in axes:
        ax.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _section_panels(position: np.ndarray, rows: int, columns: int = 1) -> tuple[Figure, list[Axes]]:
    """Panels as high as a section drawn in true scale asks for."""
    width = 8.0 if columns == 1 else 4.8
    length, height = np.ptp(position, axis=1)
    return _panels(rows, columns, size=(width, 0.85 * width * height / length + 0.8))


def _draw_particles(
    ax: Axes,
    position: np.ndarray,
    half: np.ndarray,
    values: np.ndarray,
    colours: str,
    norm: Normalize,
) -> PolyCollection:
    """Particles as boxes in true size, so that both grids fill the same area."""
    (x, z), (hx, hz) = position, half
    corners = np.stack(
        [
            np.stack([x - hx, x + hx, x + hx, x - hx], axis=-1),
            np.stack([z - hz, z - hz, z + hz, z + hz], axis=-1),
        ],
        axis=-1,
    )
    boxes = PolyCollection(
        list(corners), array=values, cmap=colours, norm=norm, lw=0, antialiased=False, rasterized=True
    )
    ax.add_collection(boxes)
    ax.autoscale_view()
    ax.set(aspect="equal", xlabel="x [m]", ylabel="z [m]")
    return boxes
