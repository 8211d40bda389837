"""Ground: its protocol, slopes, sections and terrain, their layers and files, and the particles that fill it."""

from jaxmpm.ground._base import rigid_base
from jaxmpm.ground._contact import Contact
from jaxmpm.ground._fill import cells, scene_of
from jaxmpm.ground._ground import Face, Ground, build_ground, check_ground, layer_of
from jaxmpm.ground._layer import Layer
from jaxmpm.ground._line import read_line
from jaxmpm.ground._pore_water import WATER_WEIGHT, wet
from jaxmpm.ground._probe import box_of, floor, points_held, relief, thicknesses, top_of, volume
from jaxmpm.ground._raster import Raster, read_raster
from jaxmpm.ground._reshape import reshaped
from jaxmpm.ground._seam import Thickness
from jaxmpm.ground._section import Section, section
from jaxmpm.ground._slope import Slope, as_section, slope
from jaxmpm.ground._terrain import Terrain, terrain
from jaxmpm.setup import check_discretisation, estimated_nodes

__all__ = [
    "WATER_WEIGHT",
    "Contact",
    "Face",
    "Ground",
    "Layer",
    "Raster",
    "Section",
    "Slope",
    "Terrain",
    "Thickness",
    "as_section",
    "box_of",
    "build_ground",
    "cells",
    "check_discretisation",
    "check_ground",
    "estimated_nodes",
    "floor",
    "layer_of",
    "points_held",
    "read_line",
    "read_raster",
    "relief",
    "reshaped",
    "rigid_base",
    "scene_of",
    "section",
    "slope",
    "terrain",
    "thicknesses",
    "top_of",
    "volume",
    "wet",
]
