"""Words for people from values and texts that may be long, or made to be obeyed by a terminal."""

from __future__ import annotations

import reprlib
from typing import Any

MOST_SHOWN = 80
"""Characters of a value that a message shows."""


def shown(value: Any) -> str:
    """A value as Python writes it, cut short where it is long or nested deep, without control characters."""
    try:
        said = _SHORT.repr(value)
    except ValueError:  # a whole number of more digits than Python writes
        said = f"a {type(value).__name__} too long to be written"
    return short(said)


def short(text: str, most: int = MOST_SHOWN) -> str:
    """The beginning of a text that may be long, in one line that a terminal does not obey."""
    return printable(text if len(text) <= most else f"{text[: most - 3]}...")


def printable(text: str) -> str:
    """One line of text that a terminal shows and does not obey: "?" for line ends, escapes and the like."""
    return "".join(each if each.isprintable() else "?" for each in text)


_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxlong = _SHORT.maxother = MOST_SHOWN
