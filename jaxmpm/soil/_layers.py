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
from jaxmpm.support.tracing import host, on_host, taken


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
    saturated = [above if below is None else below for above, below in zip(dry, wet, strict=True)]
    numbers = host(dry, saturated, under)
    weight = numbers.asarray(dry)[layer]
    return weight if under is None else numbers.where(under, numbers.asarray(saturated)[layer], weight)


def ratio_at_rest(soils: Sequence[AnySoil], layer: np.ndarray, law: Material) -> np.ndarray | Array | float | None:
    """Horizontal over vertical effective stress from which particles in layers come to rest.

    Args:
        soils: one per layer, of which some may have a `k0`.
        layer: (N,) number of the layer of each particle.
        law: of the particles.

    Returns:
        () or (N,), that of elastic loading in layers without one; None if no soil has one.
    """
    ratios = [getattr(soil, "k0", None) for soil in soils]
    if all(ratio is None for ratio in ratios):
        return None
    if len(ratios) == 1:
        return ratios[0]
    numbers = host(ratios, law.bulk)
    at_rest = numbers.asarray([np.nan if ratio is None else ratio for ratio in ratios])[layer]
    return numbers.where(numbers.isnan(at_rest), elastic_ratio(*on_host((law.bulk, law.shear))), at_rest)


def elastic_ratio(bulk: Array, shear: Array) -> Array:
    """Horizontal over vertical stress of level ground that gravity has loaded elastically, nu / (1 - nu).

    Args:
        bulk: modulus (Pa).
        shear: modulus (Pa).

    Returns:
        Ratio, of their shape.
    """
    return (bulk - 2 * shear / 3) / (bulk + 4 * shear / 3)


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
        different = check.is_traced(values) or any(np.any(np.asarray(value) != np.asarray(first)) for value in others)
        return taken(host(values).stack(values), column) if different else values[0]

    return jax.tree.map(parameter, *(laws[number] for number in numbers))
