"""Water that moves, for slices: pressure at their bases, and the weight above them by water content."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cooperative.scene import Campaign
from jaxmpm import Layer, Section
from jaxmpm.soil import STANDARD_GRAVITY

FINE = 2
"""Nodes of these values in a cell of the refined grid along x; upright there are twice as many."""


@dataclass(frozen=True)
class MovingWater:
    """Values at nodes of a section, linear between them.

    Args:
        corner: lowest x and z of the nodes (m).
        spacing: of the nodes (m).
        values: pressure taken off the total stress (Pa), weight above (N/m2) and its moment about height 0 (N/m), each
            (nx, nz).
    """

    corner: tuple[float, float]
    spacing: tuple[float, float]
    values: np.ndarray

    @classmethod
    def of(cls, campaign: Campaign, shape: Section, layers: Sequence[Layer]) -> MovingWater:
        """That of a campaign whose ground rests under the pressure of a time.

        Args:
            campaign: with a site at rest.
            shape: of the section.
            layers: of it, whose weight holds where none follows the water.
        """
        resting = campaign.site.pressure
        assert resting is not None
        cell = campaign.refined.cell
        count = [max(4, int(np.ceil(edge / cell * n))) for edge, n in zip(shape.extent, (FINE, 2 * FINE), strict=True)]
        x, z = (
            low + edge * np.arange(n + 1) / n for low, edge, n in zip(shape.corner, shape.extent, count, strict=True)
        )
        dx, dz = x[1] - x[0], z[1] - z[0]
        middle = z[:-1] + dz / 2
        top = np.asarray(shape.heights(x), float)[:, None]
        plain = np.array([layer.soil.unit_weight for layer in layers])

        def numbers(heights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            points = np.stack([axis.ravel() for axis in np.meshgrid(x, heights, indexing="ij")])
            inside = np.stack([points[0], np.minimum(points[1], np.repeat(top[:, 0], heights.size) - 1e-6 * dz)])
            layer = campaign.site.layer_of(inside, campaign.grids["refined"])
            return points, np.zeros(points.shape[1], int) if layer is None else layer

        points, number = numbers(z)
        pressure, _ = resting.at(points, number)
        points, number = numbers(middle)
        _, moist = resting.at(points, number)
        weight = np.where(np.isnan(moist), plain[number], moist).reshape(x.size, -1)
        weight = weight * campaign.run.gravity / STANDARD_GRAVITY
        low, high = z[:-1], np.clip(top, z[:-1], z[1:])

        def above(values: np.ndarray) -> np.ndarray:
            return np.concatenate([np.cumsum(values[:, ::-1], axis=1)[:, ::-1], np.zeros((x.size, 1))], axis=1)

        values = pressure.reshape(x.size, -1), above(weight * (high - low)), above(weight * (high**2 - low**2) / 2)
        return cls((float(x[0]), float(z[0])), (float(dx), float(dz)), np.stack(values))

    def at(self, x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pressure (...) Pa, weight above (...) N/m2 and its moment (...) N/m at points of any shape (m)."""
        from scipy.ndimage import map_coordinates  # loads what only moving water needs

        place = [
            (coordinate - low) / step for coordinate, low, step in zip((x, z), self.corner, self.spacing, strict=True)
        ]
        pressure, weight, moment = (map_coordinates(values, place, order=1, mode="nearest") for values in self.values)
        return pressure, weight, moment

    def mirrored(self) -> MovingWater:
        """Its mirror image about x = 0."""
        last = self.corner[0] + self.spacing[0] * (self.values.shape[1] - 1)
        return replace(self, corner=(-last, self.corner[1]), values=self.values[:, ::-1])
