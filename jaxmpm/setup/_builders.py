"""Builders on the host: from sizes in metres to a Scene and its initial State."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import jax.numpy as jnp
import numpy as np

from jaxmpm.grid import Grid, Wall
from jaxmpm.setup._build import PADDING, build, end_walls, material_on
from jaxmpm.setup._discretisation import Discretisation, cells_up, check_discretisation
from jaxmpm.setup._fill import box_particles
from jaxmpm.setup._initial_stress import settled
from jaxmpm.soil import AnySoil
from jaxmpm.support import check
from jaxmpm.support.tracing import array, require_known
from jaxmpm.types import Boundary, Loads, Scene, State

REMEDY = (
    "differentiate by gravity with `replace(scene, loads=...)`, by velocity with `replace(state, velocity=...)`, by "
    "soil and walls with `with_soil`"
)


def column(
    height: float,
    soil: AnySoil,
    discretisation: Discretisation,
    *,
    gravity: float = 9.81,
    at_rest: bool = True,
) -> tuple[Scene, State]:
    """Build a column on a fixed base, in 1D, or in 2D and 3D one cell wide between rollers.

    Args:
        height: along the last axis (m).
        soil: of the column.
        discretisation: cell, spacing (whose length is the dimension) and numerical choices.
        gravity: downwards (m/s2).
        at_rest: with the stress of elastic gravity loading, else free of stress, so that gravity acts suddenly.

    Returns:
        Scene and state.

    Raises:
        ValueError: If sizes and numbers do not fit each other.
    """
    d, cell = len(discretisation.spacing), discretisation.cell
    check_discretisation(discretisation, d)
    require_known({"height": height, "gravity": gravity}, REMEDY)
    check.positive("height", height, "m")
    check.not_negative("gravity", gravity, "m/s2")
    check.multiple("height", height, "the spacing along the height", discretisation.spacing[-1])
    walls = [wall for a in range(d - 1) for wall in end_walls(a, 1, "roller")]
    walls.append(Wall(d - 1, "low", PADDING, "fixed"))
    cells = [1] * (d - 1) + [cells_up(discretisation, height)]
    built, state = build(
        box_particles([cell] * (d - 1) + [height], soil, discretisation),
        Grid(tuple(n + 1 + 2 * PADDING for n in cells), cell, (-PADDING * cell,) * d),
        material_on(discretisation, soil),
        discretisation,
        boundary=Boundary(tuple(walls)),
        loads=Loads(gravity, k0=getattr(soil, "k0", None)),
        speed=math.sqrt(gravity * height),
    )
    return built, settled(built, state) if at_rest else state


def bar(
    length: float, soil: AnySoil, discretisation: Discretisation, *, velocity: float, mode: int = 1
) -> tuple[Scene, State]:
    """Build a 1D bar fixed at x = 0, free at x = length, without gravity, vibrating in one of its modes.

    It starts with v = velocity sin(b x), b = (2 mode - 1) pi / (2 length). In 1D the strain is uniaxial: for a bar of
    Young's modulus E give a Poisson's ratio of 0.

    Args:
        length: m.
        soil: of the bar.
        discretisation: cell, spacing and numerical choices.
        velocity: amplitude, at the tip (m/s).
        mode: number from 1.

    Returns:
        Scene and state.

    Raises:
        ValueError: If sizes and numbers do not fit each other.
    """
    check_discretisation(discretisation, 1)
    require_known({"length": length, "velocity": velocity}, REMEDY)
    check.positive("length", length, "m")
    check.multiple("length", length, "the spacing", discretisation.spacing[0])
    check.finite("velocity", velocity, "m/s")
    check.whole("mode", mode)
    cell = discretisation.cell
    cells = cells_up(discretisation, length)
    built, state = build(
        box_particles([length], soil, discretisation),
        Grid((cells + 1 + 2 * PADDING,), cell, (-PADDING * cell,)),
        material_on(discretisation, soil),
        discretisation,
        boundary=Boundary((Wall(0, "low", PADDING, "fixed"),)),
        loads=Loads(),
        speed=abs(velocity),
    )
    wave = (2 * mode - 1) * math.pi / (2 * length)
    return built, replace(state, velocity=velocity * jnp.sin(wave * built.particles.position))


def block(
    size: Sequence[float],
    soil: AnySoil,
    discretisation: Discretisation,
    *,
    domain: Sequence[float],
    corner: Sequence[float],
    velocity: Sequence[float] | None = None,
    gravity: Sequence[float] | None = None,
    walls: Literal["none", "fixed", "roller", "friction"] = "none",
    friction: float = 0.0,
    cohesion: float = 0.0,
    speed: float | None = None,
) -> tuple[Scene, State]:
    """Build a box of soil in a box-shaped domain, free of stress and moving.

    Args:
        size: edges of the block (m).
        soil: of the block.
        discretisation: cell, spacing and numerical choices.
        domain: edges of the domain (m).
        corner: lowest corner of the block in the domain (m).
        velocity: initial one (m/s), by default 0.
        gravity: vector (m/s2), by default 0.
        walls: constraint at all faces of the domain; with "none" a lane that leaves it fails with OUTSIDE_GRID.
        friction: coefficient of walls with "friction", the tangent of the wall's friction angle.
        cohesion: of such walls, along them (Pa); they do not resist separation.
        speed: largest particle speed that the time step allows for (m/s), by default the initial one.

    Returns:
        Scene and state.

    Raises:
        ValueError: If sizes and numbers do not fit each other.
    """
    d, cell = len(size), discretisation.cell
    check_discretisation(discretisation, d)
    zero = (0.0,) * d
    velocity, gravity = (zero if vector is None else vector for vector in (velocity, gravity))
    shaping = {"domain": domain, "corner": corner, "velocity": velocity, "gravity": gravity}
    require_known({"size": size, "friction": friction, "cohesion": cohesion, "speed": speed, **shaping}, REMEDY)
    for name, values in shaping.items():
        check.axes(name, values, d)
    check.positive("size", size, "m")
    check.not_negative("corner", corner, "m")
    for a in range(d):
        check.multiple(f"size[{a}]", size[a], f"spacing[{a}]", discretisation.spacing[a])
        if corner[a] + size[a] > domain[a] * (1 + 1e-12):
            raise ValueError(
                f"the block ends at {corner[a] + size[a]:g} m along axis {a}, beyond the domain of {domain[a]:g} m: "
                "enlarge the domain"
            )
    if walls not in ("none", "fixed", "roller", "friction"):
        raise ValueError(f"walls = {walls!r}: give 'none', 'fixed', 'roller' or 'friction'")
    for name, value in (("friction", friction), ("cohesion", cohesion)):
        check.not_negative(name, value)
        if value and walls != "friction":
            raise ValueError(f"{name} = {value:g} with walls = {walls!r}: give walls = 'friction'")
    cells = [check.multiple(f"domain[{a}]", domain[a], "cell", cell) for a in range(d)]
    faces = () if walls == "none" else tuple(wall for a in range(d) for wall in end_walls(a, cells[a], walls))
    built, state = build(
        box_particles(size, soil, discretisation, corner=corner),
        Grid(tuple(n + 1 + 2 * PADDING for n in cells), cell, (-PADDING * cell,) * d),
        material_on(discretisation, soil),
        discretisation,
        boundary=Boundary(faces, friction if walls == "friction" else None, cohesion or None),
        loads=Loads(gravity),
        speed=float(np.linalg.norm(velocity)) if speed is None else speed,
    )
    start = np.broadcast_to(np.asarray(velocity, float)[:, None], state.velocity.shape)
    return built, replace(state, velocity=array(start, state.velocity.dtype))
