"""Soil in engineers' units, the law that it gives, and detection of numbers in another unit."""

from jaxmpm.soil._beyond import AnisotropicSoil, CamClaySoil, GranularSoil
from jaxmpm.soil._interface import Interface
from jaxmpm.soil._layers import elastic_ratio, law_of_layers, ratio_at_rest, weights
from jaxmpm.soil._limits import AnySoil, soil_limits, warn_of_units
from jaxmpm.soil._soil import STANDARD_GRAVITY, FrictionalSoil, PlasticStrain, Soil, moduli, radians
from jaxmpm.soil._units import Plausible, unit_slip

__all__ = [
    "STANDARD_GRAVITY",
    "AnisotropicSoil",
    "AnySoil",
    "CamClaySoil",
    "FrictionalSoil",
    "GranularSoil",
    "Interface",
    "PlasticStrain",
    "Plausible",
    "Soil",
    "elastic_ratio",
    "law_of_layers",
    "moduli",
    "radians",
    "ratio_at_rest",
    "soil_limits",
    "unit_slip",
    "warn_of_units",
    "weights",
]
