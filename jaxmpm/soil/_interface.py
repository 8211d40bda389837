"""Contact between soil and the rigid base."""

from __future__ import annotations

from dataclasses import dataclass

from jaxmpm.soil._limits import LIMITS
from jaxmpm.support import check
from jaxmpm.support.values import by_value


@by_value
@dataclass(frozen=True)
class Interface:
    """Strength of the contact between soil and the rigid base: for sliding on rock, or on a seam thinner than a cell.

    Strength reduction divides friction and cohesion, as those of the soil.

    Args:
        friction: degrees.
        cohesion: Pa.
        residual_ratio: share of tan(friction) and of cohesion that slip leaves; 1 without softening.
        slip_length: slip over which they fall to it, linearly (m); None without softening. Slip is the displacement
            from the start of the soil next to the base.
        softens: whether slip reduces the strength of a contact with undrained soil as shear strain softens that soil,
            in a layer as thick as shear bands (a cell, or the soil's `softening_length`). Use it for a contact that
            has the strength of its soil.
    """

    friction: float
    cohesion: float = 0.0
    residual_ratio: float = 1.0
    slip_length: float | None = None
    softens: bool = False

    def check(self) -> None:
        """Raise ValueError for a strength that is impossible for a contact."""
        check.within("the interface's friction", self.friction, LIMITS["friction"])
        check.not_negative("the interface's cohesion", self.cohesion, "Pa")
        check.within("the interface's residual_ratio", self.residual_ratio, LIMITS["residual_ratio"])
        if (self.residual_ratio == 1) != (self.slip_length is None):
            raise ValueError(
                f"the interface has residual_ratio = {self.residual_ratio:g} and slip_length = {self.slip_length}: "
                "give both, the ratio below 1, or neither"
            )
        if self.softens and self.slip_length is not None:
            raise ValueError(
                f"the interface has softens = True with slip_length = {self.slip_length:g} m: let it soften as its "
                "soil does, or over a slip of its own"
            )
        if self.slip_length is not None:
            check.positive("the interface's slip_length", self.slip_length, "m")
