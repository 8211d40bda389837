"""Soils of critical state, of strength by direction and of grains that flow, in engineers' units."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from jax import Array

from jaxmpm.laws import AnisotropicUndrained, ModifiedCamClay, MuI, Saturated, saturated
from jaxmpm.soil._soil import check_numbers, moduli, radians
from jaxmpm.support import check
from jaxmpm.support.tracing import array, host
from jaxmpm.support.values import by_value


@by_value
@dataclass(frozen=True)
class CamClaySoil:
    """Clay of Modified Cam Clay in effective stress, in SI units; see `jaxmpm.laws.ModifiedCamClay`.

    Every number of the law may be one value per particle (N,) of the scene, too.

    Args:
        compression: lambda* = lambda / (1 + e), volumetric strain per ln p on the virgin line.
        swelling: kappa* = kappa / (1 + e), below the compression.
        critical_state: M, q / p at the critical state, 6 sin(phi) / (3 - sin(phi)) for the friction angle phi.
        ocr: overconsolidation ratio, the largest vertical effective stress so far over that at rest.
        poisson: Poisson's ratio.
        largest_pressure: mean effective stress (Pa) from which on stiffness grows no more, above all that the slope
            reaches; it limits the time step.
        least_pressure: mean effective stress (Pa) below which stiffness and the ellipse shrink no more.
        unit_weight: of soil and its water (N/m3).
        saturated_unit_weight: of soil that starts below a water table (N/m3); None for unit_weight.
        unusual: as for `Soil`.
        k0: as for `Soil`.
        b_value: as for `FrictionalSoil`, with the largest bulk modulus; softer soil has more.
    """

    compression: float | Array
    swelling: float | Array
    critical_state: float | Array
    ocr: float | Array = 1.0
    poisson: float = 0.3
    largest_pressure: float = 500e3
    least_pressure: float = 1e3
    unit_weight: float = 18e3
    saturated_unit_weight: float | None = None
    unusual: bool = False
    k0: float | Array | None = None
    b_value: float | None = None

    def material(self, dtype: np.dtype, band: float) -> ModifiedCamClay | Saturated:
        """Its law on any grid.

        Args:
            dtype: of the law's numbers.
            band: not used, the law has no softening of a band.

        Returns:
            `ModifiedCamClay`, `Saturated` with a B-value.

        Raises:
            ValueError: If a number is impossible for soil.
        """
        check_numbers(self)
        if not check.is_traced(self.swelling, self.compression) and np.any(
            np.asarray(self.swelling) >= np.asarray(self.compression)
        ):
            raise ValueError(
                f"swelling = {np.max(np.asarray(self.swelling)):g} with compression = "
                f"{np.min(np.asarray(self.compression)):g}: give less than the compression, commonly a tenth to a third"
            )
        number = partial(array, dtype=dtype)
        bulk = self.largest_pressure / host(self.swelling).asarray(self.swelling)
        shear = bulk * (3 * (1 - 2 * self.poisson) / (2 * (1 + self.poisson)))
        numbers = (self.compression, self.swelling, self.critical_state, self.ocr, self.least_pressure)
        return saturated(ModifiedCamClay(*map(number, (bulk, shear, *numbers))), self.b_value)


@by_value
@dataclass(frozen=True)
class AnisotropicSoil:
    """Undrained clay with strength by direction, in SI units; see `jaxmpm.laws.AnisotropicUndrained`.

    Every strength may be one value per particle (N,) of the scene, too.

    Args:
        active_strength: undrained strength where the vertical stress grows, as under a crest (Pa).
        simple_strength: in direct simple shear (Pa).
        passive_strength: where the vertical stress falls, as at a toe (Pa).
        failure_strain: engineering plastic shear strain at which they are mobilised.
        unit_weight: N/m3.
        young: Young's modulus at small strain (Pa).
        poisson: Poisson's ratio.
        unusual: as for `Soil`.
        k0: as for `Soil`.
    """

    active_strength: float | Array
    simple_strength: float | Array
    passive_strength: float | Array
    failure_strain: float = 0.05
    unit_weight: float = 18e3
    young: float = 5e7
    poisson: float = 0.45
    unusual: bool = False
    k0: float | Array | None = None

    def material(self, dtype: np.dtype, band: float) -> AnisotropicUndrained:
        """Its law on any grid.

        Args:
            dtype: of the law's numbers.
            band: not used, the law does not soften.

        Returns:
            `AnisotropicUndrained`.

        Raises:
            ValueError: If a number is impossible for soil.
        """
        check_numbers(self)
        strengths = self.active_strength, self.simple_strength, self.passive_strength
        numbers = (*moduli(self.young, self.poisson), *strengths, self.failure_strain)
        return AnisotropicUndrained(*(array(value, dtype) for value in numbers))


@by_value
@dataclass(frozen=True)
class GranularSoil:
    """Dry grains that flow with the friction mu(I), in SI units and degrees; see `jaxmpm.laws.MuI`.

    Args:
        static_friction: angle of repose (degrees).
        dynamic_friction: angle of infinitely fast flow (degrees), at least the static one.
        grain_size: diameter (m).
        inertial_number: I_0, at which friction is half way between both.
        grain_density: of the solid (kg/m3).
        unit_weight: of the grains with their voids (N/m3).
        young: Young's modulus (Pa).
        poisson: Poisson's ratio.
        gap_memory: whether grains that came apart bear pressure only once their gap has closed.
        unusual: as for `Soil`.
        k0: as for `Soil`.
    """

    static_friction: float
    dynamic_friction: float
    grain_size: float
    inertial_number: float = 0.279
    grain_density: float = 2500.0
    unit_weight: float = 15e3
    young: float = 1e7
    poisson: float = 0.3
    gap_memory: bool = True
    unusual: bool = False
    k0: float | Array | None = None

    def material(self, dtype: np.dtype, band: float) -> MuI:
        """Its law on any grid.

        Args:
            dtype: of the law's numbers.
            band: not used, the law does not soften.

        Returns:
            `MuI`.

        Raises:
            ValueError: If a number is impossible for grains.
        """
        check_numbers(self)
        traced = check.is_traced(self.dynamic_friction, self.static_friction)
        if not traced and self.dynamic_friction < self.static_friction:
            raise ValueError(
                f"dynamic_friction = {self.dynamic_friction:g} degrees, below the static_friction of "
                f"{self.static_friction:g} degrees: give at least that"
            )
        number = partial(array, dtype=dtype)
        bulk, shear = (number(modulus) for modulus in moduli(self.young, self.poisson))
        static, dynamic = (number(radians(angle)) for angle in (self.static_friction, self.dynamic_friction))
        of_grains = number(self.inertial_number), number(self.grain_size), number(self.grain_density)
        return MuI(bulk, shear, static, dynamic, *of_grains, self.gap_memory)
