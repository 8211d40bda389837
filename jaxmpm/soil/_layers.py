"""Soils of layers: one law for all of their particles, and what these weigh."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm.soil._soil import AnySoil
from jaxmpm.types import Material


def weights(soils: Sequence[AnySoil], layer: np.ndarray, under: np.ndarray | None) -> np.ndarray:
    """Unit weights (N,) N/m3 of particles in layers of these soils, saturated where they lie under a water table."""
    weight = np.array([soil.unit_weight for soil in soils])[layer]
    if under is None:
        return weight
    saturated = [getattr(soil, "saturated_unit_weight", None) or soil.unit_weight for soil in soils]
    return np.where(under, np.array(saturated)[layer], weight)


def common_law(laws: Sequence[Material], layer: np.ndarray) -> Material:
    """The law of all layers, a parameter per particle where they differ."""
    kinds = [type(law).__name__ for law in laws]
    structures: list[Any] = [jax.tree.structure(law) for law in laws]
    for number, structure in enumerate(structures[1:], 2):
        if structure != structures[0]:
            raise ValueError(
                f"layers 1 ({kinds[0]}) and {number} ({kinds[number - 1]}) have soils of unlike laws, or only one of "
                "them softens, is cut off in tension or feels the rate of shear: give all layers one kind of soil with "
                "the same features, e.g. undrained clay as FrictionalSoil(cohesion=S_u, friction=0)"
            )

    def parameter(*values: Array) -> Array:
        if any(np.ndim(value) for value in values):
            if len(values) > 1:
                raise ValueError("a soil of a layer has a parameter per particle: give numbers, then `with_soil`")
            return values[0]
        different = any(value != values[0] for value in values[1:])
        return jnp.stack(values)[layer] if different else values[0]

    return jax.tree.map(parameter, *laws)
