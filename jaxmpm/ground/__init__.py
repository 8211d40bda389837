"""Ground: its shape, its layers and their files, and the particles that fill it."""

from jaxmpm.ground._line import read_line
from jaxmpm.ground._raster import Raster, read_raster
from jaxmpm.ground._seam import Thickness
from jaxmpm.ground._section import Layer, Section, section
from jaxmpm.ground._slope import Slope, slope
from jaxmpm.ground._terrain import Terrain, terrain

__all__ = [
    "Layer",
    "Raster",
    "Section",
    "Slope",
    "Terrain",
    "Thickness",
    "read_line",
    "read_raster",
    "section",
    "slope",
    "terrain",
]
