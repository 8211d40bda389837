"""From a slope, its soil and a grid to (Scene, State): geometry, soil, initial stress, and all validation."""

from jaxmpm.site._builders import Slope, bar, block, column, slope, with_strength
from jaxmpm.site._discretisation import Discretisation, cell_independent
from jaxmpm.site._soil import FrictionalSoil, PlasticStrain, Soil

__all__ = [
    "Discretisation",
    "FrictionalSoil",
    "PlasticStrain",
    "Slope",
    "Soil",
    "bar",
    "block",
    "cell_independent",
    "column",
    "slope",
    "with_strength",
]
