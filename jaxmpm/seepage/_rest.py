"""A scene whose soil rests under pore pressures: effective stress with suction, weight by water content, a pool."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from scipy.spatial import cKDTree

from jaxmpm.ground import WATER_WEIGHT, Contact
from jaxmpm.laws import Zoned, in_total_stress
from jaxmpm.seepage._soil import Retention
from jaxmpm.seepage._table import HeadsAt
from jaxmpm.setup import with_water_sealed
from jaxmpm.soil import STANDARD_GRAVITY
from jaxmpm.support import check
from jaxmpm.types import Scene


def suction_pressure(head: ArrayLike, retention: Retention | None, unit_weight: float = WATER_WEIGHT) -> np.ndarray:
    """Pressure that total stress has over effective stress: pore pressure, times the saturation above the water table.

    Args:
        head: pressure heads (N,) m.
        retention: with one value or (N,) of each number; None for soil whose suction is left out.
        unit_weight: of water (N/m3).

    Returns:
        (N,) Pa, below 0 under suction.
    """
    heads = np.asarray(head, float)
    saturation = heads > 0 if retention is None else np.asarray(retention.saturation(jnp.asarray(heads)), float)
    return unit_weight * heads * saturation


def with_pressure(
    scene: Scene,
    heads: HeadsAt,
    *,
    retention: Retention | None = None,
    suction: bool = True,
    level: float | None = None,
    dry_weight: ArrayLike | None = None,
    unit_weight: float = WATER_WEIGHT,
) -> Scene:
    """The scene with pore pressures that stay with the soil.

    Stress is then effective stress, with the suction stress of Lu and Likos (2004) where there is a retention. Soil
    that slides keeps its pressure unless it opens. Call `jaxmpm.at_rest` for the stress at rest under them.

    Args:
        scene: of soil with friction, built with its pool as water, and with none else.
        heads: pressure heads of a flow or a table at one time.
        retention: of the particles, with one value or (N,) of each number; None leaves suction out.
        suction: whether it holds grains together.
        level: of the pool of the scene as it was built (m), None for none.
        dry_weight: unit weight of the soil without its water (N,) N/m3, nan where the weight does not change with the
            water; None if it changes nowhere. It needs a retention.
        unit_weight: of water under the scene's gravity (N/m3).

    Returns:
        Scene.

    Raises:
        ValueError: If all soil is undrained, in total stress; the scene has another pore pressure or pool; or the heads
            are not finite.
    """
    if in_total_stress(scene.material):
        raise ValueError(
            f"pore pressure in {type(scene.material).__name__}, whose strength is undrained and does not depend on it: "
            "give soil with cohesion and friction"
        )
    if scene.loads.pore_pressure is not None or (scene.loads.water is None) != (level is None):
        raise ValueError(
            "the scene has an r_u, or water and level = None, or a level and no water: build it with its pool alone, "
            "water=level, or without water"
        )
    if dry_weight is not None and retention is None:
        raise ValueError("dry_weight without a retention, which says how much water soil holds: give both")
    particles = scene.particles
    position = np.asarray(particles.position, float)
    head = np.asarray(heads.at(position), float)
    check.finite("heads at the particles", head, "m")
    suction_retention = retention if suction else None
    pressure = suction_pressure(head, suction_retention, unit_weight) - _of_pool(position, level, unit_weight)
    if isinstance(scene.material, Zoned):
        undrained = np.repeat([in_total_stress(law) for law in scene.material.laws], scene.material.counts)
        pressure = np.where(undrained, 0.0, pressure)
    dtype = particles.mass.dtype
    loads = replace(scene.loads, pore_pressure=jnp.asarray(pressure, dtype))
    boundary = scene.boundary
    if boundary.friction is not None:
        contact = Contact.of(scene)
        nearest = cKDTree(position.T).query(contact.points.T)[1]
        there = np.asarray(heads.at(contact.points), float)
        borne = suction_pressure(there, _picked(suction_retention, nearest), unit_weight)
        on_base = np.where(pressure[nearest] == 0, 0.0, borne - _of_pool(contact.points, level, unit_weight))
        boundary = replace(boundary, pressure=contact.spread(on_base))
    if dry_weight is not None:
        assert retention is not None
        content = np.asarray(retention.water_content(jnp.asarray(head)), float)
        moist = np.asarray(dry_weight, float) + WATER_WEIGHT * content
        mass = jnp.asarray(moist / STANDARD_GRAVITY * np.asarray(particles.volume, float), dtype)
        particles = replace(particles, mass=jnp.where(np.isfinite(moist), mass, particles.mass))
    material = with_water_sealed(scene.material, particles, loads)
    return replace(scene, loads=loads, boundary=boundary, particles=particles, material=material)


def _of_pool(position: np.ndarray, level: float | None, unit_weight: float) -> np.ndarray:
    """Pressure of water at rest (N,) Pa that the scene's own pool exerts."""
    return np.zeros(position.shape[1]) if level is None else unit_weight * np.maximum(level - position[-1], 0)


def _picked(retention: Retention | None, which: np.ndarray) -> Retention | None:
    """The retention at some of its points."""
    return jax.tree.map(lambda value: value[which] if np.ndim(value) else value, retention)
