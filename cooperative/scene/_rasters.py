"""Rasters of heights within the text of a scene, so that it stands alone: cropped, packed, checked as they are read."""

from __future__ import annotations

import base64
import binascii
import zlib
from typing import Any

import numpy as np

from foundation.text import shown
from jaxmpm import Raster

MOST_HEIGHTS = 150_000
"""Heights of a raster in a scene: half of the megabyte that a scene's text may have."""


def packed(name: str, raster: Raster) -> dict[str, Any]:
    """A raster as a table of a scene: its heights in single precision, compressed. ValueError for too many."""
    nx, ny = raster.heights.shape
    if nx * ny > MOST_HEIGHTS:
        raise ValueError(
            f"{name} has {nx} times {ny} heights between the walls, the limit is {MOST_HEIGHTS}: give walls x and y "
            "that lie closer, or a longer step in [terrain]"
        )
    data = zlib.compress(np.asarray(raster.heights, "<f4").tobytes(), 9)
    table: dict[str, Any] = {"corner": list(raster.corner), "step": raster.step, "shape": [nx, ny]}
    if raster.projection is not None:
        table["projection"] = raster.projection
    return table | {"heights": base64.b64encode(data).decode()}


def unpacked(table: Any) -> Raster:
    """The raster in a table of a scene. ValueError for one that holds something else, or less than it says."""
    try:
        (nx, ny), (x, y), step = table["shape"], table["corner"], table["step"]
        projection = table.get("projection")
        if not (projection is None or isinstance(projection, str)):
            raise ValueError(f"projection {shown(projection)}")
        if not (all(isinstance(n, int) and n >= 2 for n in (nx, ny)) and nx * ny <= MOST_HEIGHTS):
            raise ValueError(f"shape {shown(table['shape'])}")
        unpack = zlib.decompressobj()
        data = unpack.decompress(base64.b64decode(table["heights"], validate=True), 4 * nx * ny + 1)
        if len(data) != 4 * nx * ny:
            raise ValueError(f"{len(data)} bytes for {nx} times {ny} heights")
        heights = np.frombuffer(data, "<f4").astype(float).reshape(nx, ny)
        found = Raster(heights, (float(x), float(y)), float(step), projection)
    except (AttributeError, TypeError, KeyError, ValueError, OverflowError, zlib.error, binascii.Error) as error:
        raise ValueError(f": its table in [files] is damaged ({shown(str(error))}): run the scene's file") from error
    found.check("")
    return found
