"""Readers of soundings and laboratory values: GEF, BRO XML, AGS4 by python-AGS4, CSV with named columns."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np

from cooperative.laboratory import (
    PARAMETERS,
    POSITION,
    PointValues,
    Values,
    in_si,
    known_names,
    measured_of,
    numbers,
    one_text,
    read_columns,
)
from cooperative.scene import compare_projections
from cooperative.tools.soundings._dutch import read_bro, read_gef
from cooperative.tools.soundings._sounding import Sounding, SoundingRecord, one_number, sounding_of
from jaxmpm.support import check
from jaxmpm.support.extras import extra
from jaxmpm.support.files import read_given
from jaxmpm.support.table import MOST_BYTES, decoded
from jaxmpm.support.text import shown

Contents = tuple[list[SoundingRecord], list[PointValues]]

CONE = {
    "depth": POSITION["depth"],
    "length": ("length", ("penetration", "penetration_length", "sounding_length")),
    "inclination": ("angle", ("inclination", "incl", "inclination_resultant")),
    "cone": ("stress", ("qc", "q_c", "cone", "cone_resistance", "tip", "tip_resistance", "scpt_res")),
    "total": ("stress", ("qt", "q_t", "corrected_cone_resistance", "total_cone_resistance", "scpt_qt")),
    "sleeve": ("stress", ("fs", "f_s", "sleeve", "sleeve_friction", "friction_sleeve", "scpt_fres")),
    "friction_ratio": ("share", ("rf", "r_f", "fr", "friction_ratio", "fric_ratio", "scpt_frr")),
    "pore": ("stress", ("u2", "u_2", "u", "pore2", "pore_pressure", "scpt_pwp2")),
    "area_ratio": ("", ("area_ratio", "net_area_ratio", "a", "alpha", "scpg_car")),
}
"""Columns of a sounding: quantity, and the names that a CSV may give them."""
FARTHEST = 20e3
"""Distance (m) from the middle of a site from which on a position is wrong."""
UNSET = 1e3
"""Distance (m) from the others from which on a position of 0, 0 was never set."""


def read_files(
    paths: Sequence[Path], units: Mapping[str, str] | None = None
) -> tuple[list[Sounding], list[PointValues]]:
    """Soundings and laboratory values of files, in the order given.

    Args:
        paths: files that end in .gef, .xml, .ags or .csv.
        units: of columns of CSV files whose header has none, by the column's name.

    Raises:
        ValueError: a file that is missing, of another kind, or with numbers that no soil has; two soundings of one name
            or at one place; soundings whose elevations count from different datums.
    """
    soundings: list[Sounding] = []
    measured: list[PointValues] = []
    for path in paths:
        if not path.is_file():
            raise ValueError(f"there is no file {path}: give files that end in {', '.join(_READERS)}")
        reader = _READERS.get(path.suffix.lower())
        if reader is None:
            remedy = "save each sheet as CSV" if path.suffix.lower() in SHEETS else "export it as one of them"
            raise ValueError(f"{path} ends in {path.suffix!r}, files of a site in {', '.join(_READERS)}: {remedy}")
        records, values = reader(path, units or {})
        soundings += [sounding_of(record) for record in records]
        measured += values
    _check_together(soundings)
    _check_positions(soundings, measured)
    return soundings, measured


SHEETS = (".xlsx", ".xls", ".xlsm", ".ods")
"""Files of spreadsheets."""


def _check_together(soundings: list[Sounding]) -> None:
    names: dict[str, Sounding] = {}
    for sounding in soundings:
        if sounding.name in names:
            raise ValueError(
                f"{sounding.file} and {names[sounding.name].file} both hold the sounding "
                f"{shown(sounding.name)}: leave one out"
            )
        for other in names.values():
            if math.hypot(sounding.x - other.x, *np.diff(np.nan_to_num([sounding.y, other.y]))) < 0.01:
                raise ValueError(
                    f"{sounding.file}: soundings {shown(sounding.name)} and {shown(other.name)} lie at one place, x = "
                    f"{sounding.x:g} m: leave one out, or correct its position"
                )
            apart = math.hypot(sounding.x - other.x, *np.diff(np.nan_to_num([sounding.y, other.y])))
            if abs(sounding.top - other.top) > 2 * apart + 5:
                check.warn(
                    f"{sounding.file}: sounding {shown(sounding.name)} begins at {sounding.top:g} m and "
                    f"{shown(other.name)}, {apart:.3g} m from it, at {other.top:g} m: correct one, if "
                    "they do not count from one datum"
                )
        names[sounding.name] = sounding
    datums = {sounding.datum: sounding for sounding in soundings if sounding.datum is not None}
    if len(datums) > 1:
        (one, first), (two, second) = list(datums.items())[:2]
        raise ValueError(
            f"{first.file} has elevations from {one} and {second.file} from {two}: convert them to one datum"
        )


def _check_positions(soundings: Sequence[Sounding], measured: Sequence[PointValues]) -> None:
    """Raise ValueError for positions of several systems, that were never set, or far from all others."""
    every: list[Sounding | PointValues] = [*soundings, *measured]
    systems = {record.projection: record.file for record in every if record.projection is not None}
    (one, first), *later = systems.items() or [("", "")]
    for two, second in later:
        try:
            remark = compare_projections(second, two, first, one)
        except ValueError as error:
            raise ValueError(
                f"{first} has positions in {one} and {second} in {two}: convert them to one coordinate system ({error})"
            ) from error
        if remark is not None:
            check.warn(remark)
    places = [
        (record.file, record.projection, np.array([np.atleast_1d(record.x), np.atleast_1d(record.y)]))
        for record in every
    ]
    placed = np.concatenate([at for *_, at in places] or [np.empty((2, 0))], axis=1)
    middle = np.array([np.median(row[np.isfinite(row)]) if np.isfinite(row).any() else 0.0 for row in placed])
    others = np.hypot(*np.nan_to_num(placed))
    for file, projection, at in places:
        if (at == 0).all(axis=0).any() and (projection is not None or others.max() > UNSET):
            raise ValueError(f"{file} has the position 0, 0, which was never set: give its x and y in metres")
    for file, _, at in places:
        away = np.hypot(*np.nan_to_num(at - middle[:, None]))
        if away.size and (worst := float(away.max())) > FARTHEST:
            raise ValueError(
                f"{file} lies {worst / 1000:.3g} km from the middle of the site, the limit is {FARTHEST / 1000:g} km: "
                "its position is of another coordinate system, or wrong"
            )


def _ags(path: Path, units: Mapping[str, str]) -> Contents:
    """Soundings (SCPT, SCPG) and strengths (TRIT, IVAN, LVAN) of an AGS4 file."""
    text = decoded(path, read_given(path, MOST_BYTES))
    if text.lstrip('\ufeff" \n').startswith("**"):
        raise ValueError(f"{path}: this is AGS3, whose groups begin with **: convert it to AGS4, which has GROUP lines")
    ags4 = extra("python_ags4.AGS4", f"{path} needs python-AGS4, which is not installed", "'jaxmpm[site]'")
    try:
        with redirect_stdout(StringIO()):  # where it prints its errors too
            tables, _ = ags4.AGS4_to_dict(StringIO(text))
    except Exception as error:  # python-AGS4 raises whatever its parsers do
        raise ValueError(f"{path} is no AGS4 that python-AGS4 reads: {' '.join(str(error).split())[:200]}") from error
    groups = {name: _ags_rows(table) for name, table in tables.items()}
    if "LOCA" not in groups:
        raise ValueError(f"{path} has no group LOCA of locations: export it with LOCA, and SCPT for soundings")
    for name in ("LOCA", "SCPT", "SCPG", "TRIT", "IVAN", "LVAN"):
        if name not in groups:
            continue
        if not groups[name][0]:
            raise ValueError(f"{path}: its group {name} has no row UNIT, without which its numbers are none: add it")
        if "LOCA_ID" not in groups[name][0]:
            raise ValueError(f"{path}: its group {name} has no heading LOCA_ID, which tells its place: export it anew")
    places = _ags_places(path, groups["LOCA"])
    records = list(_ags_soundings(path, groups, places))
    measured: list[PointValues] = []
    for group, heading in (("TRIT", "TRIT_CU"), ("IVAN", "IVAN_IVAN"), ("LVAN", "LVAN_VNPK")):
        if group in groups:
            measured += _ags_strengths(path, groups[group], heading, places)
    if not records and not measured:
        raise ValueError(f"{path} has neither soundings (SCPT) nor strengths (TRIT, IVAN, LVAN)")
    return records, measured


Group = tuple[dict[str, str], list[dict[str, str]]]
"""Units by heading, and rows."""


def _ags_rows(table: Mapping[str, Sequence[str]]) -> Group:
    columns = [name for name in table if name != "HEADING"]
    kinds = table.get("HEADING", ())
    rows = [{name: str(table[name][k]) for name in columns} for k, kind in enumerate(kinds) if kind == "DATA"]
    unit = next((k for k, kind in enumerate(kinds) if kind == "UNIT"), None)
    return ({} if unit is None else {name: str(table[name][unit]) for name in columns}), rows


@dataclass(frozen=True)
class Place:
    """A location of an AGS file: x, y and elevation of the ground (m), datum and coordinate system."""

    x: float = math.nan
    y: float = math.nan
    top: float = math.nan
    datum: str | None = None
    projection: str | None = None


def _ags_column(path: Path, group: Group, heading: str, quantity: str) -> Values:
    """Numbers (n,) of a heading in SI units, nan where the group has it not."""
    units, rows = group
    if heading not in units:
        return np.full(len(rows), math.nan)
    values = numbers(f"{path}: {heading}", (row[heading] for row in rows))
    return values * in_si(f"{path}: {heading}", units[heading], quantity) if np.isfinite(values).any() else values


def _ags_places(path: Path, group: Group) -> dict[str, Place]:
    rows = group[1]
    position = [_ags_column(path, group, heading, "length") for heading in ("LOCA_NATE", "LOCA_NATN", "LOCA_GL")]
    if np.isnan(position[0]).all() and any(row.get("LOCA_LAT") for row in rows):
        raise ValueError(f"{path} has positions in degrees alone (LOCA_LAT): export it with LOCA_NATE and LOCA_NATN")
    return {
        row["LOCA_ID"]: Place(x, y, top, row.get("LOCA_DATM") or None, row.get("LOCA_GREF") or None)
        for row, (x, y, top) in zip(rows, np.transpose(position).tolist(), strict=True)
    }


def _ags_soundings(path: Path, groups: Mapping[str, Group], places: Mapping[str, Place]) -> Iterator[SoundingRecord]:
    if "SCPT" not in groups:
        return
    rows = groups["SCPT"][1]
    if lost := [name for name in dict.fromkeys(row["LOCA_ID"] for row in rows) if name not in places]:
        raise ValueError(f"{path}: SCPT has readings at {shown(lost[0])}, which LOCA lacks: export both anew")
    table = {
        name: _ags_column(path, groups["SCPT"], f"SCPT_{heading}", quantity)
        for name, heading, quantity in (
            ("depth", "DPTH", "length"), ("cone", "RES", "stress"), ("total", "QT", "stress"),
            ("sleeve", "FRES", "stress"), ("friction_ratio", "FRR", "share"), ("pore", "PWP2", "stress"),
        )
    }  # fmt: skip
    # Each push has a cone of its own; several from one borehole are one sounding.
    details = groups.get("SCPG", ({}, []))
    pushes = [(row["LOCA_ID"], row.get("SCPG_TESN", "")) for row in details[1]]
    ratios = dict(zip(pushes, (one_number(row.get("SCPG_CAR")) or math.nan for row in details[1]), strict=True))
    water = dict(zip(pushes, _ags_column(path, details, "SCPG_WAT", "length"), strict=True))
    table["area_ratio"] = np.array(
        [ratios.get((row["LOCA_ID"], row.get("SCPG_TESN", "")), math.nan) for row in rows], float
    )
    names = np.array([row["LOCA_ID"] for row in rows])
    for name in dict.fromkeys(names.tolist()):
        place = places[name]
        waters = [depth for (borehole, _), depth in water.items() if borehole == name and math.isfinite(depth)]
        yield SoundingRecord(
            file=str(path), name=name, columns={key: values[names == name] for key, values in table.items()},
            x=place.x, y=place.y, top=place.top, datum=place.datum, projection=place.projection,
            water=waters[0] if waters else math.nan,
        )  # fmt: skip


def _ags_strengths(path: Path, group: Group, heading: str, places: Mapping[str, Place]) -> Iterator[PointValues]:
    units, rows = group
    if heading not in units:
        return
    depths = [_ags_column(path, group, name, "length") for name in ("SPEC_DPTH", "IVAN_DPTH", "SAMP_TOP")]
    if not any(name in units for name in ("SPEC_DPTH", "IVAN_DPTH", "SAMP_TOP")):
        raise ValueError(f"{path}: {heading} has no depth in SPEC_DPTH, IVAN_DPTH or SAMP_TOP: add one")
    # A specimen without a depth of its own lies at the top of its sample.
    depth = depths[0]
    for other in depths[1:]:
        depth = np.where(np.isfinite(depth), depth, other)
    value = _ags_column(path, group, heading, "stress")
    located = [places.get(row["LOCA_ID"], Place()) for row in rows]
    x, y, top = np.array([(place.x, place.y, place.top) for place in located]).reshape(-1, 3).T
    read = value > 0
    lacking = {"elevation of the ground (LOCA_GL)": top, "position (LOCA_NATE)": x, "depth": depth}
    for what, numbers_of in lacking.items():
        if missing := sorted(
            {row["LOCA_ID"] for row, bad in zip(rows, read & np.isnan(numbers_of), strict=True) if bad}
        ):
            message = f"{path}: {', '.join(map(shown, missing[:5]))} have no {what}"
            if np.isnan(numbers_of[read]).all():
                raise ValueError(f"{message}: add it, without it {heading} has no place")
            check.warn(f"{message}, so that values of {heading} there are left out: add it")
    valid = read & np.isfinite(x) & np.isfinite(top) & np.isfinite(depth)
    if valid.any():
        systems = {place.projection for place, good in zip(located, valid, strict=True) if good}
        projection = systems.pop() if len(systems) == 1 else None
        yield PointValues(str(path), "strength", x[valid], y[valid], (top - depth)[valid], value[valid], projection)


def _csv(path: Path, units: Mapping[str, str]) -> Contents:
    """Soundings, or laboratory values, in columns."""
    table, texts = read_columns(path, CONE | POSITION | PARAMETERS, units)
    if "cone" in table or "total" in table:
        if "depth" not in table and "length" not in table:
            raise ValueError(f"{path} has cone resistances but no column depth [m]: add it")
        if unused := sorted({*PARAMETERS, "z"} & table.keys()):
            check.warn(f"{path} is a sounding, whose columns {', '.join(unused)} are not read")
        names = texts["name"]
        return [_of_rows(path, table | texts, name, names == name) for name in dict.fromkeys(names.tolist())], []
    if not PARAMETERS.keys() & table.keys():
        columns = known_names(CONE | PARAMETERS)
        raise ValueError(f"{path} has no column of a sounding or of the laboratory: name one of {columns}")
    return [], measured_of(path, table, texts)


def _of_rows(path: Path, table: Mapping[str, np.ndarray], name: str, rows: np.ndarray) -> SoundingRecord:
    """The sounding of the rows of one name."""

    def one(key: str) -> float:
        values = np.unique(table[key][rows]) if key in table else np.array([math.nan])
        values = values[np.isfinite(values)]
        if len(values) > 1:
            raise ValueError(f"{path}: sounding {shown(name)} has several {key}: give each its own name")
        return float(values[0]) if len(values) else math.nan

    columns = {key: table[key][rows] for key in CONE if key in table}
    datum, projection = (
        one_text(path, key, table[key][rows] if key in table else None) for key in ("datum", "projection")
    )
    return SoundingRecord(
        file=str(path), name=name, columns=columns, x=one("x"), y=one("y"), top=one("top"), datum=datum,
        projection=projection, water=one("water"), predrilled=one("predrilled"),
    )  # fmt: skip


_READERS: Mapping[str, Callable[[Path, Mapping[str, str]], Contents]] = {
    ".gef": lambda path, units: (read_gef(path), []), ".xml": lambda path, units: (read_bro(path), []),
    ".ags": _ags, ".csv": _csv,
}  # fmt: skip
