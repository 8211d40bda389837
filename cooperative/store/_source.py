"""What a campaign was made from, as its folder keeps it; whether two of these are the same, and where they are not."""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from jaxmpm.support.text import short
from jaxmpm.support.values import by_value

MOST_TEXT = 2**20
"""Bytes that a scene or a lock may have."""
MOST_ENTRIES = 10**6
"""Values, lists and tables that a scene and what stands beside it may have."""
MOST_SPELLED = 2**25
"""Characters of the dotted keys of all values of a scene, in which it is compared with another."""
SCRIPTS = "scripts"
"""Table of checksums of a script's files, which do not tell one campaign from another."""
INDEX = 8
"""Characters of the number of a value in a list."""
DEEPEST = 64
"""Tables and lists within each other."""
STORED_TABLES = ("files", "estimator", "calibration", "limit_load")
"""Tables that a campaign wrote into the scene that its folder keeps: a scene that is given again need not have them."""


@by_value
@dataclass(frozen=True)
class Source:
    """What a campaign was made from.

    Args:
        text: its scene in TOML, verbatim; None for a campaign that was written in Python.
        beside: tables that the text does not have: points and heights of the `files` that the scene names, a script's
            `estimator` in words. Of a campaign that was written in Python: `campaign`, its fields in words.
    """

    text: str | None
    beside: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Let `beside` hold what its file does: plain numbers, texts, lists and tables.

        The text of a NumPy scalar is not that of the number that is read back, and identifies another campaign.
        """
        object.__setattr__(self, "beside", json.loads(json.dumps(dict(self.beside), default=_plain)))

    @cached_property
    def tables(self) -> dict[str, object]:
        """The tables of the text and those beside it.

        Raises:
            ValueError: text that is no TOML.
        """
        tables = {**_tables_of(self.text or ""), **self.beside}
        check_bounds("the scene", tables)
        return tables

    @cached_property
    def digest(self) -> str:
        """SHA-256 of its content: comments, spacing and the order of keys do not count."""
        return hashlib.sha256(json.dumps(_flat(self.tables), sort_keys=True).encode()).hexdigest()

    @property
    def words(self) -> str:
        """For people: the scene's text, or the fields of a campaign that was written in Python."""
        return json.dumps(self.beside, indent=1) if self.text is None else self.text

    def completed(self, there: Source) -> Source:
        """A scene that is given again, with the tables of its folder that it does not have."""
        missing = {key: there.tables[key] for key in STORED_TABLES if key in there.tables and key not in self.tables}
        return Source(self.text, {**self.beside, **missing})


def _plain(value: object) -> object:
    """A NumPy or JAX number, or an array of them, as JSON has it; TypeError for what has no numbers."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{short(repr(value), 200)} is no number, text, list or table: a folder keeps only these")


def _tables_of(text: str) -> dict[str, object]:
    """The tables of a scene.

    Raises ValueError for text that is no TOML.
    """
    if text.startswith("\ufeff"):
        raise ValueError("the scene begins with a byte order mark (U+FEFF): read its file with encoding = 'utf-8-sig'")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"the scene is not valid TOML ({error}): {_remedy(text, str(error))}") from error
    except RecursionError as error:
        raise ValueError("the scene nests tables or lists without end: a scene has tables of plain values") from error


def check_bounds(where: str, tables: Mapping[str, object]) -> None:
    """Check that tables are no larger and no deeper than those of a scene.

    Args:
        where: they stand, for messages.
        tables: of a scene, or beside one.

    Raises:
        ValueError: they nest too deeply, or hold more than a scene has.
    """
    spelled, waiting = 0, [(0, 0, list[object]([tables]))]
    while waiting:
        depth, prefix, values = waiting.pop()
        if depth > DEEPEST:
            raise ValueError(f"{where} nests tables or lists {depth} deep, the limit is {DEEPEST}: write it flat")
        for value in values:
            if isinstance(value, dict):
                waiting += [(depth + 1, prefix + len(key) + 1, [part]) for key, part in value.items()]
                spelled += sum(prefix + len(key) + 1 for key in value)
            elif isinstance(value, list):
                waiting.append((depth + 1, prefix + INDEX, value))
                spelled += (prefix + INDEX) * len(value)
        if spelled > MOST_SPELLED:
            raise ValueError(
                f"{where} has values whose keys together have more than {MOST_SPELLED} characters: give fewer values, "
                "or shorter names of tables and files"
            )


MISTAKES = {
    r'"[^"]*\\': "a backslash in double quotes begins a special character; write folders of a path with / in between",
    r"=[\s\[]*[\u2018-\u201f\u00ab\u00bb]": 'a text stands between straight quotation marks, as in "clay"',
    r"^[^\"]*[\u00a0\u2000-\u200b\u202f\u3000]": "the line has a special blank of word processors: type a plain one",
    r"=\s*[-+]?\d+,\d+\s*(#.*)?$": "a point marks decimals, as in 10.5",
    r"^\s*[\w.]+\s*:": "a key and its value have = between them",
}
"""What is usually wrong in a line that is no TOML, as a pattern, and what to do."""


def _remedy(text: str, error: str) -> str:
    """What to do about the line of an error."""
    at = re.search(r"at line (\d+)", error)
    line = "".join(text.split("\n")[int(at[1]) - 1 : int(at[1])]) if at else ""
    return next((remedy for mark, remedy in MISTAKES.items() if re.search(mark, line)), "write it as toml.io says")


def table_of(tables: Mapping[str, object], name: str) -> Mapping[str, object]:
    """A table of a scene, empty where it has none.

    Args:
        tables: of the scene.
        name: of the table.
    """
    table = tables.get(name)
    return table if isinstance(table, dict) else {}


def tables_of(tables: Mapping[str, object], name: str) -> list[Mapping[str, object]]:
    """The tables of a scene of which there may be several, none where it has none.

    Args:
        tables: of the scene.
        name: of these tables.
    """
    several = tables.get(name)
    return several if isinstance(several, list) else []


def scene_digest(scene_text: str) -> str:
    """SHA-256 of the content of a scene's text: comments, spacing and the order of keys do not count.

    Args:
        scene_text: in TOML.
    """
    return Source(scene_text).digest


def source_from(text: str | None, beside: str, where: str) -> Source:
    """What a campaign was made from, of the texts that a folder stores.

    Args:
        text: the scene in TOML, None for a campaign that was written in Python.
        beside: the tables beside it in JSON.
        where: they stand, for messages.

    Raises:
        ValueError: no TOML, no JSON, or more than a scene has.
    """
    try:
        if sum(map(beside.count, ",[{")) > MOST_ENTRIES:
            raise ValueError(f"it has more than {MOST_ENTRIES} values")
        tables = json.loads(beside)
        if not isinstance(tables, dict):
            raise ValueError("it is no object")
        source = Source(text, tables)
        source.tables  # noqa: B018, checks them
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{where} is damaged ({error}): put back what the campaign began with") from error
    return source


def differences(there: Source, here: Source, most: int = 5) -> list[str]:
    """What two campaigns have otherwise, in words."""
    if (there.text is None) != (here.text is None):
        kinds = ("a scene", "written in Python")
        return [f"it is {kinds[there.text is None]} there and {kinds[here.text is None]} now"]
    old, new = _flat(there.tables), _flat(here.completed(there).tables)
    lines = [
        f"{short(key)} is {short(old.get(key, 'not set'))} there and {short(new.get(key, 'not set'))} now"
        for key in sorted(old.keys() | new.keys())
        if old.get(key) != new.get(key)
    ]
    return lines if len(lines) <= most else [*lines[:most], f"and {len(lines) - most} more"]


def _flat(tables: Mapping[str, object]) -> dict[str, str]:
    """Dotted key -> value as text; 1 and 1.0 are the same value."""

    def walk(prefix: str, node: object) -> dict[str, str]:
        if isinstance(node, dict):
            pairs = [(f"{prefix}.{key}" if prefix else key, value) for key, value in node.items()]
        elif isinstance(node, list):
            pairs = [(f"{prefix}[{index}]", value) for index, value in enumerate(node)]
        else:
            if isinstance(node, float) and node.is_integer() and abs(node) < 2**53:
                node = int(node)
            return {prefix: repr(node)}
        flat = {} if pairs or not prefix else {prefix: repr(node)}
        for key, value in pairs:
            flat |= walk(key, value)
        return flat

    return walk("", {name: table for name, table in tables.items() if name != SCRIPTS})
