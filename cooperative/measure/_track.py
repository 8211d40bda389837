"""A line in plan that the user draws, along which the run-out of a slide is measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from jaxmpm.support.values import by_value

BEYOND = 1e5
"""How far (m) the line goes on straight beyond both ends."""


@by_value
@dataclass(frozen=True)
class Track:
    """Where a slide is expected to go, as a line in plan.

    Args:
        points: x and y (m) of its points, two or more.

    Raises:
        ValueError: a line that crosses itself, or of which two points in a row are one.
    """

    points: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        points = np.array(self.points, float)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2 or not np.isfinite(points).all():
            raise ValueError(f"run-out line {list(self.points)}: give two or more points [x, y] in metres")
        for (x, y), step in zip(points, np.diff(points, axis=0), strict=False):
            if not step.any():
                raise ValueError(f"run-out line has the point ({x:g}, {y:g}) m twice in a row: leave one of them out")
        if not shapely.LineString(points).is_simple:
            raise ValueError(
                "run-out line crosses itself, so that positions on it have no order: draw it without a loop"
            )

    def along(self, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance along the line and its direction at the nearest point of it.

        Args:
            position: in plan (2, n) m.

        Returns:
            Distance (n,) m, negative before the start, and direction (2, n).
        """
        points = np.array(self.points, float)
        steps = np.diff(points, axis=0)
        lengths = np.linalg.norm(steps, axis=1)
        directions = steps / lengths[:, None]
        ends = points[0] - BEYOND * directions[0], points[-1] + BEYOND * directions[-1]
        line = shapely.LineString([ends[0], *points[1:-1], ends[1]])
        distance = shapely.line_locate_point(line, shapely.points(*position)) - BEYOND
        piece = np.searchsorted(np.cumsum(lengths)[:-1], distance, side="right")
        return distance, directions[piece].T
