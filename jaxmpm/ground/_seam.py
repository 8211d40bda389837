"""Weak layers beside the cells of a grid: one that shares its cells with stronger soil is as strong as that."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from foundation import check

RESOLVING = 2.0
"""Cells in the thickness of a weak layer from which on its strength is its own, wherever it lies on the grid."""

WEAK = 0.8
"""Strength of a weak layer, over that of soil beside it, at most."""


@dataclass(frozen=True)
class Thickness:
    """How thick a layer is. metres: half of its soil lies where it is thinner than that. weak: whether it is weaker
    than what lies above and below."""

    metres: float
    weak: bool

    def too_thin(self, cell: float) -> str | None:
        """What to ask of a weak layer on cells of this size (m) that are too large for it; None of others."""
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


def thicknesses_of(layers: Sequence[Any], tops: Sequence[np.ndarray]) -> list[Thickness]:
    """That of each layer, 0 m of those that lie nowhere or whose soil is being traced.

    tops: heights (n,) m of the layers' upper boundaries and of the base, at the same places.
    """
    thick = np.array([np.maximum(top - bottom, 0) for top, bottom in pairwise(tops)])
    if any(check.is_traced(*vars(each.soil).values()) for each in layers):
        return [Thickness(0.0, weak=False)] * len(layers)
    weight = np.array([float(np.mean(each.soil.unit_weight)) for each in layers])[:, None] * thick
    found = []
    for number, layer in enumerate(layers):
        there = thick[number] > 0
        if not there.any():
            found.append(Thickness(0.0, weak=False))
            continue
        pressure = float(np.median(weight[: number + 1, there].sum(axis=0) - weight[number, there] / 2))
        beside = [
            _strength(layers[each].soil, pressure) for each in (number - 1, number + 1) if 0 <= each < len(layers)
        ]
        weak = bool(beside) and _strength(layer.soil, pressure) < WEAK * min(beside)
        rising = np.sort(thick[number, there])
        middle = np.searchsorted(np.cumsum(rising), rising.sum() / 2)
        found.append(Thickness(float(rising[middle]), weak))
    return found


def _strength(soil: Any, pressure: float) -> float:
    """Shear strength (Pa) under a pressure (Pa), the mean where it differs from particle to particle; infinite of soil
    that has neither cohesion and friction nor a strength."""
    cohesion, friction, undrained = (getattr(soil, name, None) for name in ("cohesion", "friction", "strength"))
    if cohesion is not None and friction is not None:
        return float(np.mean(cohesion)) + pressure * math.tan(math.radians(float(np.mean(friction))))
    if undrained is None and getattr(soil, "strength_ratio", None) is not None:
        return max(soil.strength_ratio * pressure, soil.strength_minimum)
    return math.inf if undrained is None else float(np.mean(undrained))


def warn_of_seams(layers: Sequence[Any], found: Sequence[Thickness], cell: float) -> None:
    """Warn of weak layers on cells (m) too large for them, unless their soil says that it means it."""
    for number, (layer, thickness) in enumerate(zip(layers, found, strict=True), 1):
        asked = thickness.too_thin(cell)
        if asked is not None and not getattr(layer.soil, "unusual", False):
            check.warn(f"layer {number} {asked} If that is meant, give its soil unusual=True")
