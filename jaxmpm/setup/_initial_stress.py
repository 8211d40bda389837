"""Initial stress: the equilibrium of elastic loading by gravity.

Damped elastic loading with small strains converges to one linear problem on the grid, K u = f(stress_0) + load. It is
solved directly, by conjugate gradients without a matrix, at the particles' initial positions. The stress then balances
gravity exactly there, so that velocities and displacements start from zero.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm import tensors
from jaxmpm.boundary import hold
from jaxmpm.equations import MASS_FLOOR, Maps, acting_stress, closed, external_force, gaps, sheared
from jaxmpm.laws import elastic_increment
from jaxmpm.setup._scene import unstressed, with_stress
from jaxmpm.types import Scene, State


@partial(jax.jit, static_argnames=("iterations", "gapped"))
def elastic_equilibrium(
    scene: Scene, stress: Array, *, tolerance: float = 1e-5, iterations: int = 2000, gapped: bool = False
) -> tuple[Array, Array]:
    """Stress in balance with the load, reached elastically from another stress.

    The load is that of gravity, water and body force at time 0. The result depends on the elastic moduli (`bulk`,
    `shear` of the material), never on strength. The nodal mass is the preconditioner. Strain and mean stress are
    averaged as in a step; otherwise the first forces of a run would be out of balance.

    Args:
        scene: to load.
        stress: (s, N) Pa to start from.
        tolerance: of the conjugate gradients, as a share of the load.
        iterations: their largest number.
        gapped: whether soil lies above nodes of rigid ground by a share of a cell, which the forces close. The problem
            is then not symmetric.

    Returns:
        Stress (s, N) Pa, and the residual: norm of the net force over that of the load, on free nodes.
    """
    grid, particles = scene.grid, scene.particles
    scene = _sticking(scene)
    d = grid.dimension
    maps = Maps(scene, particles.position)
    mass = maps.to_grid(particles.mass[None], None)
    carries = mass > MASS_FLOOR * jnp.mean(particles.mass)
    gap, undrained, shears = gaps(scene, mass[:, 0]) if gapped else None, None, sheared(scene)
    if gapped and not isinstance(shears, bool):
        weighed = maps.to_grid((particles.mass * shears)[None], None)[:, 0]
        undrained = jnp.where(carries[:, 0], weighed / jnp.where(carries[:, 0], mass[:, 0], 1), 0)

    def free(nodal: Array) -> Array:
        return hold(scene, jnp.where(carries, nodal, 0))

    def internal_force(stress: Array) -> Array:
        force = maps.to_grid(None, acting_stress(scene, stress, particles.volume, maps))
        return free(closed(scene, gap, force, undrained, pressing=False))

    def stress_of(nodal_displacement: Array) -> Array:
        entries = tensors.entries(maps.gradient(nodal_displacement))
        strain = maps.unlocked(tensors.strain_increment(entries, jnp.ones((), stress.dtype)), particles.volume)
        return tensors.compress(elastic_increment(scene.material.bulk, scene.material.shear, strain), d)

    load = mass * scene.loads.gravity
    external = external_force(scene, particles.position, jnp.zeros((), stress.dtype))
    if external is not None:
        load = load + maps.to_grid(external, None)
    if scene.loads.pore_pressure is not None:
        load = load + maps.to_grid(None, acting_stress(scene, jnp.zeros_like(stress), particles.volume, maps))
        # The rest is linear in the effective stress.
        scene = replace(scene, loads=replace(scene.loads, pore_pressure=None))
    load = free(load)
    net = load + internal_force(stress)
    norm = jnp.linalg.norm(load)
    solve = jax.scipy.sparse.linalg.bicgstab if gapped else jax.scipy.sparse.linalg.cg
    solution, _ = solve(
        lambda u: -internal_force(stress_of(u)),
        net,
        M=lambda r: jnp.where(carries, r / jnp.where(carries, mass, 1), 0),
        tol=0.0,
        atol=tolerance * norm,
        maxiter=iterations,
    )
    balanced = stress + stress_of(solution)
    return balanced, jnp.linalg.norm(load + internal_force(balanced)) / norm


def _sticking(scene: Scene) -> Scene:
    """The scene at rest, where soil sticks to walls with friction, and to the base."""
    boundary = scene.boundary
    walls = tuple(replace(wall, hold="fixed") if wall.hold == "friction" else wall for wall in boundary.walls)
    boundary = replace(boundary, walls=walls)
    if boundary.base is not None:
        on_base = jnp.any(boundary.base.normal != 0, axis=1)
        boundary = replace(boundary, base=None, cut=on_base if boundary.cut is None else boundary.cut | on_base)
    return replace(scene, boundary=boundary)


def _gapped(scene: Scene) -> bool:
    """Whether undrained soil lies above nodes of rigid ground by a share of a cell."""
    if sheared(scene) is False:
        return False
    maps = Maps(scene, scene.particles.position)
    gap = gaps(_sticking(scene), maps.to_grid(scene.particles.mass[None], None)[:, 0])
    return gap is not None and bool(np.any(np.asarray(gap)))


RESIDUAL = 1e-3
"""Largest unbalanced share of the load."""


def at_rest(scene: Scene, *, apic: bool = False) -> State:
    """Motionless state with the stress of elastic gravity loading.

    Args:
        scene: to load.
        apic: with a velocity gradient (d, d, N).

    Returns:
        State.

    Raises:
        ValueError: If the body is not held against its load, or its moduli differ by too many orders of magnitude.
    """
    return settled(scene, unstressed(scene, apic=apic))


def settled(scene: Scene, state: State) -> State:
    """State with the stress of elastic gravity loading, solved from the columns' own weight.

    The horizontal stress to start from is K0 times the vertical one: the scene's `k0`, by default nu / (1 - nu). The
    loading adds what the ground's shape asks for, nothing where it is level.

    Args:
        scene: to load.
        state: without gravity, body force and water it is returned unchanged.

    Returns:
        State.

    Raises:
        ValueError: If the scene has ends without walls, which hold nothing, or as for `at_rest`.
    """
    if scene.free_field is not None:
        raise ValueError(
            "ends = 'free field' hold nothing at rest: the stress of such a section is that of `section`, build it anew"
        )
    loads = scene.loads
    if not np.any(np.asarray(loads.gravity)) and loads.body_force is None and loads.water is None:
        return state
    d, dtype = scene.grid.dimension, state.stress.dtype
    vertical = -overburden(scene).astype(dtype)
    bulk, shear = np.asarray(scene.material.bulk), np.asarray(scene.material.shear)
    elastic = (bulk - 2 * shear / 3) / (bulk + 4 * shear / 3)
    k0 = (elastic if scene.loads.k0 is None else np.asarray(scene.loads.k0)).astype(dtype)
    upright = {1: 0, 2: 2, 3: 2}[d]
    stress = jnp.stack([vertical * (1 if c == upright else k0 if c < 3 else 0) for c in tensors.CARRIED[d]])
    balanced, residual = elastic_equilibrium(scene, stress, gapped=_gapped(scene))
    if not float(residual) < RESIDUAL:
        raise ValueError(
            f"the initial stress leaves {float(residual):.1e} of the weight unbalanced (limit {RESIDUAL:g}): "
            "is the body held against gravity, are the moduli within some orders of magnitude, and is Poisson's ratio "
            "below 0.4999? Else start it with `unstressed`, or take float64"
        )
    return with_stress(scene, state, balanced)


def overburden(scene: Scene) -> np.ndarray:
    """Effective vertical stress by weight alone.

    It is the weight per area of the soil above each particle of a lattice in its own column, half of itself included,
    minus the pressure of the water; 0 for particles without a column.

    Args:
        scene: of particles on a lattice.

    Returns:
        (N,) Pa, positive in compression.
    """
    position = np.asarray(scene.particles.position)
    *across, z = position
    order = np.lexsort((-z, *across))
    starts = np.r_[True, np.any(np.diff(position[:-1, order], axis=1) != 0, axis=0)]
    if starts.all():
        return np.zeros(z.size)
    mass, volume = np.asarray(scene.particles.mass, float), np.asarray(scene.particles.volume, float)
    # Not volume over height: the ground's surface may cut a particle.
    gaps = [np.diff(np.unique(axis)) for axis in across]
    height = -np.diff(z[order])[~starts[1:]].min()
    area = float(np.prod([np.median(gap) for gap in gaps])) if all(gap.size for gap in gaps) else volume.max() / height
    loads = scene.loads
    weight = -float(loads.gravity[-1]) * mass
    if loads.water is not None:
        weight = weight - volume * np.asarray(loads.water.push(scene.particles.position)[-1], float)
    weight = weight[order] / area
    below = np.cumsum(weight)
    column = np.maximum.accumulate(np.where(starts, np.arange(order.size), 0))
    above = np.empty(order.size)
    above[order] = below - weight / 2 - (below - weight)[column]
    if loads.pore_pressure is not None:
        above = np.where(above > 0, above - np.asarray(loads.pore_pressure, float), above)
    return above
