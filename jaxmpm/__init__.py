"""Batched, differentiable generalised-interpolation material point method in 1D, 2D and 3D."""

from foundation import __version__
from foundation.deprecated import renamed
from foundation.pytrees import pytree
from jaxmpm import diagnostics, ground, laws, run, soil, tensors, transfer
from jaxmpm._step import step
from jaxmpm.grid import Grid, Particles, Wall
from jaxmpm.ground import (
    Face,
    Ground,
    Layer,
    Raster,
    Section,
    Slope,
    Terrain,
    read_line,
    read_raster,
    scene_of,
    section,
    slope,
    terrain,
)
from jaxmpm.io import load_state, save_state, write_particles, write_vtkhdf
from jaxmpm.laws import BaseMotion
from jaxmpm.protocols import Kernel, Material
from jaxmpm.run import (
    Result,
    Settle,
    advance,
    checkpoints,
    factor_of_safety,
    objectives,
    passing,
    reduced,
    replay,
    solve,
    solve_each,
    strength_sensitivity,
    with_columns,
)
from jaxmpm.setup import (
    Boundary,
    Discretisation,
    Loads,
    at_rest,
    bar,
    block,
    cell_independent,
    column,
    fill,
    overburden,
    read_motion,
    scene,
    unstressed,
    with_soil,
)
from jaxmpm.soil import FrictionalSoil, Interface, PlasticStrain, Soil
from jaxmpm.transfer import GIMP, Linear, QuadraticBSpline
from jaxmpm.types import Engine, Scene, Scheme, State, Status

__all__ = [
    "GIMP",
    "BaseMotion",
    "Boundary",
    "Discretisation",
    "Engine",
    "Face",
    "FrictionalSoil",
    "Grid",
    "Ground",
    "Interface",
    "Kernel",
    "Layer",
    "Linear",
    "Loads",
    "Material",
    "Particles",
    "PlasticStrain",
    "QuadraticBSpline",
    "Raster",
    "Result",
    "Scene",
    "Scheme",
    "Section",
    "Settle",
    "Slope",
    "Soil",
    "State",
    "Status",
    "Terrain",
    "Wall",
    "__version__",
    "advance",
    "at_rest",
    "bar",
    "block",
    "cell_independent",
    "checkpoints",
    "column",
    "diagnostics",
    "factor_of_safety",
    "fill",
    "ground",
    "laws",
    "load_state",
    "objectives",
    "overburden",
    "passing",
    "pytree",
    "read_line",
    "read_motion",
    "read_raster",
    "reduced",
    "replay",
    "run",
    "save_state",
    "scene",
    "scene_of",
    "section",
    "slope",
    "soil",
    "solve",
    "solve_each",
    "step",
    "strength_sensitivity",
    "tensors",
    "terrain",
    "transfer",
    "unstressed",
    "with_columns",
    "with_soil",
    "write_particles",
    "write_vtkhdf",
]

_RENAMED = {
    "foundation.check": "Limit",
    "foundation.files": "DamagedFile",
    "jaxmpm.ground": "Thickness",
    "jaxmpm.laws": "Decay DruckerPrager Elastic ExponentialSoftening FrictionalSoftening J2 Law Matching "
    "MohrCoulomb Parameter RateEffect Softening WaterSurface WaterTable Zoned cone declared reduce_strength "
    "with_parameters",
    "jaxmpm.run": "Checkpoints Chunk FactorOfSafety Midway Passing advance_lanes column_shape lanes repeat",
    "jaxmpm.setup": "with_strength",
    "jaxmpm.soil": "AnySoil moduli soil_limits unit_slip",
    "jaxmpm.transfer": "native_available native_library",
    "jaxmpm.types": "Columns FreeField",
}
"""By module: names that have moved there."""
__getattr__ = renamed(__name__, _RENAMED, Believed="jaxmpm.soil.Plausible")
