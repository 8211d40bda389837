"""What a scene is discretised by: a grid, its walls, and particles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

from jax import Array

from jaxmpm.support.check import Limit, above_zero, from_zero
from jaxmpm.support.pytrees import pytree


def static(**kwargs: Any) -> Any:
    """A dataclass field that shapes the program: hashable, part of the compilation key.

    Args:
        **kwargs: of `dataclasses.field`.

    Returns:
        The field.
    """
    return field(metadata={"static": True}, **kwargs)


@pytree
@dataclass(frozen=True)
class NearNodes:
    """Nodes of a grid that lie near soil: of each column along the last axis those that soil reaches and those between.

    One more lies above them. They are stored one column after the other. Rows that remain beyond the last column hold
    no node.

    Args:
        first: (1, columns) row of the lowest node of each column, less that node's number in the column.
        node: (rows,) number of each row's node in the grid, -1 of a row without one.
        needed: () number of rows that the soil needs; with more than there are, the other two mean nothing.
    """

    first: Array
    node: Array
    needed: Array


@pytree
@dataclass(frozen=True)
class Grid:
    """Regular background grid.

    Args:
        shape: nodes per axis; static.
        cell: edge of a cell (m); static.
        origin: position of node 0 (m); static.
        stored: number of nodes that a step stores, those near the soil; None for all; static.
        near: the stored nodes, which each step finds; None outside a step, and where it stores all.
    """

    shape: tuple[int, ...] = static()
    cell: float = static()
    origin: tuple[float, ...] = static()
    stored: int | None = static(default=None)
    near: NearNodes | None = None

    @property
    def dimension(self) -> int:
        """Number of axes: 1, 2 or 3."""
        return len(self.shape)

    @property
    def nodes(self) -> int:
        """Number of nodes; nodes are numbered fastest along the last axis."""
        total = 1
        for n in self.shape:
            total *= n
        return total

    @property
    def rows(self) -> int:
        """Length of an array of values at the nodes that are stored."""
        return self.nodes if self.near is None else self.near.node.shape[-1]


Hold = Literal["fixed", "roller", "friction"]
"""What a wall does to the nodes that it constrains."""


@dataclass(frozen=True)
class Wall:
    """A plane normal to one axis that constrains the nodes on it and beyond it.

    Args:
        axis: index of the normal's axis.
        side: "low" constrains nodes up to `index`, "high" from `index` on.
        index: node number of the plane along the axis.
        hold: "fixed" stops all motion, "roller" the normal one; "friction" stops motion into the wall and slows motion
            along it (Coulomb, with cohesion if the scene has some).
    """

    axis: int
    side: Literal["low", "high"]
    index: int
    hold: Hold


@pytree
@dataclass(frozen=True)
class RigidBase:
    """Rigid ground of any shape, on whose surface soil slides with friction.

    Args:
        normal: (nodes, d) unit vectors away from the ground at its nodes; 0 at all others.
        area: (nodes,) area of the surface at the nodes, 0 at all others (m2).
        volume: (nodes,) volume of soil that maps to a node where full cells of it cover the surface (m3).
    """

    normal: Array
    area: Array
    volume: Array

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {"area": from_zero("m2"), "volume": above_zero("m3")}


@pytree
@dataclass(frozen=True)
class Particles:
    """Constant properties of particles.

    In plane strain masses and volumes are per metre of width, in 1D per square metre of section.

    Args:
        position: initial one (d, N) m.
        mass: (N,) kg.
        volume: initial one (N,) m3.
    """

    position: Array
    mass: Array
    volume: Array

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {"mass": above_zero("kg"), "volume": above_zero("m3")}
