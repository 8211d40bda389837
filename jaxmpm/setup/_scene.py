"""A Scene from particles, a grid and a material: every number and choice checked."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from jaxmpm.grid import Grid, Particles
from jaxmpm.laws import BaseMotion, frictional, laws_of, of_skeleton, remembers_gap
from jaxmpm.protocols import History, Material, PrescribedMotion
from jaxmpm.setup._choices import (
    check_boundary,
    check_engine,
    check_grid,
    check_kernel,
    check_particles,
    check_tied,
    check_water,
    check_weight_below_water,
    gravity_vector,
    warn_of_hats,
)
from jaxmpm.setup._discretisation import Discretisation, check_discretisation, kernel_of
from jaxmpm.setup._law import check_scene, check_shape, checked_material, number_of, wave_speed, with_water_sealed
from jaxmpm.setup._motion import SKIPPED, check_motion, skipped
from jaxmpm.support import check
from jaxmpm.support.tracing import array, zeros_like
from jaxmpm.tensors import CARRIED, expand
from jaxmpm.transfer import passes_for
from jaxmpm.types import Boundary, Engine, Loads, Numerics, Scene, State, Status


def scene(
    particles: Particles,
    grid: Grid,
    material: Material,
    discretisation: Discretisation,
    *,
    boundary: Boundary | None = None,
    loads: Loads | None = None,
    speed: float | None = None,
    engine: Engine | None = None,
) -> Scene:
    """Build a scene of any particles and law; numbers take the precision of the particles' positions.

    It warns of linear hats where they do not work: with USL, or with particles on the faces of cells.

    Args:
        particles: position (d, N) m inside the grid, mass (N,) kg, volume (N,) m3.
        grid: background grid.
        material: law with parameters () or (N,).
        discretisation: cell, spacing and numerical choices; the cell is that of the grid, and the kernel is made for
            the spacing.
        boundary: what constrains the nodes; None for nothing.
        loads: gravity, body force, water and motion; None for none.
        speed: largest particle speed that the time step allows for (m/s), by default of a fall through half the grid.
        engine: of the transfers, None for the fastest available.

    Returns:
        Scene.

    Raises:
        ValueError: If shapes, numbers or choices do not fit; the message names each.
    """
    d, boundary, loads = check_grid(grid), boundary or Boundary(), loads or Loads()
    check_discretisation(discretisation, d)
    kernel = kernel_of(discretisation)
    if discretisation.cell != grid.cell:
        raise ValueError(f"cell = {discretisation.cell:g} m on a grid of cells of {grid.cell:g} m: give the same")
    dtype = check_particles(particles, grid)
    check_boundary(boundary, grid)
    check_kernel(kernel, grid)
    check_engine(engine)
    warn_of_hats(kernel, discretisation.scheme, particles, grid)
    g = gravity_vector(loads.gravity, d)
    if speed is None:
        if check.is_traced(g):
            raise ValueError("gravity is traced, and the time step allows for a fall under it: give the largest speed")
        speed = math.sqrt(float(np.linalg.norm(g)) * (grid.shape[-1] - 1) * grid.cell)
    check.not_negative("speed", speed, "m/s")
    number = number_of(dtype)

    def optional(value: ArrayLike | None) -> Array | None:
        return None if value is None else number(value)

    material = checked_material(material, particles, dtype)
    if discretisation.fbar and material.FRICTIONAL:
        raise ValueError(
            "fbar = True with a frictional soil: it averages the mean stress, on which friction depends, and soil at a "
            "free surface would lose its strength; leave fbar out, cell_average is the cure for such soils"
        )
    if discretisation.fbar and discretisation.cell_average:
        raise ValueError("fbar = True with cell_average = True: both average the volumetric strain, give one of them")
    if loads.motion is not None:
        check_motion(loads.motion, d)
    length = discretisation.internal_length
    if boundary.tied is not None:
        check_tied(boundary.tied, grid, particles, boundary.walls, length)
    if loads.motion is not None and boundary.softening is not None:
        raise ValueError(
            "motion of the base, with a contact that softens by its displacement, which shaking takes back: give the "
            "contact the strength that slip leaves, without residual_ratio and slip_length"
        )
    if loads.water is not None or loads.pore_pressure is not None:
        check_water(loads.water, loads.pore_pressure, material, particles)
        material = with_water_sealed(material, particles, loads)
    if length is not None and not jax.tree.leaves(of_skeleton(material.initial_history(particles))):
        raise ValueError(f"internal_length = {length:g} m, but the soil does not soften: leave it out")
    if loads.k0 is not None:
        check_shape("k0", loads.k0, particles)
    average = discretisation.cell_average
    average = bool(material.FRICTIONAL and d > 1) if average is None else bool(average)
    numerics = Numerics(
        time_step=number(discretisation.cfl * grid.cell / (wave_speed(particles, material) + speed)),
        kernel=kernel,
        scheme=discretisation.scheme,
        engine=engine,
        fbar=bool(discretisation.fbar),
        cell_average=average,
        gap_average=average and frictional(material) is not False,
        bridging=bool(discretisation.bridging),
        finite_strain=bool(discretisation.finite_strain),
        xpic=discretisation.xpic,
        nonlocal_passes=None if length is None else passes_for(length, kernel, grid.cell),
        flip=None if discretisation.flip == 1 else number(discretisation.flip),
        pic_damping=None if discretisation.pic_damping == 0 else number(discretisation.pic_damping),
        damping=None if discretisation.damping == 0 else number(discretisation.damping),
    )
    built = Scene(
        grid=grid,
        particles=particles,
        material=material,
        numerics=numerics,
        boundary=replace(
            boundary,
            walls=tuple(boundary.walls),
            friction=optional(boundary.friction),
            cohesion=optional(boundary.cohesion),
            pressure=optional(boundary.pressure),
            cut=None if boundary.cut is None else array(boundary.cut, bool),
            base=jax.tree.map(number, boundary.base),
            softening=optional(boundary.softening),
        ),
        loads=replace(
            loads,
            gravity=number(g),
            water=jax.tree.map(number, loads.water),
            pore_pressure=optional(loads.pore_pressure),
            motion=jax.tree.map(number, loads.motion),
            k0=optional(loads.k0),
        ),
    )
    check_scene(built)
    check_weight_below_water(built)
    _check_time_step(built, loads.motion)
    return built


def _check_time_step(scene: Scene, motion: PrescribedMotion | None) -> None:
    """Raise ValueError for damping that a time step takes too far; warn of a record that it skips parts of."""
    if check.is_traced(scene.numerics.time_step):
        return
    dt, damping = float(scene.numerics.time_step), scene.numerics.damping
    if damping is not None and float(damping) * dt >= 1:
        raise ValueError(
            f"damping = {float(damping):g} 1/s in time steps of {dt:.3g} s: give less than {1 / dt:.3g}, from "
            "which on it turns velocities round in each step, or a smaller cfl"
        )
    if not isinstance(motion, BaseMotion) or check.is_traced(motion):
        return
    lost = skipped(motion, dt)
    if lost > SKIPPED:
        warnings.warn(
            f"motion has a sample every {float(motion.interval):g} s, and time steps of {dt:.3g} s skip pulses that "
            f"make {lost:.2g} of its peak velocity: average the record over such steps, or give a smaller cfl",
            stacklevel=4,
        )


def unstressed(scene: Scene, *, apic: bool = False) -> State:
    """State without motion, stress and history.

    Args:
        scene: to start.
        apic: with a velocity gradient (d, d, N) of 0.

    Returns:
        State.
    """
    particles, d = scene.particles, scene.grid.dimension
    history = scene.material.initial_history(particles)
    return State(
        displacement=zeros_like(particles.position),
        velocity=zeros_like(particles.position),
        stress=array(np.zeros((len(CARRIED[d]), *particles.mass.shape)), particles.mass.dtype),
        volume_ratio=array(np.ones(particles.mass.shape), particles.mass.dtype),
        history=history,
        step=array(0, jnp.int32),
        status=array(int(Status.RUNNING), jnp.int32),
        affine=array(np.zeros((d, *particles.position.shape)), particles.mass.dtype) if apic else None,
        gap=zeros_like(particles.mass) if remembers_gap(scene.material) else None,
        unaveraged=None if scene.numerics.nonlocal_passes is None else zeros_like(of_skeleton(history)),
    )


def with_stress(scene: Scene, state: State, stress: Array) -> State:
    """The state at rest under a stress, with the history that a law has under it.

    Args:
        scene: of the state.
        state: that has not moved.
        stress: (s, N) Pa.

    Returns:
        State.

    Raises:
        ValueError: If a user's own law converts the stress to NumPy.
    """
    try:
        history = _history_at_rest(scene.material, state.history, stress, scene.grid.dimension)
    except jax.errors.JAXTypeError as error:
        names = " or ".join(type(law).__name__ for law in laws_of(scene.material))
        raise ValueError(
            f"history_at_rest of {names} hands the stress to NumPy, or decides by it, and it is traced: write it with "
            "jax.numpy, as `update` is"
        ) from error
    return replace(state, stress=stress, history=history)


@partial(jax.jit, static_argnums=3)
def _history_at_rest(material: Material, history: History, stress: Array, dimension: int) -> History:
    return material.history_at_rest(history, expand(stress, dimension))
