"""Constitutive laws: (parameters, strain increment, stress, history) -> (stress, history)."""

from jaxmpm.laws._base import Law, reduce_strength, snaps_back
from jaxmpm.laws._frictional import DruckerPrager, Matching, MohrCoulomb, cone
from jaxmpm.laws._softening import Decay, ExponentialSoftening, FrictionalSoftening, RateEffect, Softening
from jaxmpm.laws._undrained import J2, Elastic, elastic_increment

__all__ = [
    "J2",
    "Decay",
    "DruckerPrager",
    "Elastic",
    "ExponentialSoftening",
    "FrictionalSoftening",
    "Law",
    "Matching",
    "MohrCoulomb",
    "RateEffect",
    "Softening",
    "cone",
    "elastic_increment",
    "reduce_strength",
    "snaps_back",
]
