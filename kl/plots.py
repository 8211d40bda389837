"""Figures of fields and expansions. Each function returns a matplotlib Figure and neither shows nor saves it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jax.typing import ArrayLike
from matplotlib.figure import Figure

from kl._checks import require
from kl.field import Expansion


def slices(
    field: ArrayLike, axes: Sequence[ArrayLike], *, label: str = "field", at: tuple[int, ...] | None = None
) -> Figure:
    """Three orthogonal slices of a sample on a lattice.

    Args:
        field: (N_x, N_y, N_z).
        axes: coordinates (N_x,), (N_y,), (N_z,) in metres.
        label: of the colour bar.
        at: three numbers of the lattice point through which the slices go, None for the middle.

    Returns:
        Figure.

    Raises:
        ValueError: If shapes do not fit, or the point lies outside the lattice.
    """
    values = np.asarray(field)
    require(values.ndim == 3, f"field of shape {values.shape}: give one realisation on a lattice of three axes")
    shapes = [np.shape(axis) for axis in axes]
    require(
        shapes == [(size,) for size in values.shape],
        f"axes of shapes {shapes} for a field of shape {values.shape}: give the coordinates of each",
    )
    x, y, z = (np.asarray(axis) for axis in axes)
    point = at or tuple(size // 2 for size in values.shape)
    inside = len(point) == 3 and all(0 <= n < size for n, size in zip(point, values.shape, strict=True))
    require(inside, f"at = {point} is no point of a lattice of shape {values.shape}: give three numbers from 0")
    i, j, k = point
    figure = Figure(figsize=(11, 3.2), layout="constrained", dpi=144)
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
    """Sample autocorrelation along each axis against its target, with the 95 % band of independent samples.

    An estimate r has a standard error of (1 - r^2)/sqrt(samples).

    Args:
        lags: per axis (N,), in metres.
        estimates: per axis (N,), sample correlations.
        targets: per axis (N,), target correlations.
        samples: number of independent samples behind an estimate.
        names: of the axes.

    Returns:
        Figure.

    Raises:
        ValueError: If the numbers of lags, estimates and targets differ, or there are no samples.
    """
    counts = [len(lags), len(estimates), len(targets)]
    require(counts == [counts[0]] * 3 and len(names) >= counts[0], f"{counts} lags, estimates and targets: one an axis")
    require(samples >= 1, f"samples = {samples}: give the number of realisations, 1 or more")
    figure = Figure(figsize=(4 * len(lags), 3.2), layout="constrained", dpi=144)
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
    """Fractions of the variance of each axis' modes, and the missing variance against the number of modes.

    Args:
        expansion: from `expand`.

    Returns:
        Figure.
    """
    figure = Figure(figsize=(8, 3.2), layout="constrained", dpi=144)
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
