"""The flow of water of samples whose conductivity varies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from cooperative.runs._random_soil import RandomSoil
from cooperative.runs._values import growth_at, values_at
from cooperative.scene import CONDUCTIVITY, Campaign, rested

if TYPE_CHECKING:
    from jaxmpm.seepage import PressureInTime

LANES = 64
"""Flows that are solved side by side."""


def conductivity_of(campaign: Campaign, soil: RandomSoil, sample: np.ndarray | jax.Array | None = None) -> np.ndarray:
    """The upright conductivity of saturated soil in the cells of the flow (m/s), of their shape; 0 in rock.

    Args:
        campaign: whose conductivity varies.
        soil: what is random in it.
        sample: coefficients (modes,) of a sample, None for median soil.
    """
    flowing, site, grid = campaign.flowing, campaign.site, campaign.grids["refined"]
    layers = flowing.conductivities
    points = jnp.asarray(flowing.cells.centres().reshape(campaign.dimension, -1), jnp.float32)
    values = values_at(
        soil, CONDUCTIVITY, layers, points, growth_at(site, layers, points, grid),
        flowing.layer.ravel() if site.layers else None, np.zeros(soil.modes) if sample is None else sample,
    )  # fmt: skip
    return np.asarray(values, float).reshape(flowing.cells.shape)


def own_flows(
    campaign: Campaign, soil: RandomSoil, samples: Sequence[np.ndarray | jax.Array | None] | np.ndarray
) -> Iterator[PressureInTime]:
    """The flow of each of some samples: in turn on a CPU, where that is faster, elsewhere LANES of them side by side.

    Args:
        campaign: whose conductivity varies.
        soil: what is random in it.
        samples: coefficients (modes,) of each, None for median soil.

    Raises:
        ValueError: a flow does not converge, or the ground is full before time 0.
    """
    width = 1 if jax.default_backend() == "cpu" else LANES
    for first in range(0, len(samples), width):
        some = samples[first : first + width]
        yield from campaign.flowing.solved([conductivity_of(campaign, soil, sample) for sample in some])


def under_own_flow(campaign: Campaign, soil: RandomSoil, sample: np.ndarray | jax.Array | None = None) -> Campaign:
    """The campaign whose ground rests under the pressure of a sample's own flow; itself where all have the same.

    Args:
        campaign: the campaign.
        soil: what is random in it.
        sample: coefficients (modes,) of the sample, None for median soil.

    Raises:
        ValueError: its flow does not converge.
    """
    if not campaign.conductivities:
        return campaign
    resting = campaign.site.pressure
    assert campaign.seepage is not None
    time = campaign.seepage.moment if resting is None else resting.time
    (flow,) = own_flows(campaign, soil, [sample])
    return rested(campaign, time, flow)
