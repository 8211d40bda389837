"""Limits of the numbers of a soil, and questions about those that look like another unit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import Field, fields
from types import MappingProxyType
from typing import Any, ClassVar, Protocol

import numpy as np

from jaxmpm.laws import AnisotropicUndrained, Law, ModifiedCamClay, MuI
from jaxmpm.protocols import Material
from jaxmpm.soil._units import PLAUSIBLE, unit_slip
from jaxmpm.support import check
from jaxmpm.support.check import Limit, from_zero

ANGLE = Limit(least=0, most=60, unit="degrees")


def _of(law: type[Law]) -> Iterator[tuple[str, Limit]]:
    """Limits that a law declares beside those of its moduli, by the engineer's name and in degrees."""
    for name, limit in law.PARAMETERS.items():
        if name not in Law.PARAMETERS:
            plain = Limit(**{part.name: getattr(limit, part.name) for part in fields(Limit)})
            yield getattr(limit, "name", "") or name, ANGLE if limit.unit == "rad" else plain


LIMITS: Mapping[str, Limit] = MappingProxyType(
    {
        "strength": Limit(above=0, unit="Pa"),
        "cohesion": Limit(least=0, unit="Pa"),
        "friction": ANGLE,
        "dilation": Limit(least=-15, most=60, unit="degrees"),
        "young": Limit(above=0, unit="Pa"),
        "poisson": Limit(above=-1, below=0.5),
        "unit_weight": Limit(above=0, unit="N/m3"),
        "softening_modulus": Limit(above=0, unit="Pa"),
        "residual_cohesion": Limit(least=0, unit="Pa"),
        "residual_friction": ANGLE,
        "residual_ratio": Limit(least=0, most=1),
        "strain_95": Limit(above=0),
        "softening_strain": Limit(above=0),
        "rate_coefficient": Limit(least=0),
        "saturated_unit_weight": Limit(above=0, unit="N/m3"),
        "reference_rate": Limit(above=0, unit="1/s"),
        "tension_cutoff": Limit(least=0, unit="Pa"),
        "softening_length": Limit(above=0, unit="m"),
        "strength_ratio": Limit(above=0, most=1),
        "strength_minimum": Limit(above=0, unit="Pa"),
        "viscosity": Limit(least=0, unit="Pa s"),
        **dict(_of(ModifiedCamClay)),
        **dict(_of(AnisotropicUndrained)),
        **dict(_of(MuI)),
        "largest_pressure": Limit(above=0, unit="Pa"),
        "loss_time": Limit(above=0, unit="s"),
        "k0": from_zero(),
        "b_value": Limit(least=0, below=1),
    }
)


def soil_limits() -> Mapping[str, Limit]:
    """Limits of the numbers of soil by the engineer's name, each with its unit.

    Their order is that of a sample's coefficients: one put between others would give the samples of a seed other soil.

    Returns:
        Limit by name.
    """
    return LIMITS


class AnySoil(Protocol):
    """Protocol of a soil: `Soil`, `FrictionalSoil`, or a user's own frozen dataclass.

    If a number of its law varies in a campaign, the soil has it too, under the engineer's name that the law declares
    (`jaxmpm.laws.Parameter`) and in degrees if it is an angle; it has `young` and `poisson` if these vary. It may have
    `softens`, `softening_length`, `saturated_unit_weight` and `unusual`, as `FrictionalSoil` does.
    """

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    @property
    def unit_weight(self) -> float:
        """Unit weight (N/m3)."""

    def material(self, dtype: np.dtype, band: float) -> Material:
        """Its law.

        Args:
            dtype: of the law's numbers.
            band: thickness of the grid's shear bands (m).

        Returns:
            A `jaxmpm.Material`.

        Raises:
            ValueError: If a number is impossible for soil.
        """


def warn_of_units(soil: AnySoil) -> None:
    """Warn once of all numbers that look like another unit, unless the soil has `unusual`.

    Args:
        soil: to check.
    """
    slips = () if getattr(soil, "unusual", False) else dict.fromkeys(_slips(soil))
    if slips:
        check.warn(f"{'; '.join(slips)} If they are intended, give the soil unusual=True")


def _slips(soil: AnySoil) -> Iterator[str]:
    """Question about each number that looks like another unit, at the least and the largest of several values."""
    for name in PLAUSIBLE:
        value = getattr(soil, name, None)
        if value is None or check.is_traced(value) or not np.size(value):
            continue
        for end in (np.min, np.max):
            if slip := unit_slip(name, float(end(np.asarray(value)))):
                yield str(slip.named(name))
