"""Contact between soil and the rigid base."""

from __future__ import annotations

from dataclasses import dataclass

from foundation import check
from jaxmpm.soil._limits import ANGLE


@dataclass(frozen=True)
class Interface:
    """Strength of the contact between soil and the rigid base: for sliding on rock, or on a seam thinner than a cell.

    Strength reduction divides both numbers, as those of the soil.

    Args:
        friction: degrees.
        cohesion: Pa.
    """

    friction: float
    cohesion: float = 0.0

    def check(self) -> None:
        """Raise ValueError for a strength that is impossible for a contact."""
        check.within("the interface's friction", self.friction, ANGLE)
        check.not_negative("the interface's cohesion", self.cohesion, "Pa")
