"""Readers of soundings and laboratory values: GEF and BRO XML by pygef, AGS4 by python-AGS4, CSV with named columns."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from xml.parsers import expat

import numpy as np

from cooperative.soundings._sounding import UNITS, Measured, SiteError, Sounding, Values, checked, finite, in_si
from foundation import check, files
from foundation.extras import extra
from foundation.text import shown

MOST_BYTES = 2**26
"""Largest size (bytes) of a file of a site."""

Contents = tuple[list[Sounding], list[Measured]]

CONE = {
    "depth": ("length", ("depth", "d", "depth_below_surface", "penetration", "scpt_dpth")),
    "cone": ("stress", ("qc", "q_c", "cone", "cone_resistance", "tip", "tip_resistance", "scpt_res")),
    "sleeve": ("stress", ("fs", "f_s", "sleeve", "sleeve_friction", "friction_sleeve", "scpt_fres")),
    "pore": ("stress", ("u2", "u_2", "u", "pore_pressure", "scpt_pwp2")),
}
"""Columns of a sounding: quantity, and the names that a CSV may give them."""
POSITION = {
    "name": ("", ("name", "sounding", "id", "test", "location", "loca_id")),
    "x": ("length", ("x", "easting", "distance", "chainage")),
    "y": ("length", ("y", "northing")),
    "top": ("length", ("top", "surface", "surface_elevation", "ground_level", "z_surface")),
    "z": ("length", ("z", "elevation", "level")),
}
PARAMETERS = {
    "strength": ("stress", ("strength", "su", "s_u", "cu", "c_u", "undrained_strength", "undrained_shear_strength")),
    "cohesion": ("stress", ("cohesion", "c", "c_eff")),
    "friction": ("angle", ("friction", "phi", "friction_angle", "phi_eff")),
    "unit_weight": ("weight", ("unit_weight", "gamma", "bulk_unit_weight")),
    "young": ("stress", ("young", "e", "young_modulus", "e50")),
}
"""Columns of laboratory values: the parameter of a scene's soil, its quantity, and names."""
_COLUMNS = CONE | POSITION | PARAMETERS
_COMMA = re.compile(r"(?<=\d),(?=\d+\s*$)|(?<=\d),(?=\d+[eE][-+]?\d+\s*$)")
"""The decimal comma of a number, in files whose columns are parted by semicolons."""
_HEADER = re.compile(r"\s*([^\[(]*?)\s*(?:[\[(]([^\])]*)[\])])?\s*")


def read_files(paths: Sequence[Path], units: Mapping[str, str] | None = None) -> Contents:
    """Soundings and laboratory values of files, in the order given.

    Args:
        paths: files that end in .gef, .xml, .ags or .csv.
        units: of columns of CSV files whose header has none, by the column's name.

    Raises:
        SiteError: a file that is missing, of another kind, or with numbers that no soil has; two soundings of one name
            or at one place; soundings whose elevations count from different datums.
    """
    soundings: list[Sounding] = []
    measured: list[Measured] = []
    for path in paths:
        if not path.is_file():
            raise SiteError(f"there is no file {path}: give files that end in {', '.join(_READERS)}")
        reader = _READERS.get(path.suffix.lower())
        if reader is None:
            raise SiteError(f"{path} ends in {path.suffix!r}, files of a site in {', '.join(_READERS)}: rename it")
        _check_bounds(path)
        own, values = reader(path, units or {})
        soundings += [checked(each) for each in own]
        measured += values
    _check_together(soundings)
    return soundings, measured


def _check_bounds(path: Path) -> None:
    """Raise SiteError for a file that is too large, and for XML that declares entities, which read files and grow."""

    def refuse(*_: object) -> None:
        raise SiteError(f"{path} has a document type (DOCTYPE), which no sounding needs: delete it")

    try:
        files.check_given(path, MOST_BYTES)
        if path.suffix.lower() == ".xml":
            parser = expat.ParserCreate()
            parser.StartDoctypeDeclHandler = refuse
            parser.Parse(path.read_bytes(), True)
    except expat.ExpatError as error:
        raise SiteError(f"{path} is no XML ({error}): export it again") from error


def _check_together(soundings: list[Sounding]) -> None:
    names: dict[str, Sounding] = {}
    for each in soundings:
        if each.name in names:
            raise SiteError(
                f"{each.file} and {names[each.name].file} both hold the sounding {shown(each.name)}: leave one out"
            )
        for other in names.values():
            if math.hypot(each.x - other.x, *np.diff(np.nan_to_num([each.y, other.y]))) < 0.01:
                raise SiteError(
                    f"{each.file}: soundings {shown(each.name)} and {shown(other.name)} lie at one place, x = "
                    f"{each.x:g} m: leave one out, or correct its position"
                )
        names[each.name] = each
    datums = {each.datum: each for each in soundings if each.datum is not None}
    if len(datums) > 1:
        (one, first), (two, second) = list(datums.items())[:2]
        raise SiteError(
            f"{first.file} has elevations from {one} and {second.file} from {two}: convert them to one datum"
        )


def _cone_file(path: Path, units: Mapping[str, str]) -> Contents:
    """A sounding in GEF or in XML of the Dutch registration of the subsurface (BRO)."""
    pygef = extra("pygef", f"{path} needs pygef, which is not installed", "'jaxmpm[site]'")
    try:
        # With its voids replaced, pygef would interpolate across gaps.
        read = pygef.read_cpt(path, replace_column_voids=False)
    except Exception as error:  # pygef raises whatever its parsers do
        text = " ".join(str(error).split())[:200]
        raise SiteError(f"{path} is no cone penetration test that pygef reads: {text}") from error
    in_header = _gef_units(read.raw_headers or {})

    def column(name: str, number: str, usual: str) -> Values:
        if name not in read.data.columns:
            return np.full(read.data.height, math.nan)
        values = np.array([finite(each) for each in read.data[name].to_list()])
        void = (read.column_void_mapping or {}).get(name)
        if void is not None:
            values = np.where(np.isclose(values, void), math.nan, values)
        unit = in_header.get(number, usual)
        return values * in_si(f"{path}: {name}", unit, "length" if usual == "m" else "stress")

    depth = column("depth", "11", "m")
    if not np.isfinite(depth).any():
        depth = column("penetrationLength", "1", "m")
    location = read.delivered_location
    datum = read.delivered_vertical_position_datum
    name = read.bro_id or read.alias or path.stem
    return [
        Sounding(
            name=str(name), file=str(path), x=finite(location and location.x), y=finite(location and location.y),
            top=finite(read.delivered_vertical_position_offset), datum=getattr(datum, "name", datum), depth=depth,
            cone=column("coneResistance", "2", "MPa"), sleeve=column("localFriction", "3", "MPa"),
            pore=column("porePressureU2", "6", "MPa"), area_ratio=read.cone_surface_quotient or None,
            water=read.groundwater_level,
        )
    ], []  # fmt: skip


def _gef_units(headers: Mapping[str, Sequence[Sequence[str]]]) -> dict[str, str]:
    """Unit of each quantity of a GEF file, by the quantity's number; "MPa (megaPascal)" is "MPa"."""
    rows = [row for row in headers.get("COLUMNINFO", ()) if len(row) >= 4]
    return {row[3].strip(): row[1].split("(")[0].strip() for row in rows}


def _ags(path: Path, units: Mapping[str, str]) -> Contents:
    """Soundings (SCPT, SCPG) and strengths (TRIT, IVAN, LVAN) of an AGS4 file."""
    ags4 = extra("python_ags4.AGS4", f"{path} needs python-AGS4, which is not installed", "'jaxmpm[site]'")
    try:
        tables, _ = ags4.AGS4_to_dict(str(path))
    except Exception as error:  # python-AGS4 raises whatever its parsers do
        raise SiteError(f"{path} is no AGS4 that python-AGS4 reads: {' '.join(str(error).split())[:200]}") from error
    groups = {name: _ags_rows(table) for name, table in tables.items()}
    if "LOCA" not in groups:
        raise SiteError(f"{path} has no group LOCA of locations: export it with LOCA, and SCPT for soundings")
    locations = {row["LOCA_ID"]: row for row in groups["LOCA"][1]}
    soundings = list(_ags_soundings(path, groups, locations))
    measured: list[Measured] = []
    for group, heading in (("TRIT", "TRIT_CU"), ("IVAN", "IVAN_IVAN"), ("LVAN", "LVAN_VNPK")):
        if group in groups:
            measured += _ags_strengths(path, groups[group], heading, locations)
    if not soundings and not measured:
        raise SiteError(f"{path} has neither soundings (SCPT) nor strengths (TRIT, IVAN, LVAN)")
    return soundings, measured


Group = tuple[dict[str, str], list[dict[str, str]]]
"""Units by heading, and rows."""


def _ags_rows(table: Mapping[str, Sequence[str]]) -> Group:
    columns = [name for name in table if name != "HEADING"]
    kinds = table.get("HEADING", ())
    rows = [{name: str(table[name][k]) for name in columns} for k, kind in enumerate(kinds) if kind == "DATA"]
    unit = next((k for k, kind in enumerate(kinds) if kind == "UNIT"), None)
    return ({} if unit is None else {name: str(table[name][unit]) for name in columns}), rows


def _ags_soundings(
    path: Path, groups: Mapping[str, Group], locations: Mapping[str, Mapping[str, str]]
) -> Iterator[Sounding]:
    if "SCPT" not in groups:
        return
    units, rows = groups["SCPT"]
    details = {row["LOCA_ID"]: row for row in groups.get("SCPG", ({}, []))[1]}
    # Several pushes from one borehole are one sounding.
    for number in dict.fromkeys(row["LOCA_ID"] for row in rows):
        own = [row for row in rows if row["LOCA_ID"] == number]

        def column(heading: str, quantity: str, own: list[dict[str, str]] = own) -> Values:
            if heading not in units:
                return np.full(len(own), math.nan)
            scale = in_si(f"{path}: {heading}", units[heading], quantity)
            return np.array([finite(row[heading]) for row in own]) * scale

        row, detail = locations.get(number, {}), details.get(number, {})
        ratio = finite(detail.get("SCPG_CAR"))
        water = finite(detail.get("SCPG_WAT"))
        yield Sounding(
            name=number, file=str(path), x=finite(row.get("LOCA_NATE")),
            y=finite(row.get("LOCA_NATN")), top=finite(row.get("LOCA_GL")), datum=None,
            depth=column("SCPT_DPTH", "length"), cone=column("SCPT_RES", "stress"),
            sleeve=column("SCPT_FRES", "stress"), pore=column("SCPT_PWP2", "stress"),
            area_ratio=None if math.isnan(ratio) else ratio, water=None if math.isnan(water) else water,
        )  # fmt: skip


def _ags_strengths(
    path: Path, group: Group, heading: str, locations: Mapping[str, Mapping[str, str]]
) -> Iterator[Measured]:
    units, rows = group
    if heading not in units:
        return
    scale = in_si(f"{path}: {heading}", units[heading], "stress")
    depths = next((name for name in ("SPEC_DPTH", "IVAN_DPTH", "SAMP_TOP") if name in units), None)
    if depths is None:
        raise SiteError(f"{path}: {heading} has no depth in SPEC_DPTH, IVAN_DPTH or SAMP_TOP: add one")
    table = np.array(
        [
            [finite(location.get(key)) for key in ("LOCA_NATE", "LOCA_NATN", "LOCA_GL")]
            + [finite(row[depths]), finite(row[heading]) * scale]
            for row in rows
            for location in (locations.get(row["LOCA_ID"], {}),)
        ]
    ).reshape(-1, 5)
    table = table[np.isfinite(table[:, 3:]).all(axis=1) & (table[:, 4] > 0)]
    if len(table):
        yield Measured(str(path), "strength", table[:, 0], table[:, 1], table[:, 2] - table[:, 3], table[:, 4])


def _csv(path: Path, units: Mapping[str, str]) -> Contents:
    """Soundings, or laboratory values, in columns named by the first row, each with its unit in brackets."""
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    delimiter = max(",;\t", key=lines[0].count) if lines else ","
    try:
        rows = [row for row in csv.reader(lines, delimiter=delimiter) if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise SiteError(f"{path} is no table ({error}): is a quotation mark left open?") from error
    if delimiter == ";":
        rows = [rows[0], *([_COMMA.sub(".", cell) for cell in row] for row in rows[1:])]
    if len(rows) < 2:
        raise SiteError(f"{path} has no rows below its header: give one row for each reading")
    columns = _columns(path, rows[0], units)
    cells = {
        name: [row[column] if column < len(row) else "" for row in rows[1:]] for name, (column, _) in columns.items()
    }
    names = np.array(cells.pop("name", [path.stem] * (len(rows) - 1)))
    table = {name: np.array([finite(cell) for cell in each]) * columns[name][1] for name, each in cells.items()}
    gap = np.full(len(names), math.nan)
    if "cone" in table:
        if "depth" not in table:
            raise SiteError(f"{path} has cone resistances but no column depth [m]: add it")
        for name in table.keys() & CONE:
            if bad := sum(cell.strip() != "" for cell in cells[name]) - int(np.isfinite(table[name]).sum()):
                check.warn(f"{path}: {bad} cells of {name} are no number and count as gaps: correct or empty them")
        return [_of_rows(path, table, name, names == name, gap) for name in dict.fromkeys(names.tolist())], []
    given = [name for name in PARAMETERS if name in table]
    if not given:
        known = ", ".join(f"{name} ({' or '.join(words[:3])})" for name, (_, words) in (CONE | PARAMETERS).items())
        raise SiteError(f"{path} has no column of a sounding or of the laboratory: name one of {known}")
    if "z" not in table and not {"top", "depth"} <= table.keys():
        raise SiteError(f"{path} has no column z [m], nor top [m] and depth [m]: add the elevation of each value")
    z = table["z"] if "z" in table else table["top"] - table["depth"]
    if "x" not in table:
        raise SiteError(f"{path} has no column x [m]: add the position of each value")
    y = table.get("y", gap)
    placed = np.isfinite(table["x"]) & np.isfinite(z) & (np.isfinite(y) | np.isnan(y).all())
    measured: list[Measured] = []
    for name in given:
        valid = placed & (table[name] > 0)
        if dropped := sum(cell.strip() != "" for cell in cells[name]) - int(valid.sum()):
            check.warn(
                f"{path}: {dropped} values of {name} are left out, which have no position or are no number above 0: "
                "correct them, or leave such cells empty"
            )
        each = (table["x"], y, z, table[name])
        measured.append(Measured(str(path), name, *(values[valid] for values in each)))
    return [], measured


def read_rows(path: Path) -> list[list[float]]:
    """Rows of position and value of a CSV of laboratory or borehole values, for a scene.

    Args:
        path: of a CSV with the columns x, y in 3D, z, and one parameter.

    Returns:
        Rows [x, z, value] or [x, y, z, value], in SI units and degrees; rows with a gap are left out.

    Raises:
        SiteError: a file without these columns, or without rows.
    """
    if not path.is_file():
        raise SiteError(f"there is no file {path}: give a CSV with the columns x [m], z [m] and a parameter")
    _check_bounds(path)
    _, measured = _csv(path, {})
    if len(measured) != 1:
        raise SiteError(f"{path} has {len(measured)} columns of parameters: a field has values of one, leave one")
    (only,) = measured
    flat = bool(np.isnan(only.y).all())
    table = np.stack([only.x, only.z, only.value] if flat else [only.x, only.y, only.z, only.value], axis=1)
    valid = np.isfinite(table).all(axis=1)
    if not valid.any():
        raise SiteError(f"{path} has no row with a position and a value above 0: every row is a gap")
    return table[valid].tolist()


def _columns(path: Path, header: list[str], units: Mapping[str, str]) -> dict[str, tuple[int, float]]:
    """Number of each known column in a row, and what its numbers are multiplied by."""
    columns: dict[str, tuple[int, float]] = {}
    unknown: list[str] = []
    for column, cell in enumerate(header):
        match = _HEADER.fullmatch(cell)
        word, unit = (match.group(1), match.group(2)) if match else (cell, None)
        plain = word.strip().lower().replace(" ", "_")
        name = next((name for name, (_, words) in _COLUMNS.items() if plain == name or plain in words), None)
        if name is None:
            unknown += [shown(cell)] if cell.strip() else []
            continue
        if name in columns:
            raise SiteError(f"{path} has two columns of {name}: {shown(cell)} is the second, leave one out")
        quantity = _COLUMNS[name][0]
        unit = unit or units.get(plain) or units.get(name)
        if quantity and not unit:
            known = ", ".join(list(UNITS[quantity])[:3])
            raise SiteError(
                f"{path}: the column {shown(cell)} has no unit: write {cell.strip()} [{known.split(', ')[0]}] in the "
                f"header, or give --units {plain}=UNIT with one of {known}"
            )
        columns[name] = column, in_si(f"{path}: column {shown(cell)}", unit, quantity) if quantity and unit else 1.0
    if unknown:
        check.warn(f"{path}: unknown columns are not read: {', '.join(unknown)}")
    return columns


def _of_rows(path: Path, table: Mapping[str, Values], name: str, mine: np.ndarray, gap: Values) -> Sounding:
    """The sounding of the rows of one name."""

    def one(key: str) -> float:
        values = np.unique(table[key][mine]) if key in table else np.array([math.nan])
        if len(values) > 1:
            raise SiteError(f"{path}: sounding {shown(name)} has several {key}: give each its own name")
        return float(values[0])

    columns = {key: table.get(key, gap)[mine] for key in CONE}
    return Sounding(name=name, file=str(path), x=one("x"), y=one("y"), top=one("top"), datum=None, **columns)


_READERS: Mapping[str, Callable[[Path, Mapping[str, str]], Contents]] = {
    ".gef": _cone_file, ".xml": _cone_file, ".ags": _ags, ".csv": _csv,
}  # fmt: skip
