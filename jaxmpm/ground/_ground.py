"""Ground: a protocol that slopes, sections, terrain and a user's own class meet, and its checks."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from jaxmpm.ground._layer import Layer
from jaxmpm.setup import Discretisation
from jaxmpm.support import check
from jaxmpm.support.text import shown
from jaxmpm.types import Scene, State


@dataclass(frozen=True)
class Face:
    """The face of a slope that falls along x and does not vary along y.

    Args:
        toe_x: position of its toe (m).
        toe_z: elevation of its toe (m).
        height: from the toe to the crest (m).
        downhill: direction along x in which it falls to its toe.
    """

    toe_x: float
    toe_z: float
    height: float
    downhill: Literal[1, -1] = 1

    @property
    def crest_z(self) -> float:
        """Elevation of the crest (m)."""
        return self.toe_z + self.height

    def beyond(self, x: np.ndarray) -> np.ndarray:
        """How far (n,) m positions x (n,) m lie beyond the toe; below 0 behind it."""
        return self.downhill * (x - self.toe_x)


class Ground(Protocol):
    """Ground from which scenes are built: `Slope`, `Section`, `Terrain`, or a user's own class with these members.

    A class may have further members: `check()`, `cells(discretisation)`, `volume`, `relief`, `thicknesses(layers)` and
    `box_of(layers, number)`. Without them the functions of the same name in `jaxmpm.ground` compute these values.
    `scene_of` builds ground that is filled with a lattice of particles.
    """

    @property
    def corner(self) -> tuple[float, ...]:
        """Lowest corner (d,) m of the bounding box, d = 2 in plane strain, else 3; the last coordinate is its base."""

    @property
    def extent(self) -> tuple[float, ...]:
        """Edges (d,) m of the bounding box."""

    @property
    def face(self) -> Face | None:
        """The face of its slope, whose toe run-out is measured from; None for ground without a toe."""

    @property
    def heights(self) -> Callable[..., np.ndarray]:
        """A function of x or, in 3D, of x and y: elevation (n,) m of the surface at points (n,) m in plan."""

    @property
    def build(self) -> Callable[..., tuple[Scene, State]]:
        """A function of layers and discretisation, with keywords gravity and at_rest, that gives scene and state.

        The state has the stress of elastic gravity loading if `at_rest`. The function also takes those of `ends`,
        `water` and `r_u` that the ground supports.
        """

    def layer_of(self, layers: Sequence[Layer], position: np.ndarray, discretisation: Discretisation) -> np.ndarray:
        """Number (N,) int, from 0, of the layer that particles at position (d, N) m lie in."""


def build_ground(
    ground: Ground, layers: Sequence[Layer], discretisation: Discretisation, **loads: object
) -> tuple[Scene, State]:
    """Call the ground's own `build` for layers.

    Args:
        ground: to build.
        layers: from the top down.
        discretisation: cell, spacing and numerical choices.
        **loads: further arguments of `build`: gravity (m/s2), at_rest, ends, water, r_u; None is left out.

    Returns:
        Scene and state.

    Raises:
        ValueError: If the object is no ground, or does not support a load.
    """
    check_ground(ground)
    applied = {name: value for name, value in loads.items() if value is not None}
    parameters = inspect.signature(ground.build).parameters
    if not any(parameter.kind is inspect.Parameter.VAR_KEYWORD for parameter in parameters.values()):
        for name, value in applied.items():
            if name not in parameters:
                raise ValueError(f"{name} = {shown(value)}, and {type(ground).__name__}.build takes none: leave it out")
    return ground.build(layers, discretisation, **applied)


def check_ground(ground: Ground) -> None:
    """Check that an object is a valid ground.

    Args:
        ground: an object.

    Raises:
        ValueError: If it lacks a member of `Ground`, its box is invalid, its toe lies outside the box, or its own
            `check` refuses it.
    """
    members = [name for name in vars(Ground) if not name.startswith("_")]
    missing = [name for name in members if not hasattr(type(ground), name) and not hasattr(ground, name)]
    if missing:
        raise ValueError(f"{type(ground).__name__} lacks {', '.join(missing)}: add the members of jaxmpm.Ground")
    if hasattr(ground, "check"):
        ground.check()
    if len(ground.corner) not in (2, 3) or len(ground.extent) != len(ground.corner):
        raise ValueError(
            f"{type(ground).__name__} has corner {ground.corner} and extent {ground.extent}: give (x, z) in plane "
            "strain, or (x, y, z)"
        )
    check.finite("corner", ground.corner, "m")
    check.positive("extent", ground.extent, "m")
    face, low, high = ground.face, ground.corner[0], ground.corner[0] + ground.extent[0]
    if face is not None and not low < face.toe_x < high:
        raise ValueError(
            f"the face of {type(ground).__name__} has its toe at x = {face.toe_x:g} m, outside the ground, which "
            f"reaches from {low:g} to {high:g} m: give a toe in it, or None"
        )
    if face is not None:
        check.positive("height of the face", face.height, "m")


def layer_of(
    ground: Ground, layers: Sequence[Layer], position: np.ndarray, discretisation: Discretisation
) -> np.ndarray:
    """Layer of particles by the ground's own `layer_of`, checked.

    Args:
        ground: of the layers.
        layers: from the top down.
        position: (d, N) m.
        discretisation: cell, spacing and numerical choices.

    Returns:
        (N,) int, numbers from 0.

    Raises:
        ValueError: If the result is not one number of a layer for each particle.
    """
    number = np.asarray(ground.layer_of(layers, position, discretisation))
    if number.shape != position.shape[1:] or number.dtype.kind not in "iu":
        raise ValueError(
            f"{type(ground).__name__}.layer_of gave {number.dtype} of shape {number.shape}: give one int for each of "
            f"{position.shape[1]} particles"
        )
    if number.size and not 0 <= number.min() <= number.max() < len(layers):
        raise ValueError(
            f"{type(ground).__name__}.layer_of gave layers {number.min()} to {number.max()}: give 0 to "
            f"{len(layers) - 1}"
        )
    return number
