"""The scene that a campaign's folder keeps; whether two TOML texts say the same, and where they do not."""

from __future__ import annotations

import hashlib
import json
import tomllib
from pathlib import Path

from cooperative.store._folder import small_text
from foundation.text import short

FIRST_DEFAULTS = "\n[defaults]\ncfl = 0.5\ngap_memory = false\n"
"""What a kept scene means that has no such table, or not all of its keys."""


def kept_scene(path: Path) -> str:
    """The scene in a file of a campaign's folder. One without a table `[defaults]` was begun before defaults were kept,
    and gets those of that time. ValueError for what is no regular file, no text or no TOML."""
    text = small_text(path)
    try:
        return text if "defaults" in tomllib.loads(text) else text + FIRST_DEFAULTS
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ValueError(f"{path} is not valid TOML: {error}") from error


def scene_digest(scene_text: str) -> str:
    """SHA-256 of what the TOML text says: comments, spacing and the order of keys do not count."""
    return hashlib.sha256(json.dumps(_flat(scene_text), sort_keys=True).encode()).hexdigest()


def differences(there: str, asked: str, most: int = 5) -> list[str]:
    """What two scenes say otherwise, in words. Where `asked` says no defaults it takes those that are there."""
    old, new = _flat(there), _flat(asked)
    if "defaults" not in tomllib.loads(asked):
        new |= {key: value for key, value in old.items() if key.startswith("defaults.")}
    lines = [
        f"{short(key)} is {short(old.get(key, 'not set'))} there and {short(new.get(key, 'not set'))} now"
        for key in sorted(old.keys() | new.keys())
        if old.get(key) != new.get(key)
    ]
    return lines if len(lines) <= most else [*lines[:most], f"and {len(lines) - most} more"]


def _flat(scene_text: str) -> dict[str, str]:
    """Dotted key -> value as text; 1 and 1.0 are the same value, and the first defaults need not be said."""

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

    tables = tomllib.loads(scene_text)
    if isinstance(said := tables.pop("defaults", {}), dict):
        first = tomllib.loads(FIRST_DEFAULTS)["defaults"]
        said = {key: value for key, value in said.items() if value != first.get(key)}
    return walk("", tables | ({"defaults": said} if said else {}))
