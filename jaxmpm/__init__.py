"""Batched, differentiable generalised-interpolation material point method in 1D, 2D and 3D."""

from jaxmpm import diagnostics, files, objectives, tensors
from jaxmpm.discretisation import Discretisation, cell_independent
from jaxmpm.files import DamagedFile, write_aside
from jaxmpm.frictional import DruckerPrager, Matching, MohrCoulomb, cone
from jaxmpm.integrate import Result, Settle, advance, advance_lanes, lanes, repeat, solve
from jaxmpm.io import load_state, save_state, write_particles, write_vtkhdf
from jaxmpm.many import Chunk, Midway, solve_each
from jaxmpm.materials import J2, Elastic, reduce_strength
from jaxmpm.pytrees import pytree
from jaxmpm.reduction import FactorOfSafety, factor_of_safety, reduced
from jaxmpm.replay import Checkpoints, checkpoints, replay
from jaxmpm.scenes import Slope, bar, block, column, slope, with_strength
from jaxmpm.sensitivity import strength_sensitivity
from jaxmpm.softening import Decay, ExponentialSoftening, FrictionalSoftening, RateEffect, Softening
from jaxmpm.soil import FrictionalSoil, PlasticStrain, Soil
from jaxmpm.step import step
from jaxmpm.types import (
    GIMP,
    Engine,
    Grid,
    Linear,
    Material,
    Particles,
    QuadraticBSpline,
    Scene,
    Scheme,
    State,
    Status,
    Wall,
)

__all__ = [
    "GIMP",
    "J2",
    "Checkpoints",
    "Chunk",
    "DamagedFile",
    "Decay",
    "Discretisation",
    "DruckerPrager",
    "Elastic",
    "Engine",
    "ExponentialSoftening",
    "FactorOfSafety",
    "FrictionalSoftening",
    "FrictionalSoil",
    "Grid",
    "Linear",
    "Matching",
    "Material",
    "Midway",
    "MohrCoulomb",
    "Particles",
    "PlasticStrain",
    "QuadraticBSpline",
    "RateEffect",
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
    "advance_lanes",
    "bar",
    "block",
    "cell_independent",
    "checkpoints",
    "column",
    "cone",
    "diagnostics",
    "factor_of_safety",
    "files",
    "lanes",
    "load_state",
    "objectives",
    "pytree",
    "reduce_strength",
    "reduced",
    "repeat",
    "replay",
    "save_state",
    "slope",
    "solve",
    "solve_each",
    "step",
    "strength_sensitivity",
    "tensors",
    "with_strength",
    "write_aside",
    "write_particles",
    "write_vtkhdf",
]
