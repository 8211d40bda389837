"""Largest stable time step of a 1D bar, measured, beside the spectral radius of the step's own matrix.

About rest and with the particles where they stand, a step is a linear map of particle velocities and stresses. It is
stable while no eigenvalue is larger than 1 in modulus. Ni and Zhang (2020), IJNME 121, 4989-5016, take the eigenvalues
of the nodal stiffness; here those of the whole step are taken, so that USL, no central difference, has its limit too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm as mpm
from benchmarks.stability.stability_case import Row, judged
from jaxmpm import diagnostics
from jaxmpm.transfer import locate

KERNELS = (mpm.GIMP, mpm.Linear, mpm.QuadraticBSpline)
# Particles per cell, and by how many cells they are shifted: by 0.24 two a cell come to 0.01 from nodes and faces.
ARRANGEMENTS = ((1, 0.0), (2, 0.0), (3, 0.0), (4, 0.0), (5, 0.0), (2, 0.24))
TRIED = np.arange(0.02, 2.61, 0.02)
YOUNG, DENSITY, CELLS = 1e6, 1e3, 8
STEPS, GAIN = 400, 100
"""Steps in which unstable motion multiplies its energy by GAIN."""


def bar(
    kernel: Any, scheme: mpm.Scheme, particles: int, shift: float = 0.0, dimension: int = 1, cells: int = CELLS
) -> tuple[mpm.Scene, mpm.State]:
    """A bar, square or cube between rollers, at rest, its particles shifted by a part of a cell."""
    numerics = mpm.Discretisation(1.0, (1.0 / particles,) * dimension, kernel=kernel, scheme=scheme)
    soil = mpm.Soil(unit_weight=9.81 * DENSITY, young=YOUNG, poisson=0.0)
    size, corner = (cells,) * dimension, (0.0,) * dimension
    scene, state = mpm.block(size, soil, numerics, domain=size, corner=corner, walls="roller", speed=1e-3)
    shifted = replace(scene.particles, position=scene.particles.position + shift)
    return replace(scene, particles=shifted), state


def growth(scene: mpm.Scene, cfl: float) -> float:
    """Spectral radius of one step at rest, from shape functions alone."""
    grid, dt = scene.grid, cfl / np.sqrt(YOUNG / DENSITY)
    cells = np.asarray(locate(grid, scene.particles.position))[0]
    pairs = [scene.numerics.kernel.shape(0, grid.cell, jnp.asarray(cells - i)) for i in range(grid.nodes)]
    s, b = (np.stack([np.asarray(pair[k], float) for pair in pairs]) for k in (0, 1))
    m, volume = float(scene.particles.mass[0]), float(scene.particles.volume[0])
    nodal = m * s.sum(1)
    free = (nodal > 1e-12 * m) & (np.arange(grid.nodes) > 1) & (np.arange(grid.nodes) < grid.nodes - 2)
    inverse = np.where(free, 1 / np.where(free, nodal, 1), 0)[:, None]
    to_velocity, to_acceleration = inverse * s * m, -inverse * b * volume
    n = s.shape[1]
    # Stress in units of the impedance, so that both halves are of one size.
    z = np.sqrt(YOUNG * DENSITY)
    one, nothing = np.eye(n), np.zeros((n, n))
    kick = np.block([[one, dt * z * s.T @ to_acceleration], [nothing, one]])
    stretch = np.block([[one, nothing], [dt * YOUNG / z * b.T @ to_velocity, one]])
    if scene.numerics.scheme is mpm.Scheme.USL:
        step = kick.copy()
        step[n:, :n] = dt * YOUNG / z * b.T @ to_velocity
        step[n:, n:] += dt**2 * YOUNG * b.T @ to_acceleration
    else:
        step = kick @ stretch if scene.numerics.scheme is mpm.Scheme.USF else stretch @ kick
    return float(np.abs(np.linalg.eigvals(step)).max())


def measured(scene: mpm.Scene, state: mpm.State) -> float:
    """Largest CFL number up to which small random motion does not multiply its energy."""
    noise = np.random.default_rng(0).normal(size=state.velocity.shape) * 1e-6
    state = replace(state, velocity=jnp.asarray(noise))

    def gain(cfl: Any) -> Any:
        varied = replace(scene, numerics=replace(scene.numerics, time_step=cfl / np.sqrt(YOUNG / DENSITY)))
        final = mpm.advance(varied, state, STEPS)
        energy = diagnostics.kinetic_energy(varied, final) + diagnostics.elastic_energy(varied, final)
        return jnp.where(final.status == mpm.Status.RUNNING, energy, jnp.inf)

    stable = np.asarray(jax.jit(jax.vmap(gain))(jnp.asarray(TRIED))) < GAIN * diagnostics.kinetic_energy(scene, state)
    count = len(TRIED) if stable.all() else int(np.argmin(stable))
    return float(TRIED[count - 1]) if count else 0.0


def predicted(scene: mpm.Scene) -> float:
    """The CFL number at which the spectral radius passes that growth, by bisection."""
    low, high = 0.0, float(TRIED[-1])
    while high - low > 1e-3:
        middle = (low + high) / 2
        low, high = (middle, high) if growth(scene, middle) < GAIN ** (0.5 / STEPS) else (low, middle)
    return low


def cfl_rows(quick: bool) -> Iterator[Row]:
    """Measured against theory for every kernel, scheme and arrangement; and the default of 0.5 against all limits."""
    combinations = [(kernel, scheme) for kernel in KERNELS for scheme in mpm.Scheme]
    if quick:
        combinations = [(mpm.GIMP, mpm.Scheme.MUSL), (mpm.Linear, mpm.Scheme.USL)]
    with jax.enable_x64(True):
        for kernel, scheme in combinations:
            limits = []
            for particles, shift in ARRANGEMENTS[1:2] if quick else ARRANGEMENTS:
                scene, state = bar(kernel, scheme, particles, shift)
                theory = predicted(scene)
                result = measured(scene, state)
                limits.append(result)
                where = f"{particles} a cell" + (", 0.01 cells from nodes and faces" if shift else "")
                yield judged(
                    f"largest stable CFL against theory, {kernel.__name__} {scheme.name}, {where}",
                    abs(result / theory - 1),
                    0.05,
                    "relative",
                    measured=round(result, 2),
                    theory=round(theory, 2),
                )
            name = f"least of the limits, {kernel.__name__} {scheme.name}, against the default of 0.5"
            yield judged(name, min(limits), 0.5, "c dt / h", at_least=True)
        for dimension in () if quick else (2, 3):
            scene, state = bar(mpm.GIMP, mpm.Scheme.MUSL, 2, dimension=dimension, cells=4)
            name = f"largest stable CFL in {dimension}D, GIMP MUSL, 2 a cell, against the default of 0.5"
            yield judged(name, measured(scene, state), 0.5, "c dt / h", at_least=True)
