"""What a scene measured: the values that condition its fields, and what they leave open."""

from __future__ import annotations

import numpy as np

from cooperative.runs import GridModel, rock_of
from cooperative.scene import Campaign

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


def conditioned(
    model: GridModel, name: str, coefficients: np.ndarray, particles: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation (n,) of a parameter at some particles over samples, nan in rock.

    Args:
        model: the grid.
        name: of the parameter.
        coefficients: (samples, modes), of which the first are used.
        particles: (n,) numbers of the particles, ascending.
    """
    samples = model.of(particles).parameters_of_samples(coefficients[:DRAWN], [name])[name]
    bare = np.where(rock_of(model)[particles], np.nan, 1.0)
    return bare * samples.mean(axis=0), bare * samples.std(axis=0, ddof=1)
