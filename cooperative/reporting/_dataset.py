"""A campaign as one netCDF file with named axes, for xarray and whatever else reads netCDF."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import ModuleType

import numpy as np

from cooperative.folder import Results
from cooperative.hazard import Maps
from cooperative.reporting._geography import LIMITS, key, middle, missing
from cooperative.reporting._tables import tables_of
from cooperative.store import GRIDS, Store, read_sample
from cooperative.summary import Summary
from foundation.files import aside

Variable = tuple[tuple[str, ...] | str, np.ndarray, dict[str, str]]


def write_netcdf(results: Results, maps: Maps | None) -> Path:
    """Write `campaign.nc` in the campaign's folder.

    Along `sample`: `rough_displacement`, `refined_runout` and so on, all columns of `table.csv` with their grid's name,
    nan (or "" for text) where a sample did not run there, and `coefficients` of the random fields along `mode`. Along
    `x` and, in 3D, `y`: the hazard maps with their limits, where the scene asks for them. Along thresholds of their
    own: the exceedance curves. Attributes: the probability of failure with its interval and method, how many slides had
    not come to rest at their end (what slides do is then at least what is given), and the scene.

    ValueError without xarray and h5netcdf (extra "exports"), OSError where the disk refuses.
    """
    xarray = _xarray()
    store, summary = results.store, results.summary
    tables = tables_of({"rough": results.rough, "refined": results.refined}, summary)
    variables = _of_samples(store, tables) | _of_curves(summary)
    if maps is not None:
        variables |= _of_maps(maps)
    low, high = summary.interval
    attributes = {
        "title": summary.name,
        "probability_of_failure": summary.probability_of_failure,
        "interval_low": low,
        "interval_high": high,
        "level": summary.level,
        "estimator": summary.estimator,
        "slides": summary.cut_off.of,
        "slides_not_at_rest": summary.cut_off.at_t_end,
        "scene": store.source.words,
    }
    # Along a single name a variable of that name is its axis.
    axes = {name: variable for name, variable in variables.items() if variable[0] == name}
    data = xarray.Dataset({name: v for name, v in variables.items() if name not in axes}, coords=axes, attrs=attributes)
    numbers = [name for name, values in data.variables.items() if values.dtype.kind in "fiu"]
    path = store.folder / "campaign.nc"
    with aside(path) as part:
        data.to_netcdf(part, engine="h5netcdf", encoding={name: {"zlib": True} for name in numbers})
    return path


def _of_samples(store: Store, tables: Mapping[str, Mapping[str, np.ndarray]]) -> dict[str, Variable]:
    """Every column of both grids along the samples, and the coefficients of their fields."""
    numbers = np.unique(np.concatenate([tables[grid]["sample"] for grid in GRIDS])).astype(int)
    found: dict[str, Variable] = {"sample": ("sample", numbers, {"long_name": "number of the sample"})}
    coefficients: dict[int, np.ndarray] = {}
    for grid in GRIDS:
        at = np.searchsorted(numbers, tables[grid]["sample"].astype(int))
        for name, values in tables[grid].items():
            if name == "sample":
                continue
            text = values.dtype.kind == "U"
            whole: np.ndarray = np.full(numbers.size, "" if text else np.nan, object if text else float)
            whole[at] = values
            found[f"{grid}_{name}"] = ("sample", whole, {"grid": grid})
        for number in tables[grid]["sample"].astype(int).tolist():
            if number not in coefficients:
                coefficients[number] = read_sample(store, grid, number).coefficients
    modes = max((each.size for each in coefficients.values()), default=0)
    # A run that was given up has none.
    whole = np.full((numbers.size, modes), np.nan)
    for row, number in enumerate(numbers.tolist()):
        whole[row, : coefficients[number].size] = coefficients[number]
    found["coefficients"] = (("sample", "mode"), whole, {"long_name": "coefficients of the random fields"})
    return found


def _of_curves(summary: Summary) -> dict[str, Variable]:
    variables: dict[str, Variable] = {}
    for name, curve in summary.exceedance.items():
        axis = f"{name}_threshold"
        variables[axis] = (axis, np.array(curve.thresholds), {"long_name": f"{name} that is exceeded"})
        for limit, values in (("", curve.probability), ("_low", curve.low), ("_high", curve.high)):
            variables[f"{name}_exceedance{limit}"] = (axis, np.array(values), {"units": "1"})
    return variables


def _of_maps(maps: Maps) -> dict[str, Variable]:
    axes = ("x", "y")[: len(maps.edges)]
    variables: dict[str, Variable] = {
        axis: (axis, middle(edges), {"units": "m", "long_name": f"centre of a column along {axis}"})
        for axis, edges in zip(axes, maps.edges, strict=True)
    }
    for name, found in maps.maps.items():
        about = {"units": "1" if maps.units[name] == "-" else maps.units[name], "long_name": name}
        for limit in LIMITS:
            ending = "" if limit == "value" else f"_{limit}"
            variables[f"map_{key(name)}{ending}"] = (axes, getattr(found, limit), about)
        variables[f"map_{key(name)}_slides"] = (axes, found.count, {"units": "1", "long_name": f"slides: {name}"})
    return variables


def _xarray() -> ModuleType:
    for library in ("xarray", "h5netcdf"):
        try:
            __import__(library)
        except ImportError as error:
            raise missing(library, "campaign.nc") from error
    import xarray

    found: ModuleType = xarray
    return found
