"""The example scenes that come with the package."""

from __future__ import annotations

from pathlib import Path

import cooperative
from foundation.text import shown


def examples() -> dict[str, Path]:
    """Files of the example scenes by name. An installed package holds them; a checkout has them under benchmarks."""
    package = Path(cooperative.__file__).parent
    folder = next((f for f in (package / "scenes", package.parent / "benchmarks" / "scenes") if f.is_dir()), package)
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def example(name: str) -> str:
    """The TOML of the example scene `name`. Raises ValueError for a name that no example has."""
    known = examples()
    if name not in known:
        raise ValueError(f"no example scene is called {shown(name)}: give one of {', '.join(known)}")
    return known[name].read_text()
