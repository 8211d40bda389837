"""A campaign as one netCDF file with named axes, and its hazard maps as GeoTIFF, by xarray and rioxarray."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cooperative.exports._map_files import LIMITS, key, maps_path, middle, require
from cooperative.exports._tables import columns_by_grid
from cooperative.folder import Results
from cooperative.hazard import HazardMaps
from cooperative.runs import StoredGround
from cooperative.store import Store, read_sample
from cooperative.summary import Summary
from jaxmpm.support.files import aside

if TYPE_CHECKING:
    import xarray

Variable = tuple[tuple[str, ...] | str, np.ndarray, dict[str, str]]


def write_netcdf(results: Results, maps: HazardMaps | None) -> Path:
    """Write `campaign.nc` in the campaign's folder.

    Along `sample`: `rough_displacement`, `refined_runout` and so on, all columns of `table.csv` with their grid's name,
    nan (or "" for text) where a sample did not run there, and `coefficients` of the random fields along `term`. Along
    `x` and, in 3D, `y`: the hazard maps with their limits, where the scene asks for them. Along thresholds of their
    own: the exceedance curves. Attributes: the probability of failure with its interval and method, how many slides had
    not come to rest at their end (what slides do is then at least what is given), and the scene.

    Args:
        results: of the campaign.
        maps: its hazard maps, None without any.

    Returns:
        Path of the file.

    Raises:
        ValueError: xarray or h5netcdf is not installed (extra "exports").
        OSError: the disk refuses.
    """
    require("campaign.nc", "xarray", "h5netcdf")
    store, summary = results.store, results.summary
    data = _of_samples(store, columns_by_grid({"rough": results.rough, "refined": results.refined}, summary))
    data = data.assign(_of_curves(summary) | ({} if maps is None else _of_maps(maps)))
    low, high = summary.probability.interval
    data.attrs = {
        "title": summary.name,
        "probability_of_failure": summary.probability.value,
        "interval_low": low,
        "interval_high": high,
        "level": summary.probability.level,
        "estimator": summary.probability.estimator,
        "slides": summary.consequences.cut_off.of,
        "slides_not_at_rest": summary.consequences.cut_off.at_t_end,
        "scene": store.source.words,
    }
    numbers = [name for name, values in data.variables.items() if values.dtype.kind in "fiu"]
    path = store.folder / "campaign.nc"
    with aside(path) as part:
        data.to_netcdf(part, engine="h5netcdf", encoding={name: {"zlib": True} for name in numbers})
    return path


def write_geotiff(folder: Path, ground: StoredGround, maps: HazardMaps) -> Iterator[Path]:
    """Write `maps/reached.tif` and so for each map, in plan: three bands, the value and both limits.

    Args:
        folder: of the campaign.
        ground: of the campaign, whose projection the files have, where it has one.
        maps: in plan; nan is no data.

    Yields:
        Path of each file.

    Raises:
        ValueError: rioxarray is not installed (extra "exports"), or cannot read the projection.
        OSError: the disk refuses.
    """
    require("GeoTIFF", "rioxarray")
    import rasterio
    import xarray

    x, y = (middle(edges) + start for edges, start in zip(maps.edges, ground.origin, strict=True))
    for name, chances in maps.maps.items():
        about = {"map": name, "level": f"{maps.level:g}", "slides": maps.slides, "slides_not_at_rest": maps.moving}
        about |= {"long_name": (name, f"{name}, low limit", f"{name}, high limit")}
        bands = np.stack([getattr(chances, limit).T[::-1] for limit in LIMITS])
        raster = xarray.DataArray(bands, {"x": x, "y": y[::-1]}, ("band", "y", "x"), attrs=about)
        raster = raster.rio.write_nodata(np.nan)
        try:
            raster = raster if ground.projection is None else raster.rio.write_crs(ground.projection)
        except ValueError as error:
            raise ValueError(
                f"the projection of [terrain] surface cannot be read ({error}): give a file with another, or none"
            ) from error
        path = maps_path(folder, f"{key(name)}.tif")
        with aside(path) as part:
            raster.rio.to_raster(part, driver="GTiff", compress="deflate")
            # rioxarray has no units of bands.
            with rasterio.open(part, "r+") as file:
                file.units = (maps.units[name],) * len(LIMITS)
        yield path


def _of_samples(store: Store, tables: Mapping[str, Mapping[str, np.ndarray]]) -> xarray.Dataset:
    """Every column of both grids along the samples, and the coefficients of their fields."""
    import xarray

    parts: list[xarray.Dataset] = []
    coefficients: dict[int, np.ndarray] = {}
    for grid, columns in tables.items():
        numbers = columns["sample"].astype(int)
        text = {name: values.astype(object if values.dtype.kind == "U" else float) for name, values in columns.items()}
        variables = {f"{grid}_{name}": ("sample", values, {"grid": grid}) for name, values in text.items()}
        del variables[f"{grid}_sample"]
        parts.append(xarray.Dataset(variables, {"sample": numbers}))
        coefficients |= {n: read_sample(store, grid, n).coefficients for n in numbers.tolist() if n not in coefficients}
    empty = {name: "" if values.dtype == object else np.nan for part in parts for name, values in part.items()}
    data = xarray.merge(parts, join="outer", fill_value=empty)
    data["sample"].attrs["long_name"] = "number of the sample"
    # A run that was given up has none.
    xi = np.full((data.sizes["sample"], max(map(len, coefficients.values()), default=0)), np.nan)
    for row, number in zip(xi, data["sample"].values.tolist(), strict=True):
        row[: coefficients[number].size] = coefficients[number]
    return data.assign(coefficients=(("sample", "term"), xi, {"long_name": "coefficients of the random fields"}))


def _of_curves(summary: Summary) -> dict[str, Variable]:
    variables: dict[str, Variable] = {}
    for name, curve in summary.consequences.exceedance.items():
        axis = f"{name}_threshold"
        variables[axis] = (axis, np.array(curve.thresholds), {"long_name": f"{name} that is exceeded"})
        for limit, values in (("", curve.probability), ("_low", curve.low), ("_high", curve.high)):
            variables[f"{name}_exceedance{limit}"] = (axis, np.array(values), {"units": "1"})
    return variables


def _of_maps(maps: HazardMaps) -> dict[str, Variable]:
    axes = ("x", "y")[: len(maps.edges)]
    variables: dict[str, Variable] = {
        axis: (axis, middle(edges), {"units": "m", "long_name": f"centre of a column along {axis}"})
        for axis, edges in zip(axes, maps.edges, strict=True)
    }
    for name, chances in maps.maps.items():
        about = {"units": "1" if maps.units[name] == "-" else maps.units[name], "long_name": name}
        for limit in LIMITS:
            ending = "" if limit == "value" else f"_{limit}"
            variables[f"map_{key(name)}{ending}"] = (axes, getattr(chances, limit), about)
        variables[f"map_{key(name)}_slides"] = (axes, chances.count, {"units": "1", "long_name": f"slides: {name}"})
    return variables
