"""Scenes: TOML in, one checked and immutable campaign out."""

from cooperative.scene._calibration import calibrated, config_of, kept, measured
from cooperative.scene._schema import SECTIONS
from cooperative.scene._typed import Config, Plan, built, parse

__all__ = [
    "SECTIONS",
    "Config",
    "Plan",
    "built",
    "calibrated",
    "config_of",
    "kept",
    "measured",
    "parse",
]
