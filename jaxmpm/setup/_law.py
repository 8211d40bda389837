"""Checks of a law and of its numbers on the particles of a scene."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from jaxmpm.grid import Particles
from jaxmpm.laws import (
    DRAINED,
    Saturated,
    Zoned,
    declared,
    excesses,
    flooded,
    hardens,
    in_total_stress,
    laws_of,
    snaps_back,
)
from jaxmpm.protocols import Material, PrescribedWater
from jaxmpm.support import check
from jaxmpm.support.tracing import array, at_once, host, on_host, taken
from jaxmpm.types import Loads, Scene

Found = TypeVar("Found")

MEMBERS = [name for name in vars(Material) if not name.startswith("_")]
"""Members of the protocol `Material`."""


def check_scene(scene: Scene, axes: Scene | None = None) -> None:
    """Check the numbers of a scene. Traced values are skipped.

    Args:
        scene: to check.
        axes: leaves that have lanes first, None without lanes.

    Raises:
        ValueError: If a number is beyond its limit, softening snaps back, a residual exceeds its peak, or dilation
            exceeds friction.
    """
    check.within_limits(scene)
    laws = laws_of(scene.material)
    for law, law_axes in zip(laws, (None,) * len(laws) if axes is None else laws_of(axes.material), strict=True):
        if not check.is_traced(law):
            at_once(_check_together, on_host(law), law_axes if jax.tree.leaves(law_axes) else None)


def _check_together(law: Material, axes: Material | None) -> None:
    """Raise ValueError for numbers of a law, each within its limit, that do not go together."""

    def found(by: Callable[[Material], Found]) -> Found:
        return by(law) if axes is None else jax.vmap(by, in_axes=(axes,))(law)

    back, harder = found(snaps_back), found(hardens)
    if back is not None and np.any(back):
        steepest = float(np.max(np.asarray(law.steepest_softening)))
        raise ValueError(
            f"softening of {steepest:g} Pa per unit of shear strain is steeper than elastic unloading (shear modulus "
            f"{float(np.min(np.asarray(law.shear))):g} Pa), which snaps back: soften more slowly, raise the "
            "stiffness, or, where softening is scaled by the cell, take smaller cells"
        )
    if harder is not None and np.any(harder):
        raise ValueError(
            "softening leaves more cohesion or friction than the peak has: give residuals of at most the peak at each "
            "particle"
        )
    for name, excess in found(excesses).items():
        worst, parameter = float(np.max(np.asarray(excess))), declared(law)[name].parameter
        if worst > 0:
            above = f"{math.degrees(worst):.3g} degrees" if parameter.angle else f"{worst:.3g} {parameter.unit}"
            raise ValueError(
                f"{name} is up to {above.rstrip()} above the {parameter.at_most}: give at most the {parameter.at_most}"
            )


def wave_speed(particles: Particles, material: Material) -> float | Array:
    """Speed of the fastest elastic wave at any particle (m/s), traced where mass, volume or stiffness are.

    Args:
        particles: of a scene.
        material: their law.
    """
    modulus = at_once(lambda law: law.p_wave_modulus, on_host(material))
    if check.is_traced(modulus, particles.mass, particles.volume):
        return jnp.sqrt(jnp.max(modulus * particles.volume / particles.mass))
    density = np.asarray(particles.mass, float) / np.asarray(particles.volume, float)
    return math.sqrt(float(np.max(np.asarray(modulus, float) / density)))


def force_of_water(scene: Scene) -> np.ndarray | Array:
    """Force of a scene's water on the particles along each axis, over their volume (d, N) N/m3.

    Args:
        scene: with water.

    Returns:
        Of NumPy, traced where the water or the particles are.
    """
    return on_host(at_once(_push, scene.loads.water, scene.particles.position))


def with_water_sealed(material: Material, particles: Particles, loads: Loads) -> Material:
    """The law whose soil with a B-value knows the pore pressure at rest of the loads; all is saturated without any.

    Args:
        material: of the particles.
        particles: at rest.
        loads: with their water.

    Returns:
        The law.
    """
    carried, water, mass = loads.pore_pressure, loads.water, particles.mass
    sealed = any(isinstance(law, Saturated) for law in laws_of(material))
    if not sealed or (carried is None and water is None):
        return material
    push = None if water is None else on_host(at_once(_push, water, particles.position))[-1]
    pressure, numbers = on_host(carried), host(carried, push)
    wet = numbers.zeros(mass.shape, bool) if pressure is None else pressure > 0
    wet = wet if push is None else wet | (push > 0)
    pressure = numbers.where(wet, 0.0 if pressure is None else numbers.maximum(pressure, 0), DRAINED)
    return flooded(material, array(pressure, mass.dtype))


@jax.jit
def _push(water: PrescribedWater, position: Array) -> Array:
    return water.push(position)


def check_shape(name: str, value: ArrayLike, particles: Particles) -> None:
    """Check that a parameter is a number or one value per particle.

    Args:
        name: of the parameter, for the message.
        value: () or (N,).
        particles: N of them.

    Raises:
        ValueError: If it has another shape.
    """
    if np.shape(value) not in ((), particles.mass.shape):
        raise ValueError(
            f"{name} has shape {np.shape(value)}: give a number or {particles.mass.shape}, one value per particle"
        )


def checked_material(material: Material, particles: Particles, dtype: np.dtype) -> Material:
    """The material with its numbers in the particles' precision."""
    missing = [name for name in MEMBERS if not hasattr(type(material), name) and not hasattr(material, name)]
    if missing:
        raise ValueError(
            f"{type(material).__name__} lacks {', '.join(missing)}: derive it from jaxmpm.laws.Law, which leaves you "
            "`update` to write"
        )
    if isinstance(material, Zoned):
        return _checked_zones(material, particles, dtype)
    for name, limit, value in check.parameters(material):
        check.within(name, value, limit)
        check_shape(name, value, particles)
    return jax.tree.map(number_of(dtype), material)


def _checked_zones(material: Zoned, particles: Particles, dtype: np.dtype) -> Zoned:
    """As `checked_material`, for each law with the particles of its zone."""
    count = particles.mass.size
    if len(material.counts) != len(material.laws) or min(material.counts) < 1 or sum(material.counts) != count:
        raise ValueError(
            f"counts = {material.counts} for {len(material.laws)} laws and {count} particles: give the number of each "
            "law's particles, 1 or more, together all of them"
        )
    zones = ((law, taken(particles, zone)) for law, zone in material.zones)
    return replace(material, laws=tuple(checked_material(law, zone_particles, dtype) for law, zone_particles in zones))


def in_total_stress_at(material: Zoned) -> np.ndarray:
    """Particles (N,) bool in zones whose strength is undrained."""
    return np.repeat([in_total_stress(law) for law in material.laws], material.counts)


def number_of(dtype: np.dtype) -> Callable[[ArrayLike], Array]:
    """A function that makes an array of this precision of a number or an array."""
    return lambda value: array(value, dtype)
