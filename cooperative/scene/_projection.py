"""Coordinate systems of files in plan: refused where their units are no metres, and compared with each other.

Nothing is projected: no grid of a datum and no server is opened.
"""

from __future__ import annotations

import re
import warnings
from typing import TYPE_CHECKING

from jaxmpm.support.check import Invalid
from jaxmpm.support.extras import extra
from jaxmpm.support.text import shown

if TYPE_CHECKING:
    from pyproj import CRS

NAME = re.compile(r"[\w /.()-]{1,200}")
"""A name of a coordinate system, as EPSG has them."""
MOST_TEXT = 20_000
"""Characters of a coordinate system as text."""
NAMES = {"rd": 28992, "rd new": 28992, "osgb": 27700, "osgb36": 27700, "bng": 27700, "british national grid": 27700}
"""EPSG codes of what national files call their coordinate system."""
DATUMS = ("datum", "ellps", "a", "b", "rf", "towgs84", "nadgrids", "no_defs", "type", "wktext")
"""Of the numbers of a coordinate system, those of its datum."""


def refuse_unmetric(where: str, projection: str) -> None:
    """Refuse a coordinate system whose numbers are no metres on the ground.

    Args:
        where: the file, for the message.
        projection: its coordinate system as WKT, or "EPSG:" and a number, or its name.

    Raises:
        ValueError: it is in degrees, feet or metres of a map of the whole world, or is not known.
    """
    crs = _in_plan(where, projection)
    remedy = "project it to the metres of the surface first, e.g. with ogr2ogr -t_srs"
    if crs.is_geographic or crs.is_geocentric:
        raise Invalid((), where, f"is in degrees ({shown(crs.name)})", remedy)
    for axis in crs.axis_info[:2]:
        if abs(axis.unit_conversion_factor - 1) > 1e-9:
            raise Invalid((), where, f"is in {shown(axis.unit_name)}, not in metres ({shown(crs.name)})", remedy)
    method = "" if crs.coordinate_operation is None else crs.coordinate_operation.method_name
    if "Mercator" in method and not re.search("Transverse|Oblique", method):
        raise Invalid((), where, f"is in {shown(crs.name)}, whose metres are stretched away from the equator", remedy)


def compare_projections(where: str, projection: str, other: str, there: str) -> str | None:
    """Compare the coordinate systems of two files, and refuse different projections.

    Args:
        where: the file.
        projection: its coordinate system.
        other: the first file.
        there: its coordinate system.

    Returns:
        A remark where both have one projection and different datums; None where they have one datum too.

    Raises:
        ValueError: they have different projections; the message names both.
    """
    if projection == there:
        return None
    crs, first = _in_plan(where, projection), _in_plan(other, there)
    if crs.equals(first, ignore_axis_order=True):
        return None
    names = f"{where} is in {shown(crs.name)} and {other} in {shown(first.name)}"
    if not (_numbers(crs) and _numbers(crs) == _numbers(first)):
        raise Invalid((), names, "", "project it to the same one, e.g. with ogr2ogr -t_srs")
    if _datum(crs) == _datum(first):
        return None
    return f"{names}, one projection of two datums, which may lie 2 m apart: nothing is shifted"


def _in_plan(where: str, projection: str) -> CRS:
    """The horizontal part of a coordinate system."""
    pyproj = extra("pyproj", f"{where} states its coordinate system, which pyproj reads")
    code = re.fullmatch(r"EPSG:(\d{1,6})", projection)
    try:
        if len(projection) > MOST_TEXT:
            raise ValueError
        # An extension holds parameters of PROJ, some of which name files.
        text = re.sub(r',\s*EXTENSION\["[^"]*","[^"]*"\]', "", projection)
        if number := NAMES.get(projection.lower(), code and int(code[1])):
            crs = pyproj.CRS.from_epsg(number)
        else:
            # No name of a coordinate system has the signs of PROJ's own words.
            crs = pyproj.CRS.from_user_input(text) if NAME.fullmatch(text) else pyproj.CRS.from_wkt(text)
        while crs.is_bound or crs.is_compound:
            crs = crs.source_crs if crs.is_bound else crs.sub_crs_list[0]
    except (ValueError, pyproj.exceptions.CRSError) as error:
        raise Invalid(
            (),
            where,
            f"has a coordinate system that is not known, {shown(projection)}",
            "give it one, e.g. with ogr2ogr -a_srs",
        ) from error
    return crs


def _numbers(crs: CRS) -> dict[str, object]:
    """Projection and figure of the earth, to a millimetre; names differ between programs."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # that a text in PROJ's words has no datum, which is left out here
        words = crs.to_dict()
    figure = crs.ellipsoid
    if "proj" not in words or figure is None:
        return {}
    numbers = {name: round(value, 9) if isinstance(value, float) else value for name, value in words.items()}
    shape = {"axis": round(figure.semi_major_metre), "flattening": round(figure.inverse_flattening, 3)}
    return {name: value for name, value in numbers.items() if name not in DATUMS} | shape


def _datum(crs: CRS) -> str:
    """Name of the datum, in the letters and digits that programs agree on."""
    name = "" if crs.datum is None else crs.datum.name.lower().replace("ensemble", "")
    return re.sub(r"[^a-z0-9]", "", name).removeprefix("d")
