"""A section whose heights change while its particles stay: heights that a result is differentiated by."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxmpm.ground._section import Section
from jaxmpm.setup import check_start, settled, unstressed
from jaxmpm.support import check
from jaxmpm.support.tracing import require_known
from jaxmpm.types import Scene, State


def reshaped(scene: Scene, state: State, shape: Section, heights: ArrayLike) -> tuple[Scene, State]:
    """The section with other heights of its surface, with the same particles.

    The uppermost particle of each column takes, or loses, the soil between both surfaces: its volume and mass change,
    as those of a terrain are the parts of their boxes below the surface. The initial stress is solved again, unless
    there is none. Heights may be traced.

    Args:
        scene: built by `section` of the shape.
        state: at which it starts; it has not moved.
        shape: the outline that the scene was built of.
        heights: of the points of `shape.surface` (n,) m. A surface that moves by as much as a particle is high is one
            of other particles.

    Returns:
        Scene and state.

    Raises:
        ValueError: If there is another number of heights, the surface moves too far, the state has moved, or the scene
            has a free field or r_u, which stay as they were.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> import jaxmpm as mpm
        >>> shape = mpm.Section([(0, 6), (6, 6), (10, 2), (20, 2)])
        >>> grid = mpm.Discretisation(cell=2.0, spacing=(1.0, 1.0))
        >>> scene, state = mpm.section(shape, mpm.Soil(strength=9e3), grid)
        >>> def weight(z):
        ...     return jnp.sum(mpm.ground.reshaped(scene, state, shape, z)[0].particles.mass)
        >>> jax.grad(weight)(jnp.asarray([6.0, 6.0, 2.0, 2.0])).shape
        (4,)
    """
    x, before = np.asarray(shape.surface, float).T
    if np.shape(heights) != before.shape:
        raise ValueError(f"heights have shape {np.shape(heights)}: give {before.shape}, one for each point of surface")
    if scene.free_field is not None or scene.loads.pore_pressure is not None:
        raise ValueError("heights with a free field, or with r_u, which would stay: build the section anew")
    check_start(state, {"unit_weight"})
    require_known({"particles' position": scene.particles.position}, "close over the scene, and trace heights alone")
    position, dtype = np.asarray(scene.particles.position, float), scene.particles.mass.dtype
    order = np.lexsort((position[-1], position[0]))
    uppermost = order[np.r_[np.diff(position[0, order]) > 0, True]]
    at, spacing = position[0, uppermost], np.diff(np.unique(position[-1])).min()
    after = jnp.interp(jnp.asarray(at, dtype), jnp.asarray(x, dtype), jnp.asarray(heights, dtype))
    change = (after - shape.heights(at).astype(dtype)) / spacing
    check.require(
        abs(change) < 1,
        f"heights move the surface by {spacing:g} m or more, the height of a particle: build the section anew",
    )
    ratio = jnp.ones(position.shape[1], dtype).at[uppermost].add(change)
    particles = replace(scene.particles, volume=scene.particles.volume * ratio, mass=scene.particles.mass * ratio)
    moved = replace(scene, particles=particles)
    if not check.is_traced(state.stress) and not np.any(np.asarray(state.stress)):
        return moved, state
    return moved, settled(moved, unstressed(moved, apic=state.affine is not None))
