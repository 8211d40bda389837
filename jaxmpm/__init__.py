"""Batched, differentiable generalised-interpolation material point method in 1D, 2D and 3D."""

from jaxmpm import diagnostics, tensors
from jaxmpm.integrate import Result, Settle, advance, lanes, repeat, solve
from jaxmpm.many import Chunk, solve_each
from jaxmpm.materials import J2, Elastic, Softening, reduce_strength
from jaxmpm.reduction import FactorOfSafety, factor_of_safety, reduced
from jaxmpm.scenes import Discretisation, Slope, bar, block, column, slope, with_strength
from jaxmpm.soil import PlasticStrain, Soil
from jaxmpm.step import step
from jaxmpm.types import GIMP, Engine, Grid, Linear, Material, Particles, Scene, Scheme, State, Status, Wall

__all__ = [
    "GIMP",
    "J2",
    "Chunk",
    "Discretisation",
    "Elastic",
    "Engine",
    "FactorOfSafety",
    "Grid",
    "Linear",
    "Material",
    "Particles",
    "PlasticStrain",
    "Result",
    "Scene",
    "Scheme",
    "Settle",
    "Slope",
    "Softening",
    "Soil",
    "State",
    "Status",
    "Wall",
    "advance",
    "bar",
    "block",
    "column",
    "diagnostics",
    "factor_of_safety",
    "lanes",
    "reduce_strength",
    "reduced",
    "repeat",
    "slope",
    "solve",
    "solve_each",
    "step",
    "tensors",
    "with_strength",
]
