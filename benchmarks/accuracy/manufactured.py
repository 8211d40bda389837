"""A manufactured solution: an axis-aligned standing wave of large strain, with the body force that it needs."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import jaxmpm as mpm

ELASTIC = mpm.Soil(unit_weight=9.81e3, young=1e6, poisson=0.3)
DENSITY = 1e3


def posed(
    cells: int, dimension: int, *, amplitude: float = 0.02, cfl: float = 0.1, finest: int | None = None, **choices: Any
) -> tuple[mpm.Scene, mpm.State, Callable[[Array, Array | float], Array]]:
    """Scene, state and exact displacement (X, t) of the wave in a unit cube of `cells` per edge.

    u_i = A sin(2 pi X_i) sin(c pi t + i pi), held by the body force that it needs. With the law s' = C : d on fixed
    axes the Cauchy stress is that of the logarithmic strain, s_i = lambda ln J + 2 G ln F_i, and P_i = J s_i / F_i.
    finest: cells whose time step is taken. particles: per cell and axis, 2 if not given.
    Source: Wallstedt and Guilkey (2008), 10.1016/j.jcp.2008.07.019, section 5.1, for this law in place of theirs.
    """
    h = 1 / cells
    numerics = mpm.Discretisation(h, (h / choices.pop("particles", 2),) * dimension, cfl=cfl, **choices)
    ones = (1.0,) * dimension
    scene, state = mpm.block(
        ones, ELASTIC, numerics, domain=ones, corner=(0.0,) * dimension, walls="roller", speed=1e-3
    )
    bulk, shear = float(scene.material.bulk), float(scene.material.shear)
    c = np.sqrt(ELASTIC.young / DENSITY)

    def exact(x: Array, t: Array | float) -> Array:
        phase = jnp.arange(dimension)[:, None] * jnp.pi
        return amplitude * jnp.sin(2 * jnp.pi * x) * jnp.sin(c * jnp.pi * t + phase)

    def stretch(x: Array, t: Array | float) -> Array:
        return 1 + jax.jvp(lambda y: exact(y, t), (x,), (jnp.ones_like(x),))[1]

    def nominal_stress(x: Array, t: Array | float) -> Array:
        f = stretch(x, t)
        j = jnp.prod(f, axis=0)
        return j / f * ((bulk - 2 * shear / 3) * jnp.log(j) + 2 * shear * jnp.log(f))

    def body_force(x: Array, t: Array | float) -> Array:
        # Each component varies along its own axis for P_i; the others enter through J and are held there.
        slope = [
            jax.jvp(lambda y, i=i: nominal_stress(y, t)[i], (x,), (jnp.zeros_like(x).at[i].set(1),))[1]
            for i in range(dimension)
        ]
        return -((c * jnp.pi) ** 2) * exact(x, t) - jnp.stack(slope) / DENSITY

    _, velocity = jax.jvp(lambda t: exact(scene.particles.position, t), (jnp.zeros(()),), (jnp.ones(()),))
    dt = cfl / (finest or cells) / float(jnp.sqrt(scene.material.p_wave_modulus / DENSITY))
    scene = replace(
        scene,
        loads=replace(scene.loads, body_force=body_force),
        numerics=replace(scene.numerics, time_step=jnp.asarray(dt, scene.numerics.time_step.dtype)),
    )
    return scene, replace(state, velocity=velocity.astype(state.velocity.dtype)), exact


def manufactured_error(cells: int, dimension: int, **choices: Any) -> float:
    """Largest error of a particle's displacement over the amplitude, at t_end (s)."""
    return manufactured_run(cells, dimension, **choices)[0]


def manufactured_run(cells: int, dimension: int, *, t_end: float = 0.02, **choices: Any) -> tuple[float, float]:
    """That error, and the seconds that the run took once compiled."""
    amplitude = choices.setdefault("amplitude", 0.02)
    scene, state, exact = posed(cells, dimension, **choices)
    mpm.solve(scene, state, t_end=float(scene.numerics.time_step))
    start = time.perf_counter()
    final = mpm.solve(scene, state, t_end=t_end).raise_if_failed().state
    seconds = time.perf_counter() - start
    reached = int(final.step) * float(scene.numerics.time_step)
    return float(jnp.max(jnp.abs(final.displacement - exact(scene.particles.position, reached)))) / amplitude, seconds
