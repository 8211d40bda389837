"""Values of boreholes, the laboratory and vane tests at points, in CSV files whose columns have names and units."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from jaxmpm.support import check
from jaxmpm.support.table import LENGTHS, Table, measured, number, plain_unit, read_table
from jaxmpm.support.text import printable, shown
from jaxmpm.support.values import by_value

Values = npt.NDArray[np.float64]
Columns = Mapping[str, tuple[str, tuple[str, ...]]]
"""Columns of a table: the quantity of each, "" for one without a unit, and the names that a CSV may give it."""

UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "length": LENGTHS,
        "stress": {
            "pa": 1.0, "kpa": 1e3, "mpa": 1e6, "n/m2": 1.0, "kn/m2": 1e3, "mn/m2": 1e6, "n/mm2": 1e6, "bar": 1e5,
            "tsf": 95760.518, "psf": 47.880259, "ksf": 47880.259, "psi": 6894.757,
            **dict.fromkeys(("kgf/cm2", "kg/cm2"), 98066.5), **dict.fromkeys(("tf/m2", "t/m2"), 9806.65),
        },
        "angle": {"deg": 1.0, "degree": 1.0, "degrees": 1.0, "°": 1.0},
        "weight": {
            "n/m3": 1.0, "kn/m3": 1e3, "mn/m3": 1e6, **dict.fromkeys(("pcf", "lb/ft3", "lbf/ft3"), 157.08746),
            **dict.fromkeys(("t/m3", "tf/m3", "g/cm3"), 9806.65),
        },
        "share": {"%": 0.01, "percent": 0.01, "-": 1.0, "1": 1.0},
    }
)  # fmt: skip
"""What a number in each unit is multiplied by to be in SI units, angles in degrees."""
POSITION = {
    "name": ("", ("name", "sounding", "id", "test", "location", "loca_id")),
    "x": ("length", ("x", "easting", "distance", "chainage")),
    "y": ("length", ("y", "northing")),
    "top": ("length", ("top", "surface", "surface_elevation", "ground_level", "z_surface")),
    "z": ("length", ("z", "elevation", "level")),
    "depth": ("length", ("depth", "d", "depth_below_surface", "scpt_dpth")),
    "water": ("length", ("water", "water_table", "water_depth", "groundwater", "gwl")),
    "predrilled": ("length", ("predrilled", "predrilled_depth", "pre-drilled")),
    "datum": ("", ("datum", "vertical_datum")),
    "projection": ("", ("projection", "crs", "epsg", "coordinate_system")),
}
"""Columns of where a row was measured."""
TEXTS = ("name", "datum", "projection")
"""Columns that are no numbers."""
DEGREES = ("lat", "latitude", "lon", "long", "longitude")
"""Columns of a position that is none in metres."""
PARAMETERS = {
    "strength": ("stress", ("strength", "su", "s_u", "cu", "c_u", "undrained_strength", "undrained_shear_strength")),
    "cohesion": ("stress", ("cohesion", "c", "c_eff")),
    "friction": ("angle", ("friction", "phi", "friction_angle", "phi_eff")),
    "unit_weight": ("weight", ("unit_weight", "gamma", "bulk_unit_weight")),
    "young": ("stress", ("young", "e", "young_modulus", "e50")),
}
"""Columns of laboratory values: the parameter of a scene's soil, its quantity, and names."""


def in_si(where: str, unit: str, quantity: str) -> float:
    """What a number is multiplied by to be in SI units.

    Args:
        where: file and column, for the message.
        unit: as the file has it, such as "MPa" or "kN/m²".
        quantity: of `UNITS`.

    Raises:
        ValueError: no unit of this quantity.
    """
    plain = plain_unit(unit)
    if plain not in UNITS[quantity]:
        raise ValueError(
            f"{where} is in {shown(unit)}, which is no unit of {quantity} known here: give one of "
            f"{known_units(quantity)}"
        )
    return UNITS[quantity][plain]


def known_units(quantity: str) -> str:
    """The units of a quantity in words, each once.

    Args:
        quantity: of `UNITS`.
    """
    first = {size: unit for unit, size in reversed(list(UNITS[quantity].items()))}
    return ", ".join(reversed(list(first.values())))


@by_value
@dataclass(frozen=True)
class PointValues:
    """Values of the laboratory, or of vane tests, at points.

    Args:
        file: they were read from.
        parameter: of a scene's soil, such as "strength".
        x: (n,) m.
        y: (n,) m, nan where the file has none.
        z: (n,) elevation (m).
        value: (n,) in SI units and degrees.
        projection: of the positions, None where the file does not name it.
    """

    file: str
    parameter: str
    x: Values
    y: Values
    z: Values
    value: Values
    projection: str | None = None


def numbers(where: str, cells: Iterable[str], void: float = math.nan) -> Values:
    """Numbers of a file's cells: the one place at which what was not measured becomes nan.

    Args:
        where: file and column, for the warning of cells that are no number.
        cells: as the file has them, with a point in decimals.
        void: that the file declares, beside those known here.

    Returns:
        Numbers (n,), nan in empty cells, void codes and text.
    """
    cells = list(cells)
    finite = sum(math.isfinite(number(cell)) for cell in cells)
    if bad := sum(cell.strip() != "" for cell in cells) - finite:
        check.warn(f"{where}: {bad} cells are no number and count as gaps: correct or empty them")
    return np.array([measured(cell, void) for cell in cells], float)


def known_names(columns: Columns) -> str:
    """Names of columns in words, with what a CSV may call each.

    Args:
        columns: to be named.
    """
    return ", ".join(f"{name} ({' or '.join(words[:3])})" for name, (_, words) in columns.items())


def read_columns(
    path: Path, expected: Columns, units: Mapping[str, str] | None
) -> tuple[dict[str, Values], dict[str, npt.NDArray[np.str_]]]:
    """The known columns of a CSV, whose first row has their names, each with its unit in brackets.

    Args:
        path: of the CSV.
        expected: columns that are read.
        units: of columns whose heading has none, by the column's name; None where nobody can give them.

    Returns:
        Numbers (n,) in SI units and degrees, nan in gaps, and texts (n,): the name of each row, that of the file where
        it has none, and its datum and projection where the file has them.

    Raises:
        ValueError: no rows, no headings, a column twice or in degrees, an unknown unit or none.
    """
    read = read_table(path)
    if not read.rows:
        raise ValueError(f"{path} has no rows below its header: give one row for each reading")
    columns = _columns(path, read, expected, units)
    cells = {name: [row[column] for row in read.rows] for name, (column, _) in columns.items()}
    texts = {name: np.array(cells[name]) for name in TEXTS if name in cells}
    table = {
        name: numbers(f"{path}: {name}", cells[name]) * scale
        for name, (_, scale) in columns.items()
        if name not in TEXTS
    }
    return table, {"name": np.array([path.stem] * len(read.rows))} | texts


def measured_of(
    path: Path, table: Mapping[str, Values], texts: Mapping[str, npt.NDArray[np.str_]]
) -> list[PointValues]:
    """The values of each parameter among the columns of a CSV.

    Args:
        path: of the CSV.
        table: its numbers (n,), as `read_columns` gives them.
        texts: its texts (n,), likewise.

    Raises:
        ValueError: values without a position or an elevation.
    """
    if "z" not in table and not {"top", "depth"} <= table.keys():
        raise ValueError(f"{path} has no column z [m], nor top [m] and depth [m]: add the elevation of each value")
    z = table["z"] if "z" in table else table["top"] - table["depth"]
    if "x" not in table:
        raise ValueError(f"{path} has no column x [m]: add the position of each value")
    y = table.get("y", np.full(z.size, math.nan))
    placed = np.isfinite(table["x"]) & np.isfinite(z) & (np.isfinite(y) | np.isnan(y).all())
    measured: list[PointValues] = []
    for name in [name for name in PARAMETERS if name in table]:
        valid = placed & (table[name] > 0)
        if dropped := int(np.isfinite(table[name]).sum() - valid.sum()):
            check.warn(
                f"{path}: {dropped} values of {name} are left out, which have no position or are not above 0: correct "
                "them, or leave such cells empty"
            )
        projection = one_text(path, "projection", texts.get("projection"))
        at = table["x"][valid], y[valid], z[valid]
        measured.append(PointValues(str(path), name, *at, table[name][valid], projection))
    return measured


def read_rows(path: Path) -> list[list[float]]:
    """Rows of position and value of a CSV of laboratory or borehole values, for a scene.

    Args:
        path: of a CSV with the columns x, y in 3D, z, and one parameter.

    Returns:
        Rows [x, z, value] or [x, y, z, value], in SI units and degrees; rows with a gap are left out.

    Raises:
        ValueError: a file without these columns, or without rows.
    """
    if not path.is_file():
        raise ValueError(f"there is no file {path}: give a CSV with the columns x [m], z [m] and a parameter")
    table, texts = read_columns(path, POSITION | PARAMETERS, None)
    names = [name for name in PARAMETERS if name in table]
    if not names:
        raise ValueError(f"{path} has no column of a parameter: name one of {known_names(PARAMETERS)}")
    if len(names) > 1:
        raise ValueError(f"{path} has {len(names)} columns of parameters: a field has values of one, leave one")
    (only,) = measured_of(path, table, texts)
    flat = bool(np.isnan(only.y).all())
    rows = np.stack([only.x, only.z, only.value] if flat else [only.x, only.y, only.z, only.value], axis=1)
    valid = np.isfinite(rows).all(axis=1)
    if not valid.any():
        raise ValueError(f"{path} has no row with a position and a value above 0: every row is a gap")
    return rows[valid].tolist()


def _columns(
    path: Path, read: Table, expected: Columns, units: Mapping[str, str] | None
) -> dict[str, tuple[int, float]]:
    """Number of each known column in a row, and what its numbers are multiplied by."""
    columns: dict[str, tuple[int, float]] = {}
    unknown: list[str] = []
    bare: list[str] = []
    if not read.header:
        raise ValueError(
            f"{path} has no row of headings: name its columns, such as x [m], top [m], depth [m], qc [MPa]"
        )
    for column, (cell, word) in enumerate(zip(read.header, read.names, strict=False)):
        unit = read.units[column]
        plain = word.strip().lower().replace(" ", "_")
        if plain in DEGREES:
            raise ValueError(f"{path}: the column {shown(cell)} has degrees: give x [m] and y [m] of a national grid")
        name = next((name for name, (_, words) in expected.items() if plain == name or plain in words), None)
        if name is None:
            unknown += [shown(cell)] if cell.strip() else []
            continue
        if name in columns:
            raise ValueError(f"{path} has two columns of {name}: {shown(cell)} is the second, leave one out")
        quantity = expected[name][0]
        unit = unit or (units or {}).get(plain) or (units or {}).get(name)
        if quantity and not unit:
            allowed = known_units(quantity)
            option = "" if units is None else f", or give --units {plain}=UNIT"
            bare.append(
                f"the column {shown(cell)} has no unit: write {cell.strip()} [{allowed.split(', ')[0]}] in the header"
                f"{option}; known are {allowed}"
            )
            continue
        columns[name] = column, in_si(f"{path}: column {shown(cell)}", unit, quantity) if quantity and unit else 1.0
    if bare:
        raise ValueError(f"{path}: {'; '.join(bare)}")
    if unknown:
        check.warn(f"{path}: unknown columns are not read: {', '.join(unknown)}")
    return columns


def one_text(path: Path, key: str, column: npt.NDArray[np.str_] | None) -> str | None:
    """The one text of a column, None where there is none.

    Args:
        path: of the file.
        key: name of the column.
        column: (n,) texts, None where the file has it not.

    Raises:
        ValueError: several texts.
    """
    values = {printable(value.strip()) for value in (() if column is None else column) if value.strip()}
    if len(values) > 1:
        raise ValueError(f"{path} has several {key}: {', '.join(sorted(values)[:3])}; give one")
    return values.pop() if values else None
