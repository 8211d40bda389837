"""Weak layers relative to the cells of a grid: one that shares its cells with stronger soil is as strong as that."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from jaxmpm.ground._layer import Layer, labels
from jaxmpm.soil import AnySoil
from jaxmpm.support import check
from jaxmpm.support.values import by_value

RESOLVING = 2.0
"""Least number of cells in the thickness of a weak layer for its own strength to apply at any position."""

WEAK = 0.8
"""Largest strength of a weak layer, over that of the soil beside it."""


@by_value
@dataclass(frozen=True)
class Thickness:
    """Thickness of a layer.

    Args:
        metres: median over its soil: half of the soil lies where the layer is thinner (m).
        weak: whether the layer is weaker than its neighbours above and below.
    """

    metres: float
    weak: bool

    def too_thin(self, cell: float) -> str | None:
        """Warning about a weak layer on cells that are too large for it.

        Args:
            cell: edge of a cell (m).

        Returns:
            Text, None if the layer is not weak or the cells are small enough.
        """
        cells = self.metres / cell
        if not self.weak or cells >= RESOLVING * (1 - 1e-9):
            return None
        return (
            f"is {self.metres:.3g} m thick, {cells:.2g} cells of {cell:.3g} m, and weaker than the soil beside it, "
            "which makes it as strong as itself in cells that they share, and the factor of safety up to a third too "
            "high: "
            f"give cells of at most {self.metres / RESOLVING:.3g} m, or, where it lies on the base, draw an interface "
            "there instead."
        )


def thicknesses_of(layers: Sequence[Layer], tops: Sequence[np.ndarray]) -> list[Thickness]:
    """Thickness of each layer, 0 m for layers without soil and for traced soils.

    Args:
        layers: from the top down.
        tops: heights (n,) m of the layers' upper boundaries and of the base, at the same points.

    Returns:
        One per layer.
    """
    thick = np.array([np.maximum(top - bottom, 0) for top, bottom in pairwise(tops)])
    if any(check.is_traced(*vars(layer.soil).values()) for layer in layers):
        return [Thickness(0.0, weak=False)] * len(layers)
    weight = np.array([float(np.mean(layer.soil.unit_weight)) for layer in layers])[:, None] * thick
    result = []
    for number, layer in enumerate(layers):
        there = thick[number] > 0
        if not there.any():
            result.append(Thickness(0.0, weak=False))
            continue
        pressure = float(np.median(weight[: number + 1, there].sum(axis=0) - weight[number, there] / 2))
        beside = [
            _strength(layers[neighbour].soil, pressure)
            for neighbour in (number - 1, number + 1)
            if 0 <= neighbour < len(layers)
        ]
        weak = bool(beside) and _strength(layer.soil, pressure) < WEAK * min(beside)
        rising = np.sort(thick[number, there])
        middle = np.searchsorted(np.cumsum(rising), rising.sum() / 2)
        result.append(Thickness(float(rising[middle]), weak))
    return result


def _strength(soil: AnySoil, pressure: float) -> float:
    """Mean shear strength (Pa) under a pressure (Pa); infinite of soil whose numbers do not tell.

    That of clay with a strength by direction is the one in simple shear, that of Cam Clay the one at its critical state
    in triaxial compression, that of grains the one at rest.
    """
    cohesion, friction, undrained = (getattr(soil, name, None) for name in ("cohesion", "friction", "strength"))
    if cohesion is not None and friction is not None:
        return float(np.mean(cohesion)) + pressure * math.tan(math.radians(float(np.mean(friction))))
    directed, critical, repose = (
        getattr(soil, name, None) for name in ("simple_strength", "critical_state", "static_friction")
    )
    if critical is not None:
        sine = 3 * float(np.mean(critical)) / (6 + float(np.mean(critical)))
        return pressure * sine / math.sqrt(1 - sine**2)
    if repose is not None:
        return pressure * math.tan(math.radians(float(np.mean(repose))))
    undrained = directed if undrained is None else undrained
    ratio, minimum = (getattr(soil, name, None) for name in ("strength_ratio", "strength_minimum"))
    if undrained is None and ratio is not None:
        return max(ratio * pressure, minimum)
    return math.inf if undrained is None else float(np.mean(undrained))


def warn_of_seams(layers: Sequence[Layer], measured: Sequence[Thickness], cell: float) -> None:
    """Warn of weak layers on cells that are too large for them, unless their soil has `unusual`.

    Args:
        layers: from the top down.
        measured: thickness of each.
        cell: edge of a cell (m).
    """
    for name, layer, thickness in zip(labels(layers), layers, measured, strict=True):
        warning = thickness.too_thin(cell)
        if warning is not None and not getattr(layer.soil, "unusual", False):
            check.warn(f"{name} {warning} If that is intended, give its soil unusual=True")
