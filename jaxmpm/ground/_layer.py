"""A layer of soil and its lower boundary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from jaxmpm.ground._raster import Raster
from jaxmpm.soil import AnySoil
from jaxmpm.support import check
from jaxmpm.support.text import shown
from jaxmpm.support.values import by_value

Line = Sequence[Sequence[float]]
"""Points (x, z) m with x rising; two points of the same x make a step."""

Box = tuple[tuple[float, ...], tuple[float, ...]]
"""Lowest corner and edges (d,) m."""


@by_value
@dataclass(frozen=True)
class Layer:
    """A layer of soil, from the surface or the layer before it down to its own lower boundary.

    The last layer has no boundary and reaches down to the base; the others have one of bottom, depth and thickness.

    Args:
        soil: of the layer.
        bottom: boundary as points (x, z) m with x rising; under a terrain a raster of heights. A boundary that ends on
            the one above it, or on the surface, ends its layer there.
        depth: of the boundary below the surface (m).
        thickness: of the layer (m).
        name: of the layer in messages, None for its number from the top down.
    """

    soil: AnySoil
    bottom: Line | Raster | None = None
    depth: float | None = None
    thickness: float | None = None
    name: str | None = None

    @property
    def ends(self) -> bool:
        """Whether the layer has a lower boundary above the base."""
        return (self.bottom, self.depth, self.thickness) != (None, None, None)


def labels(layers: Sequence[Layer]) -> list[str]:
    """What messages call each layer: by its name, or its number from the top down."""
    return [f"layer {number if layer.name is None else shown(layer.name)}" for number, layer in enumerate(layers, 1)]


def check_ends(layers: Sequence[Layer]) -> None:
    """Raise ValueError unless all layers but the last have a lower boundary, each given in one way."""
    names = labels(layers)
    wrong = [number for number, layer in enumerate(layers, 1) if layer.ends == (number == len(layers))]
    if not layers or wrong:
        which = ""
        if wrong:
            which = f"; {names[wrong[0] - 1]} {'has none' if wrong[0] < len(layers) else 'is the last'}"
        raise ValueError(
            f"layers: give them from the top down, all but the last with their bottom, depth or thickness{which}"
        )
    for name, layer in zip(names, layers, strict=True):
        ends = [key for key in ("bottom", "depth", "thickness") if getattr(layer, key) is not None]
        if len(ends) > 1:
            raise ValueError(f"{name} has both {' and '.join(ends)}: give one of them")
        for key in ("depth", "thickness"):
            if getattr(layer, key) is not None:
                check.positive(f"{key} of {name}", getattr(layer, key), "m")
