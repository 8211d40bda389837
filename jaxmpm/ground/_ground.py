"""Ground: a protocol that slopes, sections, terrain and a user's own class meet, and what follows from it."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from foundation import check
from foundation.text import shown
from jaxmpm.ground._layer import Box, Layer
from jaxmpm.ground._seam import Thickness, thicknesses_of
from jaxmpm.setup import (
    PADDING,
    ROUNDING,
    Discretisation,
    Hold,
    below,
    build,
    cells_up,
    check_discretisation,
    check_resolved,
    end_walls,
    fill,
    material_on,
    settled,
    sorted_by_cell,
)
from jaxmpm.soil import STANDARD_GRAVITY, AnySoil, law_of_layers, weights
from jaxmpm.types import Grid, Material, Particles, Scene, State, Wall

PLAN = {1: 4096, 2: 256}
"""Points along each horizontal axis at which ground is sampled, by the number of these axes."""

PROBED = {1: (512,), 2: (48, 48)}
"""Columns of points at which layers are sampled, by the number of horizontal axes."""

PROBED_UP = 256
"""Points in each of these columns."""

HALVINGS = 20
"""Bisection steps for a layer's top, which is then known to a millionth of the height above a point."""


@dataclass(frozen=True)
class Face:
    """The face of a slope that falls along x and does not vary along y.

    Args:
        toe_x: position of its toe (m).
        toe_z: elevation of its toe (m).
        height: from the toe to the crest (m).
    """

    toe_x: float
    toe_z: float
    height: float

    @property
    def crest_z(self) -> float:
        """Elevation of the crest (m)."""
        return self.toe_z + self.height


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


def scene_of(
    ground: Ground,
    soil: AnySoil | Sequence[Layer],
    discretisation: Discretisation,
    *,
    inside: Callable[[np.ndarray], np.ndarray] | None = None,
    gravity: float = 9.81,
    ends: Sequence[Hold] = ("roller", "roller"),
    speed: float | None = None,
    at_rest: bool = True,
) -> tuple[Scene, State]:
    """Fill ground with a lattice of particles, on a fixed base between upright walls.

    Args:
        ground: its box, surface and layers.
        soil: one for all, or layers from the top down; `ground.layer_of` gives the layer of each particle.
        discretisation: cell, spacing and numerical choices.
        inside: function of positions (d, N) m that returns (N,) bool, which of them lie in the ground; by default those
            below its surface.
        gravity: downwards (m/s2).
        ends: constraint of both walls along x, and along y.
        speed: largest particle speed that the time step allows for (m/s), by default of a fall through half the box.
        at_rest: with the stress of elastic gravity loading, else free of stress.

    Returns:
        Scene and state.

    Raises:
        ValueError: If sizes, soils and numbers do not fit the grid or each other.
    """
    check.not_negative("gravity", gravity, "m/s2")
    layers = list(soil) if isinstance(soil, Sequence) else [Layer(soil)]
    counts = cells(ground, discretisation)
    grid = box_grid(ground.corner, counts, discretisation.cell)
    particles, law = lattice(ground, layers, discretisation, grid, inside=inside)
    upright = len(ground.corner) - 1
    walls = [wall for axis, hold in enumerate(ends[:upright]) for wall in end_walls(axis, counts[axis], hold)]
    built, state = build(
        particles,
        grid,
        law,
        discretisation,
        walls=(*walls, Wall(upright, "low", PADDING, "fixed")),
        gravity=gravity,
        speed=math.sqrt(gravity * ground.extent[-1]) if speed is None else speed,
    )
    return built, settled(built, state) if at_rest else state


def lattice(
    ground: Ground,
    layers: Sequence[Layer],
    discretisation: Discretisation,
    grid: Grid,
    *,
    inside: Callable[[np.ndarray], np.ndarray] | None = None,
    wet: Callable[[np.ndarray], np.ndarray] | None = None,
) -> tuple[Particles, Material]:
    """Particles of a lattice that lie in the ground, each with the mass of its layer, and their law.

    Args:
        ground: its box, surface and layers.
        layers: from the top down.
        discretisation: cell, spacing and numerical choices.
        grid: that the particles are sorted by.
        inside: function of positions (d, N) m that returns (N,) bool, which of them lie in the ground; by default those
            below its surface.
        wet: function of positions that returns which of them lie under a water table; by default none.

    Returns:
        Particles and their law.
    """
    corner, spacing, dz = np.array(ground.corner, float), discretisation.spacing, discretisation.spacing[-1]

    def under(position: np.ndarray) -> np.ndarray:
        return below(position[-1], ground.heights(*position[:-1]), ROUNDING * dz)

    within = under if inside is None else inside
    particles = fill(
        (*ground.extent[:-1], math.ceil(ground.extent[-1] / dz * (1 - 1e-12)) * dz),
        spacing,
        unit_weight=STANDARD_GRAVITY,
        inside=lambda position: within(position + corner[:, None]),
        corner=tuple(corner.tolist()),
        dtype=discretisation.dtype,
    )
    particles = sorted_by_cell(particles, grid)
    position = np.asarray(particles.position, float)
    number, soils = layer_of(ground, layers, position, discretisation), [each.soil for each in layers]
    law, order = law_of_layers([material_on(discretisation, soil) for soil in soils], number)
    mass = weights(soils, number, None if wet is None else wet(position)) / STANDARD_GRAVITY * np.prod(spacing)
    particles = replace(particles, mass=jnp.asarray(mass, particles.mass.dtype))
    return jax.tree.map(lambda leaf: leaf[..., order], particles), law


def build_ground(
    ground: Ground, layers: Sequence[Layer], discretisation: Discretisation, **loads: Any
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
    given = {name: value for name, value in loads.items() if value is not None}
    parameters = inspect.signature(ground.build).parameters
    if not any(each.kind is inspect.Parameter.VAR_KEYWORD for each in parameters.values()):
        for name in given.keys() - parameters.keys():
            raise ValueError(
                f"{name} = {shown(given[name])}, and {type(ground).__name__}.build takes none: leave it out"
            )
    return ground.build(layers, discretisation, **given)


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


def cells(ground: Any, discretisation: Discretisation) -> list[int]:
    """Cells of a grid along each axis, with air above the highest point.

    Args:
        ground: its own `cells` is used if it has one.
        discretisation: cell, spacing and numerical choices.

    Returns:
        Number of cells along each axis.

    Raises:
        ValueError: If ground or grid is invalid, or they do not fit each other.
    """
    if hasattr(ground, "cells"):
        return ground.cells(discretisation)
    check_ground(ground)
    return box_cells("the ground", ground, discretisation)


def box_cells(what: str, ground: Ground, discretisation: Discretisation) -> list[int]:
    """Cells along each axis of a grid that ends at the walls of a box of ground.

    Args:
        what: name of the ground in messages.
        ground: its box.
        discretisation: cell, spacing and numerical choices.

    Returns:
        Number of cells along each axis.

    Raises:
        ValueError: If the grid does not fit the box.
    """
    check_discretisation(discretisation, len(ground.corner))
    counts = []
    for axis, length, spacing in zip("xy", ground.extent[:-1], discretisation.spacing, strict=False):
        name = f"{what}'s length" + (f" along {axis}" if len(ground.corner) == 3 else "")
        check.multiple(name, length, f"the spacing along {axis}", spacing)
        counts.append(check.multiple(name, length, "cell", discretisation.cell))
    check_resolved(what, ground.corner, ground.extent, discretisation)
    return [*counts, cells_up(discretisation, ground.extent[-1])]


def box_grid(corner: Sequence[float] | np.ndarray, counts: Sequence[int], cell: float) -> Grid:
    """Grid with `counts` cells along each axis from a corner (d,) m, and PADDING cells beyond the walls."""
    origin = np.array(corner) - PADDING * cell
    return Grid(tuple(count + 1 + 2 * PADDING for count in counts), cell, tuple(origin.tolist()))


def volume(ground: Any) -> float:
    """Volume of the ground, in plane strain per metre of width.

    Args:
        ground: its own `volume` is used if it has one, else that below its surface.

    Returns:
        m3, in plane strain m2.
    """
    if hasattr(ground, "volume"):
        return ground.volume
    return float(np.mean(_surface(ground) - ground.corner[-1]) * math.prod(ground.extent[:-1]))


def relief(ground: Any) -> float:
    """Height of the ground's highest point above its lowest.

    Args:
        ground: its own `relief` is used if it has one, else that of its surface.

    Returns:
        m.
    """
    return ground.relief if hasattr(ground, "relief") else float(np.ptp(_surface(ground)))


def _surface(ground: Ground) -> np.ndarray:
    """Elevations (n,) m of the surface, at points spread evenly in plan."""
    axes = len(ground.corner) - 1
    return ground.heights(*_spread(ground, (PLAN[axes],) * axes))


def _spread(ground: Ground, counts: Sequence[int]) -> list[np.ndarray]:
    """Coordinates (n,) m of the centres of `counts` equal parts of the box along each axis, of the first axes."""
    sides = zip(ground.corner, ground.extent, counts, strict=False)
    axes = [low + edge * (np.arange(count) + 0.5) / count for low, edge, count in sides]
    return [axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")]


def thicknesses(ground: Any, layers: Sequence[Layer]) -> list[Thickness]:
    """Thickness of each layer, and whether it is a weak seam.

    Args:
        ground: its own `thicknesses` is used if it has one; else they are sampled, to a 256th of its height.
        layers: from the top down.

    Returns:
        One per layer.

    Raises:
        ValueError: If the layers are invalid.
    """
    if hasattr(ground, "thicknesses"):
        return ground.thicknesses(layers)
    number, step = _probed(ground, layers)
    thick = [(number == each).sum(axis=-1).ravel() * step[-1] for each in range(len(layers))]
    return thicknesses_of(layers, [-np.sum(thick[:each], axis=0) for each in range(len(layers) + 1)])


def box_of(ground: Any, layers: Sequence[Layer], number: int) -> Box:
    """A box that holds a layer.

    Args:
        ground: its own `box_of` is used if it has one; else the layer is sampled, to a 256th of its height.
        layers: from the top down.
        number: of the layer, from 0.

    Returns:
        Lowest corner and edges (m).

    Raises:
        ValueError: If there is no ground of this layer.
    """
    if hasattr(ground, "box_of"):
        return ground.box_of(layers, number)
    probed, step = _probed(ground, layers)
    at = np.argwhere(probed == number)
    if not at.size:
        raise ValueError(f"layer {number + 1} lies nowhere between the walls: draw it there, or leave it out")
    low, high = np.maximum(at.min(axis=0) - 1, 0), np.minimum(at.max(axis=0) + 2, probed.shape)
    return tuple((ground.corner + low * step).tolist()), tuple(((high - low) * step).tolist())


def top_of(
    ground: Ground, layers: Sequence[Layer], number: int, position: np.ndarray, discretisation: Discretisation
) -> np.ndarray:
    """Elevation of the top of a layer above points in it, to a millionth of the height above each.

    It bisects `layer_of` between each point and the surface.

    Args:
        ground: of the layers.
        layers: from the top down.
        number: of the layer, from 0.
        position: of the points (d, N) m; a point above the layer gets its own elevation.
        discretisation: cell, spacing and numerical choices.

    Returns:
        (N,) m.

    Raises:
        ValueError: If `layer_of` gives no valid numbers.
    """
    plan, low = position[:-1], np.array(position[-1], float)
    high = np.maximum(ground.heights(*plan), low)
    for _ in range(HALVINGS if number else 0):
        middle = (low + high) / 2
        under = layer_of(ground, layers, np.stack([*plan, middle]), discretisation) >= number
        low, high = np.where(under, middle, low), np.where(under, high, middle)
    return high


def _probed(ground: Ground, layers: Sequence[Layer]) -> tuple[np.ndarray, np.ndarray]:
    """Layer number at the centres of equal parts of the box, -1 above the surface; edges (d,) m of the parts."""
    counts = (*PROBED[len(ground.corner) - 1], PROBED_UP)
    step = np.array(ground.extent) / counts
    position = np.stack(_spread(ground, counts))
    numerics = Discretisation(float(step.max()), tuple(step.tolist()))
    number = layer_of(ground, layers, position, numerics)
    under = position[-1] < ground.heights(*position[:-1])
    return np.where(under, number, -1).reshape(counts), step
