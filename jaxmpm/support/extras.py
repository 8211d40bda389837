"""Packages of extras, which are asked for where they are used."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType


def extra(module: str, why: str, packages: str = "") -> ModuleType:
    """A module of a package that an extra installs.

    Args:
        module: its name.
        why: it is needed, for the message.
        packages: to install, by default of the module's name.

    Returns:
        The module.

    Raises:
        ValueError: If it is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise ValueError(f"{why}: pip install {packages or module}") from error
