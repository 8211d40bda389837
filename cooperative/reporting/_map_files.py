"""Hazard maps as files that need no extra: one table, ASCII grids, contours as GeoJSON."""

from __future__ import annotations

import io
import json
import re
import warnings
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

import numpy as np
from contourpy import contour_generator

from cooperative.hazard import COVERED, Maps
from cooperative.runs import StoredGround
from cooperative.store import own_folder
from foundation.files import aside, write_aside
from foundation.text import csv_text

NODATA = -9999.0
CONTOURS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
"""Levels of the contours of probabilities."""
TENTHS = (1, 2, 4, 6, 8)
"""Levels of all other contours, in tenths of the largest value."""
LIMITS = ("value", "low", "high")


class MissingLibrary(ValueError):
    """A library of an extra is not installed.

    Args:
        library: its name for pip.
        what: file that needs it.
    """

    def __init__(self, library: str, what: str) -> None:
        super().__init__(f"{what} needs {library}, which is not installed: pip install {library}")


def require(what: str, *libraries: str) -> None:
    """Raise MissingLibrary for one that is not installed."""
    for library in libraries:
        try:
            import_module(library)
        except ImportError as error:
            raise MissingLibrary(library, what) from error


def maps_path(folder: Path, name: str) -> Path:
    """Path of a file in `maps/` of a campaign's folder, which is made where it is not there."""
    return own_folder(folder / "maps") / name


def write_tidy(folder: Path, maps: Maps) -> Path:
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


def write_ascii(folder: Path, ground: StoredGround, maps: Maps) -> Iterator[Path]:
    """Write ESRI ASCII grids in plan, `maps/reached.asc` with `-low` and `-high` for its limits, and so for each map.

    Args:
        folder: of the campaign.
        ground: of the campaign; where it has a projection, each grid has it in a file of its own (`.prj`).
        maps: in plan.

    Yields:
        Path of each file.
    """
    (west, *_), (south, *_) = (edges + start for edges, start in zip(maps.edges, ground.origin, strict=True))
    for name, chances in maps.maps.items():
        for limit in LIMITS:
            values = getattr(chances, limit)
            lines = [f"ncols {values.shape[0]}", f"nrows {values.shape[1]}", f"xllcorner {float(west)!r}"]
            lines += [f"yllcorner {float(south)!r}", f"cellsize {maps.plan.cell!r}", f"NODATA_value {NODATA:g}"]
            rows = np.where(np.isfinite(values), values, NODATA).T[::-1]
            text = io.StringIO()
            np.savetxt(text, rows, "%.9g", header="\n".join(lines), comments="")
            file = key(name) + ("" if limit == "value" else f"-{limit}")
            yield _written(folder, f"{file}.asc", text.getvalue())
            if ground.projection is not None:
                yield _written(folder, f"{file}.prj", ground.projection)


def write_contours(folder: Path, ground: StoredGround, maps: Maps) -> Iterator[Path]:
    """Write contours of each map's value between the centres of its columns, `maps/reached.geojson` and so on.

    Args:
        folder: of the campaign.
        ground: of the campaign. Where it has a projection, contours are in longitude and latitude (RFC 7946, Section
            4), which needs rasterio (extra "terrain"); else in the scene's own metres, as the file notes.
        maps: in plan.

    Yields:
        Path of each file.

    Raises:
        MissingLibrary: rasterio is needed and not installed.
    """
    project = (lambda points: points) if ground.projection is None else _to_degrees(ground, ground.projection)
    for name, chances in maps.maps.items():
        features = [
            {
                "type": "Feature",
                "properties": {"map": name, "value": height, "unit": maps.units[name]},
                "geometry": {"type": "MultiLineString", "coordinates": [project(line).tolist() for line in lines]},
            }
            for height, lines in _contours(maps, chances.value, maps.units[name])
        ]
        whole: dict[str, object] = {"type": "FeatureCollection", "name": name, "features": features}
        if maps.moving:
            whole["at_least"] = at_least(maps)
        if ground.projection is None:
            whole["coordinates_are"] = "metres of the scene: it has no projection"
        yield _written(folder, f"{key(name)}.geojson", json.dumps(whole))


def write_notice(folder: Path, maps: Maps) -> Iterator[Path]:
    """Write `maps/AT_LEAST.txt` where slides had not come to rest; tables and rasters have no room for such a note."""
    if maps.moving:
        yield _written(folder, "AT_LEAST.txt", f"{at_least(maps)}\n")


def at_least(maps: Maps) -> str:
    """A sentence for maps of slides that would have gone on."""
    return (
        f"{maps.moving} of {maps.slides} slides had not come to rest when they ended at {maps.until:g} s, so the maps "
        "give least values."
    )


def key(name: str) -> str:
    """A map's name in names of files and variables: "deposit_thicker_than_0.5_m"."""
    return re.sub(r"[^\w.]+", "_", name.replace("/", "_per_")).strip("_")


def middle(edges: np.ndarray) -> np.ndarray:
    """Centres between edges."""
    return (edges[1:] + edges[:-1]) / 2


def _contours(maps: Maps, values: np.ndarray, unit: str) -> Iterator[tuple[float, list[np.ndarray]]]:
    """Levels that have contours, and their lines (n, 2) m each."""
    if min(values.shape) < 2 or not np.isfinite(values).any():
        return
    x, y = map(middle, maps.edges)
    drawn = contour_generator(x, y, np.ma.masked_invalid(values.T))
    top = float(np.nanmax(values))
    for height in CONTOURS if unit == "-" else [top * tenth / 10 for tenth in TENTHS]:
        lines = [np.asarray(line) for line in drawn.lines(height)]
        if lines:
            yield float(height), lines


def _to_degrees(ground: StoredGround, projection: str) -> Callable[[np.ndarray], np.ndarray]:
    """From points (n, 2) m of the scene to longitude and latitude."""
    require("GeoJSON of a scene with a projection", "rasterio")
    from rasterio.warp import transform

    def placed(points: np.ndarray) -> np.ndarray:
        x, y = (points + np.asarray(ground.origin)).T
        try:
            return np.stack(transform(projection, "EPSG:4326", x.tolist(), y.tolist()), axis=1)
        except ValueError as error:
            raise ValueError(
                f"the projection of [terrain] surface cannot be read ({error}): give a file with another, or none"
            ) from error

    return placed


def _written(folder: Path, name: str, text: str) -> Path:
    path = maps_path(folder, name)
    write_aside(path, text.encode())
    return path


def write_geopackage(folder: Path, ground: StoredGround, maps: Maps) -> Iterator[Path]:
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
        MissingLibrary: geopandas or pyogrio is not installed.
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
        for layer, rows in (("contours", contours), ("deposits", deposits)):
            frame = geopandas.GeoDataFrame(rows, columns=list(rows[0]) if rows else ["geometry"], crs=ground.projection)
            frame.to_file(part, layer=layer, driver="GPKG")
    yield path
