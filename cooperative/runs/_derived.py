"""Parameters of soil of which a law has another: the strength ratio gives a strength, a saturated weight a weight."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm
from cooperative.scene import Site
from jaxmpm import Scene
from jaxmpm.soil import AnySoil

RATIO, SATURATED = "strength_ratio", "saturated_unit_weight"
IN_LAW = {RATIO: "strength", SATURATED: "unit_weight"}
"""Parameter of the law, or of the particles, to which each contributes."""
LEVEL, PRESSURE, ON_WALLS = "water_level", "pore_pressure", "wall_pressure"
"""What `jaxmpm.with_soil` calls the height of the water, its pressure in the soil and on rigid ground."""


def by_stress(
    site: Site, soil: AnySoil, layer: np.ndarray, stress: jax.Array, ratio: jax.Array | None,
    strength: jax.Array | None,
) -> jax.Array:  # fmt: skip
    """Strength by a ratio to the stress at rest, where it goes with that.

    Args:
        site: ground of the campaign.
        soil: of the campaign.
        layer: number of the layer that each particle is of (N,).
        stress: effective and vertical, at rest (N,) Pa.
        ratio: of strength to stress (N,), None takes the means.
        strength: where it does not go with the stress (N,) Pa, likewise.

    Returns:
        (N,) Pa.
    """
    ratios = site.by_stress(soil) or []
    strengths = np.array([getattr(layer.soil, "strength", None) or 1.0 for layer in site.soils(soil)])
    means, least = np.array([(0.0, 1.0) if ratio is None else ratio for ratio in ratios]).T
    grown = jnp.maximum((means[layer] if ratio is None else ratio) * stress, least[layer])
    other = strengths[layer] if strength is None else strength
    return jnp.where(np.array([ratio is not None for ratio in ratios])[layer], grown, other)


def wet_or_dry(
    scene: Scene,
    site: Site,
    soil: AnySoil,
    layer: np.ndarray,
    saturated: jax.Array | None,
    dry: jax.Array | None,
    level: float | None,
) -> jax.Array:
    """Unit weight of soil, saturated below the water table at the start.

    Args:
        scene: of the grid, at rest.
        site: ground of the campaign.
        soil: of the campaign.
        layer: number of the layer that each particle is of (N,).
        saturated: unit weight of saturated soil (N,) N/m3, None takes the means.
        dry: that of soil above the table (N,) N/m3, likewise.
        level: of the water in this sample (m), None for that of the scene.

    Returns:
        (N,) N/m3.
    """
    soils = [layer.soil for layer in site.soils(soil)]
    moist = np.array([part.unit_weight for part in soils])[layer]
    means = np.array([getattr(part, SATURATED, None) or np.nan for part in soils])[layer]
    if level is not None:
        water = scene.loads.water
        assert water is not None
        assert hasattr(water, "at_level")
        scene = replace(scene, loads=replace(scene.loads, water=water.at_level(level)))
    wet = jaxmpm.ground.wet(scene) & np.isfinite(means)
    return jnp.where(wet, means if saturated is None else saturated, moist if dry is None else dry)


def wetted(site: Site, soil: AnySoil) -> bool:
    """Whether weights follow a water level that is random.

    Args:
        site: ground of the campaign.
        soil: of the campaign.
    """
    return site.level is not None and any(
        getattr(layer.soil, SATURATED, None) is not None for layer in site.soils(soil)
    )
