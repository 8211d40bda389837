"""A strip footing on clay, whose bearing capacity is (2 + pi) c: Prandtl's mechanism, the same for smooth and rough.

A footing of great mass moves down at a constant velocity into weightless clay; its loss of momentum is the load. Half
of it is modelled, beside a plane of symmetry. Its nodes carry what clay they touch, so that it acts as wider by about
a cell: the capacity comes down to theory in the order of the cell.
Source: Prandtl (1920), Nachr. Ges. Wiss. Goettingen, 74-85.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm as mpm

CAPACITY = 2 + np.pi
HALF_WIDTH, CLAY_SIZE, FOOTING_HEIGHT = 1.0, (5.0, 3.0), 0.5
STRENGTH, SINKING = 10e3, 0.05
MASS_RATIO = 1e4


def loaded(cell: float, *, poisson: float = 0.49, **choices: Any) -> tuple[mpm.Scene, mpm.State]:
    """Clay of E / c = 500 between rollers, and the footing on it, moving at SINKING (m/s)."""
    spacing = choices.pop("spacing", cell / 2)
    numerics = mpm.Discretisation(cell, (spacing,) * 2, **choices)
    soil = mpm.Soil(young=500 * STRENGTH, poisson=poisson, strength=STRENGTH, tension_cutoff=None)
    width, depth = CLAY_SIZE
    size = (width, depth + FOOTING_HEIGHT)
    domain = (width, depth + 2 * FOOTING_HEIGHT)
    scene, state = mpm.block(size, soil, numerics, domain=domain, corner=(0.0, 0.0), walls="roller", speed=1.0)
    x, z = np.asarray(scene.particles.position)
    inside = np.flatnonzero((z < depth) | (x < HALF_WIDTH))
    particles, state = jax.tree.map(lambda leaf: leaf[..., inside] if leaf.ndim else leaf, (scene.particles, state))
    block = particles.position[1] > depth
    mass = jnp.where(block, MASS_RATIO, 1.0) * particles.mass
    strength = jnp.where(block, 1e3, 1.0) * STRENGTH
    scene = replace(scene, particles=replace(particles, mass=mass))
    scene = replace(scene, material=replace(scene.material, strength=strength.astype(mass.dtype)))
    return scene, replace(state, velocity=state.velocity.at[1].set(jnp.where(block, -SINKING, 0.0)))


def capacity(cell: float, *, settlement: float = 0.1, dtype: str = "float64", **choices: Any) -> dict[str, float]:
    """Load over strength and half width at a settlement (m), mean over its last tenth; seconds it took."""
    with jax.enable_x64(dtype == "float64"):
        scene, state = loaded(cell, dtype=dtype, **choices)
        block = scene.particles.mass > 2 * jnp.min(scene.particles.mass)

        def momentum(s: mpm.State) -> float:
            # In double precision: the change is a small part of it.
            weighted = np.asarray(scene.particles.mass * block, float) * np.asarray(s.velocity[1], float)
            return float(weighted.sum())

        t_end = settlement / SINKING
        mpm.solve(scene, state, t_end=float(scene.numerics.time_step))
        start = time.perf_counter()
        result = mpm.solve(scene, state, t_end=t_end, snapshots=[0.9 * t_end]).raise_if_failed()
        seconds = time.perf_counter() - start
        early = result.snapshots[0]
        elapsed = (int(result.state.step) - int(early.step)) * float(scene.numerics.time_step)
        load = (momentum(result.state) - momentum(early)) / elapsed
        return {"load": load / (STRENGTH * HALF_WIDTH), "seconds": seconds}
