"""Runs whose derivatives are compared with differences: by what they vary, each number through a factor on it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

import jaxmpm as mpm
from jaxmpm.laws import DruckerPrager, ExponentialSoftening, declared, with_parameters
from jaxmpm.run import objectives

SLOPE = mpm.Slope(crest=10.0, height=6.0, run_per_rise=1.0, toe=14.0, foundation=2.0)
CLAY = mpm.Soil(young=1e7, strength=20e3, softening_modulus=60e3, tension_cutoff=None)
LEVEL = mpm.Section([(0, 3), (3, 3)])
FINE = mpm.Discretisation(1.0, (0.5, 0.5), dtype="float64")
SAND = mpm.FrictionalSoil(
    1e3, 25.0, dilation=5.0, young=5e6, softening_strain=0.1, residual_cohesion=400.0, residual_friction=20.0,
    tension_cutoff=100.0, unusual=True,
)  # fmt: skip
LAWS = {
    "J2": mpm.Soil(strength=4e3, softening_modulus=2e4, young=5e6, rate_coefficient=0.1, viscosity=50.0,
                   tension_cutoff=200.0, unusual=True),
    "MohrCoulomb": SAND,
    "DruckerPrager": replace(SAND, law=DruckerPrager),
    "AnisotropicUndrained": mpm.AnisotropicSoil(4e3, 3e3, 2e3, young=5e6),
    "ModifiedCamClay": mpm.CamClaySoil(0.1, 0.02, 1.0, ocr=1.5, largest_pressure=100e3),
    "MuI": mpm.GranularSoil(20.0, 30.0, 1e-2, young=1e6),
}  # fmt: skip
"""Soil of each law, with every number that it may have."""

Factors = Mapping[str, Any]


class Problem(NamedTuple):
    """A run, and its derivatives by reverse mode.

    Args:
        reached: factors by name -> objective at the end of the run.
        derivatives: by name, by the factor at 1.
    """

    reached: Callable[[Factors], Array]
    derivatives: dict[str, float]


def differentiated(reached: Callable[[Factors], Array], names: Collection[str]) -> Problem:
    """The problem of a run that takes factors by name."""
    gradient = jax.jit(jax.grad(reached))(dict.fromkeys(names, 1.0))
    return Problem(reached, {name: float(gradient[name]) for name in names})


def elastic(steps: int) -> Problem:
    """An elastic block in the plane that falls onto a roller and rings."""
    soil = mpm.Soil(unit_weight=9810.0, young=1e6, poisson=0.3)
    scene, state = mpm.block(
        (4.0, 3.0), soil, mpm.Discretisation(0.5, (0.25, 0.25)), domain=(6.0, 5.0), corner=(1.0, 0.0),
        gravity=(0.0, -9.81), walls="roller", speed=2.0,
    )  # fmt: skip
    return _of_parts(scene, state, steps, {"moduli": ("bulk", "shear")})


def softening(steps: int) -> Problem:
    """A slope that slides and softens."""
    scene, state = mpm.slope(SLOPE, CLAY, mpm.Discretisation(1.0, (0.5, 0.5)))
    parts = {"moduli": ("bulk", "shear"), "strength": ("strength",), "softening": ("softening_modulus",)}
    return _of_parts(mpm.reduced(scene, 1.3), state, steps, parts)


def _of_parts(scene: mpm.Scene, state: mpm.State, steps: int, parts: Mapping[str, tuple[str, ...]]) -> Problem:
    """By gravity, and by numbers of the law that share a factor."""
    numbers = {name: number.value for name, number in declared(scene.material).items()}

    def reached(factors: Factors) -> Array:
        values = {name: numbers[name] * factors[part] for part, names in parts.items() for name in names}
        loads = replace(scene.loads, gravity=scene.loads.gravity * factors["gravity"])
        varied = replace(scene, material=with_parameters(scene.material, values), loads=loads)
        return objectives.log_displacement(mpm.replay(varied, state, steps)[0])

    return differentiated(reached, [*parts, "gravity"])


def law(soil: Any, steps: int, *, exponential: bool = False) -> Problem:
    """By every number that a law declares, through `sensitivity`, of soil that is sheared and stretched and yields.

    Args:
        soil: of one law.
        steps: of the run.
        exponential: whether its strength decays exponentially, in place of linearly.
    """
    scene, state = mpm.section(LEVEL, soil, FINE)
    if exponential:
        decay = ExponentialSoftening(residual_ratio=jnp.asarray(0.4), strain_95=jnp.asarray(0.3))
        scene = replace(scene, material=replace(scene.material, softening=decay))
    z = scene.particles.position[1]
    state = replace(state, velocity=jnp.stack([0.6 * z, 0.1 * z**2 / 3]))
    numbers = declared(scene.material)

    def moved(state: mpm.State) -> Array:
        return jnp.log(jnp.mean(state.displacement**2))

    def reached(factors: Factors) -> Array:
        values = {name: number.value * factors[name] for name, number in numbers.items()}
        varied = replace(scene, material=with_parameters(scene.material, values))
        return moved(mpm.replay(varied, state, steps)[0])

    _, by_particle = mpm.sensitivity(scene, state, moved, steps=steps)
    return Problem(reached, {name: float(jnp.sum(by_particle[name] * numbers[name].value)) for name in numbers})


def contact(steps: int) -> Problem:
    """By the strength of the base under a column that falls and slides on it, and by how slip softens it."""
    interface = mpm.Interface(20.0, 50.0, residual_ratio=0.6, slip_length=0.2)
    shape = mpm.Section([(0, 4), (4, 4), (4, 0), (10, 0)], interface=interface)
    scene, state = mpm.section(shape, mpm.FrictionalSoil(100.0, 28.0, young=2e5), FINE)
    boundary = scene.boundary
    softening = jnp.asarray(boundary.softening)

    def reached(factors: Factors) -> Array:
        strength = {
            "wall_friction": boundary.friction * factors["wall_friction"],
            "wall_cohesion": boundary.cohesion * factors["wall_cohesion"],
        }
        varied, start = mpm.with_soil(scene, state, **strength)
        slip = softening * jnp.stack([factors["residual_ratio"], factors["slip_length"]])
        varied = replace(varied, boundary=replace(varied.boundary, softening=slip))
        return objectives.log_displacement(mpm.replay(varied, start, steps)[0])

    return differentiated(reached, ["wall_friction", "wall_cohesion", "residual_ratio", "slip_length"])


def set_up(steps: int) -> Problem:
    """By stiffness, weight, water and the heights of the surface, on which stress at rest and time step depend."""
    values = {"young": 1e7, "poisson": 0.3, "unit_weight": 20e3, "water_level": 5.3}
    shape = mpm.Section([(0, 8), (8, 8), (14, 2), (26, 2)])
    soil = mpm.FrictionalSoil(4e3, 25.0, young=values["young"], poisson=values["poisson"])
    scene, state = mpm.section(shape, soil, FINE, water=values["water_level"])
    heights = jnp.asarray([z for _, z in shape.surface], float)

    def reached(factors: Factors) -> Array:
        reshaped = mpm.ground.reshaped(scene, state, shape, heights * factors["heights"])
        varied = {name: value * factors[name] for name, value in values.items()}
        final, _ = mpm.replay(*mpm.with_soil(*reshaped, **varied), steps)
        return objectives.log_displacement(final)

    return differentiated(reached, [*values, "heights"])


BY_LAW: dict[str, Callable[[int], Problem]] = {
    **{name: partial(law, soil) for name, soil in LAWS.items()},
    "J2, exponential": partial(law, LAWS["J2"], exponential=True),
}
