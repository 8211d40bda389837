"""A scene with other soil; its moduli, mass, time step and initial stress follow."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from jaxmpm.laws import declared, with_parameters
from jaxmpm.protocols import Material
from jaxmpm.setup._choices import WALL_STRENGTH, check_of_contact, check_weight_below_water
from jaxmpm.setup._initial_stress import at_rest, overburden
from jaxmpm.setup._law import check_scene, check_shape, wave_speed, with_water_sealed
from jaxmpm.setup._scene import with_stress
from jaxmpm.soil import STANDARD_GRAVITY, moduli
from jaxmpm.support import check
from jaxmpm.support.tracing import at_once, host, on_host
from jaxmpm.types import Scene, State

WATER_LEVEL = "water_level"
PORE_PRESSURE = "pore_pressure"
WALL = {**WALL_STRENGTH, "wall_pressure": "pressure"}
"""What walls and a base have at their nodes, by the part of the boundary."""
K0 = "k0"
ENGINEERING = ("young", "poisson", "unit_weight", K0, WATER_LEVEL, PORE_PRESSURE, *WALL)
STRESSING = {"young", "poisson", "bulk", "shear", "unit_weight", K0, WATER_LEVEL, PORE_PRESSURE}
"""Parameters on which the initial stress depends."""
STARTING = {*STRESSING, "b_value"}
"""Parameters on which time step or initial stress depend."""


def with_soil(scene: Scene, state: State, **values: ArrayLike) -> tuple[Scene, State]:
    """The scene with other parameters of its soil, and its initial state.

    If stiffness, weight, pore pressure or the water's level change, the initial stress is solved again (unless there is
    none), and the time step becomes shorter for faster waves; it never grows, because the scene does not know which
    speed it allows for. Columns of a free field retain the soil that they were built with.

    Args:
        scene: to vary.
        state: at which it starts; it must not have moved if stiffness or weight change.
        **values: numbers or one value per particle (N,), by name: any parameter of the scene's material, as
            `laws.declared` lists them, angles in radians; young (Pa), poisson, unit_weight (N/m3, of all soil, also
            below the water table), k0 (of soil that has one), water_level (m, of a level table; soil keeps its weight,
            give a unit_weight too where it is another below water), pore_pressure (Pa, of soil that has one), and of
            walls and a base that have them wall_friction (coefficient), wall_cohesion (Pa) and wall_pressure (Pa, of
            the water there), numbers or one value per node (nodes,).

    Returns:
        Scene and state.

    Raises:
        ValueError: If a name is unknown, a shape is different, a value is beyond its limit, or the state has moved.

    Example:
        >>> import jaxmpm as mpm
        >>> soil = mpm.Soil(young=5e6, strength=9e3)
        >>> scene, state = mpm.column(4.0, soil, mpm.Discretisation(cell=1.0, spacing=(0.5,)))
        >>> weaker, start = mpm.with_soil(scene, state, strength=4e3)
        >>> float(weaker.material.strength)
        4000.0
    """
    check_names(scene, values)
    check_start(state, values)
    varied, start = vary(scene, state, values)
    check_scene(varied)
    if {"unit_weight", WATER_LEVEL} & values.keys():
        check_weight_below_water(varied)
    return varied, start


def check_names(scene: Scene, names: Collection[str]) -> None:
    """Check names of parameters.

    Args:
        scene: with its soil.
        names: of parameters to vary.

    Raises:
        ValueError: If one is no parameter of the scene's soil, or young or poisson come with bulk or shear.
    """
    allowed = [*parameter_names(scene), *ENGINEERING]
    unknown = sorted(set(names) - set(allowed))
    if unknown:
        raise ValueError(f"{unknown} is no parameter of {type(scene.material).__name__}: use some of {allowed}")
    if WATER_LEVEL in names and scene.loads.water is None:
        raise ValueError("water_level is given, and the scene has no water: build it with a level")
    if PORE_PRESSURE in names and scene.loads.pore_pressure is None:
        raise ValueError("pore_pressure is given, and the scene has none: build it by jaxmpm.seepage.with_pressure")
    if K0 in names and scene.loads.k0 is None:
        raise ValueError("k0 is given, and the scene has none: build it of soil with a k0")
    for name, part in WALL.items():
        if name in names and getattr(scene.boundary, part) is None:
            raise ValueError(
                f"{name} is given, and no wall has {part}: build the scene with an interface that has some"
            )
    for one, other in (("young", "bulk"), ("young", "shear"), ("poisson", "bulk"), ("poisson", "shear")):
        if one in names and other in names:
            raise ValueError(f"both {one} and {other} are given: give young and poisson, or bulk and shear")


def check_start(state: State, names: Collection[str]) -> None:
    """Check that a state can start with other stiffness or weight.

    Args:
        state: at the start.
        names: of the parameters that vary.

    Raises:
        ValueError: If initial stress depends on one of them and the state has moved.
    """
    if check.is_traced(state):
        return
    if STRESSING & set(names) and (np.any(np.asarray(state.displacement)) or np.any(np.asarray(state.velocity))):
        raise ValueError(
            f"{sorted(STRESSING & set(names))} vary, so the initial stress is solved again, but `state` has moved: "
            "give one at rest"
        )


def parameter_names(scene: Scene) -> list[str]:
    """Names of the material's parameters, as `laws.declared` lists them.

    Args:
        scene: with its material.

    Returns:
        The names.
    """
    return list(declared(scene.material))


def numbers_of(scene: Scene) -> dict[str, Array]:
    """Numbers of a scene's soil, and strengths of walls and a base that have them.

    Args:
        scene: of any law.

    Returns:
        Value, by the name that `with_soil` takes: a number, one per particle (N,), or of walls one per node (nodes,).

    Example:
        >>> import jaxmpm as mpm
        >>> soil = mpm.Soil(young=5e6, strength=9e3)
        >>> scene, _ = mpm.column(10.0, soil, mpm.Discretisation(cell=1.0, spacing=(0.5,)))
        >>> float(mpm.numbers_of(scene)["strength"])
        9000.0
    """
    walls = {name: getattr(scene.boundary, part) for name, part in WALL_STRENGTH.items()}
    return {
        **{name: number.value for name, number in declared(scene.material).items()},
        **{name: value for name, value in walls.items() if value is not None},
    }


def vary(scene: Scene, state: State, values: Mapping[str, ArrayLike]) -> tuple[Scene, State]:
    """As `with_soil`, for known names; values beyond their limits pass, and their lane gets the status.

    Args:
        scene: to vary.
        state: at which it starts.
        values: by name.

    Returns:
        Scene and state.
    """
    for name, value in values.items():
        if name in WALL:
            check_of_contact(name, value, scene.grid)
        else:
            check_shape(name, value, scene.particles)
    arrays = {name: jnp.asarray(value, scene.particles.mass.dtype) for name, value in values.items()}
    varied = replace(scene, material=_material(scene.material, arrays))
    if "unit_weight" in arrays:
        mass = arrays["unit_weight"] / STANDARD_GRAVITY * scene.particles.volume
        varied = replace(varied, particles=replace(scene.particles, mass=mass))
        if scene.loads.pore_pressure is not None and PORE_PRESSURE not in arrays:
            pressure = scene.loads.pore_pressure * _heavier(scene, varied)
            varied = replace(varied, loads=replace(varied.loads, pore_pressure=pressure))
    if WATER_LEVEL in arrays:
        water = scene.loads.water
        assert water is not None
        assert hasattr(water, "at_level")
        varied = replace(varied, loads=replace(varied.loads, water=water.at_level(arrays[WATER_LEVEL])))
    if K0 in arrays:
        varied = replace(varied, loads=replace(varied.loads, k0=arrays[K0]))
    if PORE_PRESSURE in arrays:
        pressure = jnp.broadcast_to(arrays[PORE_PRESSURE], scene.particles.mass.shape)
        varied = replace(varied, loads=replace(varied.loads, pore_pressure=pressure))
    contact: dict[str, Any] = {part: arrays[name] for name, part in WALL.items() if name in arrays}
    varied = replace(varied, boundary=replace(scene.boundary, **contact))
    if not STARTING & arrays.keys():
        return varied, state
    varied = replace(varied, material=with_water_sealed(varied.material, varied.particles, varied.loads))
    numerics = scene.numerics
    good = at_once(check.admissible, on_host(varied))
    if not check.is_traced(good) and not good:
        # Its lane takes no step. The time step is a leaf that varies, so it is a new array in any case.
        return replace(varied, numerics=replace(numerics, time_step=numerics.time_step * 1)), state
    before, after = (wave_speed(s.particles, s.material) for s in (scene, varied))
    shorter = host(before, after).minimum(1.0, before / after)
    varied = replace(varied, numerics=replace(numerics, time_step=numerics.time_step * shorter))
    if not STRESSING & arrays.keys():
        return varied, state
    stressed = True if check.is_traced(state.stress) else bool(np.any(np.asarray(state.stress)))
    if not stressed:
        return varied, state
    rest = at_rest(varied)
    if check.is_traced(state.stress):
        rest = replace(rest, stress=jnp.where(jnp.any(state.stress != 0), rest.stress, state.stress))
    state = replace(state, status=jnp.maximum(state.status, rest.status)) if check.is_traced(rest.status) else state
    return varied, with_stress(varied, state, rest.stress)


def _heavier(scene: Scene, varied: Scene) -> Array:
    """Weight above each particle (N,) of a scene with r_u and other weights, over that before."""
    if scene.boundary.pressure is not None:
        raise ValueError(
            "unit_weight varies where r_u presses on an interface too, whose pressure stays: leave out one of them"
        )
    dry = replace(scene.loads, pore_pressure=None)
    before, after = (overburden(replace(weighed, loads=dry)) for weighed in (scene, varied))
    numbers = host(before, after)
    ratio = numbers.where(before == 0, 1.0, after / numbers.where(before == 0, 1.0, before))
    return jnp.asarray(ratio, scene.particles.mass.dtype)


def _material(material: Material, arrays: Mapping[str, Array]) -> Material:
    parameters = {name: value for name, value in arrays.items() if name not in ENGINEERING}
    if "young" in arrays or "poisson" in arrays:
        bulk, shear = material.bulk, material.shear
        young = arrays.get("young", 9 * bulk * shear / (3 * bulk + shear))
        poisson = arrays.get("poisson", (3 * bulk - 2 * shear) / (2 * (3 * bulk + shear)))
        parameters["bulk"], parameters["shear"] = moduli(young, poisson)
    return with_parameters(material, parameters)
