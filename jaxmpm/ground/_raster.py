"""Heights on a square grid of points, and their files."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from foundation import check, files
from foundation.extras import extra
from foundation.text import shown

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

MOST_BYTES = 2**28
"""Largest size (bytes) of a file of heights."""

MOST_PROJECTION = 20_000
"""Largest size (bytes) of a projection."""

SHORTEST_STEP = 0.05
"""Smallest step (m) of a raster whose corner could be in degrees; a smaller one is taken for degrees."""

SQUARE = 1e-9
"""Largest difference between the steps of a square grid, as a share, from rounding."""

METRES = ("m", "metre", "metres", "meter", "meters", "")
"""Names of metres as the unit of heights in a GeoTIFF."""

TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of a TIFF, and of one of more than 4 GB."""

HEADER = ("ncols", "nrows", "cellsize")
CORNERS = (("xllcorner", "yllcorner", 0.5), ("xllcenter", "yllcenter", 0.0))
"""Keys of an ESRI grid's lower left corner, and the distance of the first point from it in steps."""


@dataclass(frozen=True, eq=False)
class Raster:
    """Heights on a square grid of points, linear between them.

    Args:
        heights: (nx, ny) m, x from west to east, y from south to north; nan at holes.
        corner: x and y of the first point (m).
        step: distance of the points (m).
        projection: as well-known text (WKT), if the file has one. It is only stored; nothing is projected.
    """

    heights: np.ndarray
    corner: tuple[float, float]
    step: float
    projection: str | None = None

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Raster)
            and (self.corner, self.step, self.projection) == (other.corner, other.step, other.projection)
            and np.array_equal(self.heights, other.heights)
        )

    def __hash__(self) -> int:
        return hash((self.corner, self.step, self.heights.shape))

    @property
    def ends(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """First and last x, first and last y (m)."""
        (x, y), (nx, ny) = self.corner, self.heights.shape
        return (x, x + (nx - 1) * self.step), (y, y + (ny - 1) * self.step)

    def check(self, name: str = "raster") -> None:
        """Check that this is a raster in metres.

        Args:
            name: of the raster, for messages.

        Raises:
            ValueError: If its shape or a number is invalid, or it looks like degrees.
        """
        if np.ndim(self.heights) != 2 or min(np.shape(self.heights)) < 2:
            raise ValueError(
                f"{name} has heights of shape {np.shape(self.heights)}: give (nx, ny), 2 or more along each"
            )
        check.finite(f"{name}'s corner", self.corner, "m")
        check.positive(f"{name}'s step", self.step, "m")
        (west, east), (south, north) = self.ends
        if self.step < SHORTEST_STEP and abs(west) <= 360 and abs(east) <= 360 and max(abs(south), abs(north)) <= 90:
            raise ValueError(
                f"{name} has steps of {self.step:g} from ({west:g}, {south:g}) to ({east:g}, {north:g}), which look "
                "like degrees: project it to metres first, e.g. with gdalwarp -t_srs and the EPSG code of a UTM zone"
            )

    def points(self) -> np.ndarray:
        """Positions x and y (2, n) m of its points."""
        (x, y), (nx, ny) = self.corner, self.heights.shape
        along, across = np.meshgrid(x + self.step * np.arange(nx), y + self.step * np.arange(ny), indexing="ij")
        return np.stack([along.ravel(), across.ravel()])

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Heights by bilinear interpolation.

        Args:
            x: positions of points (m), of any shape.
            y: of the same shape (m).

        Returns:
            Heights (m), of this shape; nan beyond the ends, or if one of the four heights around is nan.
        """
        (nx, ny), (west, south) = self.heights.shape, self.corner
        along, across = ((np.asarray(v, float) - start) / self.step for v, start in ((x, west), (y, south)))
        rounding = 1e-6
        inside = (along >= -rounding) & (along <= nx - 1 + rounding)
        inside &= (across >= -rounding) & (across <= ny - 1 + rounding)
        along, across = along.clip(0, nx - 1), across.clip(0, ny - 1)
        i, j = (np.minimum(np.floor(v).astype(int), n - 2) for v, n in ((along, nx), (across, ny)))
        s, t = along - i, across - j
        h = self.heights
        between = (1 - s) * (1 - t) * h[i, j] + s * (1 - t) * h[i + 1, j] + (1 - s) * t * h[i, j + 1]
        return np.where(inside, between + s * t * h[i + 1, j + 1], np.nan)

    def cropped(self, x: tuple[float, float], y: tuple[float, float]) -> Raster:
        """The part that covers a rectangle, up to a step more.

        Args:
            x: lowest and highest (m).
            y: lowest and highest (m).

        Returns:
            Raster.

        Raises:
            ValueError: If the raster does not cover it.
        """
        for axis, (low, high), (first, last) in zip("xy", (x, y), self.ends, strict=True):
            if not (low < high and first - 1e-6 * self.step <= low and high <= last + 1e-6 * self.step):
                raise ValueError(
                    f"{axis} = {low:g} to {high:g} m: give two within the raster, {axis} = {first:g} to {last:g} m"
                )
        spans = []
        for (low, high), start, count in zip((x, y), self.corner, self.heights.shape, strict=True):
            first = max(int(np.floor((low - start) / self.step + 1e-6)), 0)
            last = min(int(np.ceil((high - start) / self.step - 1e-6)), count - 1)
            spans.append(slice(min(first, count - 2), max(last, first + 1) + 1))
        corner = (self.corner[0] + spans[0].start * self.step, self.corner[1] + spans[1].start * self.step)
        return replace(self, heights=self.heights[spans[0], spans[1]], corner=corner)

    def resampled(self, step: float) -> Raster:
        """The same ground with another step.

        Args:
            step: distance of points (m), above 0.

        Returns:
            Raster, as far as whole steps reach.

        Raises:
            ValueError: If the step is not above 0.
        """
        check.positive("step", step, "m")
        counts = [int(np.floor((last - first) / step + 1e-6)) + 1 for first, last in self.ends]
        x, y = (start + step * np.arange(count) for start, count in zip(self.corner, counts, strict=True))
        return replace(self, heights=self.at(*np.meshgrid(x, y, indexing="ij")), step=step)


def read_raster(path: str | Path) -> Raster:
    """Read heights from an ESRI ASCII grid, or from a GeoTIFF by `rasterio` (extra "terrain").

    NODATA in the file is nan in the raster; a terrain that needs such a height is refused with its position.

    Args:
        path: of the file.

    Returns:
        Raster.

    Raises:
        ValueError: If the file is of another kind or incomplete, steps differ along x and y, or it is in degrees or
            feet.
    """
    path = Path(path)
    raster = _geotiff(path) if path.suffix.lower() in (".tif", ".tiff") else _esri(path)
    raster.check(str(path))
    return raster


def _esri(path: Path) -> Raster:
    try:
        words = files.read_given(path, MOST_BYTES).decode("ascii").split()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is no ESRI ASCII grid (byte {error.start}): give one, or a GeoTIFF") from error
    header: dict[str, float] = {}
    at = 0
    while at + 1 < len(words) and re.fullmatch(r"[A-Za-z_]+", words[at]) and words[at].lower() not in ("nan", "inf"):
        try:
            header[words[at].lower()] = float(words[at + 1])
        except ValueError as error:
            raise ValueError(f"{path}: {words[at]} is {shown(words[at + 1])}: give a number") from error
        at += 2
    if {"dx", "dy"} <= header.keys():
        if header["dx"] != header["dy"]:
            raise ValueError(
                f"{path} has steps of {header['dx']:g} and {header['dy']:g} m: resample it to squares, e.g. with "
                "gdalwarp -tr"
            )
        header["cellsize"] = header["dx"]
    lacks = [key for key in HEADER if key not in header]
    corner = next((keys for keys in CORNERS if header.keys() >= set(keys[:2])), None)
    if lacks or corner is None:
        raise ValueError(
            f"{path} lacks {', '.join([*lacks, *(['xllcorner'] if corner is None else [])])}: is it an ESRI grid?"
        )
    projection = _beside(path)
    nx, ny = header["ncols"], header["nrows"]
    if not (nx.is_integer() and ny.is_integer() and nx * ny == len(words) - at):
        raise ValueError(f"{path} declares {nx:g} times {ny:g} heights and holds {len(words) - at}: it is damaged")
    try:
        heights = np.array(words[at:], float).reshape(int(ny), int(nx))[::-1].T
    except ValueError as error:
        raise ValueError(f"{path} has an entry that is no number: {shown(str(error))}") from error
    heights = np.where((heights == header.get("nodata_value", -9999.0)) | ~np.isfinite(heights), np.nan, heights)
    x, y, half = corner
    step = header["cellsize"]
    return Raster(np.ascontiguousarray(heights), (header[x] + half * step, header[y] + half * step), step, projection)


def _beside(path: Path) -> str | None:
    """The projection in a file beside a grid, if there is one; ValueError for one in degrees or feet."""
    beside = path.with_suffix(".prj")
    if not beside.is_file():
        return None
    projection = files.read_plain(beside, MOST_PROJECTION).decode("ascii", errors="replace").strip()
    _refuse_projection(f"{path} ({beside.name})", projection)
    return projection or None


def _refuse_projection(where: str, projection: str) -> None:
    """Raise ValueError for a projection, as WKT, in degrees or feet."""
    text = projection.upper()
    if not re.search(r"PROJCS|PROJCRS|PROJECTEDCRS", text) and re.search(r"GEOGCS|GEOGCRS|GEODCRS", text):
        raise ValueError(f"{where} is in degrees: project it to metres first, e.g. with gdalwarp -t_srs")
    units = re.findall(r'(?:UNIT|LENGTHUNIT)\["([^"]*)"', text)
    if any("FOOT" in unit or "FEET" in unit for unit in units):
        raise ValueError(f"{where} is in feet: project it to metres first, e.g. with gdalwarp -t_srs")


def _geotiff(path: Path) -> Raster:
    rasterio = extra("rasterio", f"{path} is a GeoTIFF, which rasterio reads")
    # Bytes, so that the library opens nothing else: no address of a server, no file beside it.
    data = files.read_given(path, MOST_BYTES)
    if data[:4] not in TIFF:
        raise ValueError(f"{path} cannot be read as a GeoTIFF: it is {'none' if data else 'empty'}")
    try:
        with rasterio.MemoryFile(data) as memory, warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            with memory.open(driver="GTiff") as file:
                return _heights(path, file)
    except (rasterio.errors.RasterioError, rasterio.errors.CRSError) as error:
        raise ValueError(f"{path} cannot be read as a GeoTIFF: {shown(str(error))}") from error


def _heights(path: Path, file: DatasetReader) -> Raster:
    """The raster of an open GeoTIFF."""
    if file.count != 1 or np.dtype(file.dtypes[0]).kind not in "iuf":
        raise ValueError(
            f"{path} has {file.count} bands of {', '.join(sorted(set(file.dtypes)))}: give one of heights, e.g. with "
            "gdal_translate -b 1"
        )
    if file.width * file.height * 8 > MOST_BYTES:
        raise ValueError(f"{path} declares {file.width} times {file.height} heights, more than can be: crop it")
    if any(8.0 * block[0] * block[1] > MOST_BYTES for block in file.block_shapes):
        raise ValueError(f"{path} has tiles of {file.block_shapes[0]} heights, more than can be: save it with smaller")
    turned = file.transform
    if turned.is_identity:
        raise ValueError(f"{path} has no position: give a GeoTIFF, e.g. by gdal_translate -a_ullr")
    if turned.b or turned.d or abs(turned.a + turned.e) > SQUARE * abs(turned.a) or turned.a <= 0:
        raise ValueError(
            f"{path} has steps of {turned.a:g} and {-turned.e:g} m, or is turned: resample it to squares, e.g. with "
            "gdalwarp -tr"
        )
    projection = None if file.crs is None else file.crs.to_wkt()
    if projection is not None:
        _refuse_projection(str(path), projection)
    unit = file.units[0]
    if unit is not None and unit.lower() not in METRES:
        raise ValueError(f"{path} has heights in {shown(unit)}: give them in metres, e.g. with gdal_calc")
    heights = file.read(1, masked=True).astype(float) * file.scales[0] + file.offsets[0]
    filled = heights.filled(np.nan)[::-1].T
    corner = (turned.c + turned.a / 2, turned.f + (file.height - 0.5) * turned.e)
    heights = np.ascontiguousarray(np.where(np.isfinite(filled), filled, np.nan))
    return Raster(heights, corner, float(turned.a), projection or None)
