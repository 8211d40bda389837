"""Tables as people save them: any common encoding, delimiter and decimal sign, with headings, units and comments.

Formats: RFC 4180, doi:10.17487/RFC4180, for commas and quotes; the line `sep=;` is Excel's.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from jaxmpm.support import files
from jaxmpm.support.text import shown

MOST_BYTES = 2**26
"""Largest size (bytes) of a table."""

_FOOT, _US_FOOT = 0.3048, 1200 / 3937
LENGTHS = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), 1.0),
    **{"km": 1000.0, "dm": 0.1, "cm": 0.01, "mm": 0.001},
    **dict.fromkeys(("ft", "foot", "feet"), _FOOT),
    **dict.fromkeys(("ftus", "us-ft", "usft", "ussurveyft", "ussurveyfoot", "ussurveyfeet", "surveyft"), _US_FOOT),
    **{"in": _FOOT / 12, "inch": _FOOT / 12, "yd": 3 * _FOOT, "yard": 3 * _FOOT, "yards": 3 * _FOOT},
}
"""Metres of each unit of length, by its name as `plain_unit` writes it."""

_MARKS = (
    (b"\xff\xfe\x00\x00", "utf-32"),
    (b"\xef\xbb\xbf", "utf-8-sig"),
    (b"\xff\xfe", "utf-16"),
    (b"\xfe\xff", "utf-16"),
)
_SAVE = "save the sheet as CSV and give that file"
_OTHERS = (
    (b"PK\x03\x04", "a workbook of a spreadsheet", _SAVE),
    (b"\xd0\xcf\x11\xe0", "an old workbook of Excel", _SAVE),
    (b"%PDF", "a PDF", _SAVE),
    (b"AC10", "a drawing of AutoCAD", "save it as DXF and give that file"),
)
"""First bytes of files that other programs write, what they are, and the remedy."""
_COMMENT = ("#", "%", "//", "!")
"""Beginnings of a line that is a comment."""
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?", re.ASCII)
_DECIMAL_COMMA = re.compile(r"[-+]?(?:\d*),\d+(?:[eEdD][-+]?\d+)?", re.ASCII)
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2},\d{3}", re.ASCII)
_PARTED = re.compile(r"[-+]?[1-9]\d{0,2}(?:[ '’\u00a0\u2009\u202f]\d{3})+(?:[.,]\d+)?", re.ASCII)
"""A number whose thousands a blank or an apostrophe marks."""
_TWO_NUMBERS = re.compile(r"[-+.\d][-+.\deE]*\s+[-+.\d][-+.\deE]*", re.ASCII)
_UNIT = re.compile(r"\s*([^\[(]*?)\s*[\[(]([^\])]*)[\])]\s*")
_SAMPLE = 200
"""Lines by which the delimiter is recognised."""

VOIDS = tuple(
    -float(digits) for digits in ("999", "999.25", "999.9", "999.99", "9999", "9999.9", "9999.99", "99999", "999999",
    "9999999")
)  # fmt: skip
"""What instruments and programs write where nothing was measured, whether their file declares it or not."""
LARGEST = 1e20
"""Size from which on a number is a void: -3.4e38 of single precision, 1e30."""


@dataclass(frozen=True)
class Table:
    """Cells of a table, as text.

    Args:
        path: of the file.
        header: cells of the row of headings, with their units; none if the first row has a number.
        names: headings without units, "" where there is none; of the width of the table if it has headings.
        units: of the columns, in brackets behind the heading or in a row of units below; None where there is none.
        rows: below, each as long as the widest, without blanks around a cell, with a point in decimals.
        lines: number in the file, from 1, of the line of each row.
        remark: cells of the last comment above the rows, in which some programs write the headings.
    """

    path: Path
    header: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str | None, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    remark: tuple[str, ...] = ()

    @property
    def width(self) -> int:
        """Number of columns."""
        return max(len(self.header), len(self.rows[0]) if self.rows else 0)


def read_table(path: str | Path, most: int = MOST_BYTES) -> Table:
    """Read a table from a text file.

    Columns are parted by tabs, semicolons, bars, commas or blanks. A first row without a number has the headings. Empty
    lines, and those that begin with #, %, // or !, are skipped, as are columns at the end that are empty throughout.

    Args:
        path: of the file.
        most: largest size allowed (bytes).

    Returns:
        Table.

    Raises:
        ValueError: If the file cannot be read, is no text, has a row longer than its headings, or it is not clear
            whether commas mark decimals.
    """
    path = Path(path)
    return table_of(path, decoded(path, files.read_given(path, most)))


def decoded(path: str | Path, data: bytes) -> str:
    """Text of the bytes of a file, each of its lines ended by one line feed.

    A byte order mark gives the encoding. Without one the text is in UTF-8, or else in the Western code page 1252.

    Args:
        path: of the file, for messages.
        data: its bytes.

    Returns:
        Text.

    Raises:
        ValueError: If it is no text.
    """
    for mark, what, remedy in _OTHERS:
        if data.startswith(mark):
            raise ValueError(f"{path} is {what}, no text: {remedy}")
    encodings = [name for mark, name in _MARKS if data.startswith(mark)][:1] or [*_unmarked(data), "utf-8", "cp1252"]
    text = None
    for encoding in encodings:
        try:
            text = data.decode(encoding)
            break
        except UnicodeDecodeError:
            continue
    if text is None or "\0" in text:
        raise ValueError(f"{path} is no text in UTF-8, UTF-16 or code page 1252: save it as text in UTF-8")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _unmarked(data: bytes) -> list[str]:
    """UTF-16 without a byte order mark, in which every second byte of Western text is 0."""
    begin = data[:1000]
    if len(begin) < 4 or begin.count(0) < 0.4 * len(begin):
        return []
    return ["utf-16-le" if begin[1::2].count(0) > begin[::2].count(0) else "utf-16-be"]


def number(text: str) -> float:
    """The number of a cell; nan for a text that is none, or not finite.

    Args:
        text: of the cell, with a point in decimals.

    Returns:
        Number.
    """
    text = text.strip().replace("\u2212", "-")
    if not _NUMBER.fullmatch(text):
        return math.nan
    value = float(text.lower().replace("d", "e"))
    return value if math.isfinite(value) else math.nan


def measured(text: str, void: float = math.nan) -> float:
    """The number of a cell that holds a measured value; nan also where it holds a code for nothing measured.

    Args:
        text: of the cell, with a point in decimals.
        void: that the file declares, beside those known here.

    Returns:
        Number.
    """
    value = number(text)
    # A void of 0 that a file declares is met exactly.
    missing = any(math.isclose(value, code, rel_tol=1e-6, abs_tol=1e-9) for code in (*VOIDS, void))
    return math.nan if missing or abs(value) >= LARGEST else value


def plain_unit(unit: str) -> str:
    """A unit in lower case, without blanks and raised digits: "kN/m²" is "kn/m2", "m/s^2" is "m/s2".

    Args:
        unit: as a file has it.

    Returns:
        Its plain form.
    """
    plain = unit.strip().lower().replace("²", "2").replace("³", "3")
    return re.sub(r"[\s^*·]+", "", plain)


def scale_of(where: str, unit: str, units: Mapping[str, float] = LENGTHS) -> float:
    """What a number in a unit is multiplied by; a datum may follow the unit, as in "m NAP".

    Args:
        where: file and column, for messages.
        unit: as the file has it.
        units: factor of each unit, by its name as `plain_unit` writes it.

    Returns:
        Factor.

    Raises:
        ValueError: If the unit is none of them.
    """
    for text in (unit, re.split(r"[\s+]", f"{unit.strip()} ")[0]):
        if plain_unit(text) in units:
            return units[plain_unit(text)]
    raise ValueError(f"{where} is in {shown(unit)}, which is no unit known here: give one of {', '.join(units)}")


def table_of(path: Path, text: str) -> Table:
    """The table in a text.

    Args:
        path: of its file, for messages.
        text: as `decoded` gives it.

    Returns:
        Table.

    Raises:
        ValueError: As `read_table`.
    """
    numbered = [(n, line) for n, line in enumerate(text.split("\n"), 1) if line.strip()]
    declared = re.fullmatch(r'"?sep=(.)"?', numbered[0][1].strip("\ufeff ")) if numbered else None
    delimiter = None
    if declared is not None:
        delimiter, numbered = declared[1], numbered[1:]
    comments = [(n, line) for n, line in numbered if line.lstrip().startswith(_COMMENT)]
    skipped = {n for n, _ in comments}
    rows = [(n, line) for n, line in numbered if n not in skipped]
    if not rows:
        return Table(path, (), (), (), (), ())
    lines = [line for _, line in rows]
    delimiter = delimiter or _delimiter(path, lines)
    cells, ends = _split(path, lines, delimiter)
    above = [line.lstrip().lstrip("#%/!") for n, line in comments if n < rows[0][0]][-1:]
    remark = tuple(_split(path, above, delimiter)[0][0]) if above and above[0].strip() else ()
    return _arranged(path, cells, [rows[end - 1][0] for end in ends], remark, delimiter)


def _split(path: Path, lines: Sequence[str], delimiter: str) -> tuple[list[list[str]], list[int]]:
    """Cells of each row, and how many lines were used up by its end."""
    if delimiter == " ":
        # A unit in brackets belongs to the word before it.
        rows = [re.findall(r'"[^"]*"|[^\s"]+(?:\s?[\[(][^\])]*[\])])?', line) for line in lines]
        return [[cell.strip('"').strip() for cell in row] for row in rows], list(range(1, len(lines) + 1))
    reader = csv.reader((f"{line}\n" for line in lines), delimiter=delimiter, skipinitialspace=True)
    rows, ends = [], []
    try:
        for row in reader:
            rows.append([cell.strip() for cell in row])
            ends.append(reader.line_num)
    except csv.Error as error:
        raise ValueError(
            f"{path} is no table ({error} in row {len(rows) + 1}): is a quotation mark left open?"
        ) from error
    return rows, ends


def _delimiter(path: Path, lines: Sequence[str]) -> str:
    """What parts the columns."""
    sample = lines[:_SAMPLE]
    for delimiter in "\t;|,":
        try:
            rows, _ = _split(path, sample, delimiter)
        except ValueError:
            continue
        wide = [row for row in rows if len(row) > 1]
        cells = [cell for row in wide[1:] or wide for cell in row]
        apart = not any(cell[-1:] in (",", ";") for cell in cells)
        if delimiter == ",":
            apart = not any(_TWO_NUMBERS.fullmatch(cell) for cell in cells)
        if 2 * len(wide) > len(rows) and apart:
            return delimiter
    blanks = sum(len(line.split()) > 1 for line in sample)
    return " " if 2 * blanks > len(sample) else ","


def _arranged(path: Path, cells: list[list[str]], lines: list[int], remark: tuple[str, ...], delimiter: str) -> Table:
    """The table of its cells, with their decimals."""
    cells = [_without_end(row) for row in cells]
    _decimals(path, cells)
    header, units = cells[0], list[str | None]()
    if any(math.isfinite(number(cell)) for cell in header):
        header, rows = [], cells
    else:
        rows, lines = cells[1:], lines[1:]
        header = [cell.rstrip(",;") for cell in header] if delimiter == " " else header
        if rows and len(rows[0]) <= len(header) and _is_units(rows):
            units = [re.sub(r"^[\[(]|[\])]$", "", cell).strip() or None for cell in rows[0]]
            rows, lines = rows[1:], lines[1:]
    width = max(map(len, rows), default=0)
    if header and width > len(header):
        at = next(k for k, row in enumerate(rows) if len(row) > len(header))
        raise ValueError(
            f"{path}, line {lines[at]} has {len(rows[at])} cells and the headings {shown(header)} are {len(header)}: "
            "give each column a heading, put # before lines above the headings, and part columns by semicolons if "
            "commas mark decimals"
        )
    width = max(width, len(header))
    matches = [_UNIT.fullmatch(cell) for cell in header]
    names = [cell if match is None else match[1] for cell, match in zip(header, matches, strict=True)]
    units += [None] * (width - len(units))
    units = (
        [unit if match is None else match[2] for unit, match in zip(units, matches, strict=True)] if header else units
    )
    padded = (tuple(row + [""] * (width - len(row))) for row in rows)
    return Table(path, tuple(header), tuple(names), tuple(units), tuple(padded), tuple(lines), remark)


def _without_end(row: list[str]) -> list[str]:
    """A row without the empty cells at its end."""
    last = next((k for k in range(len(row), 0, -1) if row[k - 1]), 0)
    return row[:last]


def _is_units(rows: Sequence[Sequence[str]]) -> bool:
    """Whether the first row below the headings has units: short words above columns of numbers."""
    if len(rows) < 2:
        return False
    words = [(cell, below) for cell, below in zip(rows[0], rows[1], strict=False) if cell]
    return (
        any(re.search(r"[^\W\d_]|[%°]", cell) and math.isfinite(number(below)) for cell, below in words)
        and not any(math.isfinite(number(cell)) for cell, _ in words)
        and all(len(cell) <= 16 for cell, _ in words)
    )


def _decimals(path: Path, rows: Iterable[list[str]]) -> None:
    """Give the decimals of all cells a point, and take out blanks and apostrophes that mark thousands.

    Raises ValueError where it is not clear what a comma is.
    """
    rows = list(rows)
    for row in rows:
        row[:] = [re.sub(r"[^-+\d.,]", "", cell) if _PARTED.fullmatch(cell) else cell for cell in row]
    commas = [cell for row in rows for cell in row if "," in cell and _DECIMAL_COMMA.fullmatch(cell)]
    if not commas:
        return
    points = next((cell for row in rows for cell in row if "." in cell and _NUMBER.fullmatch(cell)), None)
    if points is not None or all(map(_THOUSANDS.fullmatch, commas)):
        beside = "" if points is None else f" beside {shown(points)}"
        raise ValueError(
            f"{path} has the number {shown(commas[0])}{beside}, whose comma may mark decimals or thousands: save it "
            "with decimal points and without marks of thousands"
        )
    for row in rows:
        row[:] = [cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell for cell in row]
