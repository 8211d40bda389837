"""Constitutive laws: (parameters, strain increment, stress, history) -> (stress, history)."""

from jaxmpm.laws._frictional import DruckerPrager, Matching, MohrCoulomb, cone
from jaxmpm.laws._softening import Decay, ExponentialSoftening, FrictionalSoftening, RateEffect, Softening
from jaxmpm.laws._undrained import J2, Elastic, elastic_increment, reduce_strength

__all__ = [
    "J2",
    "Decay",
    "DruckerPrager",
    "Elastic",
    "ExponentialSoftening",
    "FrictionalSoftening",
    "Matching",
    "MohrCoulomb",
    "RateEffect",
    "Softening",
    "cone",
    "elastic_increment",
    "reduce_strength",
]
