"""What a scene left unsaid when its campaign was begun. A default may change later; a campaign under way goes on as it
was, with the values in the table `[defaults]` of the text that its folder keeps."""

from __future__ import annotations

import json
from pathlib import Path

from cooperative.scene._schema import DEFAULTS, SECTIONS, read
from cooperative.scene._text import tables_of
from cooperative.store import kept_scene


def with_defaults(text: str, kept: Path) -> str:
    """The scene with the table `[defaults]` of that in the file `kept`, or with today's where there is no such file.

    Raises ValueError for a text, or a file, that is no TOML or has another such table.
    """
    if "defaults" in tables_of(text):
        return text
    today = {key: (SECTIONS["rough"] | SECTIONS["soil"])[key].default for key in DEFAULTS}
    values = read("defaults", tables_of(kept_scene(kept))["defaults"], DEFAULTS) if kept.exists() else today
    return text + "\n[defaults]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items())
