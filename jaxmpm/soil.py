"""Soil in engineers' numbers, and the constitutive law that they make."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from jaxmpm import check
from jaxmpm.materials import J2, Elastic, Softening


class PlasticStrain(enum.Enum):
    """The plastic strain that softening counts.

    ENGINEERING: sqrt(2 e:e), gamma in simple shear. EQUIVALENT: sqrt(2/3 e:e), 1/sqrt(3) of it.
    """

    ENGINEERING = "engineering"
    EQUIVALENT = "equivalent"


@dataclass(frozen=True)
class Soil:
    """An elastic soil with undrained strength, in SI units.

    strength: peak undrained shear strength S_u (Pa), None for an elastic soil. softening_modulus: loss of strength
    per unit of plastic strain (Pa), None without softening. residual_ratio: residual over peak strength.
    plastic_strain: the measure that the softening modulus refers to. tension_cutoff: largest mean stress (Pa) or None.
    """

    unit_weight: float = 20e3
    young: float = 1e8
    poisson: float = 0.3
    strength: float | None = None
    softening_modulus: float | None = None
    residual_ratio: float = 0.5
    tension_cutoff: float | None = 0.0
    plastic_strain: PlasticStrain = PlasticStrain.ENGINEERING


def material_of(soil: Soil, dtype: np.dtype) -> Elastic | J2:
    """The law of a soil; raises ValueError for moduli and strengths that no soil can have."""
    check.positive("young", soil.young, "Pa")
    check.between("poisson", soil.poisson, -1.0, 0.5)
    bulk = jnp.asarray(soil.young / (3 * (1 - 2 * soil.poisson)), dtype)
    shear = jnp.asarray(soil.young / (2 * (1 + soil.poisson)), dtype)
    if soil.strength is None:
        return Elastic(bulk, shear)
    check.positive("strength", soil.strength, "Pa")
    softening = None
    if soil.softening_modulus is not None:
        check.positive("softening_modulus", soil.softening_modulus, "Pa")
        check.between("residual_ratio", soil.residual_ratio, 0.0, 1.0, ends=True)
        if not isinstance(soil.plastic_strain, PlasticStrain):
            raise ValueError(f"plastic_strain = {soil.plastic_strain!r}: give a member of PlasticStrain")
        share = 1.0 if soil.plastic_strain is PlasticStrain.ENGINEERING else 1 / math.sqrt(3)
        modulus = soil.softening_modulus * share
        if modulus >= float(shear):
            raise ValueError(
                f"softening_modulus = {soil.softening_modulus:g} Pa is steeper than elastic unloading (shear modulus "
                f"{float(shear):g} Pa), which snaps back: lower it or raise the stiffness"
            )
        softening = Softening(jnp.asarray(modulus, dtype), jnp.asarray(soil.residual_ratio, dtype))
    if soil.tension_cutoff is not None:
        check.not_negative("tension_cutoff", soil.tension_cutoff, "Pa")
    cutoff = None if soil.tension_cutoff is None else jnp.asarray(soil.tension_cutoff, dtype)
    return J2(bulk, shear, jnp.asarray(soil.strength, dtype), softening, cutoff)
