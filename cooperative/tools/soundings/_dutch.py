"""Readers of GEF and of XML of the Dutch registration of the subsurface (BRO), of any version.

Formats: GEF-CPT-Report 1.1.2 (CUR, 2002), whose quantities have numbers; BRO catalogue Cone penetration test, whose
elements are found by their names in whatever name space.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from cooperative.laboratory import Values, in_si, numbers
from cooperative.tools.soundings._sounding import SoundingRecord, one_number
from jaxmpm.support.files import read_given
from jaxmpm.support.table import MOST_BYTES, decoded, number

QUANTITIES = {
    "1": "length", "2": "cone", "3": "sleeve", "4": "friction_ratio", "6": "pore", "8": "inclination", "11": "depth",
    "13": "total",
}  # fmt: skip
"""Columns of a sounding by the number of the quantity in GEF."""
PARAMETERS = {
    "penetrationLength": "length", "depth": "depth", "inclinationResultant": "inclination", "coneResistance": "cone",
    "correctedConeResistance": "total", "localFriction": "sleeve", "frictionRatio": "friction_ratio",
    "porePressureU2": "pore",
}  # fmt: skip
"""The same by the name of the parameter in BRO XML."""
USUAL = {
    "length": ("length", "m"), "depth": ("length", "m"), "inclination": ("angle", "deg"),
    "friction_ratio": ("share", "%"), **dict.fromkeys(("cone", "total", "sleeve", "pore"), ("stress", "MPa")),
}  # fmt: skip
"""Quantity of each column, and its unit where a file has none."""
SYSTEMS = {
    "31000": "EPSG:28992", "32000": "EPSG:31370", "49000": "EPSG:31467",
    **{code: f"EPSG:{code}" for code in ("28992", "31370", "31467")},
}  # fmt: skip
"""Coordinate systems by their code in GEF, or the EPSG's in its place; other codes are compared as they are."""
HEIGHTS = {"31000": "NAP", "32000": "Ostend level", "32001": "TAW", "49000": "mean sea level"}
"""Datums of elevation likewise."""
GEOGRAPHIC = {"EPSG:4258", "EPSG:4326", "EPSG:4289", "EPSG:4937", "EPSG:4979", "EPSG:4269"}
"""Systems whose coordinates are degrees."""

Headers = dict[str, list[list[str]]]


def read_gef(path: Path) -> list[SoundingRecord]:
    """The sounding of a GEF file.

    Args:
        path: of the file.

    Raises:
        ValueError: no GEF, a report of another kind, or units that are unknown.
    """
    text = decoded(path, read_given(path, MOST_BYTES))
    parts = re.split(r"^[ \t]*#[ \t]*EOH\b.*$", text, maxsplit=1, flags=re.M | re.I)
    head, body = parts[0], parts[-1]
    headers: Headers = {}
    for key, rest in re.findall(r"^[ \t]*#[ \t]*(\w+)[ \t]*=?[ \t]*(.*)$", head, re.M):
        headers.setdefault(key.upper(), []).append([cell.strip() for cell in rest.split(",")])
    if "GEFID" not in headers or len(parts) == 1:
        raise ValueError(f"{path} is no GEF: it has no lines #GEFID and #EOH")
    if len(headers["GEFID"]) > 1:
        raise ValueError(f"{path} has {len(headers['GEFID'])} reports: give each a file of its own")
    code = _value(headers, "REPORTCODE", 0) or _value(headers, "PROCEDURECODE", 0) or "CPT"
    if "CPT" not in code.upper():
        raise ValueError(f"{path} is a {code}, no cone penetration test: leave it out")
    infos = [[cell for cell in row if cell] for row in headers.get("COLUMNINFO", ())]
    declared = {number(row[0]): number(row[1]) for row in headers.get("COLUMNVOID", ()) if len(row) > 1}
    rows = _gef_rows(body, _separator(text, "RECORDSEPARATOR"), _separator(text, "COLUMNSEPARATOR"))
    columns: dict[str, Values] = {}
    for info in infos:
        name, place = QUANTITIES.get(info[-1]), number(info[0])
        if len(info) < 3 or name is None or name in columns or math.isnan(place):
            continue
        at = int(place) - 1
        quantity, usual = USUAL[name]
        unit = info[1].split("(")[0].strip() if len(info) >= 4 else ""
        scale = in_si(f"{path}: {info[2]}", unit if unit.strip("-") else usual, quantity)
        cells = [row[at] if at < len(row) else "" for row in rows]
        values = numbers(f"{path}: {name}", cells, declared.get(place, math.nan)) * scale
        # Some instruments count penetration downwards as negative.
        columns[name] = np.abs(values) if name in ("length", "depth") else values
    variables = {row[0]: row[1:] for row in headers.get("MEASUREMENTVAR", ()) if len(row) > 1}
    system, *position = (*headers.get("XYID", [[]])[0], "", "", "")[:3]
    datum, ground = (*headers.get("ZID", [[]])[0], "", "")[:2]
    top = one_number(ground)
    water, predrilled = (
        _gef_depth(f"{path}: {what}", variables.get(key, []), top)
        for key, what in (("14", "water table"), ("13", "pre-drilled depth"))
    )
    return [
        SoundingRecord(
            file=str(path), name=_value(headers, "TESTID", 0) or path.stem, columns=columns,
            x=one_number(position[0]), y=one_number(position[1]), top=top,
            datum=HEIGHTS.get(datum, f"GEF {datum}") if datum.strip("0") else None,
            projection=_gef_system(path, system), area_ratio=one_number(variables.get("3", [""])[0]),
            water=water, predrilled=predrilled,
        )
    ]  # fmt: skip


def _gef_depth(where: str, variable: Sequence[str], top: float) -> float:
    """Depth (m) that a header gives with its unit; of an elevation, as in "m NAP", that below the surface at `top`."""
    number_of, unit = ((cell or "").strip().lower() for cell in (*variable, "", "")[:2])
    value = one_number(number_of)
    if math.isnan(value):
        return value
    elevation = re.fullmatch(r"([a-z]+?)[ +.-]*(?:t\.?o\.?v\.?)?[ +]*(?:nap|taw|mtaw|dnn|nhn)", unit)
    length = elevation[1] if elevation else re.findall(r"^[a-z]*", unit)[0]
    value *= in_si(where, length or "m", "length")
    return top - value if elevation else value


def _value(headers: Headers, key: str, place: int) -> str | None:
    row = headers.get(key, [[]])[0]
    return row[place] if place < len(row) and row[place] else None


def _separator(text: str, key: str) -> str | None:
    match = re.search(rf"^\s*#\s*{key}\s*=[ \t]*(\S)", text, re.M | re.I)
    return match[1] if match else None


def _gef_rows(body: str, of_records: str | None, of_columns: str | None) -> list[list[str]]:
    """Cells of each record, with a point in decimals; many files part columns by what they do not declare."""
    records = body.split(of_records) if of_records else body.splitlines()
    lines = [line for line in (" ".join(record.split()) for record in records) if line]
    if of_columns is None:
        lines = [line.rstrip(" ;,|!") for line in lines]
        marks = ";|," if any("," in line and "." in line for line in lines) else ";|"
        of_columns = next((mark for mark in marks if any(mark in line for line in lines)), None)
    decimal = "." if of_columns == "," else ","
    return [[cell.strip().replace(decimal, ".") for cell in line.split(of_columns)] for line in lines]


def _gef_system(path: Path, code: str) -> str | None:
    if code in ("1", "00001"):
        raise ValueError(f"{path} has its position in degrees (#XYID code {code}): convert it to metres of one grid")
    if not code.strip("0"):
        return None
    return SYSTEMS.get(code, f"GEF {code}")


def read_bro(path: Path) -> list[SoundingRecord]:
    """The soundings of an XML file of the BRO.

    Args:
        path: of the file.

    Raises:
        ValueError: no such file, one that declares entities, or a sounding without readings.
    """
    text = decoded(path, read_given(path, MOST_BYTES))
    if re.search(r"<!\s*(DOCTYPE|ENTITY)", text, re.I):
        raise ValueError(f"{path} declares a document type or entities, which no file of the BRO does: remove them")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ValueError(f"{path} is no XML ({error}): was it cut off?") from error
    tests = [element for element in root.iter() if _name(element) == "CPT_O"]
    if not tests:
        kinds = sorted(
            {_name(element) for part in root.iter() if _name(part) == "dispatchDocument" for element in part}
        )
        holds = f": it holds {', '.join(kinds)}" if kinds else ""
        raise ValueError(f"{path} has no cone penetration test of the BRO (CPT_O){holds}")
    return [_of_test(path, test, count if len(tests) > 1 else 0) for count, test in enumerate(tests, 1)]


def _name(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2]


def _found(element: ElementTree.Element | None, *names: str) -> ElementTree.Element | None:
    """The first element of a name within the first of the name before."""
    for name in names:
        if element is None:
            return None
        element = next((child for child in element.iter() if _name(child) == name), None)
    return element


def _text(element: ElementTree.Element | None, *names: str) -> str:
    found = _found(element, *names)
    return ((found.text if found is not None else None) or "").strip()


def _of_test(path: Path, test: ElementTree.Element, count: int) -> SoundingRecord:
    name = _text(test, "broId") or (f"{path.stem} {count}" if count else path.stem)
    where = f"{path}: sounding {name}"
    result = _found(test, "conePenetrationTest", "cptResult")
    cells = list(_bro_rows(_text(result, "values"), _found(result, "TextEncoding")))
    listed = _found(test, "parameters")
    if not cells or listed is None:
        raise ValueError(f"{where} has no readings (cptResult) or no list of its parameters: export it with them")
    columns = {}
    for at, parameter in enumerate(listed):
        column = PARAMETERS.get(_name(parameter))
        if column is not None and (parameter.text or "").strip().lower() in ("ja", "yes", "true"):
            quantity, usual = USUAL[column]
            values = numbers(f"{where}: {column}", (row[at] if at < len(row) else "" for row in cells))
            columns[column] = values * in_si(where, usual, quantity)
    projection, x, y = _bro_position(where, _found(test, "deliveredLocation"))
    elevation = _found(test, "deliveredVerticalPosition")
    return SoundingRecord(
        file=str(path), name=name, columns=columns, x=x, y=y, projection=projection,
        top=_metres(where, _found(elevation, "offset")), datum=_text(elevation, "verticalDatum") or None,
        area_ratio=one_number(_text(test, "coneSurfaceQuotient")),
        water=_metres(where, _found(test, "groundwaterLevel")),
        predrilled=_metres(where, _found(test, "predrilledDepth")),
    )  # fmt: skip


def _metres(where: str, element: ElementTree.Element | None) -> float:
    if element is None:
        return math.nan
    return one_number(element.text) * in_si(f"{where}: {_name(element)}", element.get("uom", "m"), "length")


def _bro_rows(text: str, encoding: ElementTree.Element | None) -> Iterator[Sequence[str]]:
    attributes = {} if encoding is None else encoding.attrib
    token, block = attributes.get("tokenSeparator", ","), attributes.get("blockSeparator", ";")
    decimal = attributes.get("decimalSeparator", ".")
    for record in text.split(block):
        if record.strip():
            yield [cell.strip().replace(decimal, ".") for cell in record.split(token)]


def _bro_position(where: str, location: ElementTree.Element | None) -> tuple[str | None, float, float]:
    """Coordinate system and coordinates (m)."""
    if location is None:
        return None, math.nan, math.nan
    names = [element.get("srsName", "") for element in location.iter()]
    code = next((re.findall(r"\d+", name)[-1] for name in names if re.search(r"\d", name)), None)
    system = None if code is None else "EPSG:28992" if code == "7415" else f"EPSG:{code}"
    if system in GEOGRAPHIC:
        raise ValueError(f"{where} has its position in degrees ({system}): export it in metres, such as EPSG:28992")
    at = [one_number(word) for word in re.split(r"[\s,;]+", _text(location, "pos"))]
    return system, *((*at, math.nan, math.nan)[:2])  # type: ignore[return-value]
