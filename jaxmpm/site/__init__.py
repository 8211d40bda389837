"""From a slope, its soil and a grid to (Scene, State): geometry, soil, initial stress, and all validation."""

from jaxmpm.site._believed import Believed, unit_slip
from jaxmpm.site._builders import Slope, bar, block, column, fill, slope
from jaxmpm.site._discretisation import Discretisation, cell_independent
from jaxmpm.site._initial_stress import at_rest
from jaxmpm.site._line import read_line
from jaxmpm.site._motion import read_motion
from jaxmpm.site._raster import Raster, read_raster
from jaxmpm.site._scene import check_scene, check_shape, refuse_snap_back, scene, unstressed, with_strength
from jaxmpm.site._seam import Thickness
from jaxmpm.site._section import Layer, Section, section
from jaxmpm.site._soil import FrictionalSoil, Interface, PlasticStrain, Soil
from jaxmpm.site._terrain import Terrain, terrain
from jaxmpm.site._vary import check_names, check_start, parameter_names, vary, with_parameters, with_soil

__all__ = [
    "Believed",
    "Discretisation",
    "FrictionalSoil",
    "Interface",
    "Layer",
    "PlasticStrain",
    "Raster",
    "Section",
    "Slope",
    "Soil",
    "Terrain",
    "Thickness",
    "at_rest",
    "bar",
    "block",
    "cell_independent",
    "check_names",
    "check_scene",
    "check_shape",
    "check_start",
    "column",
    "fill",
    "parameter_names",
    "read_line",
    "read_motion",
    "read_raster",
    "refuse_snap_back",
    "scene",
    "section",
    "slope",
    "terrain",
    "unit_slip",
    "unstressed",
    "vary",
    "with_parameters",
    "with_soil",
    "with_strength",
]
