"""Soils of layers: one law for all of their particles, and their unit weights."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import numpy as np
from jax import Array

from jaxmpm.laws import Zoned
from jaxmpm.protocols import Material
from jaxmpm.soil._limits import AnySoil
from jaxmpm.support import check
from jaxmpm.support.tracing import host, taken


def weights(soils: Sequence[AnySoil], layer: np.ndarray, under: np.ndarray | Array | None) -> np.ndarray | Array:
    """Unit weights of particles in layers, saturated ones under a water table.

    Args:
        soils: one per layer.
        layer: (N,) number of the layer of each particle.
        under: (N,) bool, which particles lie under a water table; None for none.

    Returns:
        (N,) N/m3.
    """
    dry = [soil.unit_weight for soil in soils]
    wet = [getattr(soil, "saturated_unit_weight", None) for soil in soils]
    saturated = [weight if own is None else own for weight, own in zip(dry, wet, strict=True)]
    numbers = host(dry, saturated, under)
    weight = numbers.asarray(dry)[layer]
    return weight if under is None else numbers.where(under, numbers.asarray(saturated)[layer], weight)


def law_of_layers(laws: Sequence[Material], layer: np.ndarray) -> tuple[Material, np.ndarray]:
    """The law of all layers, and the order of particles that it requires.

    Layers whose laws have one structure share a law, with a parameter per particle where they differ. The order puts
    the particles of one structure after those of another.

    Args:
        laws: one per layer.
        layer: (N,) number of the layer of each particle.

    Returns:
        The law, and the order (N,) of particles.

    Raises:
        ValueError: If there are several layers and one has a parameter per particle.
    """
    if len(laws) > 1 and any(np.ndim(leaf) for law in laws for leaf in jax.tree.leaves(law)):
        raise ValueError("a soil of a layer has a parameter per particle: give numbers, then `with_soil`")
    kinds: dict[object, list[int]] = {}
    for number in np.unique(layer).tolist():
        kinds.setdefault(jax.tree.structure(laws[number]), []).append(number)
    zones = [np.flatnonzero(np.isin(layer, numbers)) for numbers in kinds.values()]
    laws_of_zones = [
        _common_law(laws, numbers, layer[zone]) for numbers, zone in zip(kinds.values(), zones, strict=True)
    ]
    law = (
        laws_of_zones[0] if len(laws_of_zones) == 1 else Zoned(tuple(laws_of_zones), tuple(len(zone) for zone in zones))
    )
    return law, np.concatenate(zones)


def _common_law(laws: Sequence[Material], numbers: Sequence[int], layer: np.ndarray) -> Material:
    """The law of layers of one structure, of these numbers, for particles of `layer` (n,)."""
    column = np.searchsorted(numbers, layer)

    def parameter(*values: Array) -> Array:
        first, *others = values
        different = check.is_traced(values) or any(np.any(np.asarray(each) != np.asarray(first)) for each in others)
        return taken(host(values).stack(values), column) if different else values[0]

    return jax.tree.map(parameter, *(laws[number] for number in numbers))
