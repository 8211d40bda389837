"""Names that have moved to another module: for one version they work in both, with a warning."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable, Mapping


def renamed(package: str, homes: Mapping[str, str], **others: str) -> Callable[[str], object]:
    """Attribute access of a package that names have left, for its module-level __getattr__.

    Args:
        package: its name.
        homes: by module, the names that it has now, with blanks between them.
        **others: by name, the module and other name that replace it, with a dot between them.

    Returns:
        Function of a name that returns its object, with a DeprecationWarning; AttributeError for an unknown name.
    """
    now = {name: f"{module}.{name}" for module, names in homes.items() for name in names.split()} | others

    def attribute(name: str) -> object:
        if name not in now:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, _, new = now[name].rpartition(".")
        warnings.warn(
            f"{package}.{name} will leave the next version, use {now[name]}", DeprecationWarning, stacklevel=2
        )
        return getattr(importlib.import_module(module), new)

    return attribute
