"""A whole scene of a site under a terrain model, for a first look: the ground, the grids and the campaign."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from cooperative.scene import compare_projections, toml_value
from cooperative.tools.site._estimate import SiteEstimate
from jaxmpm import Raster, read_raster
from jaxmpm.support import check, files

MOST_CELLS = 48
"""Cells of the refined grid along the longer side of a first look."""

MOST_BYTES = 2**28
"""Largest size (bytes) of a surface that is copied beside its scene."""

APART = 2.0
"""Difference (m) between the top of a sounding and the ground there from which on their datums are in doubt."""


def surface_beside(surface: Path, folder: Path) -> dict[Path, bytes]:
    """Files of a surface to be copied to the folder of its scene, which names no file outside; none if it lies there.

    Args:
        surface: file of the heights of the ground.
        folder: of the scene.

    Raises:
        ValueError: the folder has another file of that name.
    """
    if Path(os.path.realpath(surface)).is_relative_to(os.path.realpath(folder)):
        return {}
    copies = {folder / surface.name: files.read_given(surface, MOST_BYTES)}
    projection = files.named_beside(surface, ".prj")
    if projection is not None:
        copies[folder / projection.name] = files.read_given(projection, MOST_BYTES)
    for copy, data in copies.items():
        if copy.exists() and files.read_given(copy, MOST_BYTES) != data:
            raise ValueError(f"{copy} is there and is not {surface}: move it away, or give another --out")
    return copies


def scene_lines(site: SiteEstimate, surface: Path, folder: Path) -> Iterator[str]:
    """Lines of a scene's tables beside its layers.

    Args:
        site: the estimates, in 3D.
        surface: file of the heights of the ground.
        folder: of the scene, in which the surface lies or is copied to.

    Raises:
        ValueError: a file that is no raster, soundings of a section, or one that lies beside the raster.
    """
    raster = read_raster(surface)
    if site.assumed.line is not None or len(site.layers[0].points) < 3:
        raise ValueError(f"{surface} is ground in 3D, the soundings are of a section: leave out --line, give x and y")
    origin = site.assumed.origin
    ends = [(low - at, high - at) for (low, high), at in zip(raster.ends, origin, strict=True)]
    _check_inside(site, surface, raster)
    longest = max(high - low for low, high in ends)
    cell = _round_number(max(longest / MOST_CELLS, raster.step))
    base = site.layers[-1].bottom if site.assumed.base is None else site.assumed.base
    yield f"name = {toml_value(surface.stem)}"
    yield ""
    yield "[terrain]"
    inside = Path(os.path.relpath(os.path.realpath(surface), os.path.realpath(folder)))
    yield f"surface = {toml_value(surface.name if '..' in inside.parts else inside.as_posix())}"
    yield f"base = {base:.6g}    # m, where the soil is taken to be rigid"
    for axis, (low, high) in zip("xy", ends, strict=True):
        far = low + math.floor((high - low) / (2 * cell) + 1e-9) * 2 * cell
        yield f"{axis} = [{low:.10g}, {far:.10g}]"
    if any(origin):
        yield f"origin = [{origin[0]:.10g}, {origin[1]:.10g}]    # subtracted from the coordinates of the files"
    yield ""
    yield "[hazard]    # maps of thickness, speed and arrival"
    for grid, size in (("rough", 2 * cell), ("refined", cell)):
        yield ""
        yield f"[{grid}]    # cells for a first look: refine them and compare"
        yield f"cell = {size:g}"
        yield f"spacing = {[size / 2] * 3}"
    yield from ("", "[run]", "t_end = 20.0", "failure_displacement = 1.0", "", "[campaign]", "samples = 40", "seed = 1")
    yield from ("refined_runs = 16", "")


def _check_inside(site: SiteEstimate, surface: Path, raster: Raster) -> None:
    """Raise ValueError for a sounding beside the raster, and warn of one that begins well above or below the ground."""
    for sounding in site.soundings:
        # Other names than EPSG codes are words of whoever wrote the file.
        if raster.projection is not None and (sounding.projection or "").startswith("EPSG:"):
            remark = compare_projections(sounding.file, str(sounding.projection), str(surface), raster.projection)
            if remark is not None:
                check.warn(remark)
        for axis, at, (low, high) in zip("xy", (sounding.x, sounding.y), raster.ends, strict=True):
            if not low <= at <= high:
                raise ValueError(
                    f"{sounding.file}: sounding {sounding.name!r} lies at {axis} = {at:.10g} m, and {surface} "
                    f"reaches from {low:.10g} to {high:.10g} m: give files of the same projection, or leave it out"
                )
        ground = float(raster.at(np.array([sounding.x]), np.array([sounding.y]))[0])
        if abs(sounding.top - ground) > APART:
            check.warn(
                f"{sounding.file}: sounding {sounding.name!r} begins at {sounding.top:g} m, and {surface} has the "
                f"ground at {ground:g} m there: correct one of them, if they do not count from one datum"
            )


def _round_number(size: float) -> float:
    """The least of 1, 2, 5, 10 and so on that is no smaller."""
    power = 10.0 ** math.floor(math.log10(size))
    return next(power * step for step in (1, 2, 5, 10) if power * step >= size * (1 - 1e-9))
