"""Heights on a square grid of points, and their files."""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxmpm.support import check, files
from jaxmpm.support.extras import extra
from jaxmpm.support.table import decoded
from jaxmpm.support.text import shown
from jaxmpm.support.values import by_value

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

MOST_BYTES = 2**28
"""Largest size (bytes) of a file of heights."""

MOST_PROJECTION = 20_000
"""Largest size (bytes) of a projection."""

SHORTEST_STEP = 0.05
"""Smallest step (m) of a raster whose corner could be in degrees; a smaller one is taken for degrees."""

SQUARE = 0.01
"""Largest distance, over the step, by which points of a square grid are misplaced from rounding of its steps."""

DEEPEST, HIGHEST = -11_000.0, 9_000.0
"""Elevations (m) beyond which there is no ground: a number such as -32768 marks a hole."""

CODES = (0.0, -1.0, -99.0, -999.0, -9999.0)
"""Other numbers by which programs mark holes."""

APART = 50.0
"""Distance (m) of such a number from all other heights from which on it marks holes."""

STRETCH = 0.02
"""Largest difference of a metre of a projection from one of the ground, as a share."""

METRES = ("m", "metre", "metres", "meter", "meters", "")
"""Names of metres as the unit of heights in a GeoTIFF."""

TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of a TIFF, and of one of more than 4 GB."""

RADIUS, FLATTENED = 6_378_137.0, 0.00669438
"""Equatorial radius (m) of the ellipsoid of WGS 84, and its first eccentricity squared."""

ANGLES = ("degree", "degrees", "radian", "grad", "gon", "arc-second", "unity")
"""Names of units in a projection that are no lengths."""

KEYED = re.compile(r"\s*([A-Za-z_]{1,40})\s+(\S+)")
"""A key of an ESRI grid and its number."""

HEADER = ("ncols", "nrows", "cellsize")
CORNERS = (("xllcorner", "yllcorner", 0.5), ("xllcenter", "yllcenter", 0.0))
"""Keys of an ESRI grid's lower left corner, and the distance of the first point from it in steps."""


@by_value
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


def read_raster(path: str | Path, *, band: int | None = None) -> Raster:
    r"""Read heights from an ESRI ASCII grid, or from a GeoTIFF by `rasterio` (extra "terrain").

    NODATA in the file is nan in the raster; a terrain that needs such a height is refused with its position. A number
    that no ground has, or a usual code such as 0 far from all other heights, is taken for NODATA with a warning.

    Args:
        path: of the file.
        band: number of the heights in a GeoTIFF of several, counted from 1; None for the only one.

    Returns:
        Raster.

    Raises:
        ValueError: If the file is of another kind or incomplete, has other bands, steps differ along x and y, or it is
            in degrees, in feet or in a projection whose metres are none of the ground.

    Example:
        >>> import tempfile, pathlib
        >>> import jaxmpm as mpm
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     grid = pathlib.Path(folder, "heights.asc")
        ...     _ = grid.write_text("ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 5\n7 3\n6 2\n")
        ...     raster = mpm.read_raster(grid)
        >>> raster.step, raster.heights.tolist()  # along x, then along y from south to north
        (5.0, [[6.0, 7.0], [2.0, 3.0]])
    """
    path = Path(path)
    if path.suffix.lower() in (".tif", ".tiff"):
        raster = _geotiff(path, band)
    elif band is None:
        raster = _esri(path)
    else:
        raise ValueError(f"band = {band} of {path}, and only GeoTIFFs have bands: leave it out")
    raster.check(str(path))
    raster = replace(raster, heights=_without_codes(path, raster.heights))
    return raster if raster.projection is None else _on_the_ground(str(path), raster)


def _without_codes(path: Path, heights: np.ndarray) -> np.ndarray:
    """Heights with nan in place of numbers that mark holes without the file saying so."""
    beyond = (heights < DEEPEST) | (heights > HIGHEST)
    codes = np.unique(heights[beyond])
    ground = heights[np.isfinite(heights) & ~beyond]
    if codes.size > 2 or (codes.size and not ground.size):
        worst = codes[np.argmax(np.abs(codes))]
        raise ValueError(
            f"{path} has heights of {worst:g} m, and no ground lies beyond {DEEPEST:g} to {HIGHEST:g} m: give them in "
            "metres, and say by which number the file marks holes (NODATA)"
        )
    for code in CODES:
        others = ground[ground != code]
        if not others.size or others.size == ground.size:
            continue
        low, high = others.min(), others.max()
        apart = max(low - code, code - high)
        if apart > max(APART, 2 * (high - low)):
            beyond |= heights == code
            ground, codes = others, np.append(codes, code)
    if codes.size:
        named = " and ".join(f"{code:g}" for code in codes)
        check.warn(
            f"{path}: {int(beyond.sum())} heights of {named} m are taken for holes, beside ground at {ground.min():g} "
            f"to {ground.max():g} m: let the file name that number (NODATA), e.g. by gdal_translate -a_nodata"
        )
    return np.where(beyond, np.nan, heights)


def _esri(path: Path) -> Raster:
    try:
        text = decoded(path, files.read_given(path, MOST_BYTES))
    except ValueError as error:
        raise ValueError(f"{error}; an ESRI ASCII grid, or a GeoTIFF (.tif), is needed") from error
    # Nothing but decimals has a comma there.
    text = re.sub(r"(?<=\d),(?=\d)", ".", text) if "," in text else text
    header: dict[str, float] = {}
    at = 0
    while (entry := KEYED.match(text, at)) and entry[1].lower() not in ("nan", "inf"):
        try:
            header[entry[1].lower()] = float(entry[2])
        except ValueError as error:
            raise ValueError(f"{path}: {entry[1]} is {shown(entry[2])}: give a number") from error
        at = entry.end()
    lacks = [key for key in HEADER if key not in header and not (key == "cellsize" and {"dx", "dy"} <= header.keys())]
    corner = next((keys for keys in CORNERS if header.keys() >= set(keys[:2])), None)
    if lacks or corner is None:
        raise ValueError(
            f"{path} lacks {', '.join([*lacks, *(['xllcorner'] if corner is None else [])])}: is it an ESRI grid?"
        )
    nx, ny = header["ncols"], header["nrows"]
    values = _numbers(path, text[at:])
    if not (nx.is_integer() and ny.is_integer() and nx * ny == len(values)):
        raise ValueError(f"{path} declares {nx:g} times {ny:g} heights and holds {len(values)}: it is damaged")
    step = _square(path, header.get("dx", header.get("cellsize", 0.0)), header.get("dy"), max(nx, ny))
    heights = values.reshape(int(ny), int(nx))[::-1].T
    # Programs print the number of holes with other digits above than below.
    holes = np.isclose(heights, header.get("nodata_value", -9999.0), rtol=1e-6, atol=0)
    heights = np.where(holes | ~np.isfinite(heights), np.nan, heights)
    x, y, half = corner
    return Raster(
        np.ascontiguousarray(heights), (header[x] + half * step, header[y] + half * step), step, _beside(path)
    )


def _numbers(path: Path, text: str) -> np.ndarray:
    """Numbers (n,) with blanks between them, in as many bytes as they need: words of their own would take eightfold."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # of a text that is no number
            return np.fromstring(text, sep=" ") if text.strip() else np.zeros(0)
    except (ValueError, DeprecationWarning) as error:
        wrong = next(filter(None, (word[0] for word in re.finditer(r"\S+", text) if not _is_number(word[0]))), "")
        raise ValueError(f"{path} has an entry that is no number: {shown(wrong)}") from error


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _square(path: Path, dx: float, dy: float | None, count: float) -> float:
    """The step of a grid whose steps differ by rounding over a number of points."""
    if dy is not None and (not dx > 0 or abs(dx - dy) * count > SQUARE * dx):
        raise ValueError(
            f"{path} has steps of {dx:.10g} and {dy:.10g} m: resample it to squares, e.g. with gdalwarp -tr"
        )
    return dx


def _beside(path: Path) -> str | None:
    """The projection in a file beside a grid, if there is one; ValueError for one that is not in metres."""
    beside = files.named_beside(path, ".prj")
    if beside is None:
        return None
    where = f"{path} ({beside.name})"
    text = decoded(beside, files.read_given(beside, MOST_PROJECTION)).strip()
    if re.match(r"[A-Za-z_]+\s*\[", text):
        _refuse_projection(where, text)
        return text
    words = dict(re.findall(r"^\s*([A-Za-z]+)[ \t]+(\S+)", text.lower(), re.MULTILINE))
    if words.get("projection") == "geographic" or words.get("units", "").startswith(("dd", "ds", "deg")):
        raise ValueError(f"{where} is in degrees: project it to metres first, e.g. with gdalwarp -t_srs")
    for name in ("units", "zunits"):
        unit = words.get(name, "no")
        if "proj" in text.lower() and unit not in ("no", "none", "1", "1.0", *METRES[:-1]):
            raise ValueError(f"{where} has {name} {shown(unit)}: project it to metres first, e.g. with gdalwarp -t_srs")
    if text:
        check.warn(
            f"{where} is no well-known text (WKT), such as gdalsrsinfo -o wkt gives: exported maps have no projection"
        )
    return None


def _refuse_projection(where: str, projection: str) -> None:
    """Raise ValueError for a projection, as WKT, in degrees or feet."""
    text = projection.upper()
    if not re.search(r"PROJCS|PROJCRS|PROJECTEDCRS", text) and re.search(r"GEOGCS|GEOGCRS|GEODCRS", text):
        raise ValueError(f"{where} is in degrees: project it to metres first, e.g. with gdalwarp -t_srs")
    units = [unit.strip() for unit in re.findall(r'(?:LENGTH|(?<![A-Z]))UNIT\["([^"]*)"', text)]
    if any("FOOT" in unit or "FEET" in unit for unit in units):
        raise ValueError(f"{where} is in feet: project it to metres first, e.g. with gdalwarp -t_srs")
    others = [unit for unit in units if unit.lower() not in (*METRES, *ANGLES)]
    if others:
        raise ValueError(f"{where} is in {shown(others[-1])}: project it to metres first, e.g. with gdalwarp -t_srs")


def _on_the_ground(where: str, raster: Raster) -> Raster:
    """The raster, without a projection that cannot be read.

    Raises ValueError for one whose metres are no metres of the ground where the raster lies. Without rasterio (extra
    "terrain") that is known of Mercator's projection alone.
    """
    projection, (x, y) = raster.projection or "", (sum(ends) / 2 for ends in raster.ends)
    try:
        from rasterio.crs import CRS
        from rasterio.warp import transform
    except ImportError:
        mercator = re.search(r'"(?:POPULAR VISUALISATION PSEUDO[ -])?MERCATOR', projection.upper().replace("_", " "))
        scales = [math.cosh(y / RADIUS)] if mercator else []
    else:
        half = 500.0
        points = [x - half, x + half, x, x], [y, y, y - half, y + half]
        try:
            # An extension holds parameters of PROJ, some of which name files.
            crs = CRS.from_wkt(re.sub(r',\s*EXTENSION\["[^"]*","[^"]*"\]', "", projection))
            east, north = np.radians(transform(crs, CRS.from_epsg(4326), *points))
        except Exception:  # the library raises errors of several kinds
            check.warn(f"{where} has a projection that places it nowhere on the earth, so that exported maps have none")
            return replace(raster, projection=None)
        # Radii of curvature of the ellipsoid of WGS 84, along the meridian and across.
        part = 1 - FLATTENED * np.sin(north.mean()) ** 2
        along, across = RADIUS * (1 - FLATTENED) / part**1.5, RADIUS / math.sqrt(part) * math.cos(north.mean())
        lengths = [math.hypot(across * (east[k + 1] - east[k]), along * (north[k + 1] - north[k])) for k in (0, 2)]
        scales = [2 * half / length for length in lengths if 0 < length < math.inf]
    longest = max(scales, key=lambda scale: abs(math.log(scale)), default=1.0)
    if abs(longest - 1) > STRETCH:
        raise ValueError(
            f"{where}: a metre of its projection is {1 / longest:.3g} m of the ground there: project it to metres "
            "first, e.g. with gdalwarp -t_srs and the EPSG code of a UTM zone"
        )
    return raster


def _geotiff(path: Path, band: int | None) -> Raster:
    rasterio = extra("rasterio", f"{path} is a GeoTIFF, which rasterio reads")
    # Bytes, so that the library opens nothing else: no address of a server, no file beside it.
    data = files.read_given(path, MOST_BYTES)
    if data[:4] not in TIFF:
        raise ValueError(f"{path} cannot be read as a GeoTIFF: its first bytes are none of a TIFF")
    try:
        with rasterio.MemoryFile(data) as memory, warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            with memory.open(driver="GTiff") as file:
                return _heights(path, file, band)
    except (rasterio.errors.RasterioError, rasterio.errors.CRSError) as error:
        raise ValueError(f"{path} cannot be read as a GeoTIFF: {shown(str(error))}") from error


def _heights(path: Path, file: DatasetReader, band: int | None) -> Raster:
    """The raster of a band of an open GeoTIFF."""
    number = 1 if band is None else band
    if (band is None and file.count != 1) or not 1 <= number <= file.count:
        has = f"{path} has {file.count} bands of {', '.join(sorted(set(file.dtypes)))}"
        raise ValueError(
            f"{has}: give one of heights by its number from 1, band=1, in a scene {shown(f'{path.name}#1')}"
            if band is None
            else f"{has} and none of number {band}: give 1 to {file.count}"
        )
    if np.dtype(file.dtypes[number - 1]).kind not in "iuf":
        raise ValueError(f"{path} has a band of {file.dtypes[number - 1]}: give heights, e.g. of float32")
    if file.width * file.height * 8 > MOST_BYTES:
        raise ValueError(f"{path} declares {file.width} times {file.height} heights, more than can be: crop it")
    if any(8.0 * block[0] * block[1] > MOST_BYTES for block in file.block_shapes):
        raise ValueError(f"{path} has tiles of {file.block_shapes[0]} heights, more than can be: save it with smaller")
    turned = file.transform
    if turned.is_identity:
        raise ValueError(f"{path} has no position: give a GeoTIFF, e.g. by gdal_translate -a_ullr")
    if turned.b or turned.d or turned.a <= 0:
        raise ValueError(
            f"{path} has steps of {turned.a:.10g} and {-turned.e:.10g} m, or is turned: resample it to squares, e.g. "
            "with gdalwarp -tr"
        )
    _square(path, turned.a, -turned.e, max(file.width, file.height))
    projection = None if file.crs is None else file.crs.to_wkt()
    if projection is not None:
        _refuse_projection(str(path), projection)
    unit = file.units[number - 1]
    if unit is not None and unit.strip().lower() not in METRES:
        raise ValueError(f"{path} has heights in {shown(unit)}: give them in metres, e.g. with gdal_calc")
    stored = file.read(number, masked=True).astype(float)
    heights = stored * file.scales[number - 1] + file.offsets[number - 1]
    filled = heights.filled(np.nan)[::-1].T
    corner = (turned.c + turned.a / 2, turned.f + (file.height - 0.5) * turned.e)
    heights = np.ascontiguousarray(np.where(np.isfinite(filled), filled, np.nan))
    return Raster(heights, corner, float(turned.a), projection or None)
