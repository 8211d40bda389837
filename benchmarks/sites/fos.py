"""Seconds of the demo's factor of safety by limit equilibrium, as `jaxmpm fos demo.toml --quick` has it."""

from __future__ import annotations

from cooperative import safety
from cooperative.scene import example, parse


def seconds() -> float:
    """Wall time (s) from the scene to the critical surface. Raises ValueError without xslope."""
    return safety.factor_of_safety(parse(example("demo")), solver=False).seconds
