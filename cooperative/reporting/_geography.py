"""Hazard maps for programs of geography: ASCII grids, GeoTIFF, contours as GeoJSON, one tidy table."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from contourpy import contour_generator

from cooperative.hazard import Maps
from cooperative.runs import StoredGround
from cooperative.store import own_folder
from foundation.files import write_aside

NODATA = -9999.0
CONTOURS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
"""Probabilities of which contours are drawn; of what is no probability, so many tenths of the largest value."""
TENTHS = (1, 2, 4, 6, 8)
LIMITS = ("value", "low", "high")


class MissingLibrary(ValueError):
    """A library of an extra is not installed; the message says which one, what for, and how to install it."""


def write_tidy(folder: Path, maps: Maps) -> Path:
    """Write every map as one table, `maps/hazard.csv`: a line for each column of cells and map, with its centre in the
    scene's coordinates (m), value, limits, unit, and how many slides did it; empty where no slide tells."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    axes = ("x", "y")[: len(maps.edges)]
    writer.writerow(["map", "unit", *axes, *LIMITS, "slides"])
    centres = [middle(edges) for edges in maps.edges]
    for name, found in maps.maps.items():
        for at in np.ndindex(found.value.shape):
            place = [centre[i] for centre, i in zip(centres, at, strict=True)]
            told = [_said(getattr(found, limit)[at]) for limit in LIMITS]
            writer.writerow([name, maps.units[name], *place, *told, int(found.count[at])])
    return _written(folder, "hazard.csv", text.getvalue().encode())


def write_ascii(folder: Path, ground: StoredGround, maps: Maps) -> Iterator[Path]:
    """Write ESRI ASCII grids in plan, `maps/reached.asc` with `-low` and `-high` for its limits, and so for each map;
    each with the projection beside it (`.prj`) where the scene has one. NODATA is -9999."""
    west, south = _corner(ground, maps)
    for name, found in maps.maps.items():
        for limit in LIMITS:
            values = getattr(found, limit)
            nx, ny = values.shape
            head = f"ncols {nx}\nnrows {ny}\nxllcorner {west!r}\nyllcorner {south!r}\ncellsize {maps.plan.cell!r}\n"
            rows = np.where(np.isfinite(values), values, NODATA).T[::-1]
            lines = "\n".join(" ".join(f"{value:.9g}" for value in row) for row in rows)
            file = key(name) + ("" if limit == "value" else f"-{limit}")
            yield _written(folder, f"{file}.asc", f"{head}NODATA_value {NODATA:g}\n{lines}\n".encode())
            if ground.projection is not None:
                yield _written(folder, f"{file}.prj", ground.projection.encode())


def write_geotiff(folder: Path, ground: StoredGround, maps: Maps) -> Iterator[Path]:
    """Write `maps/reached.tif` and so for each map, in plan: three bands, the value and both limits, with the scene's
    projection where it has one. NaN is no data. ValueError without rasterio (extra "terrain")."""
    rasterio = _rasterio("GeoTIFF")
    west, south = _corner(ground, maps)
    cell, projection = maps.plan.cell, _known_projection(rasterio, ground)
    for name, found in maps.maps.items():
        nx, ny = found.value.shape
        how: dict[str, Any] = {"width": nx, "height": ny, "count": len(LIMITS), "dtype": "float64", "nodata": np.nan}
        how |= {"crs": projection, "transform": rasterio.Affine(cell, 0, west, 0, -cell, south + ny * cell)}
        with rasterio.MemoryFile() as memory:
            with memory.open(driver="GTiff", compress="deflate", **how) as file:
                for band, limit in enumerate(LIMITS, 1):
                    file.write(getattr(found, limit).T[::-1], band)
                    file.set_band_description(band, name if limit == "value" else f"{name}, {limit} limit")
                    file.set_band_unit(band, maps.units[name])
                file.update_tags(map=name, level=f"{maps.level:g}", slides=str(maps.slides))
                file.update_tags(slides_not_at_rest=str(maps.moving))
            data = bytes(memory.getbuffer())
        yield _written(folder, f"{key(name)}.tif", data)


def write_contours(folder: Path, ground: StoredGround, maps: Maps) -> Iterator[Path]:
    """Write contours of each map's value between the centres of its columns, `maps/reached.geojson` and so on.

    Where the scene has a projection they are in longitude and latitude, as GeoJSON asks for (RFC 7946, Section 4),
    which needs rasterio (extra "terrain"); else in the scene's own metres, and the file says so.
    """
    place = _to_degrees(ground)
    for name, found in maps.maps.items():
        features = []
        for height, lines in _contours(maps, found.value, maps.units[name]):
            drawn = [place(line).tolist() for line in lines]
            features.append(
                {
                    "type": "Feature",
                    "properties": {"map": name, "value": height, "unit": maps.units[name]},
                    "geometry": {"type": "MultiLineString", "coordinates": drawn},
                }
            )
        whole: dict[str, Any] = {"type": "FeatureCollection", "name": name, "features": features}
        if maps.moving:
            whole["at_least"] = at_least(maps)
        if ground.projection is None:
            whole["coordinates_are"] = "metres of the scene: it has no projection"
        yield _written(folder, f"{key(name)}.geojson", json.dumps(whole).encode())


def write_notice(folder: Path, maps: Maps) -> Iterator[Path]:
    """Write `maps/AT_LEAST.txt` where slides had not come to rest; tables and rasters have no room to say so."""
    if maps.moving:
        yield _written(folder, "AT_LEAST.txt", f"{at_least(maps)}\n".encode())


def at_least(maps: Maps) -> str:
    """That slides would have gone on, in words."""
    return (
        f"{maps.moving} of {maps.slides} slides had not come to rest when they ended at {maps.until:g} s: all these "
        "maps are at least what is given."
    )


def key(name: str) -> str:
    """A map's name in names of files and variables: "deposit_thicker_than_0.5_m"."""
    return re.sub(r"[^\w.]+", "_", name.replace("/", "_per_")).strip("_")


def middle(edges: np.ndarray) -> np.ndarray:
    """Centres between edges."""
    return (edges[1:] + edges[:-1]) / 2


def missing(library: str, what: str) -> MissingLibrary:
    """That a library of an extra is not installed."""
    return MissingLibrary(f"{what} needs {library}, which is not installed: pip install {library}")


def _contours(maps: Maps, values: np.ndarray, unit: str) -> Iterator[tuple[float, list[np.ndarray]]]:
    """Values of which there are contours, and their lines (n, 2) m each."""
    if min(values.shape) < 2 or not np.isfinite(values).any():
        return
    x, y = (middle(edges) for edges in maps.edges)
    drawn = contour_generator(x, y, np.ma.masked_invalid(values.T))
    top = float(np.nanmax(values))
    for height in CONTOURS if unit == "-" else [top * tenth / 10 for tenth in TENTHS]:
        lines = [np.asarray(line) for line in drawn.lines(height)]
        if lines:
            yield float(height), lines


def _to_degrees(ground: StoredGround) -> Any:
    """Brings points (n, 2) of the scene to longitude and latitude, or leaves them where it has no projection."""
    if ground.projection is None:
        return lambda points: points
    rasterio = _rasterio("GeoJSON of a scene with a projection")
    from rasterio.warp import transform

    known = _known_projection(rasterio, ground)

    def placed(points: np.ndarray) -> np.ndarray:
        x, y = (points + np.asarray(ground.origin)).T
        return np.stack(transform(known, "EPSG:4326", x.tolist(), y.tolist()), axis=1)

    return placed


def _corner(ground: StoredGround, maps: Maps) -> tuple[float, float]:
    """West and south end of the mapped columns, in the scene's projection (m)."""
    (west, *_), (south, *_) = maps.edges
    return float(west + ground.origin[0]), float(south + ground.origin[1])


def _rasterio(what: str) -> ModuleType:
    try:
        import rasterio
    except ImportError as error:
        raise missing("rasterio", what) from error
    found: ModuleType = rasterio
    return found


def _known_projection(rasterio: Any, ground: StoredGround) -> Any:
    if ground.projection is None:
        return None
    try:
        return rasterio.crs.CRS.from_wkt(ground.projection)
    except rasterio.errors.CRSError as error:
        raise ValueError(
            f"the projection of [terrain] surface cannot be read ({error}): give a file with another, or none"
        ) from error


def _written(folder: Path, name: str, data: bytes) -> Path:
    path = own_folder(folder / "maps") / name
    write_aside(path, data)
    return path


def _said(value: float) -> object:
    return float(value) if np.isfinite(value) else ""
