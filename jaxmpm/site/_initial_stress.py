"""Initial stress: where elastic loading by gravity comes to rest.

Damped elastic loading with small strains converges to one linear problem on the grid, K u = f(stress_0) + load.
It is solved directly, by conjugate gradients without a matrix, on the particles' initial positions: the stress
balances gravity exactly there, so that velocities and displacements start from zero.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm import tensors
from jaxmpm._step import MASS_FLOOR, acting_stress, neighbour_average
from jaxmpm.boundary import hold
from jaxmpm.laws import elastic_increment
from jaxmpm.transfer import g2p, p2g
from jaxmpm.types import Scene, State


@partial(jax.jit, static_argnames="iterations")
def elastic_equilibrium(
    scene: Scene, stress: Array, *, tolerance: float = 1e-5, iterations: int = 2000
) -> tuple[Array, Array]:
    """Stress (s, N) Pa in balance with the load, reached elastically from `stress` (s, N), and the residual left.

    The load is gravity's and the body force's at time 0. The residual is the norm of the net force over that of the
    load, on free nodes. It depends on the elastic moduli (`bulk`, `shear` of the material), never on strength.
    Preconditioned by the nodal mass. With F-bar, strain and mean stress are averaged as a step averages them: else its
    first forces would be out of balance.
    """
    grid, kernel, particles = scene.grid, scene.kernel, scene.particles
    d = grid.dimension
    to_grid = partial(p2g, grid, kernel, particles.position)
    to_particles = partial(g2p, grid, kernel, particles.position)
    average = partial(neighbour_average, scene, to_grid, to_particles)
    mass = to_grid(particles.mass[None], None)
    carries = mass > MASS_FLOOR * jnp.mean(particles.mass)

    def free(nodal: Array) -> Array:
        return hold(scene.walls, grid, jnp.where(carries, nodal, 0))

    def internal_force(stress: Array) -> Array:
        return free(to_grid(None, acting_stress(scene, stress, particles.volume, average)))

    def stress_of(nodal_displacement: Array) -> Array:
        _, gradient = to_particles(nodal_displacement, values=0, gradients=d)
        strain = tensors.strain_increment(tensors.entries(gradient), jnp.ones((), stress.dtype))
        if scene.fbar:
            strain = tensors.with_mean(strain, average(tensors.mean(strain), 0))
        return tensors.compress(elastic_increment(scene.material.bulk, scene.material.shear, strain), d)

    load = mass * scene.gravity
    if scene.body_force is not None:
        pushed = particles.mass * scene.body_force(particles.position, jnp.zeros((), stress.dtype))
        load = load + to_grid(pushed, None)
    load = free(load)
    net = load + internal_force(stress)
    norm = jnp.linalg.norm(load)
    solution, _ = jax.scipy.sparse.linalg.cg(
        lambda u: -internal_force(stress_of(u)),
        net,
        M=lambda r: jnp.where(carries, r / jnp.where(carries, mass, 1), 0),
        tol=0.0,
        atol=tolerance * norm,
        maxiter=iterations,
    )
    balanced = stress + stress_of(solution)
    return balanced, jnp.linalg.norm(load + internal_force(balanced)) / norm


def settled_elastically(scene: Scene, state: State, spacing: float) -> State:
    """The state with the stress of elastic gravity loading, started from the columns' own weight with K0 = nu/(1 - nu).

    spacing: of the particles along the vertical axis (m), for the weight above each.
    """
    d = scene.grid.dimension
    position, dtype = np.asarray(scene.particles.position), state.stress.dtype
    unit_weight = -float(scene.gravity[-1]) * float(scene.particles.mass[0] / scene.particles.volume[0])
    vertical = (-unit_weight * spacing * (_above(position, spacing) + 0.5)).astype(dtype)
    k = np.asarray(scene.material.bulk - 2 * scene.material.shear / 3)
    k0 = (k / (k + 2 * np.asarray(scene.material.shear))).astype(dtype)
    upright = {1: 0, 2: 2, 3: 2}[d]
    stress = jnp.stack([vertical * (1 if c == upright else k0 if c < 3 else 0) for c in tensors.CARRIED[d]])
    balanced, residual = elastic_equilibrium(scene, stress)
    if not float(residual) < 1e-3:
        raise ValueError(
            f"the initial stress leaves {float(residual):.1e} of the weight unbalanced (limit 1e-3): "
            "is the body held against gravity, and are the moduli within some orders of magnitude?"
        )
    return replace(state, stress=balanced)


def _above(position: np.ndarray, spacing: float) -> np.ndarray:
    """How many particles stand above each one of a lattice, in its own column."""
    columns = np.round(position[:-1] / spacing * 1024).astype(np.int64)
    order = np.lexsort((-position[-1], *columns))
    ordered = columns[:, order]
    new = np.r_[True, np.any(ordered[:, 1:] != ordered[:, :-1], axis=0)]
    start = np.maximum.accumulate(np.where(new, np.arange(len(order)), 0))
    above = np.empty(len(order), np.int64)
    above[order] = np.arange(len(order)) - start
    return above
