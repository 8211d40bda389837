"""Soil in engineers' units, and the constitutive law that it gives."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal, TypeVar

import numpy as np
from jax import Array
from jax.typing import ArrayLike

from jaxmpm.laws import (
    J2,
    Decay,
    DruckerPrager,
    Elastic,
    ExponentialSoftening,
    FrictionalSoftening,
    LossInTime,
    Matching,
    MohrCoulomb,
    RateEffect,
    Saturated,
    Softening,
    saturated,
)
from jaxmpm.soil._limits import LIMITS
from jaxmpm.support import check
from jaxmpm.support.tracing import array
from jaxmpm.support.values import by_value

Number = TypeVar("Number", float, Array)

STANDARD_GRAVITY = 9.81
"""Acceleration (m/s2) that converts a unit weight to a density, whatever the gravity of a scene."""


class PlasticStrain(enum.Enum):
    """Measure of plastic strain that softening refers to.

    ENGINEERING is sqrt(2 e:e), gamma in simple shear; EQUIVALENT is sqrt(2/3 e:e), 1/sqrt(3) of it.
    """

    ENGINEERING = "engineering"
    EQUIVALENT = "equivalent"


@by_value
@dataclass(frozen=True)
class Soil:
    """An elastic soil with undrained strength, in SI units.

    Args:
        unit_weight: N/m3.
        young: Young's modulus (Pa).
        poisson: Poisson's ratio.
        strength: peak undrained shear strength S_u (Pa), a number or one value per particle (N,) of the scene; None for
            an elastic soil.
        softening_modulus: loss of strength per unit of plastic strain (Pa); None for none.
        residual_ratio: residual over peak strength.
        tension_cutoff: largest mean stress (Pa); None for no limit.
        gap_memory: whether soil that the cutoff has opened closes its gap before it bears pressure; False makes it
            resist at once.
        plastic_strain: measure of the strain that softening_modulus and strain_95 refer to.
        strain_95: instead of softening_modulus, plastic strain at which 95 % of an exponential loss has happened.
        softening_length: thickness of the shear band (m) that softening refers to. Softening is then scaled by the
            thickness of the grid's bands (a cell, or that of an internal_length) over it, so that a band takes the same
            work on every grid. "cell" for no scaling; None likewise, but a campaign then takes a fifth of the slope's
            height.
        rate_coefficient: gain of strength per tenfold shear rate above reference_rate; None for none.
        reference_rate: 1/s.
        unusual: whether numbers that look like another unit are intended; builders warn of them otherwise, see
            `unit_slip`.
        strength_ratio: instead of strength, its ratio to the effective vertical stress at rest, at most 1; for
            campaigns, which know that stress.
        strength_minimum: least strength with a strength_ratio (Pa).
        viscosity: Bingham's plastic viscosity (Pa s): soil that flows resists with its strength plus this times the
            rate of engineering plastic shear strain. None for none.
        loss_time: instead of softening, time from the start of a run (s) over which the strength falls to
            residual_ratio of itself, whatever the strain; None for no such loss.
        k0: horizontal over vertical effective stress at rest of level ground, a number or one value per particle (N,)
            of the scene; under a slope equilibrium asks for more shear. None for that of elastic loading,
            nu / (1 - nu).
    """

    unit_weight: float = 20e3
    young: float = 1e8
    poisson: float = 0.3
    strength: float | Array | None = None
    softening_modulus: float | None = None
    residual_ratio: float = 0.5
    tension_cutoff: float | None = None
    gap_memory: bool = True
    plastic_strain: PlasticStrain = PlasticStrain.ENGINEERING
    strain_95: float | None = None
    softening_length: float | Literal["cell"] | None = None
    rate_coefficient: float | None = None
    reference_rate: float = 3e-6
    unusual: bool = False
    strength_ratio: float | None = None
    strength_minimum: float | None = None
    viscosity: float | None = None
    loss_time: float | None = None
    k0: float | Array | None = None

    @property
    def softens(self) -> bool:
        """Whether strength falls with plastic strain."""
        has_strength = self.strength is not None or self.strength_ratio is not None
        return has_strength and (self.softening_modulus is not None or self.strain_95 is not None)

    def material(self, dtype: np.dtype, band: float) -> Elastic | J2:
        """Its law on a grid.

        Args:
            dtype: of the law's numbers.
            band: thickness of the grid's shear bands (m).

        Returns:
            `Elastic` without strength, else `J2`.

        Raises:
            ValueError: If a number is impossible for soil, or a strength_ratio is given.
        """
        check_soil(self)
        if self.strength_ratio is not None:
            raise ValueError(
                f"strength_ratio = {self.strength_ratio:g} is of the stress at rest, which only a campaign works out: "
                "build with a strength, then give each particle `ratio * overburden(scene)` by `with_soil`"
            )
        number = partial(array, dtype=dtype)
        bulk, shear = (number(modulus) for modulus in moduli(self.young, self.poisson))
        if self.strength is None:
            return Elastic(bulk, shear)
        softening, cutoff = self._softening(_scale(self, band), number), _cutoff(self, number)
        viscosity = None if self.viscosity is None else number(self.viscosity)
        return J2(
            bulk, shear, number(self.strength), softening, cutoff, self._rate(number), self.gap_memory, viscosity,
            self._loss(number),
        )  # fmt: skip

    def _softening(self, scale: float, number: Callable[[ArrayLike], Array]) -> Softening | ExponentialSoftening | None:
        if self.strain_95 is not None and self.softening_modulus is not None:
            raise ValueError("both softening_modulus and strain_95 are given: choose linear or exponential softening")
        if not isinstance(self.plastic_strain, PlasticStrain):
            raise ValueError(f"plastic_strain = {self.plastic_strain!r}: give a member of PlasticStrain")
        # Ratio of engineering strain to the soil's measure of strain.
        share = 1.0 if self.plastic_strain is PlasticStrain.ENGINEERING else math.sqrt(3)
        if self.softening_modulus is not None:
            return Softening(number(self.softening_modulus * scale / share), number(self.residual_ratio))
        if self.strain_95 is None:
            return None
        return ExponentialSoftening(number(self.residual_ratio), number(self.strain_95 * share / scale))

    def _loss(self, number: Callable[[ArrayLike], Array]) -> LossInTime | None:
        if self.loss_time is None:
            return None
        for name in ("softening_modulus", "strain_95"):
            if getattr(self, name) is not None:
                raise ValueError(
                    f"both loss_time and {name} are given: choose a loss of strength over time or with plastic strain"
                )
        return LossInTime(number(self.residual_ratio), number(self.loss_time))

    def _rate(self, number: Callable[[ArrayLike], Array]) -> RateEffect | None:
        if self.rate_coefficient is None:
            return None
        return RateEffect(number(self.rate_coefficient), number(self.reference_rate))


@by_value
@dataclass(frozen=True)
class FrictionalSoil:
    """An elastic soil with cohesion and friction, in SI units and degrees.

    Args:
        cohesion: Pa.
        friction: degrees.
        dilation: degrees, at most the friction; below 0 soil contracts as it is sheared, without end unless it softens.
        unit_weight: of soil and its water (N/m3).
        young: Young's modulus (Pa).
        poisson: Poisson's ratio.
        law: its class.
        matching: of Drucker-Prager's cone with Mohr-Coulomb.
        residual_cohesion: Pa.
        residual_friction: degrees.
        softening_strain: engineering plastic shear strain at which residual values are reached; None for no softening.
        decay: form of the loss.
        softening_length: as for `Soil`.
        tension_cutoff: largest mean stress of Drucker-Prager, largest principal stress of Mohr-Coulomb (Pa); None for
            that of the apex.
        gap_memory: as for `Soil`.
        saturated_unit_weight: of soil that starts below a water table (N/m3); None for unit_weight.
        unusual: as for `Soil`.
        k0: as for `Soil`.
        b_value: Skempton's B of soil below the water, which as it strains from rest neither loses nor takes up water,
            see `jaxmpm.laws.Saturated`; None for drained soil.
    """

    cohesion: float
    friction: float
    dilation: float = 0.0
    unit_weight: float = 20e3
    young: float = 1e8
    poisson: float = 0.3
    law: type[MohrCoulomb] | type[DruckerPrager] = MohrCoulomb
    matching: Matching = Matching.PLANE_STRAIN
    residual_cohesion: float = 0.0
    residual_friction: float = 0.0
    softening_strain: float | None = None
    decay: Decay = Decay.LINEAR
    softening_length: float | Literal["cell"] | None = None
    tension_cutoff: float | None = None
    gap_memory: bool = True
    saturated_unit_weight: float | None = None
    unusual: bool = False
    k0: float | Array | None = None
    b_value: float | None = None

    @property
    def softens(self) -> bool:
        """Whether cohesion and friction fall with plastic strain."""
        return self.softening_strain is not None

    def material(self, dtype: np.dtype, band: float) -> MohrCoulomb | DruckerPrager | Saturated:
        """Its law on a grid.

        Args:
            dtype: of the law's numbers.
            band: thickness of the grid's shear bands (m).

        Returns:
            `MohrCoulomb` or `DruckerPrager`, `Saturated` with a B-value.

        Raises:
            ValueError: If a number is impossible for soil.
        """
        check_soil(self)
        check.between("dilation", self.dilation, -math.inf, self.friction, ends=True)
        _check_contraction(self)
        if not check.is_traced(self.cohesion, self.friction) and self.cohesion == 0 and self.friction == 0:
            raise ValueError("cohesion = 0 Pa with friction = 0 degrees: give at least one of them")
        number = partial(array, dtype=dtype)
        bulk, shear = (number(modulus) for modulus in moduli(self.young, self.poisson))
        angles = number(radians(self.friction)), number(radians(self.dilation))
        strength = number(self.cohesion), *angles, self._softening(_scale(self, band), number), _cutoff(self, number)
        if self.law is DruckerPrager:
            if not isinstance(self.matching, Matching):
                raise ValueError(f"matching = {self.matching!r}: give a member of Matching")
            return saturated(DruckerPrager(bulk, shear, *strength, self.matching, self.gap_memory), self.b_value)
        if self.law is MohrCoulomb:
            if self.matching is not Matching.PLANE_STRAIN:
                raise ValueError(
                    f"matching = {self.matching} is of Drucker-Prager's cone, and has no effect with MohrCoulomb: "
                    "leave it out, or give law=DruckerPrager"
                )
            return saturated(MohrCoulomb(bulk, shear, *strength, self.gap_memory), self.b_value)
        raise ValueError(f"law = {self.law!r}: give MohrCoulomb or DruckerPrager")

    def _softening(self, scale: float, number: Callable[[ArrayLike], Array]) -> FrictionalSoftening | None:
        if self.softening_strain is None:
            for name in ("residual_cohesion", "residual_friction"):
                value = getattr(self, name)
                if check.is_traced(value) or value:
                    raise ValueError(f"{name} has no effect without softening_strain: give it, or leave {name} out")
            return None
        check.between("residual_cohesion", self.residual_cohesion, 0.0, self.cohesion, ends=True)
        check.between("residual_friction", self.residual_friction, 0.0, self.friction, ends=True)
        if not isinstance(self.decay, Decay):
            raise ValueError(f"decay = {self.decay!r}: give a member of Decay")
        residual = number(self.residual_cohesion), number(radians(self.residual_friction))
        return FrictionalSoftening(*residual, number(self.softening_strain / scale), self.decay)


def check_soil(soil: Soil | FrictionalSoil) -> None:
    """Raise ValueError for numbers that are impossible for soil."""
    check_numbers(soil)
    if not isinstance(soil.gap_memory, bool):
        raise ValueError(f"gap_memory = {soil.gap_memory!r}: give True or False")


def check_numbers(soil: object) -> None:
    """Raise ValueError for numbers of any soil beyond their limits."""
    for name, limit in LIMITS.items():
        value = getattr(soil, name, None)
        if value is not None and (name, value) != ("softening_length", "cell"):
            check.within(name, value, limit)


def _check_contraction(soil: FrictionalSoil) -> None:
    """Raise ValueError for soil that contracts so fast that the elastic part of its strain turns round."""
    if check.is_traced(soil.dilation, soil.friction, soil.poisson):
        return
    turned = np.max(-np.sin(np.radians(soil.friction)) * np.sin(np.radians(soil.dilation)))
    if turned >= 1 - 2 * soil.poisson:
        raise ValueError(
            f"dilation = {np.min(soil.dilation):g} degrees with friction = {np.max(soil.friction):g} degrees and "
            f"poisson = {soil.poisson:g}: sin(friction) sin(-dilation) = {turned:.3g} is not below 1 - 2 poisson, so "
            "that contraction takes more stress than shear gives; give less contraction, or a lower poisson"
        )


def _scale(soil: Soil | FrictionalSoil, band: float) -> float:
    """Thickness of the grid's shear bands over the one that softening refers to."""
    length = soil.softening_length
    return 1.0 if length is None or isinstance(length, str) else band / length


def _cutoff(soil: Soil | FrictionalSoil, number: Callable[[ArrayLike], Array]) -> Array | None:
    return None if soil.tension_cutoff is None else number(soil.tension_cutoff)


def radians(angle: Number) -> Number:
    """An angle in radians.

    Args:
        angle: degrees, a number or an array.

    Returns:
        rad.
    """
    return angle * (math.pi / 180)


def moduli(young: Number, poisson: Number) -> tuple[Number, Number]:
    """Bulk and shear modulus from Young's modulus and Poisson's ratio.

    Args:
        young: Pa, a number or an array.
        poisson: a number or an array.

    Returns:
        Bulk and shear modulus (Pa).
    """
    return young / (3 * (1 - 2 * poisson)), young / (2 * (1 + poisson))
