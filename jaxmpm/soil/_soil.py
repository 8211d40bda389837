"""Soil in engineers' numbers, and the constitutive law that they make."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from foundation import check
from jaxmpm.laws import (
    J2,
    Decay,
    DruckerPrager,
    Elastic,
    ExponentialSoftening,
    FrictionalSoftening,
    Matching,
    MohrCoulomb,
    RateEffect,
    Softening,
)
from jaxmpm.soil._units import BELIEVED, unit_slip

STANDARD_GRAVITY = 9.81
"""What turns a unit weight into a density (m/s2), whatever gravity a scene has."""


class PlasticStrain(enum.Enum):
    """The plastic strain that softening counts.

    ENGINEERING: sqrt(2 e:e), gamma in simple shear. EQUIVALENT: sqrt(2/3 e:e), 1/sqrt(3) of it.
    """

    ENGINEERING = "engineering"
    EQUIVALENT = "equivalent"


@dataclass(frozen=True)
class Soil:
    """An elastic soil with undrained strength, in SI units.

    unit_weight: N/m3. young, poisson: Young's modulus (Pa) and Poisson's ratio. strength: peak undrained shear strength
    S_u (Pa), a number or one value per particle (N,) of the scene, None for an elastic soil. softening_modulus: loss of
    strength per unit of plastic strain (Pa). strain_95: instead of it, the plastic strain at which 95 per cent of an
    exponential loss is done. residual_ratio: residual over peak strength. plastic_strain: the
    measure of both. softening_length: thickness of the shear band (m) to which they refer; softening is then scaled by
    the thickness of the grid's bands (a cell, or what an internal_length makes of them) over it, so that a band takes
    the same work whatever the grid. None leaves them as they are. rate_coefficient: gain of strength per tenfold shear
    rate above reference_rate (1/s), None without. tension_cutoff: largest mean stress (Pa) or None. gap_memory: whether
    soil that the cutoff has opened closes its gap before it bears pressure; False lets it resist at once. unusual:
    whether numbers that betray another unit are meant as they are; builders warn of them otherwise, see `unit_slip`.
    """

    unit_weight: float = 20e3
    young: float = 1e8
    poisson: float = 0.3
    strength: float | Array | None = None
    softening_modulus: float | None = None
    residual_ratio: float = 0.5
    tension_cutoff: float | None = 0.0
    gap_memory: bool = True
    plastic_strain: PlasticStrain = PlasticStrain.ENGINEERING
    strain_95: float | None = None
    softening_length: float | None = None
    rate_coefficient: float | None = None
    reference_rate: float = 3e-6
    unusual: bool = False

    @property
    def softens(self) -> bool:
        """Whether strength falls with plastic strain."""
        return self.strength is not None and (self.softening_modulus is not None or self.strain_95 is not None)


@dataclass(frozen=True)
class FrictionalSoil:
    """An elastic soil with cohesion (Pa) and friction (degrees), in SI units.

    unit_weight: N/m3, that of soil and its water. saturated_unit_weight: of soil that starts below a water table
    (N/m3), None the same. young, poisson: Young's modulus (Pa) and Poisson's ratio. dilation: degrees, at most the
    friction. criterion: the law. matching: of Drucker-Prager's cone. residual_cohesion, residual_friction: reached over
    the engineering plastic shear strain `softening_strain`, in the manner of `decay`; softening_strain None keeps the
    peak. softening_length: as for `Soil`. tension_cutoff: largest mean stress of Drucker-Prager, largest principal
    stress of Mohr-Coulomb (Pa); None leaves it to the apex. gap_memory, unusual: as for `Soil`.
    """

    cohesion: float
    friction: float
    dilation: float = 0.0
    unit_weight: float = 20e3
    young: float = 1e8
    poisson: float = 0.3
    criterion: type[MohrCoulomb] | type[DruckerPrager] = MohrCoulomb
    matching: Matching = Matching.PLANE_STRAIN
    residual_cohesion: float = 0.0
    residual_friction: float = 0.0
    softening_strain: float | None = None
    decay: Decay = Decay.LINEAR
    softening_length: float | None = None
    tension_cutoff: float | None = None
    gap_memory: bool = True
    saturated_unit_weight: float | None = None
    unusual: bool = False

    @property
    def softens(self) -> bool:
        """Whether cohesion and friction fall with plastic strain."""
        return self.softening_strain is not None


AnySoil = Soil | FrictionalSoil
"""Of either kind."""


def material_of(soil: AnySoil, dtype: np.dtype, band: float) -> Elastic | J2 | MohrCoulomb | DruckerPrager:
    """The law of a soil on a grid whose shear bands are `band` (m) thick.

    Raises ValueError for what no soil can have.
    """
    check.positive("unit_weight", soil.unit_weight, "N/m3")
    check.positive("young", soil.young, "Pa")
    check.between("poisson", soil.poisson, -1.0, 0.5)
    if soil.tension_cutoff is not None:
        check.not_negative("tension_cutoff", soil.tension_cutoff, "Pa")
    if not isinstance(soil.gap_memory, bool):
        raise ValueError(f"gap_memory = {soil.gap_memory!r}: give True or False")
    if soil.softening_length is not None:
        check.positive("softening_length", soil.softening_length, "m")
    number = partial(jnp.asarray, dtype=dtype)
    bulk, shear = (number(modulus) for modulus in moduli(soil.young, soil.poisson))
    cutoff = None if soil.tension_cutoff is None else number(soil.tension_cutoff)
    scale = 1.0 if soil.softening_length is None else band / soil.softening_length
    if isinstance(soil, FrictionalSoil):
        return _frictional(soil, bulk, shear, cutoff, scale, number)
    if soil.strength is None:
        return Elastic(bulk, shear)
    check.positive("strength", soil.strength, "Pa")
    strength, softening = number(soil.strength), _softening(soil, scale, number)
    return J2(bulk, shear, strength, softening, cutoff, _rate(soil, number), soil.gap_memory)


@dataclass(frozen=True)
class Interface:
    """Strength of the contact between soil and the rigid base: what slides on rock, or on a seam too thin for a cell.

    friction: degrees. cohesion: Pa. Strength reduction divides both, as it does those of the soil.
    """

    friction: float
    cohesion: float = 0.0

    def check(self) -> None:
        """Raise ValueError for a strength that no contact has."""
        check.between("the interface's friction", self.friction, 0.0, 60.0, ends=True)
        check.not_negative("the interface's cohesion", self.cohesion, "Pa")


def warn_of_units(soil: AnySoil) -> None:
    """Warn, once for all of them, of numbers that betray another unit, unless the soil says that it means them."""
    slips = () if soil.unusual else dict.fromkeys(_slips(soil))
    if slips:
        check.warn(f"{'; '.join(slips)} If that is meant, give the soil unusual=True")


def _slips(soil: AnySoil) -> Iterator[str]:
    """What to ask of each number, of the least and the largest where there are several."""
    for name in BELIEVED:
        value = getattr(soil, name, None)
        if value is None or check.is_traced(value) or not np.size(value):
            continue
        for end in (np.min, np.max):
            if slip := unit_slip(name, float(end(np.asarray(value)))):
                yield f"{name} = {slip}"


def moduli(young: Any, poisson: Any) -> tuple[Any, Any]:
    """Bulk and shear modulus (Pa)."""
    return young / (3 * (1 - 2 * poisson)), young / (2 * (1 + poisson))


def _softening(soil: Soil, scale: float, number: Callable[..., Any]) -> Softening | ExponentialSoftening | None:
    if soil.strain_95 is not None and soil.softening_modulus is not None:
        raise ValueError("both softening_modulus and strain_95 are given: choose linear or exponential softening")
    check.between("residual_ratio", soil.residual_ratio, 0.0, 1.0, ends=True)
    if not isinstance(soil.plastic_strain, PlasticStrain):
        raise ValueError(f"plastic_strain = {soil.plastic_strain!r}: give a member of PlasticStrain")
    # Engineering over the soil's own measure of strain.
    share = 1.0 if soil.plastic_strain is PlasticStrain.ENGINEERING else math.sqrt(3)
    if soil.softening_modulus is not None:
        check.positive("softening_modulus", soil.softening_modulus, "Pa")
        return Softening(number(soil.softening_modulus * scale / share), number(soil.residual_ratio))
    if soil.strain_95 is None:
        return None
    check.positive("strain_95", soil.strain_95)
    return ExponentialSoftening(number(soil.residual_ratio), number(soil.strain_95 * share / scale))


def _rate(soil: Soil, number: Callable[..., Any]) -> RateEffect | None:
    if soil.rate_coefficient is None:
        return None
    check.not_negative("rate_coefficient", soil.rate_coefficient)
    check.positive("reference_rate", soil.reference_rate, "1/s")
    return RateEffect(number(soil.rate_coefficient), number(soil.reference_rate))


def _frictional(
    soil: FrictionalSoil, bulk: Array, shear: Array, cutoff: Array | None, scale: float, number: Callable[..., Any]
) -> MohrCoulomb | DruckerPrager:
    if soil.saturated_unit_weight is not None:
        check.positive("saturated_unit_weight", soil.saturated_unit_weight, "N/m3")
    check.not_negative("cohesion", soil.cohesion, "Pa")
    check.between("friction", soil.friction, 0.0, 60.0, ends=True)
    check.between("dilation", soil.dilation, 0.0, soil.friction, ends=True)
    if soil.cohesion == 0 and soil.friction == 0:
        raise ValueError("cohesion = 0 Pa with friction = 0 degrees: give at least one of them")
    softening = None
    if soil.softening_strain is not None:
        check.positive("softening_strain", soil.softening_strain)
        check.between("residual_cohesion", soil.residual_cohesion, 0.0, soil.cohesion, ends=True)
        check.between("residual_friction", soil.residual_friction, 0.0, soil.friction, ends=True)
        if not isinstance(soil.decay, Decay):
            raise ValueError(f"decay = {soil.decay!r}: give a member of Decay")
        residual = number(soil.residual_cohesion), number(math.radians(soil.residual_friction))
        softening = FrictionalSoftening(*residual, number(soil.softening_strain / scale), soil.decay)
    angles = number(math.radians(soil.friction)), number(math.radians(soil.dilation))
    if soil.criterion is DruckerPrager:
        if not isinstance(soil.matching, Matching):
            raise ValueError(f"matching = {soil.matching!r}: give a member of Matching")
        law = DruckerPrager(bulk, shear, number(soil.cohesion), *angles, softening, cutoff, soil.matching)
        return replace(law, gap_memory=soil.gap_memory)
    if soil.criterion is MohrCoulomb:
        return MohrCoulomb(bulk, shear, number(soil.cohesion), *angles, softening, cutoff, soil.gap_memory)
    raise ValueError(f"criterion = {soil.criterion!r}: give MohrCoulomb or DruckerPrager")
