"""A grid's model, built.

Its stress at rest is solved once per campaign, stored in its folder, and read by whoever builds the grid again.

    initial/rough.h5              stress of all particles at rest, and of which grid it is
    initial/refined.h5

A file belongs to the grid whose particles, nodes, walls, moduli and gravity it was solved with, by a checksum of
all these. One that is damaged, or of another grid, is named and the stress is solved again.
"""

from __future__ import annotations

import hashlib
import os
import warnings
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import h5py
import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import PyTreeDef

import jaxmpm
from cooperative.runs._derived import RATIO, SATURATED
from cooperative.runs._model import GridModel
from cooperative.runs._random_soil import RandomSoil
from cooperative.scene import CONTACT, Campaign, built
from jaxmpm import Scene, State
from jaxmpm.laws import declared
from jaxmpm.support import files, hdf5

KIND = "cooperative initial stress"
SCHEMA = 1
SAME_STRESS = 1e-3
"""Difference over the largest stress up to which two are the same: conjugate gradients end at 1e-5 of the load."""


def build(
    campaign: Campaign, grid: str, soil: RandomSoil, *, at_rest: bool = True, folder: Path | None = None
) -> GridModel:
    """Scene and initial state of one grid.

    Args:
        campaign: the campaign.
        grid: "rough" or "refined".
        soil: random soil of the campaign.
        at_rest: False leaves the state free of stress, which is not solved for then: to look at a grid that does not
            run.
        folder: of the campaign, whose initial stress is taken where it stores one of this grid.

    Raises:
        ValueError: slope, soil, grid and elements at risk do not fit together.
    """
    # The forces that hold the ends of a free field belong to the scene, and to its stress at rest.
    free_field = campaign.site.ends == "free field"
    scene, state = built(campaign, grid, at_rest=at_rest and free_field)
    _refuse_unknown(campaign.random, scene)
    if at_rest and not free_field:
        stored = None if folder is None else _read_initial(folder, grid, scene, state)
        state = jaxmpm.at_rest(scene, apic=campaign.grids[grid].apic) if stored is None else stored
    layer = campaign.site.layer_of(np.asarray(scene.particles.position), campaign.grids[grid])
    model = GridModel(grid, campaign, scene, state, soil, layer=layer, stress=_effective_stress(campaign, scene))
    return replace(model, growth=model.growth_of_trends()).with_measured(campaign)


def _effective_stress(campaign: Campaign, scene: Scene) -> jax.Array | None:
    """Vertical (N,) Pa, at rest, of the weight of soil with its means; None where no strength goes with it.

    The elastic stress of a grid would not do: within a cell of the surface it is half of that, or less. Nor does an
    earthquake change the stress under which soil has consolidated.
    """
    if campaign.site.by_stress(campaign.soil) is None:
        return None
    borne, upright = campaign.site.r_u or 0.0, jnp.zeros_like(scene.loads.gravity).at[-1].set(-campaign.run.gravity)
    scene = replace(scene, loads=replace(scene.loads, gravity=upright))
    return jnp.asarray((1 - borne) * jaxmpm.overburden(scene), scene.particles.mass.dtype)


def _refuse_unknown(random: Collection[str], scene: Scene) -> None:
    """Raise ValueError for what varies and is no parameter of the soil."""
    names = [*declared(scene.material), "young", "poisson", "unit_weight", SATURATED, "k0"]
    names += [RATIO] if "strength" in names else []
    names += [name for name in CONTACT if getattr(scene.boundary, name.removeprefix("interface_")) is not None]
    unknown = [name for name in random if name not in names]
    if unknown:
        raise ValueError(
            f"random holds {', '.join(unknown)}, which is no parameter of {type(scene.material).__name__}: give some "
            f"of {', '.join(names)}"
        )


def initial_path(folder: Path, grid: str) -> Path:
    """File of a grid's initial stress, in the campaign's folder."""
    return folder / "initial" / f"{grid}.h5"


def _read_initial(folder: Path, grid: str, scene: Scene, state: State) -> State | None:
    """The state of this grid with the stress that the folder stores.

    None where it stores none that can be trusted; a warning names a file that is damaged or of another grid.
    """
    path = initial_path(folder, grid)
    if not os.path.lexists(path):
        return None
    try:
        return _read(path, scene, state)
    except files.DamagedFile as error:
        warnings.warn(f"{error}: the initial stress is solved again", stacklevel=2)
        return None


def keep_initial(folder: Path, grid: str, scene: Scene, state: State) -> None:
    """Keep the stress of a grid at rest, unless the folder has it; what cannot be trusted is set aside.

    For the one controller.

    Args:
        folder: of the campaign.
        grid: "rough" or "refined".
        scene: of the grid.
        state: of the grid, at rest.

    Raises:
        OSError: the disk refuses.
    """
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

    hdf5.write_sealed(path, KIND, SCHEMA, fill)


def verify_initial(folder: Path, model: GridModel) -> None:
    """Solve for the stress of a grid at rest anew, and compare.

    A checksum tells damage. It does not tell a file that somebody made for another answer.

    Args:
        folder: of the campaign.
        model: of the grid, with the stress that its folder stores.

    Raises:
        ValueError: the folder stores another stress than the grid has.
    """
    campaign, grid = model.campaign, model.grid
    if campaign.site.ends == "free field":
        return  # whose stress is always solved for
    stored = np.asarray(model.state.stress, float)
    solved = np.asarray(jaxmpm.at_rest(model.scene, apic=campaign.grids[grid].apic).stress, float)
    off = float(np.abs(stored - solved).max() / max(np.abs(solved).max(), np.finfo(float).tiny))
    if off > SAME_STRESS:
        raise ValueError(
            f"{initial_path(folder, grid)} differs from the stress at rest of its scene by {off:.2g} of the largest "
            "stress: whoever wrote it changed the answer, so begin the scene in another folder"
        )


def _read(path: Path, scene: Scene, state: State) -> State:
    if path.parent.is_symlink():
        raise files.DamagedFile(f"{path} leads out of the campaign's folder")
    with hdf5.read_sealed(path, KIND, SCHEMA) as file:
        of_grid, stress = file.scalars("/").get("grid"), file.array("/", "stress", dimensions=2, kinds="f")
    if of_grid != _checksum(scene):
        raise files.DamagedFile(f"{path} holds the initial stress of another grid")
    if (stress.shape, stress.dtype) != (state.stress.shape, state.stress.dtype) or not np.isfinite(stress).all():
        raise files.DamagedFile(f"{path} holds {stress.dtype} of shape {stress.shape}, or numbers that are not finite")
    return jaxmpm.with_stress(scene, state, jnp.asarray(stress))


def _checksum(scene: Scene) -> str:
    """SHA-256 of a grid's particles, nodes, walls, material and loads by name; what is absent (None) is left out."""

    def static(part: PyTreeDef) -> list[str]:
        kind = part.node_data()
        words = [] if kind is None or kind[0] is type(None) else [str(kind[1])]
        return words + [text for child in part.children() for text in static(child)]

    digest = hashlib.sha256(str(static(jax.tree.structure(scene))).encode())
    for path, leaf in jax.tree_util.tree_leaves_with_path(scene):
        digest.update(jax.tree_util.keystr(path).encode() + _content(np.asarray(leaf)))
    return digest.hexdigest()


def _content(leaf: np.ndarray) -> bytes:
    return f"{leaf.dtype} {leaf.shape}".encode() + np.ascontiguousarray(leaf).tobytes()
