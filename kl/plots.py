"""Figures of fields and expansions. Each function returns a matplotlib Figure; nothing is shown or saved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jax.typing import ArrayLike
from matplotlib.figure import Figure

from foundation.check import require
from kl.field import Expansion


def slices(
    field: ArrayLike, axes: Sequence[ArrayLike], *, label: str = "field", at: tuple[int, ...] | None = None
) -> Figure:
    """Three orthogonal slices of a realisation (N_x, N_y, N_z) through the lattice point `at` (the middle).

    Raises ValueError for another number of axes, coordinates of another number, or a point outside the lattice.
    """
    values = np.asarray(field)
    require(values.ndim == 3, f"field of shape {values.shape}: give one realisation on a lattice of three axes")
    shapes = [np.shape(axis) for axis in axes]
    require(
        shapes == [(size,) for size in values.shape],
        f"axes of shapes {shapes} for a field of shape {values.shape}: give the coordinates of each",
    )
    x, y, z = (np.asarray(axis) for axis in axes)
    place = at or tuple(size // 2 for size in values.shape)
    inside = len(place) == 3 and all(0 <= n < size for n, size in zip(place, values.shape, strict=True))
    require(inside, f"at = {place} is no point of a lattice of shape {values.shape}: give three numbers from 0")
    i, j, k = place
    figure = Figure(figsize=(11, 3.2), layout="constrained")
    panels = figure.subplots(1, 3)
    sections = (
        (x, z, values[:, j, :], "x (m)", "z (m)", f"y = {y[j]:g} m"),
        (y, z, values[i], "y (m)", "z (m)", f"x = {x[i]:g} m"),
        (x, y, values[:, :, k], "x (m)", "y (m)", f"z = {z[k]:g} m"),
    )
    for panel, (across, up, section, across_label, up_label, title) in zip(panels, sections, strict=True):
        image = panel.pcolormesh(across, up, section.T, vmin=values.min(), vmax=values.max(), shading="nearest")
        panel.set(xlabel=across_label, ylabel=up_label, title=title)
    figure.colorbar(image, ax=panels, label=label)
    return figure


def correlation(
    lags: Sequence[ArrayLike],
    estimates: Sequence[ArrayLike],
    targets: Sequence[ArrayLike],
    *,
    samples: int,
    names: tuple[str, ...] = ("x", "y", "z"),
) -> Figure:
    """Sample autocorrelation along each axis against its target, with the 95 % band of `samples` realisations.

    Args:
        lags, estimates, targets: per axis (N,): lag in metres, sample and target correlation.
        samples: number of independent realisations behind an estimate r, of standard error (1 - r^2)/sqrt(samples).

    Raises ValueError for another number of lags, estimates, targets or names, or no samples.
    """
    counts = [len(lags), len(estimates), len(targets)]
    require(counts == [counts[0]] * 3 and len(names) >= counts[0], f"{counts} lags, estimates and targets: one an axis")
    require(samples >= 1, f"samples = {samples}: give the number of realisations, 1 or more")
    figure = Figure(figsize=(4 * len(lags), 3.2), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(lags), sharey=True))
    for panel, lag, estimate, target, name in zip(panels, lags, estimates, targets, names, strict=False):
        lag, target = np.asarray(lag), np.asarray(target)
        band = 1.96 * (1 - target**2) / np.sqrt(samples)
        panel.fill_between(lag, target - band, target + band, alpha=0.3, label="95 % of samples")
        panel.plot(lag, target, "k-", label="target")
        panel.plot(lag, estimate, ".", ms=4, label=f"{samples} realisations")
        panel.set(xlabel=f"lag along {name} (m)")
    panels[0].set_ylabel("correlation")
    panels[0].legend()
    return figure


def spectrum(expansion: Expansion) -> Figure:
    """Fractions of the variance of each axis' modes, and the variance lacking against the number of modes kept."""
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    for number, modes in enumerate(expansion.axes):
        fractions = np.asarray(modes.fractions)
        left.semilogy(np.arange(1, len(fractions) + 1), fractions, "o-", ms=3, label=f"axis {number}")
    left.set(xlabel="mode of the axis", ylabel="fraction of the variance")
    left.legend()
    lacking = 1 - np.cumsum(np.asarray(expansion.fractions, np.float64))
    right.loglog(np.arange(1, len(lacking) + 1), np.maximum(lacking, 1e-7))
    right.set(xlabel="modes of the field", ylabel="variance lacking")
    return figure


def two_grids(fields: Sequence[ArrayLike], points: Sequence[ArrayLike], *, label: str = "field") -> Figure:
    """One sample on two grids, in section.

    Args:
        fields: (N,) on each grid.
        points: (2, N), (x, z) in metres, on each.

    Raises ValueError for another number of fields or points.
    """
    require(len(fields) == len(points) == 2, f"{len(fields)} fields at {len(points)} sets of points: give two of each")
    for field, place in zip(fields, points, strict=True):
        require(
            np.shape(place) == (2, *np.shape(field)),
            f"points of shape {np.shape(place)} for a field of shape {np.shape(field)}: give (2, N) and (N,)",
        )
    figure = Figure(figsize=(9, 3.2), layout="constrained")
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    low = min(float(np.min(field)) for field in fields)
    high = max(float(np.max(field)) for field in fields)
    for panel, field, place in zip(panels, fields, points, strict=True):
        x, z = np.asarray(place)
        size = max(0.5, 4e4 / len(x) ** 1.1)
        image = panel.scatter(x, z, c=np.asarray(field), s=min(size, 40), marker="s", vmin=low, vmax=high)
        panel.set(xlabel="x (m)", title=f"{len(x):,} points", aspect="equal")
    panels[0].set_ylabel("z (m)")
    figure.colorbar(image, ax=panels, label=label)
    return figure
