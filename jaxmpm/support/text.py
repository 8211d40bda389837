"""Text for messages from values and texts that may be long or contain control characters, and tables as CSV."""

from __future__ import annotations

import csv
import io
import reprlib
from collections.abc import Iterable

MOST_SHOWN = 80
"""Characters of a value that a message shows."""


def shown(value: object) -> str:
    """A value's repr, cut if it is long or deeply nested, without control characters.

    Args:
        value: of any type.

    Returns:
        At most MOST_SHOWN characters.
    """
    try:
        text = _SHORT.repr(value)
    except ValueError:  # an integer with more digits than Python converts
        text = f"a {type(value).__name__} too long to be written"
    return short(text)


def short(text: str, most: int = MOST_SHOWN) -> str:
    """The beginning of a text in one line, without control characters.

    Args:
        text: of any length.
        most: largest number of characters.

    Returns:
        At most `most` characters.
    """
    return printable(text if len(text) <= most else f"{text[: most - 3]}...")


def printable(text: str) -> str:
    """One line of a text, with "?" for line ends, escapes and other characters that cannot be printed.

    Args:
        text: of any length.

    Returns:
        As many characters.
    """
    return "".join(character if character.isprintable() else "?" for character in text)


def duration(seconds: float) -> str:
    """Seconds in a readable unit: 45 s, 12 min, 3.5 h, 2.1 days.

    Args:
        seconds: 0 or more.

    Returns:
        Text of two digits and a unit.
    """
    for limit, unit, name in ((90, 1, "s"), (5400, 60, "min"), (172_800, 3600, "h")):
        if seconds < limit:
            return f"{seconds / unit:.2g} {name}"
    return f"{seconds / 86_400:.2g} days"


def literal(text: str) -> str:
    """A text for a figure, in which matplotlib takes dollar signs for formulas.

    Args:
        text: as it is to be seen.

    Returns:
        The text with its dollar signs escaped.
    """
    return text.replace("$", r"\$")


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """A table as CSV.

    A text that a spreadsheet would take for a formula begins with an apostrophe.

    Args:
        rows: of the table, its header the first.

    Returns:
        A line for each row.
    """
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(map(_cell, row) for row in rows)
    return text.getvalue()


def _cell(value: object) -> object:
    """A cell that no spreadsheet computes; a dash alone is the unit of a share and no formula."""
    if value == "-" or not isinstance(value, str) or not value.startswith(("=", "+", "-", "@", "\t", "\r")):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value


_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxlong = _SHORT.maxother = MOST_SHOWN
