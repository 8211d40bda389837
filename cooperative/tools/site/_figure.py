"""The soundings of a site, with layers, trend and band."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from cooperative.reporting import quantity
from cooperative.tools.site._estimate import SiteLayerFit
from jaxmpm.support.text import literal
from kl.marginal import Lognormal

TINTS = colormaps["Pastel2"]


def site_figure(layers: Sequence[SiteLayerFit]) -> Figure:
    """A panel for each sounding: its values over elevation, layers, mean with its trend and the band of 90 %.

    Args:
        layers: from the top down.
    """
    parameters = list(dict.fromkeys(layer.parameter for layer in layers))
    positions = np.unique(np.concatenate([layer.points[:-1] for layer in layers], axis=1), axis=1)
    figure = Figure(figsize=(2 + 2.4 * positions.shape[1], 4.2 * len(parameters)), layout="constrained")
    axes = figure.subplots(len(parameters), positions.shape[1], sharey=True, sharex="row", squeeze=False)
    for row, parameter in zip(axes, parameters, strict=True):
        scale = quantity(parameter)
        for ax, position in zip(row, positions.T, strict=True):
            for number, layer in enumerate(layers):
                ax.axhspan(layer.bottom, layer.top, color=TINTS(number % TINTS.N), lw=0, label=literal(layer.name))
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
                ax.fill_betweenx(z, *band / scale.size, color="0.6", alpha=0.5, lw=0)
                ax.plot(np.median(mean, axis=0) / scale.size, z, "k-", lw=1)
                here = (np.abs(points[:-1] - position[:, None]) < 1e-6).all(axis=0)
                ax.plot(layer.values[here] / scale.size, points[-1, here], ".", color="C0", ms=3)
            ax.set_title(
                ", ".join(f"{axis} = {at:.6g} m" for axis, at in zip("xy", position, strict=False)), fontsize=8
            )
            ax.set_xlabel(scale.label, fontsize=8)
        row[0].set_ylabel("z [m]")
    handles = [axes[0, 0].patches[k] for k in range(len(layers))]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(layers), fontsize=8, frameon=False)
    figure.suptitle("values (points), mean (line) and the range of 90 % of values with their uncertainty", fontsize=9)
    return figure
