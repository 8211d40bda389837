"""Whether two TOML texts say the same, and where they do not."""

from __future__ import annotations

import hashlib
import json
import tomllib

from foundation.text import short


def scene_digest(scene_text: str) -> str:
    """SHA-256 of what the TOML text says: comments, spacing and the order of keys do not count."""
    return hashlib.sha256(json.dumps(_flat(scene_text), sort_keys=True).encode()).hexdigest()


def differences(there: str, asked: str, most: int = 5) -> list[str]:
    old, new = _flat(there), _flat(asked)
    lines = [
        f"{short(key)} is {short(old.get(key, 'not set'))} there and {short(new.get(key, 'not set'))} now"
        for key in sorted(old.keys() | new.keys())
        if old.get(key) != new.get(key)
    ]
    return lines if len(lines) <= most else [*lines[:most], f"and {len(lines) - most} more"]


def _flat(scene_text: str) -> dict[str, str]:
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

    return walk("", tomllib.loads(scene_text))
