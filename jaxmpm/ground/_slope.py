"""A slope over a foundation, given by lengths in metres."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from jaxmpm.ground._fill import scene_of
from jaxmpm.ground._ground import Face, Ground
from jaxmpm.ground._layer import Layer
from jaxmpm.ground._section import Section
from jaxmpm.laws import BaseMotion
from jaxmpm.setup import Discretisation, cells_up, check_discretisation
from jaxmpm.soil import AnySoil
from jaxmpm.support import check
from jaxmpm.support.check import Limit, above_zero, from_zero
from jaxmpm.support.values import by_value
from jaxmpm.types import Scene, State


@by_value
@dataclass(frozen=True)
class Slope:
    """A slope over a foundation, falling along x from the crest at x = 0.

    Args:
        crest: flat length behind the slope (m).
        height: of the slope (m).
        run_per_rise: horizontal over vertical; 2 is 1:2.
        toe: flat length in front of the slope (m).
        foundation: thickness below the toe (m).
        width: along y (m); None for a section in plane strain.
    """

    LIMITS: ClassVar[Mapping[str, Limit]] = {
        **dict.fromkeys(("crest", "height", "toe", "foundation", "width"), above_zero("m")),
        "run_per_rise": from_zero(),
    }

    crest: float = 30.0
    height: float = 12.0
    run_per_rise: float = 2.0
    toe: float = 42.0
    foundation: float = 4.0
    width: float | None = None

    @property
    def toe_x(self) -> float:
        """Position x (m) of the toe."""
        return self.crest + self.run_per_rise * self.height

    @property
    def length(self) -> float:
        """Length along x (m)."""
        return self.toe_x + self.toe

    @property
    def face(self) -> Face:
        """Toe and height of the slope."""
        return Face(self.toe_x, self.foundation, self.height)

    @property
    def relief(self) -> float:
        """Height of the crest above the toe (m)."""
        return self.height

    def check(self) -> None:
        """Raise ValueError for sizes that are impossible for a slope."""
        for name, limit in self.LIMITS.items():
            if (value := getattr(self, name)) is not None:
                check.within(name, value, limit)

    @property
    def area(self) -> float:
        """Area of the section (m2)."""
        return self.length * self.foundation + self.height * (self.crest + self.run_per_rise * self.height / 2)

    @property
    def corner(self) -> tuple[float, ...]:
        """Lowest corner (d,) m of the bounding box: the origin."""
        return (0.0,) * len(self.extent)

    @property
    def extent(self) -> tuple[float, ...]:
        """Edges (d,) m of the bounding box."""
        top = self.foundation + self.height
        return (self.length, top) if self.width is None else (self.length, self.width, top)

    @property
    def volume(self) -> float:
        """Volume of the ground (m3), in a section per metre of width (m2)."""
        return self.area * (1.0 if self.width is None else self.width)

    def cells(self, discretisation: Discretisation) -> list[int]:
        """Cells of a grid along each axis, with air above the crest.

        Args:
            discretisation: cell, spacing and numerical choices.

        Returns:
            Number of cells along each axis.

        Raises:
            ValueError: If slope or grid is invalid, or they do not fit each other.
        """
        d, cell = len(self.extent), discretisation.cell
        check_discretisation(discretisation, d)
        self.check()
        if self.toe < 2 * cell:
            raise ValueError(
                f"toe = {self.toe:g} m leaves no room for a run-out: give at least two cells ({2 * cell:g} m)"
            )
        dx, dz = discretisation.spacing[0], discretisation.spacing[-1]
        run = self.run_per_rise * self.height
        for name, value in (("crest", self.crest), ("slope's run", run), ("toe", self.toe)):
            if value > 0:
                check.multiple(name, value, "the spacing along x", dx)
        for name, value in (("height", self.height), ("foundation", self.foundation)):
            check.multiple(name, value, "the spacing along z", dz)
        cells = [check.multiple("length", self.length, "cell", cell)]
        if self.width is not None:
            check.multiple("width", self.width, "the spacing along y", discretisation.spacing[1])
            cells.append(check.multiple("width", self.width, "cell", cell))
        return [*cells, cells_up(discretisation, self.foundation + self.height)]

    def heights(self, x: np.ndarray, _: np.ndarray | None = None) -> np.ndarray:
        """Height (n,) m of the surface at x (n,) m; it does not vary along y."""
        if self.run_per_rise == 0:
            return self.foundation + self.height * (x <= self.crest)
        return self.foundation + np.clip(self.height - (x - self.crest) / self.run_per_rise, 0.0, self.height)

    def layer_of(self, layers: Sequence[Layer], position: np.ndarray, discretisation: Discretisation) -> np.ndarray:
        """Layer of points (d, N) m: 0 for each (N,); ValueError for several layers."""
        if len(layers) != 1:
            raise ValueError(f"a Slope has {len(layers)} layers, and it is of one soil: draw it as a Section")
        return np.zeros(np.shape(position)[1], int)

    def build(
        self,
        layers: Sequence[Layer],
        discretisation: Discretisation,
        *,
        gravity: float = 9.81,
        ends: Literal["fixed", "roller"] = "fixed",
        k_h: float = 0.0,
        k_v: float = 0.0,
        motion: BaseMotion | None = None,
        at_rest: bool = True,
    ) -> tuple[Scene, State]:
        """Scene and state, as `slope`, of one layer.

        Args:
            layers: one.
            discretisation: cell, spacing and numerical choices.
            gravity: downwards (m/s2).
            ends: constraint of the ends along y.
            k_h: pseudo-static acceleration over gravity, towards the toe.
            k_v: pseudo-static acceleration over gravity, upwards.
            motion: of the base, as for `slope`.
            at_rest: with the stress of elastic gravity loading, else free of stress.

        Returns:
            Scene and state.

        Raises:
            ValueError: If there are several layers, or as for `slope`.
        """
        self.layer_of(layers, np.zeros((len(self.extent), 0)), discretisation)
        return slope(
            self, layers[0].soil, discretisation, gravity=gravity, k_h=k_h, k_v=k_v, motion=motion, y_ends=ends,
            at_rest=at_rest,
        )  # fmt: skip


def slope(
    shape: Slope,
    soil: AnySoil,
    discretisation: Discretisation,
    *,
    gravity: float = 9.81,
    k_h: float = 0.0,
    k_v: float = 0.0,
    motion: BaseMotion | None = None,
    y_ends: Literal["fixed", "roller"] = "fixed",
    speed: float | None = None,
    at_rest: bool = True,
) -> tuple[Scene, State]:
    """Build a slope on a fixed base with its x ends on rollers.

    Args:
        shape: its sizes.
        soil: of the slope.
        discretisation: cell, spacing and numerical choices.
        gravity: downwards (m/s2).
        k_h: pseudo-static acceleration over gravity, towards the toe.
        k_v: pseudo-static acceleration over gravity, upwards.
        motion: of the base, from time 0, after the initial stress; the scene is solved in its frame.
        y_ends: constraint of the ends along y.
        speed: largest particle speed that the time step allows for (m/s), by default of a fall through half the relief.
        at_rest: with the stress of elastic gravity loading; False leaves the slope free of stress, so that gravity acts
            suddenly.

    Returns:
        Scene and state.

    Raises:
        ValueError: If sizes, moduli, spacings or walls do not fit; the message names them.

    Example:
        >>> import jaxmpm as mpm
        >>> shape = mpm.Slope(crest=4, height=2, run_per_rise=1.0, toe=6, foundation=2)
        >>> soil = mpm.Soil(young=5e6, strength=9e3)
        >>> scene, state = mpm.slope(shape, soil, mpm.Discretisation(cell=1.0, spacing=(0.5, 0.5)))
        >>> scene.particles.position.shape
        (2, 134)
    """
    if y_ends not in ("fixed", "roller"):
        raise ValueError(f"y_ends = {y_ends!r}: give 'fixed' or 'roller'")
    return scene_of(
        shape, soil, discretisation, gravity=gravity, k_h=k_h, k_v=k_v, motion=motion, ends=("roller", y_ends),
        speed=speed, at_rest=at_rest,
    )  # fmt: skip


def as_section(shape: Ground) -> Section | None:
    """The ground as a section; None for ground in 3D, or of a class of one's own.

    Args:
        shape: of the ground.
    """
    if isinstance(shape, Slope) and shape.width is None:
        top = shape.foundation + shape.height
        corners = [(0, top), (shape.crest, top), (shape.toe_x, shape.foundation), (shape.length, shape.foundation)]
        return Section(corners)
    return shape if isinstance(shape, Section) else None
