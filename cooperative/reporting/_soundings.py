"""The soundings of a site, with layers, trend and band; what a scene measured, and what it leaves open."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from cooperative.reporting._plots import quantity
from cooperative.runs import GridModel, soil_of
from cooperative.scene import Campaign
from kl.estimation import FieldFit
from kl.marginal import Lognormal

TINTS = colormaps["Pastel2"]


class LayerValues(Protocol):
    """A layer with its values and estimates."""

    @property
    def name(self) -> str:
        """Of the layer."""

    @property
    def top(self) -> float:
        """Elevation (m)."""

    @property
    def bottom(self) -> float:
        """Elevation (m)."""

    @property
    def parameter(self) -> str:
        """Of a scene's soil."""

    @property
    def points(self) -> np.ndarray:
        """(d, n) m."""

    @property
    def values(self) -> np.ndarray:
        """(n,) in SI units and degrees."""

    @property
    def fit(self) -> FieldFit:
        """Estimates."""


DRAWN = 64
"""Samples from which mean and deviation of a conditioned field are drawn."""


def measured_of(campaign: Campaign, name: str) -> np.ndarray | None:
    """Positions and values (n, d + 1) that condition the fields of a parameter, None where none do.

    Args:
        campaign: the campaign.
        name: of the parameter.
    """
    fields = [campaign.random.get(name), *(layer.random.get(name) for layer in campaign.site.layers)]
    rows = dict.fromkeys(row for field in fields if field is not None for row in field.boreholes or ())
    return np.array(list(rows), float) if rows else None


def conditioned(model: GridModel, name: str, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation (N,) of a parameter at the particles over samples, nan in rock.

    Args:
        model: the grid.
        name: of the parameter.
        coefficients: (samples, modes), of which the first are used.
    """
    each = np.array([soil_of(model, own).values[name] for own in coefficients[:DRAWN]])
    return each.mean(axis=0), each.std(axis=0, ddof=1)


def site_figure(layers: Sequence[LayerValues]) -> Figure:
    """A panel for each sounding: its values over elevation, layers, mean with its trend and the band of 90 %.

    Args:
        layers: from the top down.
    """
    parameters = list(dict.fromkeys(layer.parameter for layer in layers))
    positions = np.unique(np.concatenate([layer.points[:-1] for layer in layers], axis=1), axis=1)
    figure = Figure(figsize=(2 + 2.4 * positions.shape[1], 4.2 * len(parameters)), layout="constrained")
    axes = figure.subplots(len(parameters), positions.shape[1], sharey=True, sharex="row", squeeze=False)
    for row, parameter in zip(axes, parameters, strict=True):
        drawn = quantity(parameter)
        for ax, position in zip(row, positions.T, strict=True):
            for number, layer in enumerate(layers):
                ax.axhspan(layer.bottom, layer.top, color=TINTS(number % TINTS.N), lw=0, label=layer.name)
                if layer.parameter != parameter:
                    continue
                z = np.linspace(layer.top, layer.bottom, 50)
                draws, points = layer.fit.draws, layer.points
                mean = draws.mean[:, None] + draws.trend[:, None] * (layer.top - z)
                deviation = draws.cov / np.sqrt(1 - draws.nugget)
                scores = np.random.default_rng(0).standard_normal(deviation.size)
                if layer.fit.model.marginal is Lognormal:
                    logarithmic = np.sqrt(np.log1p(deviation**2))
                    factors = np.exp(logarithmic * scores - logarithmic**2 / 2)
                else:
                    factors = 1 + deviation * scores
                band = np.quantile(mean * factors[:, None], [0.05, 0.95], axis=0)
                ax.fill_betweenx(z, *band / drawn.size, color="0.6", alpha=0.5, lw=0)
                ax.plot(np.median(mean, axis=0) / drawn.size, z, "k-", lw=1)
                mine = (np.abs(points[:-1] - position[:, None]) < 1e-6).all(axis=0)
                ax.plot(layer.values[mine] / drawn.size, points[-1, mine], ".", color="C0", ms=3)
            ax.set_title(
                ", ".join(f"{axis} = {at:.6g} m" for axis, at in zip("xy", position, strict=False)), fontsize=8
            )
            ax.set_xlabel(drawn.label, fontsize=8)
        row[0].set_ylabel("z [m]")
    handles = [axes[0, 0].patches[k] for k in range(len(layers))]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(layers), fontsize=8, frameon=False)
    figure.suptitle("values (points), mean (line) and the range of 90 % of values with their uncertainty", fontsize=9)
    return figure
