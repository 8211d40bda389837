"""The initial stress of a grid: solved once per campaign, kept in its folder, read by whoever builds the grid again.

    initial/rough.h5              stress of all particles at rest, and of which grid it is
    initial/refined.h5

A file belongs to the grid whose particles, nodes, walls, moduli and gravity it was solved with, told by a checksum of
all these. One that is damaged, or of another grid, is named and the stress is solved again.
"""

from __future__ import annotations

import hashlib
import os
import warnings
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import h5py
import jax
import jax.numpy as jnp
import numpy as np

from foundation import files
from jaxmpm import Scene, State

KIND = "cooperative initial stress"
SCHEMA = 1


def initial_path(folder: Path, grid: str) -> Path:
    """File of a grid's initial stress, in the campaign's folder."""
    return folder / "initial" / f"{grid}.h5"


def read_initial(folder: Path, grid: str, scene: Scene, state: State) -> State | None:
    """The state of this grid with the stress that the folder keeps, None where it keeps none that can be trusted; a
    warning names a file that is damaged or of another grid."""
    path = initial_path(folder, grid)
    if not os.path.lexists(path):
        return None
    try:
        return _read(path, scene, state)
    except files.DamagedFile as error:
        warnings.warn(f"{error}: the initial stress is solved again", stacklevel=2)
        return None


def keep_initial(folder: Path, grid: str, scene: Scene, state: State) -> None:
    """Keep the stress of a grid at rest, unless the folder has it; what cannot be trusted is set aside. For the one
    controller. OSError where the disk refuses."""
    path = initial_path(folder, grid)
    files.claimed_folder(path.parent)
    if os.path.lexists(path):
        try:
            _read(path, scene, state)
            return
        except files.DamagedFile:
            files.set_aside(path)

    def fill(file: h5py.File) -> None:
        file.attrs.update(grid=_checksum(scene))
        file["stress"] = np.asarray(state.stress)

    files.write_sealed(path, KIND, SCHEMA, fill)


def _read(path: Path, scene: Scene, state: State) -> State:
    if path.parent.is_symlink():
        raise files.DamagedFile(f"{path} leads out of the campaign's folder")
    with files.read_sealed(path, KIND, SCHEMA) as file:
        of_grid, stress = file.scalars("/").get("grid"), file.array("/", "stress", dimensions=2, kinds="f")
    if of_grid != _checksum(scene):
        raise files.DamagedFile(f"{path} holds the initial stress of another grid")
    if (stress.shape, stress.dtype) != (state.stress.shape, state.stress.dtype) or not np.isfinite(stress).all():
        raise files.DamagedFile(f"{path} holds {stress.dtype} of shape {stress.shape}, or numbers that are not finite")
    return replace(state, stress=jnp.asarray(stress))


YOUNGER = ("wall_cohesion", "wall_pressure")
"""Parts that scenes did not have when the first of these files were written."""


def _structure(scene: Scene) -> str:
    """The text of a scene's structure, without the younger parts that it does not have: then it is as it was before."""

    def text(part: Any) -> str:
        return str(part).removeprefix("PyTreeDef(").removesuffix(")")

    structure: Any = jax.tree.structure(scene)
    names = (part.name for part in fields(scene) if not part.metadata.get("static"))
    parts = list(zip(names, map(text, structure.children()), strict=True))
    head = str(structure).removesuffix(", ".join(part for _, part in parts) + "]))")
    return head + ", ".join(part for name, part in parts if name not in YOUNGER or part != "None") + "]))"


def _checksum(scene: Scene) -> str:
    """SHA-256 of a grid's particles, nodes, walls, material and loads."""
    told = hashlib.sha256(_structure(scene).encode())
    for leaf in map(np.asarray, jax.tree.leaves(scene)):
        told.update(f"{leaf.dtype} {leaf.shape}".encode() + np.ascontiguousarray(leaf).tobytes())
    return told.hexdigest()
