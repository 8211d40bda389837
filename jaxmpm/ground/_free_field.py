"""Sections without walls at their ends: dashpots that absorb waves join each end to a column of level ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from jaxmpm.equations import Maps, free_field, particles_to_grid
from jaxmpm.ground._boundaries import Height, Outline
from jaxmpm.setup import PADDING, Discretisation
from jaxmpm.soil import Interface
from jaxmpm.transfer import GIMP, Linear
from jaxmpm.types import FreeField, Scene, Scheme, State


def check_free_field(discretisation: Discretisation, interface: Interface | None) -> None:
    """Raise ValueError for an interface, and for numerical choices, that do not work with ends without walls."""
    if interface is not None:
        raise ValueError("ends = 'free field' with an interface on the base, which ground beyond it would need too")
    if discretisation.scheme is Scheme.USF:
        raise ValueError("ends = 'free field' with scheme = USF, whose stress is a step ahead: take MUSL or USL")
    if discretisation.kernel not in (GIMP, Linear):
        raise ValueError(
            f"ends = 'free field' with kernel = {discretisation.kernel.__name__}, which spreads the forces on an end "
            "over more nodes than its own: take GIMP"
        )
    if discretisation.internal_length is not None:
        raise ValueError(
            f"internal_length = {discretisation.internal_length:g} m with ends = 'free field', whose columns are "
            "narrower: leave it out"
        )


def with_free_field(
    scene: Scene, state: State, low: tuple[Scene, State], high: tuple[Scene, State]
) -> tuple[Scene, State]:
    """Replace the walls at both ends by a free field.

    The forces of these walls at rest continue to act on the ends.

    Args:
        scene: of a section.
        state: at rest between its walls, or free of stress.
        low: scene and state of the column of level ground at the low end, with tied sides; at rest if `state` is.
        high: those at the high end.

    Returns:
        Scene and state with the free field.
    """
    (left, left_state), (right, right_state) = low, high
    planes = (PADDING, scene.grid.shape[0] - 1 - PADDING)
    nothing = jnp.zeros((2, *scene.grid.shape[1:], scene.grid.dimension), state.stress.dtype)
    field = FreeField(left, right, nothing, planes)
    walls = tuple(wall for wall in scene.boundary.walls if wall.axis != 0)
    scene = replace(scene, boundary=replace(scene.boundary, walls=walls), free_field=field)
    state = replace(state, free_field=(left_state, right_state))
    if not np.any(np.asarray(state.stress)):
        return scene, state
    nodal = particles_to_grid(scene, state, scene.numerics.time_step, Maps(scene, scene.particles.position))
    assert nodal.force is not None
    traction = free_field(scene, state, scene.numerics.time_step).traction
    net = (nodal.force + nodal.mass * scene.loads.gravity).reshape(*scene.grid.shape, -1)[jnp.asarray(planes)]
    return replace(scene, free_field=replace(field, reaction=-net - traction)), state


def check_level(tops: Sequence[Height], outline: Outline, discretisation: Discretisation, names: Sequence[str]) -> None:
    """Raise ValueError unless the surface and layers are level within a cell of each wall, to half a particle."""
    left, right = outline.walls
    for wall, within in ((left, left + discretisation.cell), (right, right - discretisation.cell)):
        for name, top in zip(names, tops, strict=False):
            at, inside = top(np.array([wall, within]))
            if abs(at - inside) > discretisation.spacing[-1] / 2:
                raise ValueError(
                    f"ends = 'free field', but the top of {name} goes from {inside:g} to {at:g} m within a "
                    f"cell of the wall at x = {wall:g} m: draw it on level there, ground beyond it is taken as level"
                )
