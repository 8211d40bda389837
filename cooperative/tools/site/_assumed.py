"""What the interpretation of a site's files rests on beside them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cooperative.tools.site._section import DrawnSection
from cooperative.tools.soundings import Stresses, Values
from jaxmpm.soil import unit_slip
from jaxmpm.support import check
from jaxmpm.support.values import by_value


@by_value
@dataclass(frozen=True)
class Assumed:
    """What the interpretation rests on beside the files.

    Args:
        n_kt: cone factor of undrained strength and its standard deviation, None where none is given.
        unit_weight: of the soil with its water (N/m3).
        water: depth of the water table (m) where a file has none.
        marginal: of the parameters, by its name in scenes: "lognormal" or "normal".
        correlation: family along every axis, by its name in scenes.
        line: start and end [x, y] (m) of a section; positions are projected on it. None for 3D.
        origin: position [x, y] (m) that is subtracted in 3D.
        base: elevation (m) of the base of the scene, below which no value conditions the field; None for none.
        section: whose ground holds what conditions the field, and begins the scene; None for none.
        area_ratio: net area ratio of cones whose file has none beside u_2; None for none.

    Raises:
        ValueError: a number that is not finite, a unit weight in another unit, or a line of one point.
    """

    n_kt: tuple[float, float] | None = None
    unit_weight: float = 18e3
    water: float = 1.0
    marginal: str = "lognormal"
    correlation: str = "exponential"
    line: tuple[tuple[float, float], tuple[float, float]] | None = None
    origin: tuple[float, float] = (0.0, 0.0)
    base: float | None = None
    area_ratio: float | None = None
    section: DrawnSection | None = None

    def __post_init__(self) -> None:
        """Check the numbers that no reader looks at."""
        check.positive("unit_weight", self.unit_weight, "N/m3")
        if slip := unit_slip("unit_weight", self.unit_weight):
            raise ValueError(f"{slip.named('unit_weight')} Give N/m3, such as 18e3")
        for name in ("water", "line", "origin", "base"):
            if getattr(self, name) is not None:
                check.finite(name, getattr(self, name), "m")
        if self.area_ratio is not None and not 0.3 <= self.area_ratio <= 1:
            raise ValueError(f"area_ratio = {self.area_ratio:g}: cones have 0.3 to 1, such as 0.8; 1 takes q_c for q_t")
        if self.line is not None and self.line[0] == self.line[1]:
            raise ValueError(f"line = {self.line} starts and ends at one point: give two points of the section")

    def in_ground(self, points: Values) -> npt.NDArray[np.bool_]:
        """Which points (d, n) m may condition the field.

        Args:
            points: of the scene, the last axis vertical.
        """
        above = np.ones(points.shape[1], bool) if self.base is None else points[-1] >= self.base
        return above if self.section is None else above & self.section.inside(points)

    @property
    def stresses(self) -> Stresses:
        """What the ground is taken to weigh."""
        return Stresses(self.unit_weight, self.water)

    def placed(self, x: Values, y: Values) -> Values:
        """Horizontal coordinates (1 or 2, n) m of the scene, of positions (n,) in the files.

        Args:
            x: (n,) m.
            y: (n,) m, nan where the file has none.
        """
        if self.line is None:
            return x[None] if np.isnan(y).all() else np.stack([x, y]) - np.array(self.origin)[:, None]
        start, end = np.array(self.line)
        along = (end - start) / np.linalg.norm(end - start)
        return ((np.stack([x, y]) - start[:, None]) * along[:, None]).sum(axis=0)[None]
