"""A Scene from particles, a grid and a material: every number and choice checked."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from foundation import check
from jaxmpm.grid import Grid, Particles, Wall
from jaxmpm.laws import (
    BaseMotion,
    WaterSurface,
    WaterTable,
    remembers_gap,
)
from jaxmpm.protocols import Kernel, Material
from jaxmpm.setup._choices import (
    check_choices,
    check_grid,
    check_kernel,
    check_particles,
    check_tied,
    check_walls,
    check_water,
    gravity_vector,
    warn_of_hats,
)
from jaxmpm.setup._law import check_scene, checked_material, number_of, wave_speed
from jaxmpm.setup._motion import check_motion
from jaxmpm.tensors import CARRIED
from jaxmpm.transfer import passes_for
from jaxmpm.types import Engine, Scene, Scheme, State, Status


def scene(
    particles: Particles,
    grid: Grid,
    material: Material,
    *,
    kernel: Kernel,
    gravity: float | Sequence[float] = 0.0,
    walls: Sequence[Wall] = (),
    wall_friction: float | None = None,
    wall_cohesion: float | None = None,
    wall_pressure: ArrayLike | None = None,
    scheme: Scheme = Scheme.MUSL,
    cfl: float = 0.5,
    speed: float | None = None,
    flip: float = 1.0,
    damping: float = 0.0,
    fbar: bool = False,
    cell_average: bool | None = None,
    finite_strain: bool = False,
    internal_length: float | None = None,
    body_force: Callable[[Array, Array], Array] | None = None,
    water: WaterTable | WaterSurface | None = None,
    pore_pressure: ArrayLike | None = None,
    motion: BaseMotion | None = None,
    tied: tuple[int, int] | None = None,
    cut: ArrayLike | None = None,
    engine: Engine | None = None,
) -> Scene:
    """Build a scene of any particles and law; numbers take the precision of the particles' positions.

    It warns of linear hats where they do not work: with USL, or with particles on the faces of cells.

    Args:
        particles: position (d, N) m inside the grid, mass (N,) kg, volume (N,) m3.
        grid: background grid.
        material: law with parameters () or (N,).
        kernel: an object, for example GIMP(half_size).
        gravity: downwards (m/s2), or a vector (d,).
        walls: planes that constrain nodes.
        wall_friction: as in `Scene`.
        wall_cohesion: as in `Scene`.
        wall_pressure: as in `Scene`.
        scheme: when the stress is updated.
        cfl: time_step = cfl cell / (c + speed), c the fastest elastic wave.
        speed: largest particle speed that the time step allows for (m/s), by default of a fall through half the grid.
        flip: as in `Discretisation`.
        damping: as in `Discretisation`.
        fbar: as in `Discretisation`.
        cell_average: as in `Discretisation`.
        finite_strain: as in `Discretisation`.
        internal_length: as in `Discretisation`.
        body_force: as in `Scene`.
        water: as in `Scene`. The strength of undrained soil does not depend on the mean stress, so a table below the
            surface changes nothing there, and a pool is a pressure on the surface.
        pore_pressure: as in `Scene`; needs a law of effective stress.
        motion: as in `Scene`.
        tied: as in `Scene`.
        cut: as in `Scene`.
        engine: as in `Scene`.

    Returns:
        Scene.

    Raises:
        ValueError: If shapes, numbers or choices do not fit; the message names each.
    """
    d = check_grid(grid)
    dtype = check_particles(particles, grid)
    check_walls(walls, grid, wall_friction, bonded=wall_cohesion is not None or wall_pressure is not None)
    check_kernel(kernel, grid)
    check_choices(scheme, engine, cfl=cfl, flip=flip, damping=damping)
    warn_of_hats(kernel, scheme, particles, grid)
    g = gravity_vector(gravity, d)
    if speed is None:
        speed = math.sqrt(float(np.linalg.norm(g)) * (grid.shape[-1] - 1) * grid.cell)
    check.not_negative("speed", speed, "m/s")
    number = number_of(dtype)
    material = checked_material(material, particles, dtype)
    if wall_pressure is not None and np.shape(wall_pressure) != (math.prod(grid.shape),):
        raise ValueError(f"wall_pressure has shape {np.shape(wall_pressure)}: give ({math.prod(grid.shape)},), in Pa")
    if fbar and material.FRICTIONAL:
        raise ValueError(
            "fbar = True with a frictional soil: it averages the mean stress, on which friction depends, and soil at a "
            "free surface would lose its strength; leave fbar out, cell_average is the cure for such soils"
        )
    if fbar and cell_average:
        raise ValueError("fbar = True with cell_average = True: both average the volumetric strain, give one of them")
    if motion is not None:
        check_motion(motion, d)
    if cut is not None and (np.shape(cut) != (math.prod(grid.shape),) or np.asarray(cut).dtype != bool):
        raise ValueError(f"cut has shape {np.shape(cut)}: give ({math.prod(grid.shape)},), one bool for each node")
    if tied is not None:
        check_tied(tied, grid, particles, walls, internal_length)
    if water is not None or pore_pressure is not None:
        check_water(water, pore_pressure, material, particles)
    if internal_length is not None and material.initial_history(particles) is None:
        raise ValueError(f"internal_length = {internal_length:g} m, but the soil does not soften: leave it out")
    built = Scene(
        grid=grid,
        particles=particles,
        material=material,
        gravity=number(g),
        time_step=number(cfl * grid.cell / (wave_speed(particles, material) + speed)),
        kernel=kernel,
        walls=tuple(walls),
        scheme=scheme,
        engine=engine,
        fbar=bool(fbar),
        cell_average=bool(material.FRICTIONAL and d > 1) if cell_average is None else bool(cell_average),
        finite_strain=bool(finite_strain),
        nonlocal_passes=None if internal_length is None else passes_for(internal_length, kernel, grid.cell),
        body_force=body_force,
        flip=None if flip == 1 else number(flip),
        damping=None if damping == 0 else number(damping),
        wall_friction=None if wall_friction is None else number(wall_friction),
        wall_cohesion=None if wall_cohesion is None else number(wall_cohesion),
        wall_pressure=None if wall_pressure is None else number(wall_pressure),
        water=jax.tree.map(number, water),
        pore_pressure=None if pore_pressure is None else number(pore_pressure),
        motion=jax.tree.map(number, motion),
        tied=tied,
        cut=None if cut is None else jnp.asarray(cut),
    )
    check_scene(built)
    return built


def unstressed(scene: Scene, *, apic: bool = False) -> State:
    """State without motion, stress and history.

    Args:
        scene: to start.
        apic: with a velocity gradient (d, d, N) of 0.

    Returns:
        State.
    """
    particles, d = scene.particles, scene.grid.dimension
    return State(
        displacement=jnp.zeros_like(particles.position),
        velocity=jnp.zeros_like(particles.position),
        stress=jnp.zeros((len(CARRIED[d]), *particles.mass.shape), particles.mass.dtype),
        volume_ratio=jnp.ones_like(particles.mass),
        history=scene.material.initial_history(particles),
        step=jnp.zeros((), jnp.int32),
        status=jnp.asarray(int(Status.RUNNING), jnp.int32),
        affine=jnp.zeros((d, *particles.position.shape), particles.mass.dtype) if apic else None,
        gap=jnp.zeros_like(particles.mass) if remembers_gap(scene.material) else None,
    )
