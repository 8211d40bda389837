"""Hazard maps as one table, and as a GeoPackage."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from contourpy import contour_generator

from cooperative.hazard import COVERED, HazardMaps
from cooperative.runs import StoredGround
from cooperative.store import own_folder
from jaxmpm.support.extras import extra
from jaxmpm.support.files import aside, write_aside
from jaxmpm.support.text import csv_text

CONTOURS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
"""Levels of the contours of probabilities."""
TENTHS = (1, 2, 4, 6, 8)
"""Levels of all other contours, in tenths of the largest value."""
LIMITS = ("value", "low", "high")


def require(what: str, *libraries: str) -> None:
    """Raise ValueError for a library that is not installed."""
    for library in libraries:
        extra(library, f"{what} needs {library}, which is not installed")


def maps_path(folder: Path, name: str) -> Path:
    """Path of a file in `maps/` of a campaign's folder, which is made where it is not there."""
    return own_folder(folder / "maps") / name


def write_tidy(folder: Path, maps: HazardMaps) -> Path:
    """Write every map as one table, `maps/hazard.csv`, a line for each column of cells and map.

    Columns: map, unit, centre in the scene's coordinates (m), value, limits, number of slides; empty where no slide
    gives a value.

    Args:
        folder: of the campaign.
        maps: its maps.

    Returns:
        Path of the file.
    """
    rows: list[list[object]] = [["map", "unit", *("x", "y")[: len(maps.edges)], *LIMITS, "slides"]]
    centres = np.stack(np.meshgrid(*map(middle, maps.edges), indexing="ij"), axis=-1).reshape(-1, len(maps.edges))
    for name, chances in maps.maps.items():
        values = np.stack([getattr(chances, limit).ravel() for limit in LIMITS], axis=1)
        for centre, row, count in zip(centres.tolist(), values.tolist(), chances.count.ravel().tolist(), strict=True):
            rows.append([name, maps.units[name], *centre, *("" if np.isnan(v) else v for v in row), count])
    return _written(folder, "hazard.csv", csv_text(rows))


def write_notice(folder: Path, maps: HazardMaps) -> Iterator[Path]:
    """Write `maps/AT_LEAST.txt` where slides had not come to rest; tables and rasters have no room for such a note."""
    if maps.moving:
        yield _written(
            folder,
            "AT_LEAST.txt",
            f"{maps.moving} of {maps.slides} slides had not come to rest when they ended at {maps.until:g} s, so the "
            "maps give least values.\n",
        )


def key(name: str) -> str:
    """A map's name in names of files and variables: "deposit_thicker_than_0.5_m"."""
    return re.sub(r"[^\w.]+", "_", name.replace("/", "_per_")).strip("_")


def middle(edges: np.ndarray) -> np.ndarray:
    """Centres between edges."""
    return (edges[1:] + edges[:-1]) / 2


def _contours(maps: HazardMaps, values: np.ndarray, unit: str) -> Iterator[tuple[float, list[np.ndarray]]]:
    """Levels that have contours, and their lines (n, 2) m each."""
    if min(values.shape) < 2 or not np.isfinite(values).any():
        return
    x, y = map(middle, maps.edges)
    generator = contour_generator(x, y, np.ma.masked_invalid(values.T))
    top = float(np.nanmax(values))
    for height in CONTOURS if unit == "-" else [top * tenth / 10 for tenth in TENTHS]:
        lines = [np.asarray(line) for line in generator.lines(height)]
        if lines:
            yield float(height), lines


def _written(folder: Path, name: str, text: str) -> Path:
    path = maps_path(folder, name)
    write_aside(path, text.encode())
    return path


def write_geopackage(folder: Path, ground: StoredGround, maps: HazardMaps) -> Iterator[Path]:
    """Write `maps/hazard.gpkg` for geographic information systems, by geopandas (extra "region").

    Layers: "contours" of each map between the centres of its columns, and "deposits", what slides may cover at their
    end with at least a probability; in the projection of the terrain's surface, where it has one.

    Args:
        folder: of the campaign.
        ground: of the campaign.
        maps: in plan.

    Yields:
        Path of the file.

    Raises:
        ValueError: geopandas or pyogrio is not installed.
    """
    require("a GeoPackage", "geopandas", "pyogrio")
    import geopandas
    import shapely

    contours = [
        {"map": name, "value": height, "unit": maps.units[name],
         "geometry": shapely.MultiLineString([line + np.asarray(ground.origin) for line in lines])}
        for name, chances in maps.maps.items()
        for height, lines in _contours(maps, chances.value, maps.units[name])
    ]  # fmt: skip
    x, y = (np.asarray(edges) + start for edges, start in zip(maps.edges, ground.origin, strict=True))
    columns = shapely.box(*np.meshgrid(x[:-1], y[:-1], indexing="ij"), *np.meshgrid(x[1:], y[1:], indexing="ij"))
    covered = np.nan_to_num(maps.maps[COVERED].value)
    deposits = [
        {"probability": level, "geometry": shapely.union_all(columns[covered >= level])}
        for level in CONTOURS
        if (covered >= level).any()
    ]
    path = maps_path(folder, "hazard.gpkg")
    with aside(path) as part, warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # that its name ends otherwise for now
        warnings.filterwarnings("ignore", "'crs' was not provided")  # a scene need not have a projection
        for layer, rows in (("contours", contours), ("deposits", deposits)):
            frame = geopandas.GeoDataFrame(rows, columns=list(rows[0]) if rows else ["geometry"], crs=ground.projection)
            frame.to_file(part, layer=layer, driver="GPKG")
    yield path
