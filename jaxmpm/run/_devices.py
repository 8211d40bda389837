"""Lanes over the devices of a machine: each device runs its own, and no step waits for another device."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax import Array
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxmpm.types import Scene, State

LANES, ALL = PartitionSpec("lanes"), PartitionSpec()


def devices_of(lanes: int | None = None) -> list[jax.Device]:
    """The devices of this process that share some lanes evenly: as many as divide their number.

    Args:
        lanes: their number; None for all devices that lanes may run on.

    Returns:
        Devices; the one that `jax.default_device` names, where it does.
    """
    chosen = jax.config.jax_default_device  # type: ignore[attr-defined]  # set by JAX when it is imported
    if isinstance(chosen, str):  # a platform
        chosen = jax.local_devices(backend=chosen)[0]
    devices = jax.local_devices() if chosen is None else [chosen]
    if lanes is None:
        return devices
    return devices[: max(n for n in range(1, min(lanes, len(devices)) + 1) if lanes % n == 0)]


def mesh_of(lanes: int) -> Mesh | None:
    """The devices that share some lanes, see `devices_of`.

    Args:
        lanes: their number.

    Returns:
        Mesh with the axis "lanes"; None for one device.
    """
    devices = devices_of(lanes)
    return Mesh(np.array(devices), ("lanes",)) if len(devices) > 1 else None


def placed(scene: Scene, state: State, axes: Scene, mesh: Mesh | None) -> tuple[Scene, State]:
    """Scene and state of some lanes where their devices have them; as they are on a machine with one device.

    Args:
        scene: of all lanes.
        state: of all lanes.
        axes: leaves of the scene that have lanes first.
        mesh: of these lanes.
    """
    devices = devices_of()
    if len(devices) == 1:
        return scene, state
    if mesh is None:
        return jax.device_put((scene, state), devices[0])
    every, lane = NamedSharding(mesh, ALL), NamedSharding(mesh, LANES)
    where = jax.tree.map(lambda axis: every if axis is None else lane, axes, is_leaf=lambda node: node is None)
    return jax.device_put(scene, where), jax.device_put(state, lane)


def over_devices(
    function: Callable[[Scene, State, Array], State], axes: Scene | None, steps: Array, mesh: Mesh | None
) -> Callable[[Scene, State, Array], State]:
    """The function of lanes, of which each device of a mesh computes its own.

    Args:
        function: of scene, state and steps of lanes.
        axes: leaves of the scene that have lanes first.
        steps: () for all lanes, or (B,) for each.
        mesh: of the lanes, None for one device.
    """
    if mesh is None:
        return function
    scene: Any = jax.tree.map(lambda axis: ALL if axis is None else LANES, axes, is_leaf=lambda node: node is None)
    parts = (scene, LANES, LANES if np.ndim(steps) else ALL)
    return jax.shard_map(function, mesh=mesh, in_specs=parts, out_specs=LANES, check_vma=False)
