"""Constitutive laws: (parameters, strain increment, stress, history) -> (stress, history)."""

from jaxmpm.laws._anisotropic import AnisotropicUndrained, Mobilisation
from jaxmpm.laws._base import Law, reduce_strength, snaps_back, stiffened
from jaxmpm.laws._base_motion import BaseMotion
from jaxmpm.laws._cam_clay import Consolidation, ModifiedCamClay
from jaxmpm.laws._element import ElementTest, element_test
from jaxmpm.laws._frictional import DruckerPrager, Matching, MohrCoulomb, cone
from jaxmpm.laws._gap import remembers_gap, update_with_gap
from jaxmpm.laws._granular import MuI
from jaxmpm.laws._hencky import logarithmic, volumetric
from jaxmpm.laws._parameter import Declared, Parameter, declared, excesses, hardens, has_strength, with_parameters
from jaxmpm.laws._saturated import (
    DRAINED,
    Saturated,
    Sealed,
    drained,
    excess_pressure,
    flooded,
    of_skeleton,
    pressure_left,
    saturated,
    with_skeleton,
)
from jaxmpm.laws._softening import Decay, ExponentialSoftening, FrictionalSoftening, LossInTime, RateEffect, Softening
from jaxmpm.laws._undrained import J2, Elastic, add, at_time, elastic_increment, elastic_strain
from jaxmpm.laws._water import WaterSurface, WaterTable
from jaxmpm.laws._zoned import Zoned, frictional, in_total_stress, laws_of, softened, weakens_until

__all__ = [
    "DRAINED",
    "J2",
    "AnisotropicUndrained",
    "BaseMotion",
    "Consolidation",
    "Decay",
    "Declared",
    "DruckerPrager",
    "Elastic",
    "ElementTest",
    "ExponentialSoftening",
    "FrictionalSoftening",
    "Law",
    "LossInTime",
    "Matching",
    "Mobilisation",
    "ModifiedCamClay",
    "MohrCoulomb",
    "MuI",
    "Parameter",
    "RateEffect",
    "Saturated",
    "Sealed",
    "Softening",
    "WaterSurface",
    "WaterTable",
    "Zoned",
    "add",
    "at_time",
    "cone",
    "declared",
    "drained",
    "elastic_increment",
    "elastic_strain",
    "element_test",
    "excess_pressure",
    "excesses",
    "flooded",
    "frictional",
    "hardens",
    "has_strength",
    "in_total_stress",
    "laws_of",
    "logarithmic",
    "of_skeleton",
    "pressure_left",
    "reduce_strength",
    "remembers_gap",
    "saturated",
    "snaps_back",
    "softened",
    "stiffened",
    "update_with_gap",
    "volumetric",
    "weakens_until",
    "with_parameters",
    "with_skeleton",
]
