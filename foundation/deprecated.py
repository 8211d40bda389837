"""Names that have moved to another module: for one version they work in both, with a warning."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable, Mapping


def renamed(package: str, homes: Mapping[str, str]) -> Callable[[str], object]:
    """Attribute access of a package that names have left, for its module-level __getattr__.

    Args:
        package: its name.
        homes: module and name that replaces each name, with a dot between them.

    Returns:
        Function of a name that returns its object, with a DeprecationWarning; AttributeError for an unknown name.
    """

    def attribute(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, _, new = homes[name].rpartition(".")
        warnings.warn(
            f"{package}.{name} will leave the next version, use {homes[name]}", DeprecationWarning, stacklevel=2
        )
        return getattr(importlib.import_module(module), new)

    return attribute
