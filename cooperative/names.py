"""Names that commands, scenes, stores and reports share."""

GRIDS = ("rough", "refined")
USUAL_EXPORTS = ("table", "particles", "maps")
"""Files that `export` writes where nobody names others."""
EXPORTS = (*USUAL_EXPORTS, "geotiff", "geopackage", "netcdf")
DRAWN_SLIDES = 3
"""Slides that a report draws at several times, unless the caller gives another number."""
